//! The two implementations of every kernel agree on ordinary, random and adversarial input; a planted fault makes them
//! disagree; the GPU gives the same bits twice.

mod common;

use common::{Noise, agree, gpu, repeats, sees};
use glam::DVec3;
use vorofit::kernel::Kernel;
use vorofit::kernel::closest_point::{self, ClosestInput, ClosestPointTwins};
use vorofit::kernel::sparse::{self, Csr, SparseInput, SparseProduct};
use vorofit::kernel::sum::{self, Segments, Sum, SumInput};
use vorofit::mesh::TriangleMesh;

fn sums(noise: &mut Noise, records: usize, width: usize, segments: usize, size: f64) -> SumInput {
    let keys: Vec<_> = (0..records).map(|_| noise.below(segments) as u32).collect();
    SumInput {
        values: (0..records * width)
            .map(|_| std::array::from_fn(|_| size * noise.next()))
            .collect(),
        width,
        segments: Segments::by_key(keys.into_iter(), segments),
    }
}

#[test]
fn segmented_sums() {
    let noise = &mut Noise(1);
    // Longer than a thread may loop.
    let long = sums(noise, 400_000, 2, 3, 1.0);
    agree::<Sum>(&[
        ("nothing", sums(noise, 0, 1, 1, 1.0)),
        (
            "no segments",
            SumInput {
                values: Vec::new(),
                width: 2,
                segments: Segments::by_key([].into_iter(), 0),
            },
        ),
        ("one record", sums(noise, 1, 1, 1, 1.0)),
        (
            "short segments, many empty",
            sums(noise, 1000, 1, 5000, 1.0),
        ),
        ("ordinary", sums(noise, 20_000, 2, 3000, 1.0)),
        ("small", sums(noise, 20_000, 2, 3000, 1e-3)),
        ("large", sums(noise, 20_000, 2, 3000, 1e3)),
        (
            "more threads than a row of workgroups",
            sums(noise, 1000, 1, 4_200_000, 1.0),
        ),
        ("long segments", long.clone()),
    ]);
    sees::<Sum>(
        &sum::SHADER,
        &long,
        &[
            ("total += block", "total = block"),
            (
                "end = offsets[segment + 1u]",
                "end = offsets[segment + 1u] - 1u",
            ),
            ("* params.stride + lane]", "* params.stride]"),
        ],
    );
    repeats::<Sum>(&long);
}

fn product(
    noise: &mut Noise,
    rows: usize,
    columns: usize,
    entries: usize,
    size: f64,
) -> SparseInput {
    let rows: Vec<Vec<_>> = (0..rows)
        .map(|_| {
            (0..noise.below(entries + 1))
                .map(|_| (noise.below(columns) as u32, noise.next()))
                .collect()
        })
        .collect();
    SparseInput {
        matrix: Csr::from_rows(&rows, columns),
        points: (0..columns).map(|_| size * noise.vector()).collect(),
    }
}

#[test]
fn sparse_products() {
    let noise = &mut Noise(2);
    let ordinary = product(noise, 5000, 400, 20, 1.0);
    let transposed = SparseInput {
        points: (0..5000).map(|_| noise.vector()).collect(),
        matrix: ordinary.matrix.transpose(),
    };
    agree::<SparseProduct>(&[
        ("no rows", product(noise, 0, 1, 1, 1.0)),
        ("empty rows", product(noise, 100, 1, 0, 1.0)),
        ("transposed", transposed),
        ("small", product(noise, 5000, 400, 20, 1e-3)),
        ("large", product(noise, 5000, 400, 20, 1e3)),
        (
            "cancelling",
            SparseInput {
                matrix: Csr::from_rows(&[vec![(0, 1.0), (1, -1.0), (2, 1e-7)]], 3),
                points: vec![DVec3::ONE, DVec3::ONE, DVec3::X],
            },
        ),
        ("ordinary", ordinary.clone()),
    ]);
    sees::<SparseProduct>(
        &sparse::SHADER,
        &ordinary,
        &[
            ("offsets[row + 1u]", "offsets[row + 1u] - 1u"),
            ("values[k] *", "1.01 * values[k] *"),
        ],
    );
    repeats::<SparseProduct>(&ordinary);
}

/// A bumpy sheet of `2 n²` triangles and queries within `reach` of it.
fn sheet(noise: &mut Noise, n: u32, queries: usize, reach: f64) -> ClosestInput {
    let m = n + 1;
    let at = |k: u32| f64::from(k) / f64::from(n) - 0.5;
    let positions: Vec<_> = (0..m * m)
        .map(|k| (at(k % m), at(k / m)))
        .map(|(x, y)| DVec3::new(x, y, 0.2 * (7.0 * x).sin() * (5.0 * y).cos()))
        .collect();
    let corner = (0..m * n).filter(|k| k % m != n);
    let triangles = corner.flat_map(|k| [[k, k + 1, k + m], [k + 1, k + m + 1, k + m]]);
    let points = (0..queries)
        .map(|_| positions[noise.below(positions.len())] + reach * noise.vector())
        .collect();
    ClosestInput {
        mesh: TriangleMesh {
            triangles: triangles.collect(),
            positions,
        },
        points,
    }
}

