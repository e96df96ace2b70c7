//! Facts about subdivision that hold exactly: splines on regular grids, limits that no further level moves, and the rules of sharp edges.

use super::*;
use crate::geometry::random::Random;

pub(super) fn control(positions: Vec<DVec3>, faces: Vec<Vec<u32>>) -> ControlMesh {
    PolygonMesh::from_faces(positions, faces).into()
}

pub(super) fn scattered(n: usize) -> Vec<DVec3> {
    let mut random = Random::new(n as u64);
    let mut coordinate = || random.between(-1.0, 1.0);
    (0..n)
        .map(|_| DVec3::new(coordinate(), coordinate(), coordinate()))
        .collect()
}

/// Quads around vertex 0, which is of valence `n`; open.
pub(super) fn quad_fan(n: u32) -> ControlMesh {
    let ring = |k: u32| 1 + k % (2 * n);
    let faces = (0..n).map(|i| vec![0, ring(2 * i), ring(2 * i + 1), ring(2 * i + 2)]);
    control(scattered(2 * n as usize + 1), faces.collect())
}

/// Kites around two poles of valence `n`; the other vertices have valence 3. Closed.
pub(super) fn trapezohedron(n: u32) -> ControlMesh {
    let ring = |k: u32| 2 + k % (2 * n);
    let top = (0..n).map(|i| vec![0, ring(2 * i), ring(2 * i + 1), ring(2 * i + 2)]);
    let bottom = (0..n).map(|i| vec![1, ring(2 * i + 3), ring(2 * i + 2), ring(2 * i + 1)]);
    control(scattered(2 * n as usize + 2), top.chain(bottom).collect())
}

/// Triangles around two poles of valence `n`; the other vertices have valence 4. Closed.
pub(super) fn bipyramid(n: u32) -> ControlMesh {
    let ring = |k: u32| 2 + k % n;
    let top = (0..n).map(|i| vec![0, ring(i), ring(i + 1)]);
    let bottom = (0..n).map(|i| vec![1, ring(i + 1), ring(i)]);
    control(scattered(n as usize + 2), top.chain(bottom).collect())
}

/// Quads between two n-gons. Closed.
fn prism(n: u32) -> ControlMesh {
    let sides = (0..n).map(|i| vec![i, (i + 1) % n, n + (i + 1) % n, n + i]);
    let caps = [(0..n).rev().collect(), (n..2 * n).collect()];
    control(scattered(2 * n as usize), sides.chain(caps).collect())
}

/// A grid of unit squares, `n` points a side, with random heights; `triangles` cuts each into two.
pub(super) fn grid(n: u32, triangles: bool) -> ControlMesh {
    let mut positions = scattered((n * n) as usize);
    for (i, p) in positions.iter_mut().enumerate() {
        (p.x, p.y) = (f64::from(i as u32 % n), f64::from(i as u32 / n));
    }
    let mut faces = Vec::new();
    for (i, j) in (1..n).flat_map(|j| (1..n).map(move |i| (i, j))) {
        let at = |di: u32, dj: u32| (j - dj) * n + i - di;
        if triangles {
            faces.push(vec![at(1, 1), at(0, 1), at(0, 0)]);
            faces.push(vec![at(1, 1), at(0, 0), at(1, 0)]);
        } else {
            faces.push(vec![at(1, 1), at(0, 1), at(0, 0), at(1, 0)]);
        }
    }
    control(positions, faces)
}

pub(super) fn crease(a: u32, b: u32, sharpness: f64) -> Crease {
    Crease {
        edge: [a, b],
        sharpness,
    }
}

fn positions(control: &ControlMesh, scheme: Scheme, levels: usize, limit: bool) -> Vec<DVec3> {
    let model = Model::new(control, scheme, levels, limit).unwrap();
    model.connectivity.validate().unwrap();
    model.positions(&control.mesh.positions)
}

pub(super) fn largest_distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    let distances = a.iter().zip(b).map(|(a, b)| (*a - *b).length());
    distances.fold(0.0, f64::max)
}

/// The limits of one level's vertices are the same whether taken there or one level further on.
fn assert_limit_is_fixed(name: &str, control: &ControlMesh, scheme: Scheme) {
    for levels in 0..3 {
        let here = positions(control, scheme, levels, true);
        let further = positions(control, scheme, levels + 1, true);
        let distance = largest_distance(&here, &further);
        assert!(
            distance < 1e-12,
            "{name}, level {levels}: limits differ by {distance:e}"
        );
    }
}

