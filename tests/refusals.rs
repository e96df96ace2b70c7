//! What the program refuses: bad input, places that cannot be written, misfit templates, bad usage. One line, and nothing left behind.

#[path = "common/program.rs"]
mod program;

use program::*;
use std::path::Path;

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
        &["fit", "a.obj", "-o", "b.obj", "--genus", "most"],
        &[
            "fit",
            "a.obj",
            "-o",
            "b.obj",
            "--template",
            "bbox",
            "--genus",
            "keep",
        ],
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
