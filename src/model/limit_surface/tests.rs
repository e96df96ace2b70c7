//! The surface against subdivision, limit masks and its own derivatives.

use super::*;
use crate::geometry::random::Random;
use crate::model::tests::{bipyramid, crease, grid, quad_fan, scattered, trapezohedron};
use crate::model::{Model, subdivide};
use domain::{corner_count, from_corner};

fn at(face: usize, p: DVec2) -> SurfaceParameter {
    SurfaceParameter {
        face: face as u32,
        u: p.x,
        v: p.y,
    }
}

/// The parameters of the corners of each face after some refinements of the control faces, in the order of the refined faces.
fn corner_parameters(triangles: bool, faces: usize, levels: usize) -> Vec<(usize, Vec<DVec2>)> {
    let domain: &[DVec2] = match triangles {
        true => &[DVec2::ZERO, DVec2::X, DVec2::Y],
        false => &[DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y],
    };
    let mut all: Vec<_> = (0..faces).map(|f| (f, domain.to_vec())).collect();
    for _ in 0..levels {
        all = (all.iter())
            .flat_map(|(f, p)| quarters(p).map(|q| (*f, q)))
            .collect();
    }
    all
}

fn quarters(p: &[DVec2]) -> [Vec<DVec2>; 4] {
    let n = p.len();
    let middle = |k: usize| 0.5 * (p[k % n] + p[(k + 1) % n]);
    let center = p.iter().sum::<DVec2>() / n as f64;
    std::array::from_fn(|k| match n {
        3 if k == 3 => vec![middle(0), middle(1), middle(2)],
        3 => vec![p[k], middle(k), middle(k + 2)],
        _ => vec![p[k], middle(k), center, middle(k + 3)],
    })
}

/// The limits of all vertices after some levels against evaluation at their parameters, from every face around them.
fn assert_is_subdivision(name: &str, control: &ControlMesh, scheme: Scheme, levels: usize) {
    let model = Model::new(control, scheme, levels, true).unwrap();
    let limits = model.positions(&control.mesh.positions);
    let surface = LimitSurface::new(control, scheme).unwrap();
    let patches = surface.patches(&control.mesh.positions);
    let corners = corner_parameters(scheme == Scheme::Loop, control.mesh.face_count(), levels);
    let mut worst: f64 = 0.0;
    for ((f, parameters), face) in corners.iter().zip(model.connectivity.faces()) {
        for (&p, &v) in parameters.iter().zip(face) {
            let distance = (patches.evaluate(at(*f, p)).position - limits[v as usize]).length();
            assert!(
                distance < 1e-13,
                "{name}, {scheme:?}: {distance:e} off at {p} of face {f}"
            );
            worst = worst.max(distance);
        }
    }
    println!("{name}, {scheme:?}: {worst:e}");
}

/// Meshes with sharp edges in every arrangement around a vertex of valence n.
fn with_sharp_edges(n: u32) -> Vec<(String, ControlMesh, Scheme)> {
    let mut meshes = Vec::new();
    let places: [&[u32]; 6] = [&[0], &[0, 1], &[0, 2], &[1, 2], &[0, 1, 2], &[]];
    for places in places {
        for pinned in [false, true] {
            let (mut quads, mut triangles) = (trapezohedron(n), bipyramid(n));
            for k in places {
                quads.creases.push(crease(0, 2 + 2 * k, f64::INFINITY));
                triangles.creases.push(crease(0, 2 + k, f64::INFINITY));
            }
            if pinned {
                quads.corners.push(0);
                triangles.corners.push(0);
            }
            let name = format!("valence {n}, sharp {places:?}, pinned {pinned}");
            meshes.push((name.clone(), quads, Scheme::CatmullClark));
            meshes.push((name, triangles, Scheme::Loop));
        }
    }
    meshes
}

/// Triangles around vertex 0; open.
fn triangle_fan(n: u32) -> ControlMesh {
    let faces = (0..n).map(|i| vec![0, 1 + i, 2 + i]).collect();
    crate::model::tests::control(scattered(n as usize + 2), faces)
}

