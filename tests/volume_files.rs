//! Volume meshes through files: real meshes are read with their known sizes, what is written is read back, every encoding of a format gives
//! the same mesh, and `check` judges what it reads.

mod common;

use common::data;
use common::volumes::{curved, medit, mixed, only, parse, sizes, valid_files, written};
use glam::DVec3;
use serde_json::json;
use std::path::Path;
use vorofit::files::{Pyramids, VolumeToWrite, check_volume_writable, read_volume, write_volume};
use vorofit::mesh::{CellShape, NodalVolume, VolumeMesh};

#[test]
fn real_meshes_have_their_published_sizes() {
    let expected = [
        (
            "volumes/bumpy-torus.mesh",
            [40_545, 0, 0, 35_137, 10_354],
            vec![],
        ),
        (
            "volumes/hanger-inverted.mesh",
            [6_633, 0, 0, 4_539, 4_028],
            vec!["surface elements"],
        ),
        (
            "volumes/rocker-arm-hexes.mesh",
            [12_751, 0, 0, 10_600, 4_076],
            vec!["surface elements"],
        ),
        (
            "volumes/sphere-tets.mesh",
            [4_505, 24_013, 0, 0, 2_880],
            vec!["surface elements"],
        ),
        ("volumes/double-torus.vtk", [1_025, 0, 0, 632, 700], vec![]),
        // Its cells have eight vertices each and the type of tetrahedra.
        (
            "volumes/hex-sphere.vtk",
            [4_482, 0, 0, 4_032, 816],
            vec!["4032 cells whose type"],
        ),
        (
            "volumes/mfem_toroid-wedge.mesh",
            [18, 0, 6, 0, 18],
            vec!["order 3"],
        ),
        (
            "volumes/mfem_escher-p3.mesh",
            [26, 42, 0, 0, 48],
            vec!["order 3"],
        ),
        ("pairs/bone.hex.vtk", [10_356, 0, 0, 8_619, 3_200], vec![]),
        ("pairs/bunny.hex.vtk", [26_375, 0, 0, 21_695, 8_812], vec![]),
        (
            "pairs/dtorus.hex.vtk",
            [19_515, 0, 0, 15_872, 6_790],
            vec![],
        ),
        ("pairs/eight.hex.vtk", [30_157, 0, 0, 25_264, 9_190], vec![]),
        (
            "pairs/genus3.hex.vtk",
            [54_592, 0, 0, 45_176, 18_010],
            vec![],
        ),
        ("pairs/venus.hex.vtk", [25_794, 0, 0, 21_895, 7_286], vec![]),
    ];
    for (name, wanted, warnings) in expected {
        let Some(path) = data(name) else { continue };
        let volume = read_volume(&path, Pyramids::Refused).unwrap();
        assert_eq!(sizes(&volume.mesh), wanted, "{name}");
        assert_eq!(
            volume.warnings.len(),
            warnings.len(),
            "{name}: {:?}",
            volume.warnings
        );
        for (line, part) in volume.warnings.iter().zip(warnings) {
            assert!(line.contains(part), "{name}: {line}");
        }
    }
}

#[test]
fn neighbours_share_nodes_at_every_order() {
    for order in 1..=5 {
        let volume = curved(&mixed(), order);
        let p = order;
        // Vertices, edges, triangles, quads and cells of the mixed mesh.
        let inside_triangle = (p - 1) * p.saturating_sub(2) / 2;
        let inside_tetrahedron = inside_triangle * p.saturating_sub(3) / 3;
        let wanted = 15
            + 28 * (p - 1)
            + 5 * inside_triangle
            + 13 * (p - 1) * (p - 1)
            + 2 * (p - 1).pow(3)
            + inside_triangle * (p - 1)
            + inside_tetrahedron;
        assert_eq!(volume.positions.len(), wanted, "order {order}");
        let again = curved(&volume.corners(), order);
        assert_eq!(again.cell_count(), 4);
    }
}

#[test]
fn what_is_written_is_read_back_to_the_bit() {
    for mesh in [
        mixed(),
        only(CellShape::Tetrahedron),
        only(CellShape::Prism),
        only(CellShape::Hexahedron),
    ] {
        for order in 1..=6 {
            let volume = curved(&mesh, order);
            for extension in ["vtu", "mesh", "msh"] {
                let name = format!("volume.{extension}");
                if check_volume_writable(name.as_ref(), &VolumeToWrite::new(&volume)).is_err() {
                    assert!(extension == "msh" && order > 2);
                    continue;
                }
                let back = parse(&name, &written(extension, &volume)).unwrap();
                assert_eq!(back.warnings, Vec::<String>::new(), "{name}");
                assert_eq!(back.nodes.is_some(), order > 1, "{name}");
                let nodes = back.nodes.unwrap_or_else(|| NodalVolume::from(&back.mesh));
                assert_eq!(
                    cell_points(&nodes),
                    sorted_as(extension, &volume),
                    "{name} of order {order}"
                );
            }
        }
    }
}

