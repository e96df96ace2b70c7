//! The program as its user meets it: files, reports, exit statuses, interruption.

#[path = "common/program.rs"]
mod program;

use glam::DVec3;
use program::*;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};
use vorofit::files::{SurfaceToWrite, read_surface, write_surface};
use vorofit::mesh::{PolygonMesh, shapes};

#[test]
fn a_fit_writes_its_files_and_a_report_that_says_what_they_are() {
    let folder = folder_with_scan("fit");
    let at = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
    let said = succeed(&[
        "fit",
        &at("scan.ply"),
        "-o",
        &at("a.obj"),
        "-o",
        &at("a.usda"),
        "--surface",
        &at("s.ply"),
        "--surface",
        &at("s.glb"),
        "--template",
        "bbox",
        "--control-points",
        "98",
        "--json",
        &at("report.json"),
        "--device",
        "cpu",
    ]);
    assert_eq!(
        names(&folder),
        [
            "a.obj",
            "a.usda",
            "report.json",
            "s.glb",
            "s.ply",
            "scan.ply"
        ]
    );
    let control = read_surface(&folder.join("a.obj"))
        .expect("a control mesh")
        .mesh;
    let surface = read_surface(&folder.join("s.ply")).expect("a surface").mesh;

    let report = json(&folder.join("report.json"));
    assert_eq!(report["schema"], "vorofit.report/1");
    assert_eq!(report["command"], "fit");
    assert_eq!(report["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(report["device"]["kind"], "cpu");
    assert_eq!(report["target"]["faces"], 5120);
    assert!(
        (report["target"]["bbox_diagonal"]
            .as_f64()
            .expect("a length")
            - 3.8)
            .abs()
            < 0.3
    );
    assert_eq!(report["result"]["control_points"], control.positions.len());
    assert_eq!(report["result"]["control_faces"], control.face_count());
    assert_eq!(
        report["result"]["surface_vertices"],
        surface.positions.len()
    );
    assert_eq!(report["settings"]["template"], "bbox");
    assert_eq!(report["settings"]["scheme"], "catmull-clark");
    assert_eq!(report["stop_reason"], "schedule");
    assert_eq!(report["converged"], true);
    assert_eq!(control.positions.len(), 98);

    let error = &report["error"];
    let number = |value: &Value| value.as_f64().expect("a number");
    let percent = number(&error["max_percent"]);
    assert!(percent > 0.0 && percent < 1.0, "{percent}");
    assert!(number(&error["mean_percent"]) <= number(&error["rms_percent"]));
    assert!(number(&error["rms_percent"]) < percent);
    assert_eq!(number(&error["hausdorff_percent"]), percent);
    let directed = ["target_to_surface", "surface_to_target"].map(|d| number(&error[d]["max"]));
    assert_eq!(directed[0].max(directed[1]), number(&error["hausdorff"]));
    assert!(error.get("over_holes").is_none(), "the ball is closed");

    let iterations = report["iterations"].as_array().expect("iterations");
    assert!(
        iterations
            .iter()
            .zip(1..)
            .all(|(it, k)| it["iteration"] == k)
    );
    assert!(
        iterations
            .iter()
            .any(|it| it["terms"]["smoothness"].is_number())
    );
    let stages = report["timing"]["stages"].as_object().expect("stages");
    let sum: f64 = stages.values().map(number).sum();
    let total = number(&report["timing"]["total_s"]);
    assert!(sum <= total && sum > 0.8 * total, "{sum} of {total} s");
    for absent in ["quality", "adapters", "kernels"] {
        assert!(report.get(absent).is_none(), "{absent}");
    }
    for word in ["a.obj", "s.glb", "98 control points", "error", "open"] {
        assert!(said.contains(word), "{word} in {said}");
    }

    // The judge in the report and the comparison of the files agree.
    let compared = succeed(&["compare", &at("scan.ply"), &at("s.ply"), "--json", "-"]);
    let compared: Value = serde_json::from_str(&compared).expect("only JSON on stdout");
    let interval = compared["error"]["hausdorff_interval"]
        .as_array()
        .expect("an interval");
    let [lower, upper] = [number(&interval[0]), number(&interval[1])];
    assert!(lower <= upper && upper <= lower * 1.001 + 1e-5);
    let sampled = number(&error["hausdorff"]);
    assert!(
        sampled <= 1.0001 * upper && sampled > 0.9 * lower,
        "{sampled} in {lower}..{upper}"
    );
    let ratio = number(&compared["error"]["rms_percent"]) / number(&error["rms_percent"]);
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
}

#[test]
fn a_fit_far_from_the_origin_is_as_good() {
    let folder = folder_with_scan("georeferenced");
    let mut moved = ball();
    for p in &mut moved.positions {
        *p = 100.0 * *p + DVec3::new(5e6, -4.2e6, 310.0);
    }
    write(&folder.join("moved.ply"), &moved);
    write(&folder.join("moved.obj"), &moved);
    let error = |name: &str| {
        let [scan, out, report] = [name, "c.obj", "r.json"].map(|n| folder.join(n));
        succeed(&[
            "fit",
            path_text(&scan),
            "-o",
            path_text(&out),
            "--control-points",
            "98",
            "--quiet",
            "--device",
            "cpu",
            "--json",
            path_text(&report),
        ]);
        let control = read_surface(&out).expect("a control mesh").mesh;
        let report = json(&report);
        let percent = |key: &str| report["error"][key].as_f64().expect("a number");
        (percent("max_percent"), percent("rms_percent"), control)
    };
    let (max, rms, _) = error("scan.ply");
    for name in ["moved.ply", "moved.obj"] {
        let (far_max, far_rms, control) = error(name);
        assert!(
            (far_max / max - 1.0).abs() < 0.05,
            "{far_max} against {max}"
        );
        assert!(
            (far_rms / rms - 1.0).abs() < 0.05,
            "{far_rms} against {rms}"
        );
        let away = (control.positions[0] - DVec3::new(5e6, -4.2e6, 310.0)).length();
        assert!(away < 300.0, "{away}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let folder = folder_with_scan("threads");
    let scan = folder.join("scan.ply");
    let bytes = |threads: &str| {
        let out = folder.join("c.ply");
        succeed(&[
            "fit",
            path_text(&scan),
            "-o",
            path_text(&out),
            "--control-points",
            "98",
            "--threads",
            threads,
            "--device",
            "cpu",
        ]);
        std::fs::read(out).expect("a file")
    };
    assert!(bytes("1") == bytes("2"));
}

#[test]
fn schemes_templates_and_limits_do_what_they_say() {
    let folder = folder_with_scan("options");
    write(
        &folder.join("ring.stl"),
        &shapes::torus(3.0, 1.0, 40, 20).triangulate(),
    );
    let cage = PolygonMesh::from(shapes::sphere(0.1, 2));
    write_surface(
        &folder.join("cage.off"),
        &SurfaceToWrite::dense(&cage, None),
    )
    .expect("written");
    let at = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
    let fit = |target: &str, options: &[&str]| {
        let (target, out, report) = (at(target), at("c.obj"), at("r.json"));
        let mut args = vec![
            "fit", &target, "-o", &out, "--json", &report, "--device", "cpu",
        ];
        args.extend(options);
        succeed(&args);
        (
            read_surface(Path::new(&out)).expect("a mesh").mesh,
            json(Path::new(&report)),
        )
    };
    let (control, report) = fit("scan.ply", &["--scheme", "loop", "--control-points", "98"]);
    assert!(control.faces().all(|f| f.len() == 3));
    assert_eq!(report["settings"]["scheme"], "loop");
    let (control, report) = fit(
        "scan.ply",
        &["--scheme", "polygon", "--control-points", "98"],
    );
    assert_eq!(
        report["result"]["surface_vertices"],
        control.positions.len()
    );
    let (control, _) = fit(
        "ring.stl",
        &[
            "--template",
            "torus",
            "--control-points",
            "128",
            "--axis",
            "0,0,0,0,0,-2",
        ],
    );
    assert_eq!(control.positions.len(), 128);
    let (control, report) = fit(
        "scan.ply",
        &[
            "--template",
            &at("cage.off"),
            "--align",
            "box",
            "--scheme",
            "loop",
            "--levels",
            "1",
        ],
    );
    assert_eq!(control.positions.len(), cage.positions.len());
    assert!(report["error"]["max_percent"].as_f64().expect("a number") < 1.0);
    let (_, report) = fit("scan.ply", &["--control-points", "98", "--iterations", "7"]);
    assert_eq!(
        report["iterations"].as_array().expect("iterations").len(),
        7
    );
    assert_eq!(report["stop_reason"], "iterations");
    assert_eq!(report["converged"], false);
    let (_, report) = fit("scan.ply", &["--control-points", "98", "--max-error", "50"]);
    assert_eq!(report["stop_reason"], "tolerance");
    assert_eq!(report["converged"], true);
}

#[test]
fn compare_states_known_distances() {
    let folder = folder("compare");
    let [a, b] = ["a.off", "b.off"].map(|name| folder.join(name));
    write(&a, &shapes::sphere(1.0, 5));
    write(&b, &shapes::sphere(1.1, 5));
    let table = succeed(&["compare", path_text(&a), path_text(&b)]);
    for row in ["at least", "at most", "rms", "mean", "10,242 vertices"] {
        assert!(table.contains(row), "{table}");
    }
    let report: Value = serde_json::from_str(&succeed(&[
        "compare",
        path_text(&a),
        path_text(&b),
        "--json",
        "-",
    ]))
    .expect("JSON");
    let number = |value: &Value| value.as_f64().expect("a number");
    let error = &report["error"];
    for direction in ["target_to_surface", "surface_to_target"] {
        assert!(
            (number(&error[direction]["mean"]) - 0.1).abs() < 1e-3,
            "{error}"
        );
    }
    assert!((number(&error["hausdorff"]) - 0.1).abs() < 1e-3);
    let diagonal = number(&report["target"]["bbox_diagonal"]);
    assert!((number(&error["mean_percent"]) - 10.0 / diagonal).abs() < 0.1);
}

#[test]
fn devices_are_listed_and_kernels_compared() {
    let listed: Value = serde_json::from_str(&succeed(&["devices", "--json", "-"])).expect("JSON");
    assert!(
        !listed["adapters"].as_array().expect("adapters").is_empty(),
        "install mesa-vulkan-drivers"
    );
    let file = folder("bench").join("bench.json");
    let table = succeed(&[
        "bench",
        "--sizes",
        "1000",
        "--device",
        "gpu",
        "--json",
        path_text(&file),
    ]);
    let report = json(&file);
    let rows = report["kernels"].as_array().expect("rows");
    assert_eq!(rows.len(), vorofit::benchmark::MEASUREMENTS.len());
    for row in rows {
        assert!(table.contains(row["kernel"].as_str().expect("a name")));
        let disagreement = row["disagreement"].as_f64().expect("a number");
        assert!(disagreement <= 1.0, "{row}");
        assert!(row["cpu_ms"].as_f64() > Some(0.0) && row["gpu_ms"].as_f64() > Some(0.0));
    }
    let against = [
        "bench",
        "--sizes",
        "1000",
        "--device",
        "cpu",
        "--against",
        path_text(&file),
    ];
    assert!(succeed(&against).contains("ratio"));
}

#[test]
fn a_reader_that_goes_away_does_no_harm() {
    let mut child = vorofit(&["devices", "--device", "cpu"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("it ends");
    assert!(output.status.success(), "{}", text(&output.stderr));
}

#[cfg(unix)]
#[test]
fn an_interrupted_fit_writes_the_best_so_far() {
    use std::io::{BufRead, BufReader};
    let folder = folder_with_scan("interrupted");
    let [scan, out, report] = ["scan.ply", "c.obj", "r.json"].map(|name| folder.join(name));
    let mut child = vorofit(&[
        "fit",
        path_text(&scan),
        "-o",
        path_text(&out),
        "--template",
        "bbox",
        "--control-points",
        "6146",
        "--device",
        "cpu",
    ])
    .args(["--json", path_text(&report)])
    .stdout(Stdio::piped())
    .stderr(Stdio::piped())
    .spawn()
    .expect("the program starts");
    let mut stderr = BufReader::new(child.stderr.take().expect("stderr")).lines();
    let begun = |line: std::io::Result<String>| line.is_ok_and(|line| line.starts_with("near"));
    assert!(stderr.any(begun), "the second phase begins");
    let kill = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(kill.expect("kill").success());
    let said: Vec<String> = stderr.map_while(Result::ok).collect();
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(130), "{said:?}");
    assert!(
        said.iter().any(|line| line.starts_with("interrupted")),
        "{said:?}"
    );
    assert!(text(&output.stdout).contains("best so far"));
    let report = json(&report);
    assert_eq!(report["stop_reason"], "interrupted");
    let control = read_surface(&out).expect("a control mesh").mesh;
    assert_eq!(report["result"]["control_points"], control.positions.len());
    assert!(report["error"]["rms_percent"].as_f64().expect("a number") < 2.0);
}
