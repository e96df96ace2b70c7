//! The program as its user meets it: files, reports, refusals, exit statuses, interruption.

use glam::DVec3;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use vorofit::files::{SurfaceToWrite, read_surface, write_surface};
use vorofit::mesh::{PolygonMesh, TriangleMesh, shapes};

fn vorofit(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vorofit"));
    command.args(args).env_remove("RUST_LOG");
    command
}

fn run(args: &[&str]) -> Output {
    vorofit(args).output().expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("UTF-8")
}

/// Runs what must succeed; what it printed.
fn succeed(args: &[&str]) -> String {
    let output = run(args);
    assert!(
        output.status.success(),
        "{args:?}: {}",
        text(&output.stderr)
    );
    text(&output.stdout)
}

/// A folder of its own for each test, empty.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("command_line")
        .join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<_> = entries
        .map(|e| {
            e.expect("an entry")
                .file_name()
                .into_string()
                .expect("UTF-8")
        })
        .collect();
    names.sort();
    names
}

fn path_text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("a report")).expect("JSON")
}

/// A bumpy ball of some thousand triangles, a bit longer than wide.
fn ball() -> TriangleMesh {
    let mut ball = shapes::sphere(1.0, 4);
    for p in &mut ball.positions {
        *p *= DVec3::new(1.3, 1.0, 0.9) * (1.0 + 0.05 * (4.0 * p.x).sin() * (3.0 * p.y).cos());
    }
    ball
}

fn write(path: &Path, mesh: &TriangleMesh) {
    let mesh = PolygonMesh::from(mesh.clone());
    write_surface(path, &SurfaceToWrite::dense(&mesh, None)).expect("written");
}

/// A folder with `scan.ply` in it.
fn folder_with_scan(name: &str) -> PathBuf {
    let folder = folder(name);
    write(&folder.join("scan.ply"), &ball());
    folder
}

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

/// The program refuses: exit status 1, one line that names the file, and no file left behind.
fn assert_refused(args: &[&str], named: &str, folder: &Path) {
    let before = names(folder);
    let output = run(args);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{args:?}: {said}");
    let errors: Vec<_> = said
        .lines()
        .filter(|line| line.starts_with("error: "))
        .collect();
    assert!(
        matches!(errors[..], [line] if line.contains(named)),
        "{args:?}: {said}"
    );
    assert!(
        said.lines()
            .last()
            .is_some_and(|line| line.starts_with("error: ")),
        "{said}"
    );
    assert!(output.stdout.is_empty());
    assert_eq!(names(folder), before, "{args:?}");
}

#[test]
fn bad_input_is_refused_in_one_line_that_names_the_file() {
    let folder = folder("bad");
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let ply = |vertices: &str, faces: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let files: &[(&str, String)] = &[
        ("empty.ply", String::new()),
        ("empty.obj", String::new()),
        ("huge.ply", ply("4000000000", "4000000000")),
        ("cloud.ply", ply("1", "0") + "0 0 0\n"),
        ("nan.obj", format!("{obj}v nan 0 0\nf 1 2 4\n")),
        ("outside.obj", format!("{obj}f 1 2 9\n")),
        ("point.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n".into()),
        ("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n".into()),
        ("words.xyz", obj.into()),
        ("mislabelled.stl", ply("1", "0") + "0 0 0\n"),
    ];
    let out = folder.join("c.obj");
    for (name, content) in files {
        let path = folder.join(name);
        std::fs::write(&path, content).expect("written");
        assert_refused(
            &["fit", path_text(&path), "-o", path_text(&out)],
            name,
            &folder,
        );
        assert_refused(
            &["compare", path_text(&path), path_text(&path)],
            name,
            &folder,
        );
    }
    let missing = folder.join("missing.ply");
    assert_refused(
        &["fit", path_text(&missing), "-o", path_text(&out)],
        "missing.ply",
        &folder,
    );
    assert_refused(
        &["bench", "--against", path_text(&folder.join("point.obj"))],
        "point.obj",
        &folder,
    );
}

