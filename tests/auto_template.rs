//! The automatic template: closed quads of the target's topology on the target, whatever its triangles are like, or a refusal; the same bits again.

mod common;

use glam::DVec3;
use vorofit::device::Device;
use vorofit::files::read_surface;
use vorofit::fit::{Options, Proximity, Start, Target, Template, fit};
use vorofit::measure::distances;
use vorofit::mesh::{Connectivity, ControlMesh, Frame, Scheme, TriangleMesh, shapes};
use vorofit::progress::Silent;
use vorofit::template::{Automatic, Genus, automatic};
use vorofit::topology::Holes;

fn joined(parts: &[TriangleMesh]) -> TriangleMesh {
    let mut all = TriangleMesh::default();
    for part in parts {
        let first = all.positions.len() as u32;
        all.positions.extend(&part.positions);
        all.triangles
            .extend(part.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    all
}

fn torus(major: f64, minor: f64, center: DVec3) -> TriangleMesh {
    let mut torus = shapes::torus(major, minor, 60, 30).triangulate();
    torus.positions.iter_mut().for_each(|p| *p += center);
    torus
}

/// Two tori that overlap where their tubes meet.
fn double_torus() -> TriangleMesh {
    joined(&[
        torus(1.0, 0.35, DVec3::ZERO),
        torus(1.0, 0.35, 2.2 * DVec3::X),
    ])
}

/// Whether all faces are quads, and what [`Connectivity`] says.
fn checked(control: &ControlMesh) -> Connectivity {
    assert!(control.mesh.faces().all(|f| f.len() == 4));
    let connectivity = Connectivity::of(&control.mesh).expect("a manifold");
    connectivity.validate().expect("consistent");
    let mut edges = 0..connectivity.edge_count() as u32;
    assert!(
        !edges.any(|e| connectivity.is_boundary_edge(e)),
        "it is closed"
    );
    connectivity
}

fn assert_wraps(name: &str, target: &TriangleMesh, asked: usize, euler: i64) {
    let Automatic { control, sound, .. } =
        automatic(target, asked, Genus::Simplify, Holes::Bridge).expect(name);
    let found = checked(&control).euler_characteristic();
    let points = control.mesh.positions.len();
    println!("{name}: {points} points, Euler characteristic {found}");
    assert_eq!((found, sound), (euler, true), "{name}");
    assert!(points.abs_diff(asked) * 20 <= asked, "{name}: {points}");
    let diagonal = Frame::of(target).expect("an extent").diagonal;
    let off = distances(target, &control.mesh.positions).expect("triangles");
    let worst = off.into_iter().fold(0.0, f64::max);
    assert!(worst < 0.01 * diagonal, "{name}: a point is {worst} off");
}

#[test]
fn generated_shapes_keep_their_handles() {
    assert_wraps("ball", &shapes::sphere(1.0, 4), 300, 2);
    assert_wraps("lobed ball", &shapes::lobed_ball(4), 1500, 2);
    assert_wraps("torus", &torus(1.0, 0.4, DVec3::ONE), 500, 0);
    assert_wraps("double torus", &double_torus(), 1500, -2);
}

#[test]
fn holes_turned_and_doubled_triangles_and_crumbs_change_nothing() {
    let mut scan = torus(1.0, 0.4, DVec3::ZERO);
    scan.triangles.drain(700..760);
    let copies = scan.triangles[100..200].to_vec();
    scan.triangles.extend(copies);
    for t in scan.triangles.iter_mut().step_by(5) {
        t.swap(0, 2);
    }
    let mut crumb = shapes::sphere(0.05, 1);
    crumb.positions.iter_mut().for_each(|p| p.z += 1.0);
    let scan = joined(&[scan, crumb]);
    let target = Target::new(&Device::Cpu, &scan).expect("a target");
    assert_wraps("torn torus", &target.mesh, 600, 0);
}

/// The penguin's wing touches its side in a point.
#[test]
fn small_handles_go_unless_they_are_to_be_kept() {
    let Some(penguin) = scan("surfaces/penguin.obj") else {
        return;
    };
    let target = Target::new(&Device::Cpu, &penguin).expect("a target");
    let euler = |genus| {
        let wrapped = automatic(&target.mesh, 1500, genus, Holes::Bridge).expect("a surface");
        checked(&wrapped.control).euler_characteristic()
    };
    assert_eq!(euler(Genus::Simplify), 2);
    assert_eq!(euler(Genus::Keep), 0);
}

#[test]
fn every_larger_piece_is_wrapped() {
    let mut other = shapes::sphere(0.4, 4);
    other.positions.iter_mut().for_each(|p| p.x += 2.0);
    let pair = joined(&[torus(1.0, 0.4, DVec3::ZERO), other]);
    assert_wraps("torus and ball", &pair, 1200, 2);
}

/// A bar bent around until its ends are inside one another.
#[test]
fn what_crosses_itself_keeps_its_own_topology() {
    let mut bar = shapes::box_grid(DVec3::ZERO, DVec3::new(6.8, 0.6, 0.6), [68, 6, 6]);
    for p in &mut bar.positions {
        let (angle, radius) = (p.x, 1.0 + p.y);
        *p = DVec3::new(radius * angle.cos(), radius * angle.sin(), p.z);
    }
    let bar = bar.triangulate();
    let wrapped = automatic(&bar, 1000, Genus::Simplify, Holes::Bridge).expect("a surface");
    assert_eq!(checked(&wrapped.control).euler_characteristic(), 2);
    let seen = automatic(&bar, 1000, Genus::Keep, Holes::Bridge).expect("a surface");
    assert_eq!(checked(&seen.control).euler_characteristic(), 0);
}

/// A ball with a ring half sunk into it.
#[test]
fn handles_larger_than_that_stay() {
    let cup = joined(&[shapes::sphere(1.0, 4), torus(0.3, 0.08, DVec3::X)]);
    assert_wraps("cup", &cup, 1500, 0);
}

#[test]
fn what_encloses_nothing_is_refused() {
    let refusal = |mesh: &TriangleMesh| {
        let refused = automatic(mesh, 500, Genus::Simplify, Holes::Bridge).map(|a| a.sound);
        refused.expect_err("nothing to wrap").to_string()
    };
    assert!(refusal(&TriangleMesh::default()).contains("0 triangles"));
    let triangle = TriangleMesh {
        positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
        triangles: vec![[0, 1, 2]],
    };
    assert!(refusal(&triangle).contains("flat"));
    let line = TriangleMesh {
        positions: vec![DVec3::ZERO, DVec3::X, 2.0 * DVec3::X],
        triangles: vec![[0, 1, 2]],
    };
    assert!(refusal(&line).contains("flat"));
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("threads")
            .install(|| automatic(&double_torus(), 400, Genus::Simplify, Holes::Bridge))
            .expect("a surface")
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn a_fit_from_it_has_the_handles_and_the_shape() {
    let mesh = double_torus();
    let target = Target::new(&Device::Cpu, &mesh).expect("a target");
    let template = Template::Automatic {
        control_points: 500,
        genus: Genus::Simplify,
    };
    let start = Start::new(&target, &template, Scheme::CatmullClark).expect("a start");
    assert_eq!(
        (start.proximity, start.subdivisions),
        (Proximity::Touching, 0)
    );
    let fit = fit(&Device::Cpu, &target, start, &Options::default(), &Silent).expect("a fit");
    assert!(fit.iterations.iter().all(|i| i.phase == "polish"));
    let fitted = Connectivity::of(&fit.surface).expect("a manifold");
    assert_eq!(fitted.euler_characteristic(), -2);
    // Judged one way: what lies inside the union is part of the target, but not of the fit.
    let surface = fit.surface.triangulate();
    let off = distances(&target.mesh, &surface.positions).expect("triangles");
    let worst = off.into_iter().fold(0.0, f64::max);
    println!("largest distance {:.3} % of the diagonal", 100.0 * worst);
    assert!(worst < 0.02);
}

/// A scan of the public data.
fn scan(name: &str) -> Option<TriangleMesh> {
    let path = common::data(name)?;
    Some(read_surface(&path).expect(name).mesh.triangulate())
}

#[test]
fn real_scans_keep_their_handles() {
    for (name, euler) in [
        ("surfaces/fertility.obj", -6),
        ("surfaces/plate-holes.stl", -8),
        ("scans/quadknot.obj", 0),
    ] {
        if let Some(mesh) = scan(name) {
            let target = Target::new(&Device::Cpu, &mesh).expect(name);
            assert_wraps(name, &target.mesh, 1500, euler);
        }
    }
}

#[test]
fn unconnected_triangles_are_no_surface() {
    let Some(soup) = scan("scans/soup.stl") else {
        return;
    };
    let target = Target::new(&Device::Cpu, &soup).expect("triangles");
    let refused = automatic(&target.mesh, 500, Genus::Simplify, Holes::Bridge).map(|a| a.sound);
    let message = refused.expect_err("no surface").to_string();
    assert!(message.contains("no surface to wrap"), "{message}");
}

#[test]
fn a_bunny_far_from_the_origin_gets_the_same_template() {
    let Some(mesh) = scan("surfaces/stanford-bunny.obj") else {
        return;
    };
    let mut away = mesh.clone();
    away.positions
        .iter_mut()
        .for_each(|p| *p += DVec3::splat(5e6));
    let [here, there] = [mesh, away].map(|mesh| {
        let target = Target::new(&Device::Cpu, &mesh).expect("a target");
        automatic(&target.mesh, 1500, Genus::Simplify, Holes::Bridge)
            .expect("a surface")
            .control
    });
    assert!(here.mesh.faces().eq(there.mesh.faces()), "the same quads");
    let pairs = here.mesh.positions.iter().zip(&there.mesh.positions);
    let apart = pairs.map(|(p, q)| p.distance(*q)).fold(0.0, f64::max);
    println!("{apart:.1e} of the diagonal apart");
    assert!(apart < 1e-6, "{apart}");
}

/// Coordinates are rounded to what the sum holds exactly, or the far one would be another bunny: by 4·10⁻⁹ of its diagonal, which moves samples from
/// triangle to triangle and the fitted surface by more than this.
#[test]
fn a_bunny_far_from_the_origin_is_fitted_by_the_same_surface() {
    const AWAY: f64 = 5e6;
    const DIGITS: f64 = (1u64 << 28) as f64;
    let Some(mut mesh) = scan("surfaces/stanford-bunny.obj") else {
        return;
    };
    for p in &mut mesh.positions {
        *p = (*p * DIGITS).round() / DIGITS;
    }
    let mut away = mesh.clone();
    away.positions.iter_mut().for_each(|p| *p += AWAY);
    let [here, there] = [mesh, away].map(|mesh| {
        let target = Target::new(&Device::Cpu, &mesh).expect("a target");
        let template = Template::Automatic {
            control_points: 400,
            genus: Genus::Simplify,
        };
        let options = Options::default();
        let start = Start::new(&target, &template, options.scheme).expect("a start");
        let fit = fit(&Device::Cpu, &target, start, &options, &Silent).expect("a fit");
        let control = fit.control.mesh.positions;
        let in_input = |p: &DVec3| target.frame.to_input(*p);
        (
            control.iter().map(in_input).collect::<Vec<_>>(),
            target.frame.diagonal,
        )
    });
    assert_eq!(here.1, there.1, "the same diagonal");
    let pairs = here.0.iter().zip(&there.0);
    let apart = pairs
        .map(|(p, q)| p.distance(*q - AWAY))
        .fold(0.0, f64::max);
    println!("{:.1e} of the diagonal apart", apart / here.1);
    assert!(apart < 1e-6 * here.1, "{apart}");
}