/// Shape and nodes' positions of every cell.
fn cell_points(volume: &NodalVolume) -> Vec<(CellShape, Vec<DVec3>)> {
    let points = |nodes: &[u32]| {
        nodes
            .iter()
            .map(|&n| volume.positions[n as usize])
            .collect()
    };
    volume
        .cells()
        .map(|(shape, nodes)| (shape, points(nodes)))
        .collect()
}

/// The cells as a format orders them: MSH has one shape after the other.
fn sorted_as(extension: &str, volume: &NodalVolume) -> Vec<(CellShape, Vec<DVec3>)> {
    let mut cells = cell_points(volume);
    if extension == "msh" {
        cells.sort_by_key(|&(shape, _)| shape);
    }
    cells
}

#[test]
fn what_a_format_cannot_hold_is_refused_with_an_alternative() {
    let refusal = |name: &str, volume: &VolumeToWrite<'_>| {
        check_volume_writable(name.as_ref(), volume)
            .unwrap_err()
            .to_string()
    };
    let prism = curved(&only(CellShape::Prism), 3);
    assert!(
        refusal("a.msh", &VolumeToWrite::new(&prism))
            .contains("prism of order 2 at most, not 3; write a .vtu")
    );
    let hexahedra = curved(&only(CellShape::Hexahedron), 10);
    assert!(refusal("a.msh", &VolumeToWrite::new(&hexahedra)).contains("order 9 at most"));
    assert!(
        refusal("a.vtk", &VolumeToWrite::new(&prism)).contains("use .vtu, .mesh (MFEM) or .msh")
    );
    let data: [(&str, &[f64]); 1] = [("error", &[0.5])];
    let short = VolumeToWrite {
        node_data: &data,
        ..VolumeToWrite::new(&prism)
    };
    assert!(refusal("a.vtu", &short).contains("1 values for 40 places"));
    let infinite: [(&str, &[f64]); 1] = [("validity", &[f64::INFINITY])];
    let infinite = VolumeToWrite {
        cell_data: &infinite,
        ..VolumeToWrite::new(&prism)
    };
    assert!(refusal("a.vtu", &infinite).contains("finite"));
}

#[test]
fn every_encoding_of_a_format_gives_the_same_mesh() {
    let cells = |mesh: &VolumeMesh| {
        let mut cells: Vec<(CellShape, Vec<u32>)> =
            mesh.cells().map(|(s, c)| (s, c.to_vec())).collect();
        cells.sort();
        cells
    };
    for (name, bytes) in valid_files() {
        let volume = parse(name, &bytes).unwrap();
        if volume.nodes.is_none() {
            assert_eq!(volume.mesh.positions, mixed().positions, "{name}");
            assert_eq!(cells(&volume.mesh), cells(&mixed()), "{name}");
        }
    }
}

#[test]
fn cells_numbered_the_other_way_round_are_turned_and_inverted_ones_stay() {
    let mirrored = |cell: &[u32]| [1, 0, 3, 2, 5, 4, 7, 6].map(|k| cell[k]).to_vec();
    let mut mesh = only(CellShape::Hexahedron);
    let cells: Vec<Vec<u32>> = mesh.cells().map(|(_, cell)| mirrored(cell)).collect();
    mesh = VolumeMesh::new(mesh.positions);
    cells
        .iter()
        .for_each(|cell| mesh.push_cell(CellShape::Hexahedron, cell));
    let volume = parse("a.mesh", medit(&mesh).as_bytes()).unwrap();
    assert!(
        volume.warnings[1].contains("hexahedron (2)"),
        "{:?}",
        volume.warnings
    );
    for (_, cell) in volume.mesh.cells() {
        let at = |k: usize| volume.mesh.positions[cell[k] as usize];
        assert!((at(1) - at(0)).cross(at(3) - at(0)).dot(at(4) - at(0)) > 0.0);
    }
    // One inverted cell among others is no convention.
    let (first, second) = (cells[0].clone(), mirrored(&cells[1]));
    let mut mesh = VolumeMesh::new(mesh.positions);
    mesh.push_cell(CellShape::Hexahedron, &first);
    mesh.push_cell(CellShape::Hexahedron, &second);
    let volume = parse("a.mesh", medit(&mesh).as_bytes()).unwrap();
    assert_eq!(volume.mesh.cell(0), first);
}

