//! The geometric algorithm: bad input, tolerances and counts met, the same bits again; on real scans figures, genus and boundaries.

mod common;

use common::Impatient;
use glam::DVec3;
use std::path::Path;
use std::process::Command;
use vorofit::device::Device;
use vorofit::files::{Scan, SurfaceToWrite, read_scans, write_surface};
use vorofit::fit::geometric::{Data, Options, Start, Step, fit};
use vorofit::fit::{Fit, StopReason};
use vorofit::geometry::Bvh;
use vorofit::measure::surface_error;
use vorofit::mesh::{Connectivity, ControlMesh, PolygonMesh, TriangleMesh, shapes};
use vorofit::progress::Silent;
use vorofit::template::Align;
use vorofit::topology;

fn simplified(count: usize) -> Start {
    Start::Simplified(Some(count))
}

fn fitted(data: &Data, start: &Start, options: &Options) -> Fit {
    let control = data
        .control_mesh(&Device::Cpu, start, &Silent)
        .expect("a start");
    fit(&Device::Cpu, data, control, options, &Silent).expect("a fit")
}

/// Options with tolerances in percent.
fn within(max: f64, mean: Option<f64>) -> Options {
    Options {
        max_error: Some(max / 100.0),
        mean_error: mean.map(|mean| mean / 100.0),
        levels: 3,
        ..Options::default()
    }
}

/// A ball with waves on it.
fn wavy_ball(levels: usize) -> TriangleMesh {
    let mut ball = shapes::sphere(1.0, levels);
    for p in &mut ball.positions {
        *p *= 1.0 + 0.1 * (4.0 * p.x).sin() * (3.0 * p.y).cos();
    }
    ball
}

/// A wavy square sheet of n² cells.
fn sheet(n: u32) -> TriangleMesh {
    let positions = (0..=n)
        .flat_map(|j| (0..=n).map(move |i| [i, j].map(|k| f64::from(k) / f64::from(n))))
        .map(|[x, y]| DVec3::new(x, y, 0.1 * (5.0 * x).sin() * (4.0 * y).cos()))
        .collect();
    let cells = (0..n).flat_map(|j| (0..n).map(move |i| j * (n + 1) + i));
    let triangles = cells.flat_map(|a| [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]);
    TriangleMesh {
        positions,
        triangles: triangles.collect(),
    }
}

#[test]
fn what_cannot_be_started_from_is_refused_with_a_remedy() {
    assert!(Data::of_points(&[]).is_err());
    assert!(Data::of_points(&[DVec3::ONE; 9]).is_err());
    assert!(Data::of_mesh(&TriangleMesh::default(), None, 0).is_err());
    let ball = wavy_ball(2);
    let cloud = Data::of_points(&ball.positions).expect("points");
    let error = cloud
        .control_mesh(&Device::Cpu, &simplified(50), &Silent)
        .expect_err("no triangles");
    assert!(error.to_string().contains("--template FILE"), "{error}");

    let mut soup = TriangleMesh::default();
    for k in 0..30 {
        let x = DVec3::splat(f64::from(k));
        soup.positions.extend([x, x + DVec3::X, x + DVec3::Y]);
        soup.triangles.push([3 * k, 3 * k + 1, 3 * k + 2]);
    }
    let data = Data::of_mesh(&soup, None, 0).expect("triangles");
    let error = data
        .control_mesh(&Device::Cpu, &simplified(50), &Silent)
        .expect_err("a soup");
    assert!(error.to_string().contains("topology"), "{error}");
}

#[test]
fn a_tolerance_is_met_by_either_step_and_holds_in_a_search_of_the_dense_surface() {
    let ball = wavy_ball(4);
    let data = Data::of_mesh(&ball, None, 0).expect("a ball");
    for (step, most) in [(Step::LeastSquares, 200), (Step::Displacement, 800)] {
        let options = Options {
            step,
            levels: 5,
            ..within(0.1, Some(0.02))
        };
        let fit = fitted(&data, &simplified(60), &options);
        assert_eq!(fit.stop_reason, StopReason::Tolerance, "{step:?}");
        let error = fit.data_error.expect("measured");
        println!(
            "{step:?}: {} control points, {} iterations, {:.4} % / {:.4} %",
            fit.control.mesh.positions.len(),
            fit.iterations.len(),
            100.0 * error.max,
            100.0 * error.mean
        );
        assert!(error.max <= 0.001 && error.mean <= 0.0002);
        assert!(fit.control.mesh.positions.len() < most);
        let dense = fit.surface.triangulate();
        let tree = Bvh::new(&dense.positions, &dense.triangles).expect("triangles");
        let distance = |p: &DVec3| tree.closest(*p).distance_squared.sqrt();
        // Chords of the dense surface are a little off the limit surface.
        let largest = data.points.iter().map(distance).fold(0.0, f64::max);
        assert!(
            (largest - error.max).abs() < 5e-5,
            "{largest} {}",
            error.max
        );
    }
}