#[test]
fn bad_control_meshes_are_refused_by_name() {
    let refusal = |control: &ControlMesh, scheme| {
        let refused = Model::new(control, scheme, 1, true);
        refused.expect_err("must be refused").to_string()
    };
    let empty = ControlMesh::default();
    assert!(refusal(&empty, Scheme::CatmullClark).contains("no faces"));
    let unused = control(scattered(4), vec![vec![0, 1, 2]]);
    assert!(refusal(&unused, Scheme::Loop).contains("control point 3"));
    assert!(refusal(&quad_fan(5), Scheme::Loop).contains("face 0 has 4 corners"));
    let mut tagged = quad_fan(5);
    for (bad, message) in [
        (crease(0, 2, 1.0), "vertices 0 and 2"),
        (crease(99, 0, 1.0), "vertices 99 and 0"),
        (crease(0, 99, 1.0), "vertices 0 and 99"),
        (crease(0, 1, f64::NAN), "sharpness NaN"),
        (crease(0, 1, -1.0), "sharpness -1"),
    ] {
        tagged.creases = vec![bad];
        assert!(refusal(&tagged, Scheme::CatmullClark).contains(message));
    }
    tagged.creases.clear();
    tagged.corners = vec![99];
    assert!(refusal(&tagged, Scheme::CatmullClark).contains("corner 99"));
    let levels = Model::new(&quad_fan(5), Scheme::CatmullClark, 40, false);
    let message = levels.expect_err("too fine").to_string();
    assert!(message.contains("40 levels"), "{message}");
}

#[test]
fn one_triangle_and_one_quad_are_surfaces() {
    for n in [3, 4] {
        let one = control(scattered(n), vec![(0..n as u32).collect()]);
        assert_limit_is_fixed("one face", &one, Scheme::CatmullClark);
        let limit = positions(&one, Scheme::CatmullClark, 2, true);
        assert_eq!(
            limit[..n],
            one.mesh.positions[..],
            "corners of one face stay"
        );
    }
}

#[test]
fn limits_are_fixed_at_every_valence() {
    for n in 3..=30 {
        assert_limit_is_fixed("trapezohedron", &trapezohedron(n), Scheme::CatmullClark);
        assert_limit_is_fixed("bipyramid", &bipyramid(n), Scheme::Loop);
    }
    for n in [3, 4, 7, 30] {
        assert_limit_is_fixed("fan", &quad_fan(n), Scheme::CatmullClark);
        assert_limit_is_fixed("prism", &prism(n), Scheme::CatmullClark);
        assert_limit_is_fixed("triangles", &bipyramid(n), Scheme::CatmullClark);
    }
    assert_limit_is_fixed("grid", &grid(4, true), Scheme::Loop);
    assert_limit_is_fixed("doublet", &quad_fan(2), Scheme::CatmullClark);
}

#[test]
fn limits_are_fixed_with_creases_darts_corners_and_semi_sharp_edges() {
    let tags: [&[f64]; 7] = [
        &[f64::INFINITY],
        &[f64::INFINITY, f64::INFINITY],
        &[f64::INFINITY; 3],
        &[0.3],
        &[0.3, 1.7],
        &[2.5, f64::INFINITY, 1.0],
        &[3.0, 0.4, 1.2, f64::INFINITY],
    ];
    for n in [3, 4, 5, 6, 9, 30] {
        for tag in tags {
            let mut quads = trapezohedron(n);
            let mut triangles = bipyramid(n);
            for (k, &sharpness) in tag.iter().enumerate().take(n as usize) {
                quads.creases.push(crease(0, 2 + 2 * k as u32, sharpness));
                triangles.creases.push(crease(2 + k as u32, 0, sharpness));
            }
            let name = format!("valence {n}, sharpness {tag:?}");
            assert_limit_is_fixed(&name, &quads, Scheme::CatmullClark);
            assert_limit_is_fixed(&name, &triangles, Scheme::Loop);
            quads.corners.push(0);
            let fixed = positions(&quads, Scheme::CatmullClark, 2, true)[0];
            assert_eq!(fixed, quads.mesh.positions[0], "a tagged corner stays");
        }
    }
}

#[test]
fn plain_subdivision_converges_to_the_limit() {
    let mut dart = trapezohedron(5);
    dart.creases.push(crease(0, 2, f64::INFINITY));
    let mut semi_sharp = bipyramid(7);
    semi_sharp.creases.push(crease(0, 2, 1.4));
    for (control, scheme) in [
        (dart, Scheme::CatmullClark),
        (prism(5), Scheme::CatmullClark),
        (semi_sharp, Scheme::Loop),
    ] {
        let limit = positions(&control, scheme, 0, true);
        let plain = positions(&control, scheme, 7, false);
        let start = largest_distance(&limit, &control.mesh.positions);
        let end = largest_distance(&limit, &plain);
        assert!(
            end < 2e-3 * start,
            "{scheme:?}: {start} has only shrunk to {end}"
        );
    }
}

