//! `optimize` and `shell` as commands, and templates with inverted elements: what they write, report and refuse.

mod common;

use common::{Noise, data};
use glam::DVec3;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use vorofit::device::Device;
use vorofit::files::{
    Pyramids, SurfaceToWrite, VolumeToWrite, read_volume, write_surface, write_volume,
};
use vorofit::fit::{Target, VolumeOptions, VolumeStart, VolumeTemplate, fit_volume};
use vorofit::measure::validity::{Validity, validities};
use vorofit::mesh::shapes;
use vorofit::mesh::{NodalVolume, PolygonMesh, VolumeMesh};
use vorofit::model::element::Basis;
use vorofit::model::volume::CurvedVolume;
use vorofit::progress::Silent;
use vorofit::template::{Align, volume};
use vorofit::untangle::{Boundary, Ideals, inverted, untangle};

fn vorofit(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vorofit"))
        .args(["--device", "cpu", "--quiet"])
        .args(arguments)
        .output()
        .unwrap()
}

/// The report of a run that succeeds.
fn report(arguments: &[&str]) -> serde_json::Value {
    let output = vorofit(&[arguments, &["--json", "-"]].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn invalid(mesh: &VolumeMesh) -> usize {
    let volume = CurvedVolume::new(mesh, Basis::Legendre).unwrap();
    let validities = validities(&volume);
    validities.iter().filter(|v| **v != Validity::Valid).count()
}

/// A ball whose inner vertices are moved at random until cells are inverted.
fn tangled_ball() -> VolumeMesh {
    let mut mesh = volume::ball(DVec3::splat(-1.0), DVec3::splat(1.0), 3);
    let mut noise = Noise(5);
    for p in mesh.positions.iter_mut().filter(|p| p.length() < 0.99) {
        *p += noise.vector();
    }
    assert!(inverted(&mesh).into_iter().filter(|x| *x).count() > 20);
    mesh
}

fn write(mesh: &VolumeMesh, path: &Path) {
    write_volume(path, &VolumeToWrite::new(&NodalVolume::from(mesh))).unwrap();
}

fn name(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn optimize_repairs_a_mesh_and_reports_before_and_after() {
    let folder = tempfile::tempdir().unwrap();
    let [from, to] = ["tangled.vtu", "mended.vtu"].map(|file| folder.path().join(file));
    write(&tangled_ball(), &from);
    let report = report(&[
        "optimize",
        name(&from),
        "-o",
        name(&to),
        "--tolerance",
        "0.2",
    ]);
    assert!(report["quality_before"]["invalid"].as_u64().unwrap() > 20);
    assert_eq!(report["quality"]["invalid"], 0);
    assert!(report["quality"]["scaled_jacobian_min"].as_f64().unwrap() > 0.3);
    assert!(report["error"]["hausdorff_percent"].as_f64().unwrap() < 0.2);
    let mended = read_volume(&to, Pyramids::Refused).unwrap().mesh;
    assert_eq!((mended.cell_count(), invalid(&mended)), (189, 0));
}

#[test]
fn optimize_curves_where_an_order_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let [from, to] = ["ball.vtu", "curved.vtu"].map(|file| folder.path().join(file));
    write(
        &volume::ball(DVec3::splat(-1.0), DVec3::splat(1.0), 1),
        &from,
    );
    let report = report(&["optimize", name(&from), "-o", name(&to), "--order", "2"]);
    assert_eq!(
        (&report["result"]["order"], &report["quality"]["invalid"]),
        (&2.into(), &0.into())
    );
    assert_eq!(
        read_volume(&to, Pyramids::Refused)
            .unwrap()
            .nodes
            .unwrap()
            .order(),
        2
    );
}

#[test]
fn optimize_refuses_bad_input_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let [from, to] = ["ball.vtu", "out.obj"].map(|file| folder.path().join(file));
    write(&tangled_ball(), &from);
    for arguments in [
        vec!["optimize", name(&from), "-o", name(&to)],
        vec!["optimize", name(&from), "-o", name(&from)],
        vec!["optimize", "absent.vtu", "-o", "x.vtu"],
    ] {
        assert_eq!(vorofit(&arguments).status.code(), Some(1), "{arguments:?}");
        assert!(!to.exists());
    }
    let bad_tolerance = ["optimize", name(&from), "-o", "x.vtu", "--tolerance", "0"];
    assert_eq!(vorofit(&bad_tolerance).status.code(), Some(2));
}

#[test]
fn a_shell_is_valid_and_as_thick_as_asked() {
    let folder = tempfile::tempdir().unwrap();
    let [from, to] = ["torus.obj", "shell.vtu"].map(|file| folder.path().join(file));
    let torus: PolygonMesh = shapes::torus(1.0, 0.4, 32, 16);
    write_surface(&from, &SurfaceToWrite::dense(&torus, None)).unwrap();
    for side in ["--outside", "--inside", "--both"] {
        let arguments = [
            "shell",
            name(&from),
            "-o",
            name(&to),
            "--layers",
            "2",
            "--distance",
            "3",
            side,
        ];
        let report = report(&arguments);
        let sides = if side == "--both" { 2 } else { 1 };
        assert_eq!(report["result"]["elements"], sides * 2 * 512);
        assert_eq!(report["quality"]["invalid"], 0);
        let mean = report["shell"]["mean_percent"].as_f64().unwrap();
        // Inwards a tube has less room, and its cells are wide for their height: shape is weighed against thickness there.
        assert!((mean - 100.0).abs() < 12.0, "{side}: {mean}");
        assert_eq!(
            invalid(&read_volume(&to, Pyramids::Refused).unwrap().mesh),
            0
        );
    }
    let without_side = ["shell", name(&from), "-o", name(&to), "--distance", "3"];
    assert_eq!(vorofit(&without_side).status.code(), Some(2));
    let nowhere: PathBuf = folder.path().join("shell.ply");
    let unwritable = [
        "shell",
        name(&from),
        "-o",
        name(&nowhere),
        "--distance",
        "3",
        "--both",
    ];
    assert_eq!(vorofit(&unwritable).status.code(), Some(1));
}

#[test]
fn a_template_with_inverted_elements_is_untangled_before_the_fit() {
    let target = Target::new(&Device::Cpu, &shapes::sphere(1.0, 3)).unwrap();
    let template = VolumeTemplate::Mesh {
        mesh: tangled_ball(),
        align: Align::None,
    };
    let start = VolumeStart::new(&target, &template).unwrap();
    let options = VolumeOptions {
        order: 1,
        ..VolumeOptions::default()
    };
    let fit = fit_volume(&Device::Cpu, &target, start, &options, &Silent).unwrap();
    assert!(
        validities(&fit.volume)
            .iter()
            .all(|v| *v == Validity::Valid)
    );
}

#[test]
fn a_part_that_is_mostly_inverted_comes_out_valid() {
    let Some(path) = data("volumes/hanger-inverted.mesh") else {
        return;
    };
    let mesh = read_volume(&path, Pyramids::Refused).unwrap().mesh;
    assert!(invalid(&mesh) > 3_900);
    let own = Boundary::Own {
        tolerance: f64::INFINITY,
    };
    let found = untangle(&mesh, &Ideals::local(&mesh), own, &Silent).unwrap();
    assert_eq!((found.inverted, invalid(&found.mesh)), (0, 0));
}
