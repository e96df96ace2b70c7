use super::*;

/// Numbers in −1..1 from a fixed sequence.
fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(2).wrapping_add(1);
    (0..count)
        .map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        })
        .collect()
}

fn points(count: usize, seed: u64) -> Vec<DVec3> {
    noise(3 * count, seed)
        .chunks(3)
        .map(DVec3::from_slice)
        .collect()
}

fn brute_force(positions: &[DVec3], triangles: &[[u32; 3]], p: DVec3) -> (f64, u32) {
    triangles
        .iter()
        .map(|t| {
            Triangle::new(t.map(|v| positions[v as usize]))
                .nearest(p)
                .distance_squared
        })
        .zip(0..)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .expect("not empty")
}

/// Every way to ask gives the answer of a search through all triangles, to the bit.
fn check(positions: &[DVec3], triangles: &[[u32; 3]], queries: &[DVec3]) {
    let bvh = Bvh::new(positions, triangles).expect("triangles");
    check_tree(&bvh, positions, triangles, queries);
}

/// The same of a tree that is there.
fn check_tree(bvh: &Bvh, positions: &[DVec3], triangles: &[[u32; 3]], queries: &[DVec3]) {
    assert_covers(bvh, positions, triangles);
    let all = bvh.closest_all(queries);
    for (&p, together) in queries.iter().zip(&all) {
        let alone = bvh.closest(p);
        let (distance_squared, triangle) = brute_force(positions, triangles, p);
        assert_eq!(alone.distance_squared, distance_squared);
        assert_eq!(alone.triangle, triangle);
        assert_eq!(alone, *together);
        let distance = distance_squared.sqrt();
        assert_eq!(bvh.closest_within(p, distance * (1.0 + 1e-15)), Some(alone));
        if distance > 0.0 {
            assert_eq!(bvh.closest_within(p, distance * (1.0 - 1e-15)), None);
        }
    }
}

/// Every triangle is in one leaf, and inside the boxes above it.
fn assert_covers(bvh: &Bvh, positions: &[DVec3], triangles: &[[u32; 3]]) {
    let mut seen = vec![0; triangles.len()];
    let everything = (DVec3::NEG_INFINITY, DVec3::INFINITY);
    let mut stack = vec![(0u32, everything)];
    while let Some((child, (lo, hi))) = stack.pop() {
        if child & LEAF != 0 {
            let (first, count) = leaf_range(child);
            for leaf in &bvh.leaves[first as usize..(first + count) as usize] {
                seen[leaf.index as usize] += 1;
                for v in triangles[leaf.index as usize] {
                    let p = (positions[v as usize] - bvh.center) * bvh.scale;
                    assert!(p.cmpgt(lo).all() && p.cmplt(hi).all());
                }
            }
            continue;
        }
        let node = &bvh.nodes[child as usize];
        for k in 0..4 {
            let corner = |b: &[Vec4; 3]| DVec3::from(b.map(|c| f64::from(c[k])));
            let bounds = (lo.max(corner(&node.lo)), hi.min(corner(&node.hi)));
            stack.push((node.children[k], bounds));
        }
    }
    assert!(seen.iter().all(|&n| n == 1));
}

/// Triangles of size `size` anywhere in the cube.
fn soup(count: usize, size: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let centers = points(count, 1);
    let positions = points(3 * count, 2)
        .iter()
        .enumerate()
        .map(|(i, &p)| centers[i / 3] + size * p)
        .collect();
    let triangles = (0..count as u32)
        .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
        .collect();
    (positions, triangles)
}

#[test]
fn no_triangle_is_refused() {
    assert!(Bvh::new(&[DVec3::ZERO], &[]).is_err());
}

#[test]
fn one_triangle_one_point_and_many_copies() {
    let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
    check(&positions, &[[0, 1, 2]], &points(50, 3));
    check(&positions, &[[1, 1, 1]], &points(50, 4));
    check(&positions, &[[0, 1, 2]; 100], &points(50, 5));
    check(&positions, &[[2, 2, 2]; 1000], &points(50, 6));
}