#[test]
fn outputs_that_cannot_be_written_are_refused_before_the_work() {
    let folder = folder_with_scan("outputs");
    std::fs::create_dir(folder.join("folder.obj")).expect("a folder");
    let scan = folder.join("scan.ply");
    for name in [
        "c.xyz",
        "c",
        "c.glb",
        "c.stl",
        "none/c.obj",
        "folder.obj",
        "scan.ply",
    ] {
        let out = folder.join(name);
        // A target that is not there shows that the output is looked at first.
        let target = if name == "scan.ply" {
            &scan
        } else {
            &folder.join("missing.ply")
        };
        assert_refused(
            &["fit", path_text(target), "-o", path_text(&out)],
            name,
            &folder,
        );
    }
    let out = folder.join("c.obj");
    let report = folder.join("none/r.json");
    assert_refused(
        &[
            "fit",
            path_text(&scan),
            "-o",
            path_text(&out),
            "--json",
            path_text(&report),
        ],
        "r.json",
        &folder,
    );
    let twice = [
        "fit",
        path_text(&scan),
        "-o",
        path_text(&out),
        "--surface",
        path_text(&out),
    ];
    assert_refused(&twice, "c.obj", &folder);
}

#[test]
fn templates_that_do_not_fit_are_refused_by_name() {
    let folder = folder_with_scan("templates");
    let [scan, out] = ["scan.ply", "c.obj"].map(|name| folder.join(name));
    let fin = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 0 -1 0\nf 1 2 3\nf 1 2 4\nf 1 2 5\n";
    std::fs::write(folder.join("fin.obj"), fin).expect("written");
    let fin = folder.join("fin.obj");
    let fit = |template: &str, named: &str| {
        let args = [
            "fit",
            path_text(&scan),
            "-o",
            path_text(&out),
            "--template",
            template,
        ];
        assert_refused(&args, named, &folder);
    };
    fit(path_text(&fin), "fin.obj");
    fit("bbux", "bbux");
    fit("torus", "scan.ply");
}

#[test]
fn bad_usage_exits_with_two() {
    let folder = folder_with_scan("usage");
    let scan = folder.join("scan.ply");
    let wrong: &[&[&str]] = &[
        &[],
        &["fit"],
        &["fit", "a.obj"],
        &["fit", "a.obj", "-o", "b.obj", "--control-points", "many"],
        &["fit", "a.obj", "-o", "b.obj", "--max-error", "-1"],
        &["fit", "a.obj", "-o", "b.obj", "--max-error", "nan"],
        &[
            "fit",
            "a.obj",
            "-o",
            "b.obj",
            "--max-error",
            "1",
            "--polish",
            "off",
        ],
        &["fit", "a.obj", "-o", "b.obj", "--scheme", "cubic"],
        &["fit", "a.obj", "-o", "b.obj", "--axis", "0,0,0,0,0,1"],
        &[
            "fit",
            "a.obj",
            "-o",
            "b.obj",
            "--template",
            "torus",
            "--axis",
            "0,0,1",
        ],
        &[
            "fit",
            "a.obj",
            "-o",
            "b.obj",
            "--template",
            "torus",
            "--axis",
            "0,0,1,0,0,0",
        ],
        &["fit", "a.obj", "-o", "b.obj", "--align", "box"],
        &[
            "fit",
            "a.obj",
            "-o",
            "b.obj",
            "--template",
            "t.obj",
            "--control-points",
            "100",
        ],
        &["compare", "a.obj"],
        &["devices", "--threads", "0"],
        &["bench", "--quick", "--sizes", "1000"],
        &["render", "a.obj"],
    ];
    for args in wrong {
        let output = run(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(
            output.stdout.is_empty() && !output.stderr.is_empty(),
            "{args:?}"
        );
    }
    assert_eq!(run(&["--help"]).status.code(), Some(0));
    let no_adapter = [
        "fit",
        path_text(&scan),
        "-o",
        "c.obj",
        "--device",
        "gpu",
        "--adapter",
        "no such adapter",
    ];
    assert_refused(&no_adapter, "adapter", &folder);
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
