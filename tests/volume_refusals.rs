//! Volume files that are refused: in one line that names the file and the place, and no content whatever makes a reader panic.

mod common;

use common::data;
use common::volumes::{parse, sizes, valid_files};
use std::path::Path;
use vorofit::files::{Pyramids, read_volume, volume_from_bytes};
use vorofit::mesh::check_volume;

#[test]
fn pyramids_are_refused_by_name_and_number_or_left_out() {
    let Some(path) = data("volumes/mixed-elements.vtk") else {
        return;
    };
    let message = read_volume(&path, Pyramids::Refused)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("36 pyramids") && !message.contains('\n'),
        "{message}"
    );
    let volume = read_volume(&path, Pyramids::LeftOut).unwrap();
    assert_eq!(sizes(&volume.mesh), [1_200, 703, 323, 560, 877]);
    assert!(
        volume.warnings.iter().any(|w| w.contains("36 pyramids")),
        "{:?}",
        volume.warnings
    );
    // Gmsh writes prisms as VTK's manual numbers them, mirrored.
    assert!(
        volume.warnings.iter().any(|w| w.contains("prism (323)")),
        "{:?}",
        volume.warnings
    );
}

#[test]
fn pyramids_that_are_left_out_leave_the_other_cells() {
    let corners: String = (0..8)
        .map(|k| format!("{} {} {} 0\n", k & 1, k >> 1 & 1, k >> 2))
        .collect();
    let head = format!("MeshVersionFormatted 1\nDimension 3\nVertices 9\n{corners}0.5 0.5 2 0\n");
    let pyramid = "Pyramids 1\n5 6 8 7 9 0\n";
    let read =
        |text: String| volume_from_bytes(Path::new("a.mesh"), text.as_bytes(), Pyramids::LeftOut);
    let volume = read(format!(
        "{head}Hexahedra 1\n1 2 4 3 5 6 8 7 0\n{pyramid}End\n"
    ))
    .unwrap();
    assert_eq!(sizes(&volume.mesh), [8, 0, 0, 1, 6]);
    assert!(
        volume.warnings[0].contains("1 pyramids"),
        "{:?}",
        volume.warnings
    );
    let none = read(format!("{head}{pyramid}End\n"))
        .unwrap_err()
        .to_string();
    assert!(none.contains("no cells"), "{none}");
}

#[test]
fn a_refusal_is_one_line_that_names_the_file_and_the_place() {
    let head =
        "MeshVersionFormatted 1\nDimension 3\nVertices 4\n0 0 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n";
    let medit = |rest: &str| format!("{head}{rest}");
    let vtk = |rest: &str| format!("# vtk DataFile Version 2.0\nt\nASCII\nDATASET {rest}");
    let cases = [
        ("a.mesh", String::new(), "empty"),
        (
            "a.mesh",
            medit("Tetrahedra 1\n1 2 3 5 0\n"),
            "tetrahedron 0 (counted from 0): it names vertex 4",
        ),
        (
            "a.mesh",
            medit("Tetrahedra 1\n1 2 3 0 0\n"),
            "line 9: it names vertex -1",
        ),
        ("a.mesh", medit("Tetrahedra 2\n1 2 3 4 0\n"), "end of file"),
        ("a.mesh", medit("Tetrahedra 1\n1 2 3 3 0\n"), "cell 0"),
        (
            "a.mesh",
            medit("Tetrahedra 1\n1 2 3 x 0\n"),
            "line 9: \"x\"",
        ),
        ("a.mesh", medit("Triangles 1\n1 2 3 0\n"), "but no cells"),
        (
            "a.mesh",
            medit("Pyramids 1\n1 2 3 4 4 0\n"),
            "line 9: here is the first of 1 pyramids",
        ),
        (
            "a.mesh",
            medit("Tetrahedra 1\n1 2 3 4 0\n").replace("0 1 0 0", "0 nan 0 0"),
            "not finite",
        ),
        (
            "a.mesh",
            medit("Tetrahedra 18446744073709551615\n"),
            "line 8",
        ),
        (
            "a.mesh",
            medit("").replace("Dimension 3", "Dimension 2"),
            "2 dimensions",
        ),
        ("a.vtk", vtk("POLYDATA"), "UNSTRUCTURED_GRID"),
        (
            "a.vtk",
            vtk("UNSTRUCTURED_GRID\nPOINTS 99999999999999999999 float"),
            "line 5",
        ),
        (
            "a.vtk",
            vtk("UNSTRUCTURED_GRID\nPOINTS 6148914691236517206 double 0"),
            "line 5",
        ),
        (
            "a.vtk",
            vtk(
                "UNSTRUCTURED_GRID\nPOINTS 1 float\n0 0 0\nCELLS 1 9\n8 0 0 0 0 0 0 0 0\nCELL_TYPES 1\n42",
            ),
            "polyhedra",
        ),
        (
            "a.vtk",
            vtk(
                "UNSTRUCTURED_GRID\nPOINTS 1 float\n0 0 0\nCELLS 1 9\n8 0 0 0 0 0 0 0 0\nCELL_TYPES 1\n25",
            ),
            "quadratic hexahedra",
        ),
        (
            "a.vtk",
            medit(""),
            "the name says legacy VTK, the content Medit",
        ),
        ("a.vtu", "<VTKFile type=\"PolyData\">".into(), "line 1"),
        (
            "a.vtu",
            "<VTKFile type=\"PolyData\"/>".into(),
            "unstructured grid",
        ),
        (
            "a.vtu",
            "<VTKFile type=\"UnstructuredGrid\" compressor=\"vtkLZ4DataCompressor\"/>".into(),
            "zlib",
        ),
        (
            "a.msh",
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n".into(),
            "-format msh41",
        ),
        ("a.mesh", "MFEM NURBS mesh v1.0\n".into(), "not NURBS"),
        ("a.stl", "solid".into(), "use .mesh"),
    ];
    for (name, content, part) in cases {
        let message = parse(name, content.as_bytes()).unwrap_err().to_string();
        assert!(
            message.starts_with(name) && message.contains(part),
            "{name}: {message}"
        );
        assert!(!message.contains('\n'), "{message}");
    }
    let missing = read_volume(Path::new("nowhere/a.vtu"), Pyramids::Refused)
        .unwrap_err()
        .to_string();
    assert!(missing.starts_with("nowhere/a.vtu: "), "{missing}");
}

/// A reader must refuse in one line, or give what the rest of the program can compute with.
fn read_anything(name: &str, bytes: &[u8]) {
    match parse(name, bytes) {
        Ok(volume) => drop(check_volume::sound(&volume.mesh).unwrap()),
        Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
    }
}

#[test]
fn damaged_files_never_panic() {
    for (name, bytes) in valid_files() {
        for part in 0..50 {
            read_anything(name, &bytes[..bytes.len() * part / 50]);
        }
        for at in (0..bytes.len()).step_by(1 + bytes.len() / 300) {
            for change in [0x01, 0x10, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] ^= change;
                read_anything(name, &damaged);
            }
            for word in [
                "-1 ",
                "4294967296 ",
                "18446744073709551615 ",
                "nan ",
                "1e999 ",
                "\n",
                "\0",
            ] {
                let mut damaged = bytes.clone();
                damaged.splice(at..at, word.bytes());
                read_anything(name, &damaged);
            }
        }
    }
}
