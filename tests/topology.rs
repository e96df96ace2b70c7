//! Simplification: topology, boundaries and sharp edges stay; counts are exact; bad input is survived.

use glam::DVec3;
use std::collections::HashMap;
use vorofit::mesh::TriangleMesh;
use vorofit::topology::{Simplified, Target, simplify};

/// Faces per edge.
fn edges(mesh: &TriangleMesh) -> HashMap<[u32; 2], usize> {
    let mut faces = HashMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            *faces.entry([a.min(b), a.max(b)]).or_default() += 1;
        }
    }
    faces
}

fn euler(mesh: &TriangleMesh) -> isize {
    (mesh.positions.len() + mesh.triangles.len()) as isize - edges(mesh).len() as isize
}

/// Every edge has the numbers of faces given, no triangle repeats a vertex or another, every vertex is used.
fn assert_valid(mesh: &TriangleMesh, allowed: &[usize]) {
    let mut sorted: Vec<_> = mesh
        .triangles
        .iter()
        .map(|&t| {
            let mut t = t;
            t.sort_unstable();
            t
        })
        .collect();
    sorted.sort_unstable();
    assert!(
        sorted.windows(2).all(|w| w[0] != w[1]),
        "a triangle is there twice"
    );
    assert!(
        sorted.iter().all(|t| t[0] != t[1] && t[1] != t[2]),
        "a triangle repeats a vertex"
    );
    let mut used = vec![false; mesh.positions.len()];
    mesh.triangles
        .iter()
        .flatten()
        .for_each(|&v| used[v as usize] = true);
    assert!(used.into_iter().all(|u| u), "a vertex is unused");
    assert!(
        edges(mesh).values().all(|n| allowed.contains(n)),
        "an edge has another number of faces"
    );
}

/// A grid of `n` by `m` cells, two triangles each, mapped by `shape`; closed where `shape` is periodic, since equal positions are merged.
fn grid(n: usize, m: usize, shape: impl Fn(f64, f64) -> DVec3) -> TriangleMesh {
    let positions = (0..=n)
        .flat_map(|i| (0..=m).map(move |j| (i, j)))
        .map(|(i, j)| shape(i as f64 / n as f64, j as f64 / m as f64))
        .collect();
    let at = |i: usize, j: usize| (i * (m + 1) + j) as u32;
    let triangles = (0..n)
        .flat_map(|i| (0..m).map(move |j| (i, j)))
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    TriangleMesh {
        positions,
        triangles,
    }
}

/// cos and sin of whole turns, with the same bits at 0 and 1.
fn turn(t: f64) -> (f64, f64) {
    let angle = std::f64::consts::TAU * t.fract();
    (angle.cos(), angle.sin())
}

fn torus(n: usize, m: usize) -> TriangleMesh {
    grid(n, m, |u, v| {
        let ((cu, su), (cv, sv)) = (turn(u), turn(v));
        let r = 1.0 + 0.4 * cv;
        DVec3::new(r * cu, r * su, 0.4 * sv)
    })
}

fn sphere(n: usize) -> TriangleMesh {
    grid(2 * n, n, |u, v| {
        let (c, s) = turn(u);
        if v == 0.0 || v == 1.0 {
            return DVec3::new(0.0, 0.0, 2.0 * v - 1.0);
        }
        let (sin, cos) = (std::f64::consts::PI * v).sin_cos();
        DVec3::new(sin * c, sin * s, -cos)
    })
}