fn is_between(x: f64, y: f64, low: f64, high: f64) -> bool {
    x.min(y) > low - 1e-9 && x.max(y) < high + 1e-9
}

/// The uniform cubic B-spline.
fn cubic(t: f64) -> f64 {
    match t.abs() {
        t if t < 1.0 => 2.0 / 3.0 - t * t + 0.5 * t * t * t,
        t if t < 2.0 => (2.0 - t).powi(3) / 6.0,
        _ => 0.0,
    }
}

#[test]
fn catmull_clark_on_a_regular_grid_is_the_bicubic_spline() {
    let grid = grid(8, false);
    let mut checked = 0;
    for p in positions(&grid, Scheme::CatmullClark, 3, true) {
        if !is_between(p.x, p.y, 1.0, 6.0) {
            continue;
        }
        let spline: f64 = (grid.mesh.positions.iter())
            .map(|c| c.z * cubic(p.x - c.x) * cubic(p.y - c.y))
            .sum();
        assert!(
            (p.z - spline).abs() < 1e-13,
            "{p} should have height {spline}"
        );
        checked += 1;
    }
    assert_eq!(checked, 41 * 41);
}

#[test]
fn loop_on_a_regular_grid_reproduces_cubics_as_the_quartic_box_spline_does() {
    // Skewed so that all triangles are equilateral; the spline of |p|² lies 1/2 above it, that of a harmonic cubic on it.
    let mut grid = grid(9, true);
    for p in &mut grid.mesh.positions {
        // The diagonals of the squares become edges too: (1, 0) and (1, 1) at 60 degrees.
        let (x, y) = (p.x - 0.5 * p.y, p.y * 0.75f64.sqrt());
        *p = DVec3::new(x, y, x * x + y * y + x * x * x - 3.0 * x * y * y);
    }
    let fine = positions(&grid, Scheme::Loop, 3, true);
    let mut checked = 0;
    for p in fine {
        let (x, y) = (p.x, p.y);
        let (u, v) = (x + 0.5 * y / 0.75f64.sqrt(), y / 0.75f64.sqrt());
        if !is_between(u, v, 1.0, 7.0) {
            continue;
        }
        let spline = 0.5 + x * x + y * y + x * x * x - 3.0 * x * y * y;
        assert!(
            (p.z - spline).abs() < 1e-11,
            "{p} should have height {spline}"
        );
        checked += 1;
    }
    assert_eq!(checked, 49 * 49);
}

#[test]
fn boundaries_are_cubic_splines_of_the_boundary_points_and_end_in_corners() {
    for (triangles, scheme) in [(false, Scheme::CatmullClark), (true, Scheme::Loop)] {
        let grid = grid(6, triangles);
        let model = Model::new(&grid, scheme, 2, true).unwrap();
        let fine = model.positions(&grid.mesh.positions);
        let on_boundary = |v: u32| {
            let p = grid.mesh.positions[v as usize];
            p.x.min(p.y) == 0.0 || p.x.max(p.y) == 5.0
        };
        let mut checked = 0;
        for v in (0..fine.len() as u32).filter(|&v| model.connectivity.is_boundary_vertex(v)) {
            assert!(model.matrix.row(v as usize).all(|(c, _)| on_boundary(c)));
            let p = fine[v as usize];
            if p.y == 0.0 && is_between(p.x, p.x, 1.0, 4.0) {
                let row = &grid.mesh.positions[..6];
                let spline: f64 = row.iter().map(|c| c.z * cubic(p.x - c.x)).sum();
                assert!((p.z - spline).abs() < 1e-13);
                checked += 1;
            }
        }
        assert_eq!(checked, 13, "{scheme:?}");
        // The corner of two triangles is a smooth piece of boundary; that of one face stays.
        let single = if triangles { 5 } else { 0 };
        assert_eq!(fine[single], grid.mesh.positions[single]);
    }
}