#[test]
fn without_a_tolerance_the_count_stays() {
    let data = Data::of_mesh(&wavy_ball(3), None, 0).expect("a ball");
    let options = Options {
        levels: 2,
        ..Options::default()
    };
    let fit = fitted(&data, &simplified(80), &options);
    assert_eq!(fit.control.mesh.positions.len(), 80);
    assert_eq!(fit.stop_reason, StopReason::Stagnation);
    let last = fit.iterations.last().expect("iterations");
    assert!(last.rms_percent < fit.iterations[0].rms_percent.map(|first| 0.2 * first));
}

#[test]
fn limits_of_counts_and_iterations_are_kept_and_named() {
    let data = Data::of_mesh(&wavy_ball(4), None, 0).expect("a ball");
    let few = Options {
        max_control_points: Some(90),
        ..within(1e-4, None)
    };
    let fit = fitted(&data, &simplified(60), &few);
    assert!((61..=90).contains(&fit.control.mesh.positions.len()));
    assert_eq!(fit.stop_reason, StopReason::ControlPoints);
    let short = Options {
        iterations: Some(3),
        ..within(1e-4, None)
    };
    let fit = fitted(&data, &simplified(60), &short);
    assert_eq!(fit.iterations.len(), 3);
    assert_eq!(fit.stop_reason, StopReason::Iterations);
}

#[test]
fn an_interrupted_fit_is_whole() {
    let data = Data::of_mesh(&wavy_ball(3), None, 0).expect("a ball");
    let control = data
        .control_mesh(&Device::Cpu, &simplified(60), &Silent)
        .expect("a start");
    let fit = fit(
        &Device::Cpu,
        &data,
        control,
        &within(1e-3, None),
        &Impatient,
    )
    .expect("a fit");
    assert_eq!(fit.stop_reason, StopReason::Interrupted);
    assert!(fit.data_error.is_some() && fit.surface.face_count() > 0);
}

#[test]
fn threads_do_not_matter() {
    let data = Data::of_mesh(&sheet(30), None, 0).expect("a sheet");
    let run = || fitted(&data, &simplified(60), &within(0.05, None)).control;
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("a pool").install(run)
    };
    assert!(with(1) == with(3));
}

#[test]
fn a_sheet_keeps_its_boundary() {
    let sheet = sheet(40);
    let data = Data::of_mesh(&sheet, None, 0).expect("a sheet");
    let fit = fitted(&data, &simplified(40), &within(0.1, None));
    assert_eq!(fit.stop_reason, StopReason::Tolerance);
    let [there, back] = rims_apart(&sheet, &fit, &data);
    println!("rims {there:.5} {back:.5} apart");
    assert!(there < 0.0011 && back < 0.005);
}

#[test]
fn points_and_samples_are_fitted_like_vertices() {
    let ball = wavy_ball(4);
    let cloud = Data::of_points(&ball.positions).expect("points");
    let whole = Data::of_mesh(&ball, Some(3000), 0).expect("a ball");
    assert_eq!(whole.points.len(), 3000);
    let control = ControlMesh::from(PolygonMesh::from(shapes::sphere(1.0, 1)));
    let start = Start::Mesh {
        control,
        align: Align::None,
    };
    for data in [cloud, whole] {
        let fit = fitted(&data, &start, &within(0.2, None));
        assert_eq!(fit.stop_reason, StopReason::Tolerance);
    }
}

/// Runs the program in a folder: its exit status, what it printed, and what it complained of.
fn vorofit(folder: &Path, args: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_vorofit"))
        .current_dir(folder)
        .args(args)
        .output()
        .expect("the program");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        output.status.code(),
        text(&output.stdout),
        text(&output.stderr),
    )
}

