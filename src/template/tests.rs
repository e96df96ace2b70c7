use super::*;
use crate::mesh::{Connectivity, Crease, Frame, TriangleMesh};
use glam::DMat3;

fn validated(control: &ControlMesh) -> Connectivity {
    let connectivity = Connectivity::of(&control.mesh).unwrap();
    connectivity.validate().unwrap();
    connectivity
}

/// The smallest distance of the target's triangles from a line, and the widest gap between their directions as seen from it: sampled.
fn seen_from_line(target: &TriangleMesh, point: DVec3, direction: DVec3) -> (f64, f64) {
    let (u, v) = direction.any_orthonormal_pair();
    let mut nearest = f64::INFINITY;
    let mut angles = Vec::new();
    for t in 0..target.triangles.len() {
        let [a, b, c] = target.corners(t).map(|p| p - point);
        for (s, t) in (0..=8).flat_map(|i| (0..=8 - i).map(move |j| (i, j))) {
            let p = a + (b - a) * (f64::from(s) / 8.0) + (c - a) * (f64::from(t) / 8.0);
            nearest = nearest.min(p.dot(u).hypot(p.dot(v)));
            angles.push(p.dot(v).atan2(p.dot(u)));
        }
    }
    angles.sort_by(f64::total_cmp);
    angles.push(angles[0] + std::f64::consts::TAU);
    let gap = angles.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
    (nearest, gap)
}

fn bounds(points: &[DVec3]) -> Option<(DVec3, DVec3)> {
    let first = *points.first()?;
    let grow = |(lo, hi): (DVec3, DVec3), p: &DVec3| (lo.min(*p), hi.max(*p));
    Some(points.iter().fold((first, first), grow))
}

#[test]
fn boxes_have_the_points_asked_for() {
    let size = DVec3::new(1.0, 0.6, 0.4);
    for m in [1, 4, 8, 16, 32] {
        let control = bounding_box(DVec3::ZERO, size, 6 * m * m + 2);
        assert_eq!(control.mesh.positions.len(), 6 * m * m + 2);
        assert_eq!(validated(&control).euler_characteristic(), 2);
    }
    for asked in [110, 500, 898, 5_000] {
        let control = bounding_box(DVec3::ZERO, size, asked);
        let made = control.mesh.positions.len();
        assert!(made.abs_diff(asked) * 20 <= asked, "{made} for {asked}");
        let sides = control.mesh.faces().map(|f| {
            let [a, b, c] = [0, 1, 2].map(|k| control.mesh.positions[f[k] as usize]);
            (a.distance(b) / b.distance(c)).ln().abs()
        });
        assert!(sides.fold(0.0, f64::max) < 0.4, "nearly square for {asked}");
    }
}

#[test]
fn the_smallest_and_the_flat_box_are_still_boxes() {
    assert_eq!(
        bounding_box(DVec3::ZERO, DVec3::ONE, 0)
            .mesh
            .positions
            .len(),
        8
    );
    let flat = bounding_box(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), 100);
    let (lo, hi) = bounds(&flat.mesh.positions).unwrap();
    assert!((hi.z - lo.z - 0.01 * 2f64.sqrt()).abs() < 1e-15);
    assert_eq!(validated(&flat).euler_characteristic(), 2);
    let long = bounding_box(DVec3::ZERO, DVec3::new(1.0, 1e-6, 0.0), 50);
    assert!(long.mesh.positions.len().abs_diff(50) <= 2);
}

#[test]
fn a_torus_is_wrapped_by_a_torus() {
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 0.5).normalize(), 1.1);
    let shift = DVec3::new(3.0, -1.0, 7.0);
    let mut target = shapes::torus(1.0, 0.3, 120, 40).triangulate();
    for p in &mut target.positions {
        *p = turn * *p + shift;
    }
    let given = Axis::Given {
        point: shift,
        direction: turn * DVec3::Z,
    };
    for axis in [Axis::Inertia, given] {
        let control = torus(&target, axis, 512).unwrap();
        assert_eq!(control.mesh.positions.len(), 512);
        assert_eq!(validated(&control).euler_characteristic(), 0);
        for p in &control.mesh.positions {
            let q = turn.transpose() * (*p - shift);
            let distance = (q.x.hypot(q.y) - 1.0).hypot(q.z) - 0.3;
            assert!(distance.abs() < 0.03, "{p} is {distance} off");
        }
        let mut outwards = 0;
        let triangles = control.mesh.triangulate();
        for t in 0..triangles.triangles.len() {
            let [a, b, c] = triangles.corners(t).map(|p| turn.transpose() * (p - shift));
            let middle = (a + b + c) / 3.0;
            let ring = DVec3::new(middle.x, middle.y, 0.0).normalize();
            outwards += usize::from((b - a).cross(c - a).dot(middle - ring) > 0.0);
        }
        assert_eq!(outwards, triangles.triangles.len());
    }
}

