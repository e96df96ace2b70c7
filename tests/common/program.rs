//! Running the program as its user does.
#![allow(dead_code, reason = "each test binary uses a part")]

use glam::DVec3;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use vorofit::files::{SurfaceToWrite, write_surface};
use vorofit::mesh::{PolygonMesh, TriangleMesh, shapes};

pub fn vorofit(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vorofit"));
    command.args(args).env_remove("RUST_LOG");
    command
}

pub fn run(args: &[&str]) -> Output {
    vorofit(args).output().expect("the program starts")
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("UTF-8")
}

/// Runs what must succeed; what it printed.
pub fn succeed(args: &[&str]) -> String {
    let output = run(args);
    assert!(
        output.status.success(),
        "{args:?}: {}",
        text(&output.stderr)
    );
    text(&output.stdout)
}

/// A folder of its own for each test, empty.
pub fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("command_line")
        .join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

pub fn names(folder: &Path) -> Vec<String> {
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

pub fn path_text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

pub fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("a report")).expect("JSON")
}

/// A bumpy ball of some thousand triangles, a bit longer than wide.
pub fn ball() -> TriangleMesh {
    let mut ball = shapes::sphere(1.0, 4);
    for p in &mut ball.positions {
        *p *= DVec3::new(1.3, 1.0, 0.9) * (1.0 + 0.05 * (4.0 * p.x).sin() * (3.0 * p.y).cos());
    }
    ball
}

pub fn write(path: &Path, mesh: &TriangleMesh) {
    let mesh = PolygonMesh::from(mesh.clone());
    write_surface(path, &SurfaceToWrite::dense(&mesh, None)).expect("written");
}

/// A folder with `scan.ply` in it.
pub fn folder_with_scan(name: &str) -> PathBuf {
    let folder = folder(name);
    write(&folder.join("scan.ply"), &ball());
    folder
}