/// The six sides of a cube, `n` by `n` cells each.
fn cube(n: usize) -> TriangleMesh {
    let mut all = TriangleMesh::default();
    for axis in 0..3 {
        for side in [0.0, 1.0] {
            let face = grid(n, n, |u, v| {
                let (u, v) = if side == 0.0 { (v, u) } else { (u, v) };
                let mut p = [0.0; 3];
                (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (side, u, v);
                DVec3::from_array(p)
            });
            append(&mut all, &face);
        }
    }
    all
}

fn append(mesh: &mut TriangleMesh, other: &TriangleMesh) {
    let first = mesh.positions.len() as u32;
    mesh.positions.extend(&other.positions);
    mesh.triangles
        .extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
}

fn boundary_length(mesh: &TriangleMesh) -> f64 {
    let length =
        |e: &[u32; 2]| mesh.positions[e[0] as usize].distance(mesh.positions[e[1] as usize]);
    edges(mesh)
        .iter()
        .filter(|(_, n)| **n == 1)
        .map(|(e, _)| length(e))
        .sum()
}

#[test]
fn degenerate_input_is_survived() {
    let empty = simplify(&TriangleMesh::default(), Target::Faces(0));
    assert!(empty.reached && empty.mesh.triangles.is_empty());
    let point = TriangleMesh {
        positions: vec![DVec3::ONE; 3],
        triangles: vec![[0, 1, 2]; 4],
    };
    assert!(
        simplify(&point, Target::Vertices(1))
            .mesh
            .triangles
            .is_empty()
    );
    let p = |x: f64| DVec3::new(x, 0.0, 0.0);
    let needles = TriangleMesh {
        positions: (0..12).map(|i| p(f64::from(i))).collect(),
        triangles: (0..10).map(|i| [i, i + 1, i + 2]).collect(),
    };
    assert!(
        simplify(&needles, Target::Faces(1))
            .mesh
            .positions
            .iter()
            .all(|p| p.is_finite())
    );
    let one = TriangleMesh {
        positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
        triangles: vec![[0, 1, 2]],
    };
    let Simplified {
        mesh,
        deviation,
        reached,
    } = simplify(&one, Target::Faces(0));
    assert_eq!(
        (mesh, deviation, reached),
        (one, 0.0, true),
        "a triangle alone cannot go, and is within one of none"
    );
}

#[test]
fn a_soup_comes_back_as_it_is() {
    let mut soup = TriangleMesh::default();
    for i in 0..50 {
        let x = DVec3::splat(f64::from(i));
        append(
            &mut soup,
            &TriangleMesh {
                positions: vec![x, x + DVec3::X, x + DVec3::Y],
                triangles: vec![[0, 1, 2]],
            },
        );
    }
    let result = simplify(&soup, Target::Faces(10));
    assert_eq!(result.mesh, soup);
    assert!(!result.reached);
}

#[test]
fn a_closed_surface_keeps_its_topology_to_any_count() {
    let torus = torus(60, 40);
    for n in [4000, 1000, 201, 100, 40] {
        let Simplified { mesh, reached, .. } = simplify(&torus, Target::Faces(n));
        assert!(reached);
        assert_eq!(mesh.triangles.len(), n + n % 2);
        assert_eq!(euler(&mesh), 0);
        assert_valid(&mesh, &[2]);
    }
    let least = simplify(&torus, Target::Vertices(0));
    assert!(!least.reached && least.mesh.triangles.len() < 40);
    assert_eq!(euler(&least.mesh), 0);
    assert_valid(&least.mesh, &[2]);
    assert_eq!(
        simplify(&torus, Target::Vertices(123)).mesh.positions.len(),
        123
    );
}

#[test]
fn a_sphere_stays_round_and_unfolded() {
    let sphere = sphere(60);
    for n in [2000, 500, 100] {
        let Simplified {
            mesh, deviation, ..
        } = simplify(&sphere, Target::Faces(n));
        assert_eq!(mesh.triangles.len(), n);
        assert_eq!(euler(&mesh), 2);
        for t in 0..n {
            let [a, b, c] = mesh.corners(t);
            assert!(
                mesh.area_vector(t).dot(a + b + c) > 0.0,
                "face {t} of {n} is turned inside"
            );
        }
        assert!(
            mesh.positions
                .iter()
                .all(|p| (p.length() - 1.0).abs() < 8.0 / n as f64)
        );
        assert!(deviation < 8.0 / n as f64);
    }
}

#[test]
fn a_cube_keeps_its_edges_down_to_twelve_faces() {
    let Simplified {
        mesh,
        deviation,
        reached,
    } = simplify(&cube(12), Target::Faces(12));
    assert!(reached && mesh.triangles.len() == 12 && mesh.positions.len() == 8);
    assert!(
        deviation < 1e-2,
        "only the anchors cost anything: {deviation}"
    );
    for p in &mesh.positions {
        assert!(p.distance(p.round()) < 1e-3, "{p} is no corner");
    }
    assert!((mesh.area() - 6.0).abs() < 5e-3);
}

#[test]
fn a_boundary_keeps_its_place_and_counts_are_exact() {
    let sheet = grid(60, 40, |u, v| {
        DVec3::new(3.0 * u, 2.0 * v, 0.3 * (5.0 * u).sin() * (4.0 * v).cos())
    });
    for n in [1001, 300, 151] {
        let Simplified { mesh, reached, .. } = simplify(&sheet, Target::Faces(n));
        assert!(reached && mesh.triangles.len() == n);
        assert_eq!(euler(&mesh), 1);
        assert_valid(&mesh, &[1, 2]);
        assert!((mesh.area() / sheet.area() - 1.0).abs() < 0.01);
        assert!((boundary_length(&mesh) / boundary_length(&sheet) - 1.0).abs() < 0.01);
    }
}

#[test]
fn sheets_that_meet_stay_joined() {
    // Three pages that share a spine, and a fourth that touches it in one point.
    let mut book = TriangleMesh::default();
    for page in 0..3 {
        let (c, s) = turn(f64::from(page) / 3.0);
        append(&mut book, &grid(20, 20, |u, v| DVec3::new(c * u, s * u, v)));
    }
    append(
        &mut book,
        &grid(10, 10, |u, v| DVec3::new(-u - 0.3 * v, 0.2 * (u - v), 0.5)),
    );
    let before = euler(&simplify(&book, Target::Faces(usize::MAX)).mesh);
    let Simplified { mesh, reached, .. } = simplify(&book, Target::Faces(60));
    assert!(reached && mesh.triangles.len() == 60);
    assert_eq!(euler(&mesh), before);
    assert_valid(&mesh, &[1, 2, 3]);
    let spine =
        |e: &[u32; 2]| mesh.positions[e[0] as usize].distance(mesh.positions[e[1] as usize]);
    let length: f64 = edges(&mesh)
        .iter()
        .filter(|(_, n)| **n == 3)
        .map(|(e, _)| spine(e))
        .sum();
    assert!((length - 1.0).abs() < 0.01, "{length}");
}

#[test]
fn neither_frame_nor_threads_matter() {
    let torus = torus(40, 30);
    let near = simplify(&torus, Target::Faces(300));
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let again = pool.map(|pool| pool.install(|| simplify(&torus, Target::Faces(300))));
        assert_eq!(again.ok().as_ref(), Some(&near));
    }
    let far = TriangleMesh {
        positions: torus
            .positions
            .iter()
            .map(|p| p * 1024.0 + DVec3::splat(1048576.0))
            .collect(),
        triangles: torus.triangles.clone(),
    };
    let far = simplify(&far, Target::Faces(300));
    assert!((far.mesh.area() / (1024.0 * 1024.0 * near.mesh.area()) - 1.0).abs() < 1e-3);
    assert!((far.deviation / (1024.0 * near.deviation) - 1.0).abs() < 0.05);
}

#[test]
fn a_mesh_under_its_target_keeps_its_bits() {
    let torus = torus(10, 8);
    let same = simplify(&torus, Target::Faces(1000)).mesh;
    assert!(same.positions.iter().all(|p| torus.positions.contains(p)));
    assert_eq!(same.triangles.len(), torus.triangles.len());
}