/// Boundary vertices of 1 to 8 faces.
fn open_meshes() -> Vec<(String, ControlMesh, Scheme)> {
    let mut meshes = vec![
        ("grid".into(), grid(4, false), Scheme::CatmullClark),
        ("grid".into(), grid(4, true), Scheme::Loop),
    ];
    for n in 1..=8 {
        meshes.push((format!("fan of {n}"), triangle_fan(n), Scheme::Loop));
        if n > 1 {
            meshes.push((format!("disc of {n}"), quad_fan(n), Scheme::CatmullClark));
        }
        // A fan of quads: every second face of a disc is left out.
        let mut open = quad_fan(n + 2);
        let kept: Vec<Vec<u32>> = open
            .mesh
            .faces()
            .take(n as usize)
            .map(<[u32]>::to_vec)
            .collect();
        let used = 2 * n as usize + 2;
        open.mesh =
            crate::mesh::PolygonMesh::from_faces(open.mesh.positions[..used].to_vec(), kept);
        meshes.push((format!("fan of {n}"), open, Scheme::CatmullClark));
    }
    meshes
}

/// A grid with one edge flipped: valences 5 and 7 in one face.
fn flipped() -> ControlMesh {
    let mut mesh = grid(6, true);
    let mut faces: Vec<Vec<u32>> = mesh.mesh.faces().map(<[u32]>::to_vec).collect();
    let (a, b) = (24, 25);
    let [c, d] = [faces[a].clone(), faces[b].clone()];
    assert_eq!((c[0], c[2]), (d[0], d[1]));
    (faces[a], faces[b]) = (vec![c[1], d[2], d[0]], vec![d[2], c[1], c[2]]);
    mesh.mesh = crate::mesh::PolygonMesh::from_faces(mesh.mesh.positions, faces);
    mesh
}

#[test]
fn what_has_no_such_surface_is_refused_by_name() {
    let refusal =
        |mesh: &ControlMesh, scheme| LimitSurface::new(mesh, scheme).unwrap_err().to_string();
    assert!(refusal(&bipyramid(4), Scheme::Polygon).contains("polygon"));
    assert!(refusal(&bipyramid(4), Scheme::CatmullClark).contains("face 0 has 3 corners"));
    assert!(refusal(&grid(3, false), Scheme::Loop).contains("Loop"));
    let mut semi_sharp = bipyramid(4);
    semi_sharp.creases.push(crease(0, 2, 1.5));
    assert!(refusal(&semi_sharp, Scheme::Loop).contains("vertices 0 and 2"));
    let pillow = crate::model::tests::control(scattered(3), vec![vec![0, 1, 2], vec![0, 2, 1]]);
    assert!(refusal(&pillow, Scheme::Loop).contains("vertex 0"));
}

#[test]
fn subdivision_leads_to_the_surface_at_every_valence() {
    for n in 3..=50 {
        let levels = if n < 10 { 5 } else { 3 };
        assert_is_subdivision(&format!("valence {n}"), &bipyramid(n), Scheme::Loop, levels);
        let quads = trapezohedron(n);
        assert_is_subdivision(
            &format!("valence {n}"),
            &quads,
            Scheme::CatmullClark,
            levels,
        );
    }
    assert_is_subdivision("a flipped edge", &flipped(), Scheme::Loop, 4);
}

#[test]
fn subdivision_leads_to_the_surface_at_boundaries() {
    for (name, mesh, scheme) in open_meshes() {
        assert_is_subdivision(&name, &mesh, scheme, 4);
    }
}

#[test]
fn subdivision_leads_to_the_surface_at_creases_darts_and_corners() {
    for n in [3, 4, 5, 6, 7, 12] {
        for (name, mesh, scheme) in with_sharp_edges(n) {
            assert_is_subdivision(&name, &mesh, scheme, 3);
        }
    }
}