#[test]
fn a_target_without_a_hole_is_refused() {
    let refusal = |target: &TriangleMesh, axis| torus(target, axis, 512).unwrap_err().to_string();
    let sphere = shapes::sphere(1.0, 3);
    assert!(refusal(&sphere, Axis::Inertia).contains("no hole"));
    assert!(refusal(&TriangleMesh::default(), Axis::Inertia).contains("no hole"));
    let given = |direction| Axis::Given {
        point: DVec3::ZERO,
        direction,
    };
    assert!(refusal(&sphere, given(DVec3::ZERO)).contains("no direction"));
    assert!(refusal(&TriangleMesh::default(), given(DVec3::Z)).contains("does not pass"));
}

#[test]
fn the_hole_of_the_rocker_arm_is_found() {
    let data = std::env::var_os("VOROFIT_DATA").map_or_else(
        || concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data").into(),
        std::path::PathBuf::from,
    );
    let path = data.join("surfaces/rocker-arm.obj");
    if !path.exists() {
        eprintln!(
            "skipped the_hole_of_the_rocker_arm_is_found: no {}",
            path.display()
        );
        return;
    }
    let mut target = crate::files::read_surface(&path)
        .unwrap()
        .mesh
        .triangulate();
    let frame = Frame::of(&target).unwrap();
    for p in &mut target.positions {
        *p = frame.to_unit(*p);
    }
    let hole = torus::widest_hole(&target).unwrap();
    let (nearest, gap) = seen_from_line(&target, hole.center, hole.direction);
    assert!(nearest > 0.02, "the axis passes the target at {nearest}");
    assert!(
        gap < 0.1,
        "the target leaves {gap} rad around the axis open"
    );
    let control = torus(&target, Axis::Inertia, 512).unwrap();
    assert_eq!(control.mesh.positions.len(), 512);
    assert_eq!(validated(&control).euler_characteristic(), 0);
    let (nearest, gap) = seen_from_line(&control.mesh.triangulate(), hole.center, hole.direction);
    assert!(
        nearest > 0.02 && gap < 0.1,
        "the template winds around the same hole"
    );
}

#[test]
fn a_placed_template_fills_the_target_box_and_drops_unused_vertices() {
    let mut control = bounding_box(DVec3::ZERO, DVec3::new(2.0, 3.0, 4.0), 26);
    control.mesh.positions.insert(0, DVec3::splat(99.0));
    let faces: Vec<Vec<u32>> = (control.mesh.faces())
        .map(|f| f.iter().map(|v| v + 1).collect())
        .collect();
    control.mesh = PolygonMesh::from_faces(control.mesh.positions, &faces);
    let edge = [faces[0][0], faces[0][1]];
    control.creases = vec![Crease {
        edge,
        sharpness: 2.0,
    }];
    control.corners = vec![0, faces[0][2]];
    let target = shapes::box_grid(DVec3::NEG_ONE, DVec3::ONE, [1; 3]).triangulate();
    let as_is = placed(&control, Align::None, &target).unwrap();
    assert_eq!(as_is.mesh.positions, control.mesh.positions[1..]);
    assert_eq!(as_is.creases[0].edge, edge.map(|v| v - 1));
    assert_eq!(as_is.corners, [faces[0][2] - 1]);
    let stretched = placed(&control, Align::Box, &target).unwrap();
    assert_eq!(
        bounds(&stretched.mesh.positions),
        Some((DVec3::NEG_ONE, DVec3::ONE))
    );
    assert!(placed(&ControlMesh::default(), Align::Box, &target).is_err());
}
