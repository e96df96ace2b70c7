//! Volume meshes through files: real meshes are read with their known sizes, every encoding of a format gives the same mesh, and no
//! content whatever makes a reader panic.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use serde_json::json;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use vorofit::files::{
    Volume, VolumeToWrite, check_volume_writable, read_volume, volume_from_bytes, write_volume,
};
use vorofit::mesh::check_volume;
use vorofit::mesh::{CellShape, NodalVolume, VolumeMesh};

/// A file of the public data, which is no part of the repository; `None` is reported.
fn data(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("VOROFIT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let path = folder.join(name);
    if !path.exists() {
        eprintln!("skipped: {name} is not in {}", folder.display());
        return None;
    }
    Some(path)
}

fn parse(name: &str, bytes: &[u8]) -> vorofit::Result<Volume> {
    volume_from_bytes(Path::new(name), bytes)
}

/// Numbers of vertices, tetrahedra, prisms, hexahedra and boundary faces.
fn sizes(mesh: &VolumeMesh) -> [usize; 5] {
    let census = check_volume::sound(mesh).unwrap();
    [
        census.vertices,
        census.tetrahedra,
        census.prisms,
        census.hexahedra,
        census.boundary_faces,
    ]
}

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
        let volume = read_volume(&path).unwrap();
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
fn pyramids_are_refused_by_name_and_number() {
    let Some(path) = data("volumes/mixed-elements.vtk") else {
        return;
    };
    let message = read_volume(&path).unwrap_err().to_string();
    assert!(
        message.contains("36 pyramids") && !message.contains('\n'),
        "{message}"
    );
}

/// A legacy VTK text of linear cells without its pyramids, which leaves holes of their shape.
fn without_pyramids(text: &str) -> String {
    let is_pyramid = |line: &&str| line.split_whitespace().count() == 6 && line.starts_with("5 ");
    let pyramids = text.lines().filter(is_pyramid).count();
    let mut counts = [0; 2];
    let mut kept = String::new();
    for line in text.lines() {
        let mut words = line.split_whitespace();
        if let (Some("CELLS"), Some(cells), Some(size)) = (words.next(), words.next(), words.next())
        {
            counts = [cells, size].map(|n| n.parse().unwrap());
            writeln!(
                kept,
                "CELLS {} {}",
                counts[0] - pyramids,
                counts[1] - 6 * pyramids
            )
            .unwrap();
        } else if line.starts_with("CELL_TYPES") {
            writeln!(kept, "CELL_TYPES {}", counts[0] - pyramids).unwrap();
        } else if line.starts_with("CELL_DATA") {
            break;
        } else if !is_pyramid(&line) && line.trim() != "14" {
            writeln!(kept, "{line}").unwrap();
        }
    }
    kept
}

#[test]
fn without_its_pyramids_the_mixed_mesh_is_sound() {
    let Some(path) = data("volumes/mixed-elements.vtk") else {
        return;
    };
    let text = std::fs::read_to_string(path).unwrap();
    let volume = parse("mixed.vtk", without_pyramids(&text).as_bytes()).unwrap();
    assert_eq!(sizes(&volume.mesh), [1_200, 703, 323, 560, 877]);
    // Gmsh writes prisms as VTK's manual numbers them, mirrored.
    assert!(
        volume.warnings.iter().any(|w| w.contains("prism (323)")),
        "{:?}",
        volume.warnings
    );
}

/// Two cubes, a prism beside them and a tetrahedron on top of the prism.
fn mixed() -> VolumeMesh {
    let mut mesh = VolumeMesh::new(
        [
            [0, 0, 0],
            [1, 0, 0],
            [1, 1, 0],
            [0, 1, 0],
            [0, 0, 1],
            [1, 0, 1],
            [1, 1, 1],
            [0, 1, 1],
            [0, 0, 2],
            [1, 0, 2],
            [1, 1, 2],
            [0, 1, 2],
            [2, 0, 0],
            [2, 0, 1],
            [2, 1, 2],
        ]
        .map(|p| DVec3::from(p.map(f64::from)))
        .into(),
    );
    mesh.push_cell(CellShape::Hexahedron, &[0, 1, 2, 3, 4, 5, 6, 7]);
    mesh.push_cell(CellShape::Hexahedron, &[9, 10, 6, 5, 8, 11, 7, 4]);
    mesh.push_cell(CellShape::Prism, &[1, 12, 2, 5, 13, 6]);
    mesh.push_cell(CellShape::Tetrahedron, &[6, 5, 13, 14]);
    mesh
}

/// The cells of one shape of [`mixed`].
fn only(shape: CellShape) -> VolumeMesh {
    let mixed = mixed();
    let mut mesh = VolumeMesh::new(mixed.positions.clone());
    for (_, cell) in mixed.cells().filter(|&(s, _)| s == shape) {
        mesh.push_cell(shape, cell);
    }
    NodalVolume::from(&mesh).corners()
}

/// A map of a polynomial degree up to 3 that is known to `volumes_elsewhere.py` too.
fn bent(p: DVec3, degree: usize) -> DVec3 {
    let DVec3 { x, y, z } = p;
    let mut q = p;
    if degree >= 2 {
        q += 0.1 * DVec3::new(y * z, x * x - z, x * y);
    }
    if degree >= 3 {
        q += 0.05 * DVec3::new(z * z * z, x * y * z, x * x * y);
    }
    q
}

/// The cells of a mesh, bent, as polynomials of an order.
fn curved(mesh: &VolumeMesh, order: usize) -> NodalVolume {
    let mut points = Vec::new();
    for (shape, cell) in mesh.cells() {
        let corners: Vec<DVec3> = cell.iter().map(|&v| mesh.positions[v as usize]).collect();
        for ijk in NodalVolume::lattice(shape, order) {
            let u = DVec3::from(ijk.map(|x| x as f64 / order as f64));
            // All cells here are images of the reference cell under an affine map.
            let [x, y, z] = match shape {
                CellShape::Tetrahedron | CellShape::Prism => [1, 2, 3],
                CellShape::Hexahedron => [1, 3, 4],
            }
            .map(|k| corners[k] - corners[0]);
            points.push(bent(corners[0] + u.x * x + u.y * y + u.z * z, order));
        }
    }
    NodalVolume::from_cells(mesh, order, &points)
}

/// Writes a volume and gives the file's content.
fn written(extension: &str, volume: &NodalVolume) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("volume").with_extension(extension);
    write_volume(&path, &VolumeToWrite::new(volume)).unwrap();
    std::fs::read(&path).unwrap()
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

/// The rows of numbers of a mesh's points and of its cells of a shape, the vertices counted from `base`.
fn rows(mesh: &VolumeMesh, shape: CellShape, base: u32, end: &str) -> String {
    let cells = mesh.cells().filter(|&(s, _)| s == shape);
    cells.fold(String::new(), |mut text, (_, cell)| {
        let row: Vec<String> = cell.iter().map(|v| (v + base).to_string()).collect();
        writeln!(text, "{}{end}", row.join(" ")).unwrap();
        text
    })
}

fn point_rows(mesh: &VolumeMesh, end: &str) -> String {
    let row = |p: &DVec3| format!("{} {} {}{end}\n", p.x, p.y, p.z);
    mesh.positions.iter().map(row).collect()
}

const MEDIT: [(CellShape, &str, i32); 3] = [
    (CellShape::Tetrahedron, "Tetrahedra", 8),
    (CellShape::Prism, "Prisms", 9),
    (CellShape::Hexahedron, "Hexahedra", 10),
];

fn medit(mesh: &VolumeMesh) -> String {
    let mut text = String::from("# made by hand\nMeshVersionFormatted 2\nDimension\n3\n");
    writeln!(
        text,
        "Vertices\n{}\n{}",
        mesh.positions.len(),
        point_rows(mesh, " 0")
    )
    .unwrap();
    text += "Corners 1\n1\nTriangles 1\n1 2 3 0\nNormals 1\n0 0 1\n";
    for (shape, keyword, _) in MEDIT {
        let count = mesh.cells().filter(|&(s, _)| s == shape).count();
        writeln!(text, "{keyword} {count}\n{}", rows(mesh, shape, 1, " 7")).unwrap();
    }
    text + "End\n"
}

fn medit_binary(mesh: &VolumeMesh, big_endian: bool) -> Vec<u8> {
    let int = |x: i32| {
        if big_endian {
            x.to_be_bytes()
        } else {
            x.to_le_bytes()
        }
    };
    let real = |x: f64| {
        if big_endian {
            x.to_be_bytes()
        } else {
            x.to_le_bytes()
        }
    };
    let mut bytes = [1, 2, 3, 0, 3].map(int).concat();
    // An unknown section of 8 bytes, passed over by the position of the next.
    let next = bytes.len() as i32 + 16;
    bytes.extend([77, next, -1, -1].map(int).concat());
    bytes.extend([4, 0, mesh.positions.len() as i32].map(int).concat());
    for p in &mesh.positions {
        bytes.extend(p.to_array().map(real).concat());
        bytes.extend(int(0));
    }
    for (shape, _, code) in MEDIT {
        let cells: Vec<_> = mesh.cells().filter(|&(s, _)| s == shape).collect();
        bytes.extend([code, 0, cells.len() as i32].map(int).concat());
        for (_, cell) in cells {
            bytes.extend(cell.iter().flat_map(|&v| int(v as i32 + 1)));
            bytes.extend(int(0));
        }
    }
    bytes.extend([54, 0].map(int).concat());
    bytes
}

/// VTK's lists of a mesh: connectivity, offsets from 0, types.
fn vtk_lists(mesh: &VolumeMesh) -> [Vec<i64>; 3] {
    let mut offsets = vec![0];
    let (mut nodes, mut types) = (Vec::new(), Vec::new());
    for (shape, cell) in mesh.cells() {
        nodes.extend(cell.iter().map(|&v| i64::from(v)));
        offsets.push(nodes.len() as i64);
        types.push([10, 13, 12][shape as usize]);
    }
    [nodes, offsets, types]
}

fn spaced(numbers: &[i64]) -> String {
    let words: Vec<String> = numbers.iter().map(i64::to_string).collect();
    words.join(" ")
}

/// Legacy VTK of a version, text or binary, with sections that do not matter.
fn legacy_vtk(mesh: &VolumeMesh, version: &str, binary: bool) -> Vec<u8> {
    let [nodes, offsets, types] = vtk_lists(mesh);
    let kind = if binary { "BINARY" } else { "ASCII" };
    let mut file =
        format!("# vtk DataFile Version {version}\ntitle\n{kind}\nDATASET UNSTRUCTURED_GRID\n")
            .into_bytes();
    let integers = |numbers: &[i64], wide: bool| -> Vec<u8> {
        match (binary, wide) {
            (false, _) => spaced(numbers).into_bytes(),
            (true, true) => numbers.iter().flat_map(|n| n.to_be_bytes()).collect(),
            (true, false) => numbers
                .iter()
                .flat_map(|&n| (n as i32).to_be_bytes())
                .collect(),
        }
    };
    let mut section = |head: String, body: Vec<u8>| {
        file.extend(head.bytes());
        file.push(b'\n');
        file.extend(body);
        file.push(b'\n');
    };
    section(
        "FIELD FieldData 1\nTIME 1 2 int".into(),
        integers(&[3, 4], false),
    );
    let coordinates = if binary {
        mesh.positions
            .iter()
            .flat_map(|p| p.to_array())
            .flat_map(f64::to_be_bytes)
            .collect()
    } else {
        point_rows(mesh, "").into_bytes()
    };
    section(
        format!("POINTS {} double", mesh.positions.len()),
        coordinates,
    );
    section("METADATA\nINFORMATION 0".into(), Vec::new());
    if version.starts_with('5') {
        section(
            format!(
                "CELLS {} {}\nOFFSETS vtktypeint64",
                offsets.len(),
                nodes.len()
            ),
            integers(&offsets, true),
        );
        section("CONNECTIVITY vtktypeint64".into(), integers(&nodes, true));
    } else {
        let counted: Vec<i64> = offsets
            .windows(2)
            .flat_map(|ends| {
                let cell = &nodes[ends[0] as usize..ends[1] as usize];
                std::iter::once(cell.len() as i64).chain(cell.iter().copied())
            })
            .collect();
        section(
            format!("CELLS {} {}", types.len(), counted.len()),
            integers(&counted, false),
        );
    }
    section(
        format!("CELL_TYPES {}", types.len()),
        integers(&types, false),
    );
    section(
        format!("CELL_DATA {}\nSCALARS u float 1", types.len()),
        Vec::new(),
    );
    file
}

/// A `.vtu` in one piece whose arrays `array` writes, from type, name, components and bytes or words.
fn vtu(
    mesh: &VolumeMesh,
    head: &str,
    tail: &[u8],
    mut array: impl FnMut(&str, &str, Vec<u8>, String) -> String,
) -> Vec<u8> {
    let [nodes, offsets, types] = vtk_lists(mesh);
    let points: Vec<f64> = mesh.positions.iter().flat_map(|p| p.to_array()).collect();
    let words: Vec<String> = points.iter().map(f64::to_string).collect();
    let bytes = points.iter().flat_map(|x| x.to_le_bytes()).collect();
    let mut lists = String::new();
    let points = array(
        "Float64",
        "Points\" NumberOfComponents=\"3",
        bytes,
        words.join(" "),
    );
    for (name, numbers) in [
        ("connectivity", &nodes[..]),
        ("offsets", &offsets[1..]),
        ("types", &types),
    ] {
        let bytes = numbers
            .iter()
            .flat_map(|&n| (n as i32).to_le_bytes())
            .collect();
        lists += &array("Int32", name, bytes, spaced(numbers));
    }
    let mut file = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"LittleEndian\" {head}>\n\
         <UnstructuredGrid><Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n<PointData/>\n<Points>{points}</Points>\n<Cells>{lists}</Cells>\n\
         </Piece></UnstructuredGrid>\n",
        mesh.positions.len(),
        mesh.cell_count()
    )
    .into_bytes();
    file.extend(tail);
    file
}

