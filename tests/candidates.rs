//! Candidate lists hold every owner, also after motions within their slack, and little else.

use glam::DVec3;
use vorofit::geometry::clip::Clipper;
use vorofit::geometry::random::Random;
use vorofit::geometry::triangle_tree::{TriangleTree, spatial_order};
use vorofit::kernel::candidates::Candidates;
use vorofit::kernel::restricted_voronoi::{self, Metric};
use vorofit::mesh::shapes::torus;

/// A vector in the unit ball's bounding cube.
fn noise(random: &mut Random) -> DVec3 {
    let mut coordinate = || 2.0 * random.uniform() - 1.0;
    DVec3::new(coordinate(), coordinate(), coordinate())
}

/// A torus of 2,400 triangles with areas from slivers to a few cells, in spatial order.
fn surface(random: &mut Random) -> Vec<[DVec3; 3]> {
    let mesh = torus(1.0, 0.4, 40, 30).triangulate();
    let bent: Vec<DVec3> = mesh
        .positions
        .iter()
        .map(|p| p + 0.03 * noise(random))
        .collect();
    let mut triangles: Vec<[DVec3; 3]> = mesh
        .triangles
        .iter()
        .map(|t| t.map(|v| bent[v as usize]))
        .collect();
    for t in triangles.iter_mut().step_by(50) {
        t[2] = t[0].lerp(t[1], 0.3) + 1e-9 * (t[2] - t[0]);
    }
    let centers: Vec<DVec3> = triangles
        .iter()
        .map(|t| (t[0] + t[1] + t[2]) / 3.0)
        .collect();
    spatial_order(&centers)
        .iter()
        .map(|&t| triangles[t as usize])
        .collect()
}

/// Seeds near the surface, anywhere, in one clump, far away, on a lattice and twice at a place.
fn seed_sets(triangles: &[[DVec3; 3]], random: &mut Random) -> Vec<(&'static str, Vec<DVec3>)> {
    let on = |count: usize, off: f64, random: &mut Random| -> Vec<DVec3> {
        (0..count)
            .map(|_| {
                let t = triangles[(random.uniform() * triangles.len() as f64) as usize];
                t[0] + off * noise(random)
            })
            .collect()
    };
    let lattice = (0..1000)
        .map(|k| 0.2 * DVec3::new((k % 10) as f64, (k / 10 % 10) as f64, (k / 100) as f64) - 1.0)
        .collect();
    let near = on(700, 0.02, random);
    vec![
        ("one", on(1, 0.0, random)),
        ("two", on(2, 0.0, random)),
        ("fewer than a block", on(9, 0.3, random)),
        ("corners of triangles", on(1500, 0.0, random)),
        ("near", near.clone()),
        ("scattered", (0..900).map(|_| 1.5 * noise(random)).collect()),
        (
            "one clump",
            (0..800)
                .map(|_| DVec3::new(0.9, 0.1, 0.4) + 0.05 * noise(random))
                .collect(),
        ),
        (
            "far away",
            (0..600)
                .map(|_| DVec3::new(30.0, -10.0, 5.0) + noise(random))
                .collect(),
        ),
        ("lattice", lattice),
        ("pairs", near.iter().flat_map(|&x| [x, x]).collect()),
        ("all at one place", vec![DVec3::new(0.2, 0.3, 0.1); 50]),
    ]
}

fn nearest(seeds: &[DVec3], y: DVec3) -> u32 {
    let distances = seeds.iter().map(|x| (x - y).length_squared());
    let least = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
    least.expect("there are seeds").0 as u32
}

/// Every owner at the corners and at random points of each triangle is in its list.
fn assert_complete(
    name: &str,
    triangles: &[[DVec3; 3]],
    seeds: &[DVec3],
    candidates: &Candidates,
    random: &mut Random,
) {
    for (t, corners) in triangles.iter().enumerate() {
        let [a, b, c] = *corners;
        let (u, v) = (random.uniform(), random.uniform());
        let inside = a + (b - a) * (u * (1.0 - v)) + (c - a) * (u * v);
        for y in [a, b, c, inside] {
            let owner = nearest(seeds, y);
            assert!(
                candidates.of(t).contains(&owner),
                "{name}, slack {}: triangle {t} lacks {owner}",
                candidates.slack
            );
        }
    }
}

