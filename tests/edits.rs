//! Splits and flips in any order leave a manifold of the same topology, its boundaries and creases in place; they do what they are for.

mod common;

use common::Noise;
use glam::DVec3;
use vorofit::mesh::{Connectivity, ControlMesh, Crease, PolygonMesh, Scheme, shapes};
use vorofit::model;
use vorofit::topology::flip::irregularity;
use vorofit::topology::{self, flip_for_angles, flip_for_valence};

/// A wavy sheet with two holes.
fn sheet() -> ControlMesh {
    let n = 13u32;
    let positions = (0..n * n)
        .map(|k| {
            let (x, y) = (f64::from(k % n), f64::from(k / n));
            DVec3::new(x, y, 0.4 * (0.9 * x).sin() * (0.7 * y).cos())
        })
        .collect();
    let is_hole = |i: u32, j: u32| (i == 3 && j == 4) || (i == 8 && (6..8).contains(&j));
    let cells = (0..n - 1).flat_map(|j| (0..n - 1).map(move |i| (i, j)));
    let faces = cells.filter(|&(i, j)| !is_hole(i, j)).flat_map(|(i, j)| {
        let a = j * n + i;
        [[a, a + 1, a + n + 1], [a, a + n + 1, a + n]]
    });
    PolygonMesh::from_faces(positions, faces).into()
}

fn torus() -> ControlMesh {
    PolygonMesh::from(shapes::torus(3.0, 1.0, 16, 9).triangulate()).into()
}

/// A ball with a crease around a vertex, and one that ends at two.
fn creased_ball() -> ControlMesh {
    let mut ball = ControlMesh::from(PolygonMesh::from(shapes::sphere(1.0, 2)));
    let mesh = Connectivity::of(&ball.mesh).expect("a ball");
    let ring = mesh.around(0).map(|h| mesh.next(h));
    let line = mesh.half_edges(200).take(2);
    ball.creases = ring
        .chain(line)
        .map(|h| Crease {
            edge: [mesh.origin(h), mesh.target(h)],
            sharpness: f64::INFINITY,
        })
        .collect();
    ball
}

fn split(control: &ControlMesh, marked: &[bool]) -> ControlMesh {
    let fine = model::subdivide(control, Scheme::Loop).expect("triangles");
    let split = topology::split(control, marked, &fine.mesh.positions).expect("triangles");
    split.control
}

fn boundary_edges(mesh: &Connectivity) -> usize {
    (0..mesh.edge_count() as u32)
        .filter(|&e| mesh.is_boundary_edge(e))
        .count()
}

/// The mesh is a manifold, every crease is an edge of it, and no two faces have the same vertices.
fn checked(control: &ControlMesh) -> Connectivity {
    let mesh = Connectivity::of(&control.mesh).expect("a manifold");
    mesh.validate().expect("consistent");
    for crease in &control.creases {
        let [a, b] = crease.edge;
        assert!(mesh.edge_between(a, b).is_some(), "{a}–{b} is no edge");
    }
    let mut faces: Vec<[u32; 3]> = mesh
        .faces()
        .map(|f| {
            let mut f = [f[0], f[1], f[2]];
            f.sort_unstable();
            f
        })
        .collect();
    faces.sort_unstable();
    assert!(
        faces.windows(2).all(|w| w[0] != w[1]),
        "a face is there twice"
    );
    mesh
}

#[test]
fn random_edits_keep_the_topology() {
    for (name, start) in [
        ("sheet", sheet()),
        ("torus", torus()),
        ("creased ball", creased_ball()),
    ] {
        let mesh = checked(&start);
        let euler = mesh.euler_characteristic();
        for seed in 0..6 {
            let mut noise = Noise(seed);
            let mut control = start.clone();
            for _ in 0..12 {
                let before = checked(&control);
                let boundary = boundary_edges(&before);
                match noise.below(3) {
                    0 if control.mesh.face_count() < 3000 => {
                        let share = noise.next() * 0.2 + 0.1;
                        let marked: Vec<bool> = (0..control.mesh.face_count())
                            .map(|_| noise.next() + 0.5 < share)
                            .collect();
                        control = split(&control, &marked);
                    }
                    1 => {
                        flip_for_valence(&mut control).expect("triangles");
                        assert_eq!(boundary_edges(&checked(&control)), boundary);
                    }
                    _ => {
                        // Away from the plane, so that there is something to flip and something to refuse.
                        for p in &mut control.mesh.positions {
                            *p += 0.02 * noise.vector();
                        }
                        flip_for_angles(&mut control).expect("triangles");
                        assert_eq!(boundary_edges(&checked(&control)), boundary);
                    }
                }
                assert_eq!(
                    checked(&control).euler_characteristic(),
                    euler,
                    "{name}, seed {seed}"
                );
            }
        }
    }
}

#[test]
fn creases_are_cut_with_their_edges_and_stay_in_place() {
    let mut ball = creased_ball();
    let count = ball.creases.len();
    let marked: Vec<bool> = (0..ball.mesh.face_count()).map(|f| f % 7 == 0).collect();
    let length = |control: &ControlMesh| -> f64 {
        let ends = |c: &Crease| c.edge.map(|v| control.mesh.positions[v as usize]);
        control
            .creases
            .iter()
            .map(|c| ends(c)[0].distance(ends(c)[1]))
            .sum()
    };
    let before = length(&ball);
    ball = split(&ball, &marked);
    flip_for_valence(&mut ball).expect("triangles");
    checked(&ball);
    assert!(ball.creases.len() > count);
    // The ring around a vertex contracts a little, like any coarse polygon of a spline.
    assert!((length(&ball) / before - 1.0).abs() < 0.2);
}

#[test]
fn flips_for_valence_regularize_what_splits_upset() {
    for start in [sheet(), torus(), creased_ball()] {
        let marked: Vec<bool> = (0..start.mesh.face_count()).map(|f| f % 11 == 0).collect();
        let mut control = split(&start, &marked);
        let before = irregularity(&checked(&control));
        let flips = flip_for_valence(&mut control).expect("triangles");
        let after = irregularity(&checked(&control));
        println!("R {before} → {after} by {} flips", flips.len());
        assert!(!flips.is_empty() && after < before);
        // The second time there is nothing to do.
        assert!(
            flip_for_valence(&mut control)
                .expect("triangles")
                .is_empty()
        );
    }
}

/// The faces with an angle under 0.4 radians.
fn needles(control: &ControlMesh) -> usize {
    let p = |v: u32| control.mesh.positions[v as usize];
    let is_needle = |f: &&[u32]| {
        let mut angles = (0..3).map(|k| {
            let [a, b, c] = [f[k], f[(k + 1) % 3], f[(k + 2) % 3]].map(p);
            (b - a).angle_between(c - a)
        });
        angles.any(|angle| angle < 0.4)
    };
    control.mesh.faces().filter(is_needle).count()
}

#[test]
fn flips_for_angles_take_needles_away_and_fold_nothing() {
    // A flat sheet, sheared so that every cell's diagonal is the longer one.
    let mut control = sheet();
    for p in &mut control.mesh.positions {
        *p = DVec3::new(p.x + 0.9 * p.y, p.y, 0.0);
    }
    let before = needles(&control);
    flip_for_angles(&mut control).expect("triangles");
    let after = needles(&control);
    println!("{before} needles → {after}");
    assert!(before > 250 && after < before / 10);
    let upwards = checked(&control).faces().all(|f| {
        let [a, b, c] = [0, 1, 2].map(|k| control.mesh.positions[f[k] as usize]);
        (b - a).cross(c - a).z > 0.0
    });
    assert!(upwards, "a face is turned over");
}