#[test]
fn slivers_points_segments_and_duplicates_in_a_soup() {
    let (mut positions, mut triangles) = soup(400, 0.1);
    for (k, t) in triangles.clone().iter().enumerate() {
        let [a, b, c] = t.map(|v| v as usize);
        match k % 4 {
            0 => positions[c] = positions[a].lerp(positions[b], 0.4) + 1e-9 * positions[c],
            1 => positions[b] = positions[a],
            2 => triangles.push([t[0]; 3]),
            _ => triangles.push(*t),
        }
    }
    let mut queries = points(300, 7);
    // On the triangles, on their corners, and far away.
    queries.extend(triangles.iter().map(|t| {
        t.iter()
            .map(|&v| positions[v as usize] / 3.0)
            .sum::<DVec3>()
    }));
    queries.extend_from_slice(&positions[..100]);
    queries.extend(points(20, 8).iter().map(|p| 1e9 * p));
    check(&positions, &triangles, &queries);
}

#[test]
fn far_from_the_origin_and_at_any_scale() {
    let (positions, triangles) = soup(300, 0.05);
    let queries = points(100, 9);
    for (scale, shift) in [(1e-12, 0.0), (1e12, 0.0), (1.0, 5e6), (1e-3, 5e6)] {
        let place = |points: &[DVec3]| -> Vec<DVec3> {
            points
                .iter()
                .map(|p| scale * p + DVec3::splat(shift))
                .collect()
        };
        check(&place(&positions), &triangles, &place(&queries));
    }
}

#[test]
fn triangles_in_a_row_that_shrink_without_end_do_not_deepen_the_tree() {
    let positions: Vec<_> = (0..900).map(|i| DVec3::X * 0.5f64.powi(i)).collect();
    let triangles: Vec<_> = (0..898u32).map(|t| [t, t + 1, t + 2]).collect();
    check(&positions, &triangles, &points(30, 10));
}

#[test]
fn a_tree_follows_its_mesh() {
    let (mut positions, triangles) = soup(400, 0.1);
    let mut bvh = Bvh::new(&positions, &triangles).unwrap();
    let queries = points(200, 12);
    for (size, seed) in [(0.01, 13), (3.0, 14), (0.0, 15), (1e6, 16)] {
        for (p, change) in positions.iter_mut().zip(points(1200, seed)) {
            *p = (*p + change) * size;
        }
        bvh.refit(&positions, &triangles);
        check_tree(&bvh, &positions, &triangles, &queries);
    }
}

#[test]
fn what_is_near_enough_is_not_searched_further() {
    let (positions, triangles) = soup(2000, 0.05);
    let bvh = Bvh::new(&positions, &triangles).unwrap();
    let queries = points(2000, 17);
    let exact = bvh.closest_all(&queries);
    assert_eq!(bvh.closest_beyond(&queries, 0.0), exact);
    let enough = 0.05;
    let found = bvh.closest_beyond(&queries, enough);
    let mut cut_short = 0;
    for (exact, found) in exact.iter().zip(&found) {
        if exact.distance_squared > enough * enough {
            assert_eq!(exact, found);
        } else {
            assert!(found.distance_squared <= enough * enough);
            cut_short += usize::from(exact != found);
        }
    }
    assert!(cut_short > 10, "{cut_short}");
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let (positions, triangles) = soup(20_000, 0.02);
    let queries = points(5000, 11);
    let run = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a thread pool")
            .install(|| {
                let bvh = Bvh::new(&positions, &triangles).expect("triangles");
                let order: Vec<_> = bvh.leaves.iter().map(|leaf| leaf.index).collect();
                (
                    bytemuck::cast_slice::<_, u32>(&bvh.nodes).to_vec(),
                    order,
                    bvh.closest_all(&queries),
                )
            })
    };
    assert!(run(1) == run(3));
}