#[test]
fn doubled_vertices_are_merged_and_unused_ones_left_out() {
    let mut text = String::from("MeshVersionFormatted 1\nDimension 3\nVertices 17\n9 9 9 0\n");
    let cube = |x: i32| {
        (0..8)
            .map(move |k| format!("{} {} {} 0\n", x + (k & 1), k >> 1 & 1, k >> 2))
            .collect::<String>()
    };
    text += &(cube(0) + &cube(1));
    text += "Hexahedra 2\n2 3 5 4 6 7 9 8 0\n10 11 13 12 14 15 17 16 0\nEnd\n";
    let volume = parse("a.mesh", text.as_bytes()).unwrap();
    assert_eq!(sizes(&volume.mesh), [12, 0, 0, 2, 10]);
    assert_eq!(volume.warnings.len(), 2, "{:?}", volume.warnings);
}

/// `vorofit check` of a file: exit status, JSON report, stderr.
fn check(path: &Path) -> (Option<i32>, serde_json::Value, String) {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_vorofit"))
        .args(["check", "--quiet", "--json", "-"])
        .arg(path)
        .output()
        .unwrap();
    let report = serde_json::from_slice(&output.stdout).unwrap();
    let errors = String::from_utf8(output.stderr).unwrap();
    (output.status.code(), report, errors)
}

#[test]
fn check_reports_quality_and_fails_on_invalid_elements() {
    let folder = tempfile::tempdir().unwrap();
    let volume = curved(&mixed(), 3);
    for name in ["a.vtu", "a.mesh"] {
        let path = folder.path().join(name);
        write_volume(&path, &VolumeToWrite::new(&volume)).unwrap();
        let (status, report, errors) = check(&path);
        assert_eq!((status, errors.as_str()), (Some(0), ""), "{name}");
        let result = json!({ "elements": 4, "order": 3, "nodes": volume.positions.len() });
        assert_eq!(report["result"], result);
        assert_eq!(report["quality"]["invalid"], 0);
        assert_eq!(report["quality"]["undecided"], 0);
        let least = report["quality"]["scaled_jacobian_min"].as_f64().unwrap();
        assert!(least > 0.3 && least < 1.0, "{least}");
    }
    // The middle node of an edge beyond its end folds the element over.
    let mut folded = curved(&only(CellShape::Hexahedron), 2);
    folded.positions[1] += 2.0 * DVec3::Z;
    let path = folder.path().join("folded.msh");
    write_volume(&path, &VolumeToWrite::new(&folded)).unwrap();
    let (status, report, errors) = check(&path);
    assert_eq!(status, Some(1));
    assert!(report["quality"]["invalid"].as_u64() > Some(0));
    assert!(
        errors.contains("invalid") && errors.lines().count() == 1,
        "{errors}"
    );
}

/// Writes curved cells in every format and order that it holds, for `volumes_elsewhere.py`.
#[test]
fn files_for_other_software_are_written() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("volumes");
    std::fs::create_dir_all(&folder).unwrap();
    let mut expected = serde_json::Map::new();
    let meshes = [
        ("mixed", mixed()),
        ("tetrahedra", only(CellShape::Tetrahedron)),
        ("prisms", only(CellShape::Prism)),
        ("hexahedra", only(CellShape::Hexahedron)),
    ];
    for (kind, mesh) in meshes {
        for order in (1..=10).chain([16]) {
            let volume = curved(&mesh, order);
            let distances: Vec<f64> = volume.positions.iter().map(|p| p.length()).collect();
            let numbers: Vec<f64> = (0..mesh.cell_count()).map(|c| c as f64).collect();
            let volume = VolumeToWrite {
                nodes: &volume,
                node_data: &[("distance", &distances)],
                cell_data: &[("number", &numbers)],
            };
            let corners = |cell: &[u32]| {
                cell.iter()
                    .map(|&v| mesh.positions[v as usize].to_array())
                    .collect::<Vec<_>>()
            };
            let cells: Vec<_> = mesh
                .cells()
                .map(|(shape, cell)| json!([shape.name(), corners(cell)]))
                .collect();
            for extension in ["vtu", "mesh", "msh"] {
                let name = format!("{kind}-{order}.{extension}");
                if check_volume_writable(name.as_ref(), &volume).is_ok() {
                    write_volume(&folder.join(&name), &volume).unwrap();
                    expected.insert(name, json!({ "order": order, "cells": cells }));
                }
            }
        }
    }
    let text = serde_json::to_string_pretty(&expected).unwrap();
    std::fs::write(folder.join("expected.json"), text).unwrap();
}