fn with_size(bytes: Vec<u8>) -> Vec<u8> {
    [(bytes.len() as u32).to_le_bytes().to_vec(), bytes].concat()
}

fn vtu_text(mesh: &VolumeMesh) -> Vec<u8> {
    vtu(mesh, "", b"</VTKFile>", |number, name, _, words| {
        format!(
            "<DataArray type=\"{number}\" Name=\"{name}\" format=\"ascii\">\n{words}\n</DataArray>"
        )
    })
}

fn vtu_inline(mesh: &VolumeMesh) -> Vec<u8> {
    vtu(
        mesh,
        "header_type=\"UInt32\"",
        b"</VTKFile>",
        |number, name, bytes, _| {
            let text = STANDARD.encode(with_size(bytes));
            format!(
                "<DataArray type=\"{number}\" Name=\"{name}\" format=\"binary\">\n  {text}\n</DataArray>"
            )
        },
    )
}

fn vtu_appended(mesh: &VolumeMesh, base64: bool) -> Vec<u8> {
    let mut data = Vec::new();
    let draft = vtu(mesh, "", b"", |number, name, bytes, _| {
        let offset = data.len();
        let bytes = with_size(bytes);
        if base64 {
            data.extend(STANDARD.encode(bytes).bytes());
        } else {
            data.extend(bytes);
        }
        format!(
            "<DataArray type=\"{number}\" Name=\"{name}\" format=\"appended\" offset=\"{offset}\"/>"
        )
    });
    let encoding = if base64 { "base64" } else { "raw" };
    let tag = format!("<AppendedData encoding=\"{encoding}\">\n _");
    [
        draft,
        tag.into_bytes(),
        data,
        b"\n</AppendedData></VTKFile>".to_vec(),
    ]
    .concat()
}