/// The faces with a corner within one face of vertex 0, which are all that its own faces see; vertex 0 stays number 0.
fn cropped(control: &ControlMesh) -> ControlMesh {
    let mesh = &control.mesh;
    let around: Vec<u32> = mesh
        .faces()
        .filter(|f| f.contains(&0))
        .flatten()
        .copied()
        .collect();
    let kept: Vec<&[u32]> = mesh
        .faces()
        .filter(|f| f.iter().any(|v| around.contains(v)))
        .collect();
    let mut old = vec![0];
    for &v in kept.iter().copied().flatten() {
        if !old.contains(&v) {
            old.push(v);
        }
    }
    let new = |v: &u32| old.iter().position(|o| o == v).map(|k| k as u32);
    let faces: Vec<Vec<u32>> = kept
        .iter()
        .map(|f| f.iter().filter_map(new).collect())
        .collect();
    let creases = (control.creases.iter())
        .filter_map(|c| Some(crease(new(&c.edge[0])?, new(&c.edge[1])?, c.sharpness)))
        .collect();
    let positions = old.iter().map(|&v| mesh.positions[v as usize]).collect();
    ControlMesh {
        mesh: crate::mesh::PolygonMesh::from_faces(positions, faces),
        creases,
        corners: control.corners.iter().filter_map(new).collect(),
    }
}

/// Subdivides towards vertex 0 step by step and compares the ring of it there.
fn assert_is_subdivision_deep_down(
    name: &str,
    control: &ControlMesh,
    scheme: Scheme,
    steps: usize,
) {
    let surface = LimitSurface::new(control, scheme).unwrap();
    let patches = surface.patches(&control.mesh.positions);
    let mut mesh = control.clone();
    for step in 1..=steps {
        mesh = cropped(&subdivide(&mesh, scheme).unwrap());
        let limits = Model::new(&mesh, scheme, 0, true).unwrap();
        let limits = limits.positions(&mesh.mesh.positions);
        let coarse = control
            .mesh
            .faces()
            .enumerate()
            .filter(|(_, face)| face.contains(&0));
        let fine = mesh.mesh.faces().filter(|face| face.contains(&0));
        for ((f, corners), face) in coarse.zip(fine) {
            let k = corners.iter().position(|&v| v == 0).unwrap();
            let split = surface.split;
            let domain = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y];
            for i in 0..corner_count(split) {
                let local = if face.len() == 3 && i == 2 {
                    DVec2::Y
                } else {
                    domain[i]
                };
                let p = from_corner(split, k).apply(local * 0.5f64.powi(step as i32));
                let distance =
                    (patches.evaluate(at(f, p)).position - limits[face[i] as usize]).length();
                // Away from corner 0 of a face a parameter is rounded to 1e-16, and position may change fast with it.
                assert!(
                    distance < 1e-12,
                    "{name}, {scheme:?}: {distance:e} off after {step} steps"
                );
            }
        }
    }
}

#[test]
fn ten_and_more_subdivision_steps_lead_to_the_surface() {
    for n in [3, 4, 5, 6, 7, 8, 15, 50] {
        let name = format!("valence {n}");
        assert_is_subdivision_deep_down(&name, &bipyramid(n), Scheme::Loop, 20);
        assert_is_subdivision_deep_down(&name, &trapezohedron(n), Scheme::CatmullClark, 20);
    }
    for (name, mesh, scheme) in with_sharp_edges(5).into_iter().chain(open_meshes()) {
        assert_is_subdivision_deep_down(&name, &mesh, scheme, 18);
    }
}

/// Parameters inside the domain, some of them near the corners.
fn spots(random: &mut Random, triangles: bool, count: usize) -> Vec<DVec2> {
    (0..count)
        .map(|i| {
            let shrink = 0.5f64.powi((i % 3 * 2) as i32);
            let mut p = DVec2::new(random.uniform(), random.uniform()) * shrink;
            if triangles && p.x + p.y > 1.0 {
                p = DVec2::ONE - p;
            }
            0.01 + 0.98 * p - if triangles { 0.01 * p.x.max(p.y) } else { 0.0 }
        })
        .collect()
}

fn all_meshes() -> Vec<(String, ControlMesh, Scheme)> {
    let mut meshes = open_meshes();
    meshes.extend([3, 4, 5, 6, 9].into_iter().flat_map(with_sharp_edges));
    meshes.push(("flipped".into(), flipped(), Scheme::Loop));
    meshes
}