#[test]
fn lists_hold_every_owner() {
    let mut random = Random::new(1);
    let triangles = surface(&mut random);
    let tree = TriangleTree::new(&triangles);
    for (name, seeds) in seed_sets(&triangles, &mut random) {
        let candidates = Candidates::find(&tree, &triangles, &seeds, 0.0);
        assert_eq!(candidates.offsets.len(), triangles.len() + 1);
        assert!((0..triangles.len()).all(|t| candidates.of(t).is_sorted_by(|a, b| a < b)));
        assert_complete(name, &triangles, &seeds, &candidates, &mut random);
    }
}

#[test]
fn lists_hold_every_owner_at_other_scales_and_places() {
    let mut random = Random::new(2);
    let triangles = surface(&mut random);
    let sets = seed_sets(&triangles, &mut random);
    for (scale, shift) in [(1e-3, 0.0), (1e3, 0.0), (1.0, 1e4)] {
        let place = |p: DVec3| p * scale + shift;
        let moved: Vec<[DVec3; 3]> = triangles.iter().map(|t| t.map(place)).collect();
        let tree = TriangleTree::new(&moved);
        let (name, seeds) = &sets[4];
        let seeds: Vec<DVec3> = seeds.iter().map(|&x| place(x)).collect();
        let candidates = Candidates::find(&tree, &moved, &seeds, 0.0);
        assert_complete(name, &moved, &seeds, &candidates, &mut random);
    }
}

#[test]
fn lists_stay_complete_within_the_slack() {
    let mut random = Random::new(3);
    let triangles = surface(&mut random);
    let tree = TriangleTree::new(&triangles);
    for (name, seeds) in seed_sets(&triangles, &mut random) {
        for slack in [0.003, 0.05] {
            let candidates = Candidates::find(&tree, &triangles, &seeds, slack);
            // Half of the slack for the seeds, half for the corners, used up by every one.
            let mut step = || 0.4999 * slack * noise(&mut random).normalize();
            let seeds: Vec<DVec3> = seeds.iter().map(|x| x + step()).collect();
            let moved: Vec<[DVec3; 3]> = triangles.iter().map(|t| t.map(|p| p + step())).collect();
            assert_complete(name, &moved, &seeds, &candidates, &mut random);
        }
    }
}

#[test]
fn lists_are_hardly_longer_than_the_true_ones() {
    let mut random = Random::new(4);
    let triangles = surface(&mut random);
    let tree = TriangleTree::new(&triangles);
    for (name, seeds) in &seed_sets(&triangles, &mut random)[4..6] {
        let candidates = Candidates::find(&tree, &triangles, seeds, 0.0);
        let mut clipper = Clipper::default();
        let mut true_pairs = 0;
        for (t, corners) in triangles.iter().enumerate() {
            clipper.cells(corners, seeds, candidates.of(t), false, |_, _, _| {
                true_pairs += 1;
            });
        }
        let ratio = candidates.seeds.len() as f64 / f64::from(true_pairs);
        assert!(ratio < 1.15, "{name}: {ratio} candidates a true pair");
    }
}

#[test]
fn no_triangles_and_no_seeds_give_empty_lists() {
    let none = Candidates::find(&TriangleTree::default(), &[], &[DVec3::ZERO], 0.0);
    assert_eq!(none.offsets, [0]);
    let triangles = [[DVec3::ZERO, DVec3::X, DVec3::Y]; 3];
    let tree = TriangleTree::new(&triangles);
    let none = Candidates::find(&tree, &triangles, &[], 0.0);
    assert_eq!(none.offsets, [0; 4]);
    assert!(none.seeds.is_empty());
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let mut random = Random::new(5);
    let triangles = surface(&mut random);
    let (_, seeds) = seed_sets(&triangles, &mut random).swap_remove(4);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build().expect("threads").install(|| {
            let tree = TriangleTree::new(&triangles);
            let candidates = Candidates::find(&tree, &triangles, &seeds, 0.0);
            let metric = Metric::anisotropic(5.0);
            let cells = restricted_voronoi::cpu(&triangles, &seeds, &candidates, metric);
            (candidates, cells)
        })
    };
    let one = with(1);
    assert_eq!(one, with(2));
    assert_eq!(one, with(7));
}
