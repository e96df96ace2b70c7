//! Volume files for tests: what a small mesh of all shapes looks like in every format and encoding that is read, made by hand, and real files.

#![allow(dead_code, reason = "each test binary uses a part")]

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use std::fmt::Write;
use std::path::Path;
use vorofit::files::{Pyramids, Volume, VolumeToWrite, volume_from_bytes, write_volume};
use vorofit::mesh::{CellShape, NodalVolume, VolumeMesh, check_volume};

pub fn parse(name: &str, bytes: &[u8]) -> vorofit::Result<Volume> {
    volume_from_bytes(Path::new(name), bytes, Pyramids::Refused)
}

/// Numbers of vertices, tetrahedra, prisms, hexahedra and boundary faces.
pub fn sizes(mesh: &VolumeMesh) -> [usize; 5] {
    let census = check_volume::sound(mesh).unwrap();
    [
        census.vertices,
        census.tetrahedra,
        census.prisms,
        census.hexahedra,
        census.boundary_faces,
    ]
}

/// Two cubes, a prism beside them and a tetrahedron on top of the prism.
pub fn mixed() -> VolumeMesh {
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
pub fn only(shape: CellShape) -> VolumeMesh {
    let mixed = mixed();
    let mut mesh = VolumeMesh::new(mixed.positions.clone());
    for (_, cell) in mixed.cells().filter(|&(s, _)| s == shape) {
        mesh.push_cell(shape, cell);
    }
    NodalVolume::from(&mesh).corners()
}

/// A map of a polynomial degree up to 3 that is known to `volumes_elsewhere.py` too.
pub fn bent(p: DVec3, degree: usize) -> DVec3 {
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
pub fn curved(mesh: &VolumeMesh, order: usize) -> NodalVolume {
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
pub fn written(extension: &str, volume: &NodalVolume) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("volume").with_extension(extension);
    write_volume(&path, &VolumeToWrite::new(volume)).unwrap();
    std::fs::read(&path).unwrap()
}

/// The rows of numbers of a mesh's points and of its cells of a shape, the vertices counted from `base`.
pub fn rows(mesh: &VolumeMesh, shape: CellShape, base: u32, end: &str) -> String {
    let cells = mesh.cells().filter(|&(s, _)| s == shape);
    cells.fold(String::new(), |mut text, (_, cell)| {
        let row: Vec<String> = cell.iter().map(|v| (v + base).to_string()).collect();
        writeln!(text, "{}{end}", row.join(" ")).unwrap();
        text
    })
}

pub fn point_rows(mesh: &VolumeMesh, end: &str) -> String {
    let row = |p: &DVec3| format!("{} {} {}{end}\n", p.x, p.y, p.z);
    mesh.positions.iter().map(row).collect()
}

pub const MEDIT: [(CellShape, &str, i32); 3] = [
    (CellShape::Tetrahedron, "Tetrahedra", 8),
    (CellShape::Prism, "Prisms", 9),
    (CellShape::Hexahedron, "Hexahedra", 10),
];

pub fn medit(mesh: &VolumeMesh) -> String {
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

pub fn medit_binary(mesh: &VolumeMesh, big_endian: bool) -> Vec<u8> {
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
pub fn vtk_lists(mesh: &VolumeMesh) -> [Vec<i64>; 3] {
    let mut offsets = vec![0];
    let (mut nodes, mut types) = (Vec::new(), Vec::new());
    for (shape, cell) in mesh.cells() {
        nodes.extend(cell.iter().map(|&v| i64::from(v)));
        offsets.push(nodes.len() as i64);
        types.push([10, 13, 12][shape as usize]);
    }
    [nodes, offsets, types]
}

pub fn spaced(numbers: &[i64]) -> String {
    let words: Vec<String> = numbers.iter().map(i64::to_string).collect();
    words.join(" ")
}

/// Legacy VTK of a version, text or binary, with sections that do not matter.
pub fn legacy_vtk(mesh: &VolumeMesh, version: &str, binary: bool) -> Vec<u8> {
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
pub fn vtu(
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

pub fn with_size(bytes: Vec<u8>) -> Vec<u8> {
    [(bytes.len() as u32).to_le_bytes().to_vec(), bytes].concat()
}

pub fn vtu_text(mesh: &VolumeMesh) -> Vec<u8> {
    vtu(mesh, "", b"</VTKFile>", |number, name, _, words| {
        format!(
            "<DataArray type=\"{number}\" Name=\"{name}\" format=\"ascii\">\n{words}\n</DataArray>"
        )
    })
}

pub fn vtu_inline(mesh: &VolumeMesh) -> Vec<u8> {
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

pub fn vtu_appended(mesh: &VolumeMesh, base64: bool) -> Vec<u8> {
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

pub fn msh_text(mesh: &VolumeMesh) -> String {
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
pub fn valid_files() -> Vec<(&'static str, Vec<u8>)> {
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