#[test]
fn derivatives_are_those_of_the_position() {
    let mut random = Random::new(5);
    for (name, mesh, scheme) in all_meshes() {
        let surface = LimitSurface::new(&mesh, scheme).unwrap();
        let patches = surface.patches(&mesh.mesh.positions);
        for (i, p) in spots(&mut random, scheme == Scheme::Loop, 30)
            .into_iter()
            .enumerate()
        {
            let f = i % mesh.mesh.face_count();
            let h = 1e-6;
            let jet = |offset: DVec2| patches.evaluate(at(f, p + h * offset));
            let difference = |axis: DVec2, pick: fn(&LimitJet) -> DVec3| {
                (pick(&jet(axis)) - pick(&jet(-axis))) / (2.0 * h)
            };
            let here = patches.evaluate(at(f, p));
            let size = 1.0 + here.duu.length() + here.dvv.length() + here.duv.length();
            for (difference, exact) in [
                (difference(DVec2::X, |j| j.position), here.du),
                (difference(DVec2::Y, |j| j.position), here.dv),
                (difference(DVec2::X, |j| j.du), here.duu),
                (difference(DVec2::Y, |j| j.du), here.duv),
                (difference(DVec2::X, |j| j.dv), here.duv),
                (difference(DVec2::Y, |j| j.dv), here.dvv),
            ] {
                // The second derivative jumps where h leads into another piece.
                let error = (difference - exact).length();
                assert!(
                    error < 3e-5 * size,
                    "{name}, {scheme:?}, face {f}, {p}: {error:e} of {size}"
                );
            }
        }
    }
}

#[test]
fn weights_sum_to_one_and_make_the_position() {
    let mut random = Random::new(7);
    let mut weights = vec![(9, 9.0)];
    for (name, mesh, scheme) in all_meshes() {
        let surface = LimitSurface::new(&mesh, scheme).unwrap();
        let patches = surface.patches(&mesh.mesh.positions);
        let deep = DVec2::splat(0.5f64.powi(40));
        let spots = spots(&mut random, scheme == Scheme::Loop, 20);
        for (i, p) in spots
            .into_iter()
            .chain([DVec2::ZERO, DVec2::X, deep])
            .enumerate()
        {
            let place = at(i % mesh.mesh.face_count(), p);
            surface.weights(place, &mut weights);
            let sum: f64 = weights.iter().map(|w| w.1).sum();
            assert!((sum - 1.0).abs() < 1e-14, "{name}: {sum}");
            assert!(weights.is_sorted_by(|a, b| a.0 < b.0));
            let point: DVec3 = (weights.iter())
                .map(|&(c, w)| w * mesh.mesh.positions[c as usize])
                .sum();
            let distance = (point - patches.evaluate(place).position).length();
            assert!(distance < 1e-14, "{name}, {place:?}: {distance:e}");
        }
    }
}

#[test]
fn refined_points_are_those_of_subdivision() {
    for (name, mesh, scheme) in all_meshes() {
        let surface = LimitSurface::new(&mesh, scheme).unwrap();
        let subdivided = crate::model::subdivide(&mesh, scheme).unwrap().mesh;
        let refined = surface.refined(&mesh.mesh.positions);
        assert_eq!(refined, subdivided.positions, "{name}");
    }
}

#[test]
fn the_surface_moves_with_its_control_points() {
    let mesh = trapezohedron(7);
    let surface = LimitSurface::new(&mesh, Scheme::CatmullClark).unwrap();
    let turn =
        glam::DMat3::from_rotation_x(0.4) * glam::DMat3::from_diagonal(DVec3::new(2.0, -1.0, 3.0));
    let shift = DVec3::new(3.0, 4.0, 5.0);
    let moved: Vec<_> = mesh
        .mesh
        .positions
        .iter()
        .map(|&p| turn * p + shift)
        .collect();
    let (before, after) = (
        surface.patches(&mesh.mesh.positions),
        surface.patches(&moved),
    );
    for p in spots(&mut Random::new(1), false, 50) {
        let (a, b) = (before.evaluate(at(3, p)), after.evaluate(at(3, p)));
        assert!((turn * a.position + shift - b.position).length() < 1e-14);
        assert!((turn * a.duv - b.duv).length() < 1e-11);
    }
}