#[test]
fn the_command_fits_meshes_and_points_and_says_what_it_cannot() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let ball = wavy_ball(3);
    let (mesh, start) = (folder.join("ball.ply"), folder.join("start.obj"));
    let write = |path: &Path, mesh: TriangleMesh| {
        let mesh = mesh.into();
        write_surface(path, &SurfaceToWrite::dense(&mesh, None)).expect("written");
    };
    // Georeferenced points, with a comment and normals.
    let far = DVec3::new(4.6e6, 5.1e6, 300.0);
    let lines = ball.positions.iter().map(|p| {
        let q = *p + far;
        format!("{} {} {} 0 0 1\n", q.x, q.y, q.z)
    });
    let text = std::iter::once("# x y z nx ny nz\n".to_owned()).chain(lines);
    std::fs::write(folder.join("ball.xyz"), text.collect::<String>()).expect("written");
    let mut near = shapes::sphere(1.0, 1);
    near.positions.iter_mut().for_each(|p| *p += far);
    write(&mesh, ball);
    write(&start, near);

    let geometric = ["--method", "geometric", "--max-error", "0.3", "--json", "-"];
    let fit = |args: &[&str]| vorofit(folder, &[&["fit"], args, &geometric[..]].concat());
    let (status, json, complaint) = fit(&["ball.ply", "-o", "a.obj", "--control-points", "60"]);
    assert_eq!(status, Some(0), "{complaint}");
    let report: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(report["stop_reason"], "tolerance");
    assert_eq!(report["settings"]["method"], "geometric");
    assert_eq!(report["settings"]["template"], "simplify");
    assert!(report["error"]["data_to_limit"]["max_percent"].as_f64() <= Some(0.3));
    let iterations = report["iterations"].as_array().expect("iterations");
    for key in [
        "max_percent",
        "rms_percent",
        "mean_percent",
        "control_points",
        "seconds",
    ] {
        assert!(iterations.iter().all(|it| it[key].is_number()), "{key}");
    }
    assert!(report["timing"]["stages"]["closest points"].is_number());

    let (status, json, complaint) = fit(&["ball.xyz", "-o", "b.obj", "--template", "start.obj"]);
    assert_eq!(status, Some(0), "{complaint}");
    let report: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert!(report["error"]["target_to_surface"]["max_percent"].as_f64() <= Some(0.3));
    assert!(report["error"].get("surface_to_target").is_none());

    let (status, _, complaint) = fit(&["ball.xyz", "-o", "c.obj"]);
    assert!(
        status == Some(1) && complaint.contains("--template FILE"),
        "{complaint}"
    );
    // The other method makes a surface of them first.
    let (status, _, complaint) = vorofit(folder, &["fit", "ball.xyz", "-o", "d.obj"]);
    assert_eq!(status, Some(0), "{complaint}");
    for args in [
        ["--scheme", "polygon"],
        ["--template", "bbox"],
        ["--smoothness", "1"],
    ] {
        let (status, _, _) = fit(&[&["ball.ply", "-o", "c.obj"], &args[..]].concat());
        assert_eq!(status, Some(2), "{args:?}");
    }
    let (status, ..) = vorofit(
        folder,
        &["fit", "ball.ply", "-o", "c.obj", "--samples", "99"],
    );
    assert_eq!(status, Some(2));
    assert!(!folder.join("c.obj").exists());
}

#[test]
fn voronoi_distances_start_from_the_simplified_scan_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let mesh = wavy_ball(3).into();
    let path = folder.path().join("ball.ply");
    write_surface(&path, &SurfaceToWrite::dense(&mesh, None)).expect("written");
    let options = [
        "--template",
        "simplify",
        "--scheme",
        "loop",
        "--control-points",
        "70",
    ];
    let line = [
        "fit",
        "ball.ply",
        "-o",
        "a.obj",
        "--iterations",
        "8",
        "--json",
        "-",
    ];
    let (status, json, complaint) = vorofit(folder.path(), &[&line[..], &options[..]].concat());
    assert_eq!(status, Some(0), "{complaint}");
    let report: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(report["result"]["control_points"], 70);
    assert!(report["error"]["rms_percent"].as_f64() < Some(1.0));
}

/// A scan of the public data.
fn scan(name: &str) -> Option<TriangleMesh> {
    let path = common::data(name)?;
    match read_scans(&[path]).expect("a scan") {
        Scan::Surface(surface) => Some(surface.mesh.triangulate()),
        Scan::Points(_) => panic!("{name} has faces"),
    }
}

fn in_unit_frame(mesh: &TriangleMesh, data: &Data) -> TriangleMesh {
    let mut mesh = topology::manifold(&topology::cleaned(mesh)).mesh;
    for p in &mut mesh.positions {
        *p = data.frame.to_unit(*p);
    }
    mesh
}

/// The edges of a boundary as triangles without area.
fn rim(mesh: &PolygonMesh) -> TriangleMesh {
    let connectivity = Connectivity::of(mesh).expect("a manifold");
    let edges = 0..connectivity.edge_count() as u32;
    TriangleMesh {
        positions: mesh.positions.clone(),
        triangles: edges
            .filter(|&e| connectivity.is_boundary_edge(e))
            .map(|e| connectivity.ends(e))
            .map(|[a, b]| [a, b, b])
            .collect(),
    }
}

