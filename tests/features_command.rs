//! `vorofit features` writes every format, a picture and a report, and refuses what it cannot do.

#[path = "common/program.rs"]
mod program;

use program::{folder, run, succeed, text};
use serde_json::Value;
use vorofit::files::{SurfaceToWrite, write_surface};
use vorofit::mesh::{PolygonMesh, shapes};

#[test]
fn features_are_written_drawn_and_counted() {
    let folder = folder("features");
    let place = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
    let mesh: PolygonMesh = shapes::lobed_ball(4).into();
    write_surface(
        place("ball.ply").as_ref(),
        &SurfaceToWrite::dense(&mesh, None),
    )
    .unwrap();
    let (ball, ply, obj, vtp, png) = (
        place("ball.ply"),
        place("a.ply"),
        place("a.obj"),
        place("a.vtp"),
        place("a.png"),
    );
    let outputs = ["-o", &ply, "-o", &obj, "-o", &vtp, "--picture", &png];
    let options = [
        "features",
        &ball,
        "--control-points",
        "120",
        "--json",
        "-",
        "--device",
        "cpu",
    ];
    let json: Value = serde_json::from_str(&succeed(&[&options[..], &outputs].concat())).unwrap();
    let features = &json["features"];
    assert_eq!(features["sites"]["count"], 120);
    let number = |key: &str| features[key].as_u64().unwrap();
    let points = number("elliptic_umbilics")
        + number("hyperbolic_umbilics")
        + number("crossings")
        + number("turning_points")
        + 120;
    let lines: u64 = features["ridges"]
        .as_array()
        .unwrap()
        .iter()
        .map(|r| r["count"].as_u64().unwrap())
        .sum();
    assert!(lines > 10 && number("elliptic_umbilics") > 0);

    let obj = std::fs::read_to_string(obj).unwrap();
    let records = |tag: &str| obj.lines().filter(|line| line.starts_with(tag)).count() as u64;
    assert_eq!((records("l "), records("p ")), (lines, points));
    let vtp = std::fs::read_to_string(vtp).unwrap();
    assert!(
        vtp.contains(&format!("NumberOfLines=\"{lines}\""))
            && vtp.contains(&format!("NumberOfVerts=\"{points}\""))
    );
    let ply = std::fs::read(ply).unwrap();
    let header = String::from_utf8_lossy(&ply[..700]);
    let edges = records("v ") - lines - points;
    assert!(
        header.contains(&format!("element vertex {}\n", records("v ")))
            && header.contains(&format!("element edge {edges}\n"))
    );
    assert!(std::fs::read(png).unwrap().starts_with(b"\x89PNG"));
    let (with, without) = (place("with.png"), place("without.png"));
    succeed(&["render", &ball, "--features", "-o", &with]);
    succeed(&["render", &ball, "--edges", "off", "-o", &without]);
    let [with, without] = [with, without].map(|path| std::fs::read(path).unwrap());
    assert!(with.starts_with(b"\x89PNG") && with != without);
}

#[test]
fn bad_requests_are_refused_before_the_work() {
    let folder = folder("features_refused");
    let place = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
    let mesh: PolygonMesh = shapes::sphere(1.0, 1).into();
    let ball = place("ball.ply");
    write_surface(ball.as_ref(), &SurfaceToWrite::dense(&mesh, None)).unwrap();
    let (stl, jpg, obj) = (place("a.stl"), place("a.jpg"), place("a.obj"));
    for (arguments, code, expected) in [
        (vec!["-o", &stl], 1, "use .vtp, .ply or .obj"),
        (vec!["-o", &obj, "--picture", &jpg], 1, "use .png"),
        (vec!["-o", &ball], 1, "also an input"),
        (vec!["-o", &obj, "--scale", "0.4"], 2, "up to 0.25"),
        (vec!["-o", &obj, "--control-points", "3"], 2, "3"),
    ] {
        let output = run(&[&["features", &ball][..], &arguments].concat());
        assert_eq!(output.status.code(), Some(code));
        assert!(
            text(&output.stderr).contains(expected),
            "{}",
            text(&output.stderr)
        );
    }
    assert!(!std::path::Path::new(&obj).exists());
}