fn msh_text(mesh: &VolumeMesh) -> String {
    let n = mesh.positions.len();
    let tags: String = (0..n).map(|k| format!("{}\n", 10 * k + 5)).collect();
    let mut text = format!(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 1 \"a b\"\n$EndPhysicalNames\n\
         $Nodes\n1 {n} 5 {}\n2 1 1 {n}\n{tags}{}$EndNodes\n",
        10 * n,
        point_rows(mesh, " 0.5 0.5")
    );
    write!(
        text,
        "$Elements\n4 {} 1 99\n2 1 2 1\n50 5 15 25\n",
        mesh.cell_count() + 1
    )
    .unwrap();
    for shape in CellShape::ALL {
        let cells: Vec<_> = mesh.cells().filter(|&(s, _)| s == shape).collect();
        writeln!(text, "3 1 {} {}", [4, 6, 5][shape as usize], cells.len()).unwrap();
        for (e, (_, cell)) in cells.iter().enumerate() {
            let nodes: Vec<i64> = cell.iter().map(|&v| 10 * i64::from(v) + 5).collect();
            writeln!(text, "{} {}", e + 1, spaced(&nodes)).unwrap();
        }
    }
    text + "$EndElements\n"
}

/// Valid files of every format and encoding that is read, all of [`mixed`].
fn valid_files() -> Vec<(&'static str, Vec<u8>)> {
    let mesh = mixed();
    let linear = NodalVolume::from(&mesh);
    vec![
        ("a.mesh", medit(&mesh).into_bytes()),
        ("a.mesh", medit(&mesh).replace('\n', "\r\n").into_bytes()),
        ("little.meshb", medit_binary(&mesh, false)),
        ("big.meshb", medit_binary(&mesh, true)),
        ("text3.vtk", legacy_vtk(&mesh, "3.0", false)),
        ("binary3.vtk", legacy_vtk(&mesh, "3.0", true)),
        ("text5.vtk", legacy_vtk(&mesh, "5.1", false)),
        ("binary5.vtk", legacy_vtk(&mesh, "5.1", true)),
        ("text.vtu", vtu_text(&mesh)),
        ("inline.vtu", vtu_inline(&mesh)),
        ("raw.vtu", vtu_appended(&mesh, false)),
        ("base64.vtu", vtu_appended(&mesh, true)),
        ("text.msh", msh_text(&mesh).into_bytes()),
        ("written.vtu", written("vtu", &linear)),
        ("written.msh", written("msh", &linear)),
        ("mfem.mesh", written("mesh", &linear)),
        ("curved.vtu", written("vtu", &curved(&mesh, 3))),
        ("curved.msh", written("msh", &curved(&mesh, 2))),
        ("curved.mesh", written("mesh", &curved(&mesh, 3))),
    ]
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
    let missing = read_volume(Path::new("nowhere/a.vtu"))
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
