//! `--open`: control meshes that are open where the target is, with their boundary curves on its own.

mod common;
#[path = "common/program.rs"]
mod program;

use glam::DVec3;
use vorofit::device::Device;
use vorofit::files::read_surface;
use vorofit::fit::{Options, Start, Target, Template, fit};
use vorofit::measure::{Mended, RimError, SurfaceError, rim_error};
use vorofit::mesh::{Connectivity, PolygonMesh, Scheme, TriangleMesh, shapes};
use vorofit::progress::Silent;
use vorofit::template::Genus;
use vorofit::topology::Holes;

/// A grid of points over the unit square, the second coordinate going round if `closed`.
fn patch(closed: bool, point: impl Fn(f64, f64) -> DVec3) -> TriangleMesh {
    let (n, m) = (40u32, 80u32);
    let columns = if closed { m } else { m + 1 };
    let mut mesh = PolygonMesh::default();
    for i in 0..=n {
        for j in 0..columns {
            let (u, v) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(m));
            mesh.positions.push(point(u, v));
        }
    }
    for i in 0..n {
        for j in 0..m {
            let at = |i: u32, j: u32| i * columns + j % columns;
            mesh.push_face(&[at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    mesh.triangulate()
}

/// The lower part of a ball, with a tiny hole at the pole.
fn bowl() -> TriangleMesh {
    patch(true, |u, v| {
        let (polar, turn) = (0.01 + 1.3 * u, std::f64::consts::TAU * v);
        let (x, y) = (turn.cos(), turn.sin());
        DVec3::new(polar.sin() * x, polar.sin() * y, -polar.cos())
    })
}

/// A tube whose ends are no plane curves.
fn tube() -> TriangleMesh {
    patch(true, |u, v| {
        let turn = std::f64::consts::TAU * v;
        let height = 3.0 * u + 0.3 * (2.0 * turn).sin() * (2.0 * u - 1.0);
        DVec3::new(turn.cos(), turn.sin(), height)
    })
}

/// A wavy sheet, which encloses nothing.
fn sheet() -> TriangleMesh {
    patch(false, |u, v| {
        let height = 0.3 * (3.0 * u).sin() * (2.0 * v).cos();
        DVec3::new(2.0 * u, 2.0 * v, height)
    })
}

/// A ball of fine triangles less two caps.
fn ball_with_two_holes() -> TriangleMesh {
    let mut ball = shapes::sphere(1.0, 5);
    let other = DVec3::new(0.6, 0.0, -0.8);
    let positions = ball.positions.clone();
    ball.triangles.retain(|t| {
        let center = t.iter().map(|&v| positions[v as usize] / 3.0);
        let center: DVec3 = center.sum();
        center.z < 0.8 && center.dot(other) < 0.9
    });
    ball
}

struct Followed {
    /// In diagonals.
    error: SurfaceError,
    rims: RimError,
}

/// Fits an open surface, and checks its topology.
fn follow(name: &str, mesh: &TriangleMesh, control_points: usize, euler: i64) -> Followed {
    let target = Target::with(&Device::Cpu, mesh, &[], Holes::Follow).expect(name);
    let template = Template::Automatic {
        control_points,
        genus: Genus::Simplify,
    };
    let start = Start::new(&target, &template, Scheme::CatmullClark).expect(name);
    let options = Options::default();
    let fit = fit(&Device::Cpu, &target, start, &options, &Silent).expect(name);
    let connectivity = Connectivity::of(&fit.control.mesh).expect(name);
    assert_eq!(connectivity.euler_characteristic(), euler, "{name}");
    let points = fit.control.mesh.positions.len();
    assert!(
        points.abs_diff(control_points) * 20 <= control_points,
        "{name}: {points} points"
    );
    let surface = fit.surface.triangulate();
    let mended = Mended::of(&target.mesh, Holes::Follow).expect(name);
    let error = mended
        .surface_error(&target.mesh, &surface, 30_000)
        .expect(name);
    let rims = rim_error(&target.mesh, &surface, 5_000).expect("both are open");
    let [there, back] = [rims.target_to_surface, rims.surface_to_target];
    println!(
        "{name}: {points} points, {:.3} / {:.4} %; rims {:.3} / {:.4} % there, {:.3} / {:.4} % back",
        100.0 * error.max(),
        100.0 * error.target_to_surface.rms,
        100.0 * there.max,
        100.0 * there.rms,
        100.0 * back.max,
        100.0 * back.rms,
    );
    Followed { error, rims }
}

impl Followed {
    fn largest_at_rims(&self) -> f64 {
        let RimError {
            target_to_surface,
            surface_to_target,
        } = self.rims;
        target_to_surface.max.max(surface_to_target.max)
    }
}

#[test]
fn generated_surfaces_keep_their_boundaries() {
    for (name, mesh, euler, at_most) in [
        ("bowl", bowl(), 1, 0.003),
        ("tube", tube(), 0, 0.002),
        ("sheet", sheet(), 1, 0.003),
        // Its rims are zigzags of the ball's triangles, 0.9 % high.
        ("ball with two holes", ball_with_two_holes(), 0, 0.01),
    ] {
        let followed = follow(name, &mesh, 300, euler);
        assert!(followed.error.max() < 0.01, "{name}");
        assert!(followed.largest_at_rims() < at_most, "{name}");
        assert!(followed.error.share_folded < 0.003, "{name}");
    }
}

#[test]
fn a_closed_target_stays_closed_and_tiny_holes_are_bridged() {
    let mut ball = shapes::sphere(1.0, 6);
    ball.triangles.swap_remove(77);
    let target = Target::with(&Device::Cpu, &ball, &[], Holes::Follow).expect("a target");
    assert!(target.rim().is_none());
    let template = Template::Automatic {
        control_points: 200,
        genus: Genus::Simplify,
    };
    let start = Start::new(&target, &template, Scheme::CatmullClark).expect("a start");
    let connectivity = Connectivity::of(&start.control.mesh).expect("a manifold");
    assert_eq!(connectivity.euler_characteristic(), 2);
}

#[test]
fn the_program_says_what_became_of_boundaries_and_what_the_cage_is_like() {
    let folder = program::folder("open");
    let [scan, control, report] =
        ["scan.ply", "control.obj", "report.json"].map(|n| folder.join(n));
    program::write(&scan, &tube());
    let path = program::path_text;
    let asked = [
        "fit",
        path(&scan),
        "-o",
        path(&control),
        "--control-points",
        "100",
    ];
    let said = program::succeed(&[&asked[..], &["--open", "--json", path(&report)]].concat());
    assert!(said.contains("boundaries of scan and surface"), "{said}");
    assert!(
        said.contains("Euler characteristic 0 as the scan's"),
        "{said}"
    );
    let json = program::json(&report);
    assert_eq!(json["settings"]["holes"], "follow");
    assert_eq!(json["cage"]["target_euler_characteristic"], 0);
    assert!(
        json["cage"]["least_angle"]
            .as_f64()
            .is_some_and(|a| a > 5.0)
    );
    assert!(
        json["cage"]["folded_percent"]
            .as_f64()
            .is_some_and(|f| f < 0.5)
    );
    for key in ["target_to_surface", "surface_to_target"] {
        let largest = json["error"]["rims"][key]["max_percent"].as_f64();
        assert!(
            largest.is_some_and(|l| l > 0.0 && l < 1.0),
            "{key}: {largest:?}"
        );
    }
    let refused = program::run(&[&asked[..], &["--open", "--template", "bbox"]].concat());
    assert_eq!(refused.status.code(), Some(2));
    assert!(program::text(&refused.stderr).contains("--open needs"));
}

#[test]
fn real_scans_keep_their_holes() {
    let Some(path) = common::data("surfaces/stanford-bunny.obj") else {
        return;
    };
    let bunny = read_surface(&path).expect("a surface").mesh.triangulate();
    let followed = follow("bunny", &bunny, 1500, 2 - 5);
    assert!(followed.largest_at_rims() < 0.015);
}