/// The largest distances between the boundaries of a target and of the surface fitted to it, from the vertices of each to the edges of the other: there and
/// back.
fn rims_apart(target: &TriangleMesh, fit: &Fit, data: &Data) -> [f64; 2] {
    let ours = rim(&fit.surface);
    let theirs = rim(&in_unit_frame(target, data).into());
    assert!(!ours.triangles.is_empty());
    let one_way = |from: &TriangleMesh, to: &TriangleMesh| {
        let tree = Bvh::new(&to.positions, &to.triangles).expect("edges");
        let ends = from.triangles.iter().map(|t| from.positions[t[0] as usize]);
        let distances = ends.map(|p| tree.closest(p).distance_squared.sqrt());
        distances.fold(0.0, f64::max)
    };
    [one_way(&theirs, &ours), one_way(&ours, &theirs)]
}

#[test]
fn the_bunny_is_nearer_than_peers_bring_it_at_equal_counts() {
    let Some(bunny) = scan("surfaces/stanford-bunny.obj") else {
        return;
    };
    let data = Data::of_mesh(&bunny, None, 0).expect("a bunny");
    // Control points; the largest and root mean square error of the peer, in percent.
    for (count, max, rms) in [(390, 0.765, 0.110), (627, 0.658, 0.075)] {
        let options = Options {
            levels: 3,
            ..Options::default()
        };
        let fit = fitted(&data, &simplified(count), &options);
        let target = in_unit_frame(&bunny, &data);
        let error = surface_error(&target, &fit.surface.triangulate(), 100_000).expect("areas");
        let reached = error.target_to_surface.rms.max(error.surface_to_target.rms);
        println!(
            "bunny {count}: {:.3} / {:.4}",
            100.0 * error.max(),
            100.0 * reached
        );
        assert!(100.0 * error.max() < max && 100.0 * reached < 0.8 * rms);
    }
}

#[test]
fn scans_are_met_with_fewer_control_points_than_the_paper_takes() {
    // The paper's control points at the start and at the end and its largest error; the root mean square error to reach with it, and a mean
    // that stands for it, in percent.
    for (name, start, most, max, rms, mean) in [
        ("stanford-bunny.obj", 612, 7098, 0.049, 0.0108, 0.0085),
        ("igea.ply", 336, 1572, 0.238, 0.038, 0.029),
    ] {
        let Some(mesh) = scan(&format!("surfaces/{name}")) else {
            continue;
        };
        let data = Data::of_mesh(&mesh, None, 0).expect(name);
        let fit = fitted(&data, &simplified(start), &within(max, Some(mean)));
        let error = fit.data_error.expect("measured");
        let count = fit.control.mesh.positions.len();
        println!(
            "{name}: {count} control points, {} iterations, {:.4} / {:.4}",
            fit.iterations.len(),
            100.0 * error.max,
            100.0 * error.rms
        );
        assert_eq!(fit.stop_reason, StopReason::Tolerance, "{name}");
        assert!(count <= most && 100.0 * error.max <= max && 100.0 * error.rms <= rms);
        if name.contains("bunny") {
            let target = in_unit_frame(&mesh, &data);
            let error = surface_error(&target, &fit.surface.triangulate(), 200_000);
            let error = error.expect("areas");
            let rms = error.target_to_surface.rms.max(error.surface_to_target.rms);
            println!("{name}: both ways {:.4}", 100.0 * rms);
            assert!(100.0 * rms <= 0.0196);
        }
    }
}

#[test]
fn genus_and_boundary_loops_stay() {
    for (name, start, max) in [
        ("surfaces/fertility.obj", 300, 0.3),
        ("surfaces/three-holes.obj", 200, 0.3),
        ("scans/elephant-with-holes.off", 1200, 0.3),
        ("surfaces/featuretype.stl", 600, 0.3),
    ] {
        let Some(mesh) = scan(name) else { continue };
        let data = Data::of_mesh(&mesh, None, 0).expect(name);
        let options = Options {
            iterations: Some(80),
            ..within(max, None)
        };
        let fit = fitted(&data, &simplified(start), &options);
        let connectivity = |mesh: &PolygonMesh| Connectivity::of(mesh).expect("a manifold");
        let ours = connectivity(&fit.control.mesh);
        ours.validate().expect("consistent");
        let theirs = connectivity(&in_unit_frame(&mesh, &data).into());
        let error = fit.data_error.expect("measured");
        println!(
            "{name}: {} control points, {:.4} %, {:?}",
            fit.control.mesh.positions.len(),
            100.0 * error.max,
            fit.stop_reason
        );
        assert_eq!(ours.euler_characteristic(), theirs.euler_characteristic());
        assert!(error.max < 0.01 * max, "{name}");
        if data.rims.iter().any(Option::is_some) {
            let [there, back] = rims_apart(&mesh, &fit, &data).map(|d| 100.0 * d);
            println!("{name}: rims {there:.4} % and {back:.4} % apart");
            // Between the points of our boundary that are watched, and those of theirs, it may be a little more.
            assert!(there.max(back) < 1.05 * max);
        }
    }
}