/// Triangles of every shape anywhere in the cube: needles, caps, segments, points, duplicates.
fn soup(noise: &mut Noise, count: u32) -> ClosestInput {
    let mut mesh = TriangleMesh::default();
    for k in 0..count {
        let (a, b, c) = (noise.vector(), noise.vector(), noise.vector());
        let thin = 10f64.powi(-(k as i32 % 9));
        mesh.positions.extend(match k % 4 {
            0 => [a, b, c],
            1 => [a, b, 0.5 * (a + b) + thin * c],
            2 => [a, a + thin * b, c],
            _ => [a, b, [a, b, 0.3 * a + 0.7 * b][k as usize / 4 % 3]],
        });
        mesh.triangles.push([3 * k, 3 * k + 1, 3 * k + 2]);
        if k % 7 == 0 {
            mesh.triangles.push([3 * k, 3 * k + 1, 3 * k + 2]);
        }
    }
    let points = (0..2000).map(|_| 1.5 * noise.vector()).collect();
    ClosestInput { mesh, points }
}

/// The search from the middle of a sphere has to look at every triangle, more than a thread may.
fn centre_of_a_sphere() -> ClosestInput {
    let n = 200;
    let mut input = sheet(&mut Noise(1), n, 0, 0.0);
    for p in &mut input.mesh.positions {
        let (down, around) = (
            (p.x + 0.5) * std::f64::consts::PI,
            (p.y + 0.5) * std::f64::consts::TAU,
        );
        *p = DVec3::new(
            down.sin() * around.cos(),
            down.sin() * around.sin(),
            down.cos(),
        );
    }
    input.points = vec![DVec3::ZERO, DVec3::splat(1e-9), DVec3::X];
    input
}

fn moved(mut input: ClosestInput, scale: f64, offset: DVec3) -> ClosestInput {
    for p in input.mesh.positions.iter_mut().chain(&mut input.points) {
        *p = offset + scale * *p;
    }
    input
}

#[test]
fn closest_points() {
    let noise = &mut Noise(3);
    let near = sheet(noise, 60, 5000, 0.05);
    let mut on_vertices = near.clone();
    on_vertices.points.clone_from(&near.mesh.positions);
    let far = DVec3::new(4e6, -5e6, 300.0);
    let mut one = sheet(noise, 1, 500, 2.0);
    one.mesh.triangles.truncate(1);
    let mut point = one.clone();
    point.mesh.triangles[0] = [2, 2, 2];
    let soup = soup(noise, 1500);
    agree::<ClosestPointTwins>(&[
        ("no queries", sheet(noise, 2, 0, 1.0)),
        ("one triangle", one),
        ("one point", point),
        ("queries on vertices", on_vertices),
        ("equally far from everything", centre_of_a_sphere()),
        ("far queries", sheet(noise, 30, 1000, 1000.0)),
        ("small", moved(near.clone(), 1e-3, DVec3::ZERO)),
        ("large", moved(near.clone(), 1e3, DVec3::ZERO)),
        ("far away", moved(near.clone(), 1.0, far)),
        ("soup", soup.clone()),
        ("near", near.clone()),
    ]);
    sees::<ClosestPointTwins>(
        &closest_point::SHADER,
        &near,
        &[
            (
                "candidate.squared < best.squared",
                "candidate.squared > best.squared",
            ),
            ("vec2f(v, w) / area", "vec2f(w, v) / area"),
            ("max(max(n.lo_y - p.y", "max(max(p.y - n.lo_y"),
            ("vec2f(1.0 - bc.x, bc.x)", "vec2f(bc.x, 1.0 - bc.x)"),
        ],
    );
    repeats::<ClosestPointTwins>(&soup);
}

#[test]
fn closest_points_are_on_the_same_triangle_but_for_shared_edges() {
    let input = sheet(&mut Noise(8), 60, 20_000, 0.02);
    let cpu = ClosestPointTwins::cpu(&input);
    let mut resident = ClosestPointTwins::upload(gpu(), &input).unwrap();
    let gpu = ClosestPointTwins::gpu(gpu(), &mut resident).unwrap();
    let pairs = || cpu.iter().zip(&gpu);
    let inside = |c: &vorofit::geometry::ClosestPoint| c.barycentric.iter().all(|&b| b > 1e-4);
    let clear = pairs().filter(|(a, _)| inside(a)).count();
    assert!(clear > 10_000, "{clear}");
    // The rest are as near to two triangles across a fold.
    let same = pairs().filter(|(a, b)| inside(a) && a.triangle == b.triangle);
    assert!(same.count() as f64 > 0.999 * clear as f64);
}