#[test]
fn steps_over_edges_are_continuous_and_smooth_where_the_surface_is_regular() {
    for (triangles, scheme) in [(true, Scheme::Loop), (false, Scheme::CatmullClark)] {
        let mesh = grid(8, triangles);
        let surface = LimitSurface::new(&mesh, scheme).unwrap();
        let patches = surface.patches(&mesh.mesh.positions);
        let split = surface.split;
        let direction = DVec2::new(0.3, 0.8);
        let mut crossed = 0;
        for f in 0..mesh.mesh.face_count() {
            for edge in 0..corner_count(split) {
                let here = at(f, from_corner(split, edge).apply(DVec2::new(0.3, 0.0)));
                let Some((there, turned)) = surface.cross(here, direction, edge) else {
                    let h = surface.connectivity().half_edges(f).start + edge as u32;
                    assert!(surface.connectivity().opposite(h).is_none());
                    continue;
                };
                let (a, b) = (patches.evaluate(here), patches.evaluate(there));
                assert!((a.position - b.position).length() < 1e-14);
                // Affine at boundaries, too: ghosts make the grid regular there.
                let slope = |j: &LimitJet, d: DVec2| d.x * j.du + d.y * j.dv;
                let difference = slope(&a, direction) - slope(&b, turned);
                assert!(difference.length() < 1e-13, "{scheme:?}: {difference}");
                let bend = |j: &LimitJet, d: DVec2| {
                    d.x * d.x * j.duu + 2.0 * d.x * d.y * j.duv + d.y * d.y * j.dvv
                };
                assert!((bend(&a, direction) - bend(&b, turned)).length() < 1e-12);
                // And back again.
                let inner = at(
                    there.face as usize,
                    DVec2::new(there.u, there.v) + 0.1 * turned,
                );
                let back = (0..corner_count(split)).find_map(|e| {
                    let (p, d) = surface.cross(inner, turned, e)?;
                    (p.face == f as u32).then_some((p, d))
                });
                let (p, d) = back.unwrap();
                let expected = DVec2::new(here.u, here.v) + 0.1 * direction;
                assert!(
                    (DVec2::new(p.u, p.v) - expected).length() < 1e-15
                        && (d - direction).length() < 1e-15
                );
                crossed += 1;
            }
        }
        assert!(crossed > 100);
    }
}

/// With tables for regular vertices, too, as if they were irregular.
#[test]
fn tangents_at_corners_are_derivatives_where_the_vertex_is_regular_and_their_limits_elsewhere() {
    let smooth = |faces| Sector {
        extent: ring::Extent::Closed,
        faces,
        place: 0,
        pinned: false,
    };
    for (split, regular) in [(Split::Triangles, 6), (Split::Quads, 4)] {
        for n in [3, 4, 5, 6, 7] {
            let tables = Irregular::new(split, smooth(n)).unwrap();
            let points = scattered(tables.points);
            let here = tables.jet(|i| points[i], DVec2::ZERO);
            // So far down that the tangent is the larger part, but not lost in the rounding of the position.
            let k = if n < 7 { 20 } else { 40 };
            let scale = (2.0 * irregular::subdominant(split, n)).powi(-k);
            let near = |axis: DVec2| tables.jet(|i| points[i], 0.5f64.powi(k) * axis);
            let bound = if n == regular { 1e-4 } else { 5e-3 };
            for (near, exact) in [(near(DVec2::X).du, here.du), (near(DVec2::Y).dv, here.dv)] {
                let error = (scale * near - exact).length();
                assert!(
                    error < bound * exact.length(),
                    "{split:?}, {n}: {error:e} of {}",
                    exact.length()
                );
            }
        }
    }
}

#[test]
fn tangents_of_triangles_are_the_first_harmonics_of_the_ring_at_every_valence() {
    for n in 3..=50 {
        let sector = Sector {
            extent: ring::Extent::Closed,
            faces: n,
            place: 0,
            pinned: false,
        };
        let tables = Irregular::new(Split::Triangles, sector).unwrap();
        let points = scattered(tables.points);
        let here = tables.jet(|i| points[i], DVec2::ZERO);
        for (tangent, turned) in [(here.du, 0.0), (here.dv, 1.0)] {
            let harmonic: DVec3 = (0..n)
                .map(|i| {
                    (std::f64::consts::TAU * (i as f64 - turned) / n as f64).cos() * points[1 + i]
                })
                .sum();
            let error = (tangent.normalize() - harmonic.normalize()).length();
            assert!(error < 1e-9, "{n}: {error:e}");
        }
    }
}