#[test]
fn sharpness_is_used_up_level_by_level() {
    let with = |sharpness: f64, levels| {
        let mut mesh = trapezohedron(6);
        mesh.creases = vec![crease(0, 2, sharpness), crease(0, 6, sharpness)];
        positions(&mesh, Scheme::CatmullClark, levels, false)
    };
    let infinite = with(f64::INFINITY, 2);
    assert_eq!(
        with(2.0, 2),
        infinite,
        "two levels are as sharp as for ever"
    );
    assert_eq!(with(10.0, 2), infinite, "ten is for ever");
    assert!(largest_distance(&with(1.5, 2), &infinite) > 1e-3);
    let blend: Vec<DVec3> = (with(0.0, 1).iter().zip(with(1.0, 1)))
        .map(|(smooth, sharp)| smooth.lerp(sharp, 0.3))
        .collect();
    assert!(largest_distance(&with(0.3, 1), &blend) < 1e-15);
}

#[test]
fn rows_are_convex_combinations() {
    for (control, scheme) in [
        (trapezohedron(9), Scheme::CatmullClark),
        (prism(5), Scheme::CatmullClark),
        (bipyramid(3), Scheme::Loop),
        (grid(4, true), Scheme::Loop),
        (grid(4, false), Scheme::Polygon),
    ] {
        for limit in [false, true] {
            let model = Model::new(&control, scheme, 2, limit).unwrap();
            for r in 0..model.matrix.row_count() {
                let sum: f64 = model.matrix.row(r).map(|e| e.1).sum();
                assert!(
                    (sum - 1.0).abs() < 1e-14,
                    "{scheme:?}, row {r} sums to {sum}"
                );
                assert!(model.matrix.row(r).all(|e| e.1 > -1e-16));
            }
        }
    }
}

#[test]
fn subdividing_the_control_mesh_keeps_the_limit_surface() {
    let mut quads = prism(6);
    quads.creases = vec![crease(0, 1, f64::INFINITY), crease(1, 2, 2.3)];
    quads.corners = vec![4];
    let finer = subdivide(&quads, Scheme::CatmullClark).unwrap();
    assert_eq!(finer.creases.len(), 4);
    assert_eq!(finer.corners, [4]);
    let direct = positions(&quads, Scheme::CatmullClark, 2, true);
    let staged = positions(&finer, Scheme::CatmullClark, 1, true);
    assert_eq!(direct.len(), staged.len());
    assert!(largest_distance(&direct, &staged) < 1e-14);
}

#[test]
fn a_limit_mesh_is_the_surface_of_the_model() {
    for (control, scheme) in [
        (grid(4, true), Scheme::Loop),
        (bipyramid(7), Scheme::Loop),
        (quad_fan(5), Scheme::CatmullClark),
    ] {
        for levels in [0, 2] {
            let model = Model::new(&control, scheme, levels, true).unwrap();
            let expected = model.surface(&control.mesh.positions);
            let found = limit_mesh(&control, scheme, levels).unwrap();
            assert!(found.faces().eq(expected.faces()));
            for (p, q) in found.positions.iter().zip(&expected.positions) {
                assert!(p.distance(*q) < 1e-14, "{scheme:?}, {levels} levels");
            }
        }
    }
    assert!(limit_mesh(&grid(4, true), Scheme::Loop, 40).is_err());
}

#[test]
fn polygons_stay_where_they_are() {
    let triangles = bipyramid(5);
    let model = Model::new(&triangles, Scheme::Polygon, 2, true).unwrap();
    let surface = model.surface(&triangles.mesh.positions);
    assert_eq!(surface.face_count(), 10 * 16);
    assert_eq!(surface.positions[..7], triangles.mesh.positions[..]);
    let (fine, coarse) = (
        surface.triangulate().area(),
        triangles.mesh.triangulate().area(),
    );
    assert!((fine - coarse).abs() < 1e-13 * coarse);
}

#[test]
fn faces_know_their_patch_and_the_topology_stays() {
    let prism = prism(5);
    let model = Model::new(&prism, Scheme::CatmullClark, 2, true).unwrap();
    assert_eq!(model.connectivity.euler_characteristic(), 2);
    assert!(model.patches.is_sorted());
    for (f, face) in prism.mesh.faces().enumerate() {
        let count = model.patches.iter().filter(|&&p| p as usize == f).count();
        assert_eq!(count, face.len() * 4 * 2, "face {f}");
    }
    let checked = Connectivity::of(&model.surface(&prism.mesh.positions)).unwrap();
    assert_eq!(
        checked, model.connectivity,
        "paired by search and by arithmetic"
    );
}

#[test]
fn the_matrix_is_the_same_for_any_number_of_threads() {
    let build = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap().install(|| {
            let model = Model::new(&grid(20, false), Scheme::CatmullClark, 2, true);
            model.unwrap().matrix
        })
    };
    assert_eq!(build(1), build(3));
}
