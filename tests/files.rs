//! Surfaces through files: real scans are read with their known flaws, no content whatever makes a reader panic, and what is written is
//! read back the same.

mod common;

use glam::DVec3;
use proptest::prelude::*;
use serde_json::json;
use std::path::Path;
use vorofit::files::curves::{Curve, write_curves};
use vorofit::files::{SurfaceToWrite, read_surface, surface_from_bytes, write_surface};
use vorofit::mesh::check::{self, Census};
use vorofit::mesh::{ControlMesh, Crease, PolygonMesh, Scheme};

const READ_FORMATS: [&str; 5] = ["obj", "ply", "stl", "off", "usda"];

#[test]
fn real_surfaces_have_their_published_sizes_and_flaws() {
    let clean = |vertices, faces| Census {
        vertices,
        faces,
        components: 1,
        ..Census::default()
    };
    let expected = [
        ("surfaces/cactus.off", clean(5_261, 10_518)),
        ("surfaces/fandisk.obj", clean(3_248, 3_267)),
        ("surfaces/fertility.obj", clean(3_730, 2_048)),
        ("surfaces/gear.obj", clean(9_934, 9_934)),
        ("surfaces/igea.ply", clean(134_345, 268_686)),
        ("surfaces/penguin-cage.obj", clean(201, 221)),
        ("surfaces/penguin.obj", clean(3_362, 6_720)),
        ("surfaces/plate-holes.stl", clean(618, 1_252)),
        ("surfaces/rocker-arm.obj", clean(10_044, 20_088)),
        ("surfaces/three-holes.obj", clean(1_987, 3_982)),
        ("scans/quadknot.obj", clean(1_440, 1_440)),
        (
            "surfaces/stanford-bunny.obj",
            Census {
                unreferenced_vertices: 1_113,
                boundary_edges: 223,
                boundary_loops: 5,
                ..clean(35_947, 69_451)
            },
        ),
        // Its seams are closed but for rounding.
        ("surfaces/featuretype.stl", clean(1_722, 3_476)),
        // Points in a range grid.
        (
            "scans/dragonStandRight_0.ply",
            Census {
                unreferenced_vertices: 40,
                components: 23,
                boundary_edges: 4_223,
                boundary_loops: 35,
                ..clean(41_841, 79_361)
            },
        ),
        (
            "scans/bunny-range-000.ply",
            Census {
                unreferenced_vertices: 11,
                boundary_edges: 1_186,
                boundary_loops: 3,
                ..clean(40_256, 79_312)
            },
        ),
        (
            "scans/dragon-nonmanifold.ply",
            Census {
                duplicate_faces: 1_254,
                unreferenced_vertices: 16,
                non_manifold_edges: 2_094,
                ..clean(22_998, 47_794)
            },
        ),
        (
            "scans/elephant-with-holes.off",
            Census {
                boundary_edges: 1_353,
                boundary_loops: 106,
                ..clean(2_798, 4_463)
            },
        ),
        (
            "scans/snowden.obj",
            Census {
                components: 4,
                boundary_edges: 39,
                boundary_loops: 7,
                non_manifold_edges: 88,
                ..clean(18_743, 37_629)
            },
        ),
        (
            "scans/soup.stl",
            Census {
                components: 100,
                boundary_edges: 300,
                boundary_loops: 100,
                ..clean(300, 100)
            },
        ),
    ];
    for (name, census) in expected {
        if let Some(path) = common::data(name) {
            assert_eq!(read_surface(&path).unwrap().census, census, "{name}");
        }
    }
}

#[test]
fn point_clouds_are_no_surfaces() {
    for name in ["points/hippo.ply", "points/ball.ply"] {
        if let Some(path) = common::data(name) {
            let message = read_surface(&path).unwrap_err().to_string();
            assert!(
                message.contains("but no faces; give a surface"),
                "{message}"
            );
        }
    }
}

#[test]
fn a_refusal_is_one_line_that_names_the_file() {
    let huge_ply = "ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\n\
                    property float y\nproperty float z\nend_header\n0 0 0\n";
    let one_point = "v 1 2 3\nv 1 2 3\nf 1 1 2\n";
    let cases = [
        ("a.obj", "", "empty"),
        ("a.ply", "", "empty"),
        ("a.stl", "", "empty"),
        ("a.off", "", "empty"),
        ("a.ply", huge_ply, "4000000000"),
        (
            "a.obj",
            "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n",
            "vertex 1 ",
        ),
        (
            "a.obj",
            "v 0 0 0\nv 1e999 0 0\nv 0 1 0\nf 1 2 3\n",
            "vertex 1 ",
        ),
        (
            "a.off",
            "OFF 3 1 0\n0 0 0\n0 inf 0\n1 0 0\n3 0 1 2\n",
            "vertex 1 ",
        ),
        ("a.obj", one_point, "bounding box"),
        ("a.off", "OFF 3 1 0\n0 0 0\n", "truncated"),
        ("a.usda", "#usda 1.0", "no Mesh"),
        ("a.glb", "glTF", "not read"),
        ("a.xyz", "0 0 0", "use .obj"),
    ];
    for (name, content, part) in cases {
        let error = surface_from_bytes(Path::new(name), content.as_bytes()).unwrap_err();
        let message = error.to_string();
        assert!(
            message.starts_with(name) && message.contains(part),
            "{message}"
        );
        assert!(!message.contains('\n'), "{message}");
    }
    let missing = read_surface(Path::new("nowhere/a.obj"))
        .unwrap_err()
        .to_string();
    assert!(missing.starts_with("nowhere/a.obj: "), "{missing}");
}

/// Writes a surface and gives the file's content.
fn written(extension: &str, mesh: &PolygonMesh) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("surface").with_extension(extension);
    write_surface(&path, &SurfaceToWrite::dense(mesh, None)).unwrap();
    std::fs::read(&path).unwrap()
}

/// Valid files of every format and kind that is read.
fn valid_files() -> Vec<(&'static str, Vec<u8>)> {
    let mesh = cube(DVec3::ZERO);
    let mut files: Vec<_> = READ_FORMATS.map(|e| (e, written(e, &mesh))).into();
    let ascii = "ply\nformat ascii 1.0\ncomment c\nelement vertex 4\nproperty float x\nproperty float y\n\
                 property float z\nelement face 1\nproperty list uchar int vertex_indices\nelement tristrips 1\n\
                 property list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n5 0 1 2 -1 3\n";
    let stl = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n\
               endfacet\nendsolid a\n";
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 -2/1 \\\n3/1\nl 1 2\nt crease 2/1/0 0 1 2.5\nt corner 1/1/0 2 10\n";
    let usda = "#usda 1.0\n(\n)\ndef Xform \"x\" (\n)\n{\ndef Mesh \"m\" {\nint[] faceVertexCounts = [3]\n\
                int[] faceVertexIndices = [0, 1, 2]\npoint3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]\n\
                int[] creaseIndices = [0, 1, 2]\nint[] creaseLengths = [3]\nfloat[] creaseSharpnesses = [1]\n\
                int[] cornerIndices = [2]\nfloat[] cornerSharpnesses = [10]\nstring a = '''b''' (doc = \"c\")\n}\n}\n";
    files.extend([
        ("ply", ascii.into()),
        ("ply", ascii.replace('\n', "\r\n").into()),
        ("stl", stl.into()),
        ("obj", obj.into()),
        ("usda", usda.into()),
        (
            "off",
            "COFF\n3 1 0\n0 0 0 1 1 1 1\n1 0 0 1 1 1 1\n0 1 0 1 1 1 1 # c\n3 0 1 2\n".into(),
        ),
    ]);
    files
}

/// A reader must refuse, or give what the rest of the program can compute with.
fn read_anything(extension: &str, bytes: &[u8]) -> Result<(), TestCaseError> {
    let path = Path::new("surface").with_extension(extension);
    match surface_from_bytes(&path, bytes) {
        Ok(surface) => prop_assert_eq!(check::sound(&surface.mesh), Ok(())),
        Err(error) => prop_assert!(!error.to_string().contains('\n'), "{error}"),
    }
    Ok(())
}

#[test]
fn valid_files_of_every_kind_are_read() {
    for (extension, bytes) in valid_files() {
        let path = Path::new("surface").with_extension(extension);
        surface_from_bytes(&path, &bytes).unwrap();
    }
}

proptest! {
    // A case takes about 5 µs.
    #![proptest_config(ProptestConfig::with_cases(20_000))]

    #[test]
    fn arbitrary_bytes_never_panic(
        extension in prop::sample::select(&READ_FORMATS[..]),
        start in prop::sample::select(vec!["", "ply\nformat ascii 1.0\n", "OFF\n", "solid \n", "v 0 0 0\nf ", "#usda 1.0\ndef Mesh \"m\" {\n"]),
        bytes in prop::collection::vec(any::<u8>(), 0..400),
    ) {
        read_anything(extension, &[start.as_bytes(), &bytes].concat())?;
    }

    #[test]
    fn damaged_files_never_panic(
        (extension, mut bytes) in prop::sample::select(valid_files()),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        word in prop::option::of((any::<prop::sample::Index>(), prop::sample::select(
            vec!["-1 ", "4294967296 ", "18446744073709551615 ", "nan ", "1e999 ", "\n", "\0"]))),
        end in prop::option::of(any::<prop::sample::Index>()),
    ) {
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Some((at, word)) = word {
            let at = at.index(bytes.len());
            bytes.splice(at..at, word.bytes());
        }
        if let Some(end) = end {
            bytes.truncate(end.index(bytes.len()));
        }
        read_anything(extension, &bytes)?;
    }
}

proptest! {
    #[test]
    fn what_is_written_is_read_back_to_the_bit(mesh in polygons()) {
        for extension in ["obj", "ply", "off"] {
            let path = Path::new("surface").with_extension(extension);
            let back = surface_from_bytes(&path, &written(extension, &mesh)).unwrap();
            prop_assert_eq!(&back.mesh, &mesh, "{}", extension);
        }
    }

    #[test]
    fn stl_keeps_the_triangles_in_f32(mesh in polygons()) {
        let back = surface_from_bytes(Path::new("a.stl"), &written("stl", &mesh)).unwrap().mesh;
        let (back, mesh) = (back.triangulate(), mesh.triangulate());
        prop_assert_eq!(back.triangles.len(), mesh.triangles.len());
        for t in 0..mesh.triangles.len() {
            prop_assert_eq!(back.corners(t), mesh.corners(t).map(|p| p.as_vec3().as_dvec3()));
        }
    }
}

/// Meshes of distinct vertices, up to 12, and faces of 3 to 6 corners, at scales from 10⁻⁶ to 10⁶.
fn polygons() -> impl Strategy<Value = PolygonMesh> {
    (3u32..12, -6i32..7).prop_flat_map(|(vertices, scale)| {
        let coordinate = -1.0..1.0f64;
        let points = prop::collection::vec(
            [coordinate.clone(), coordinate.clone(), coordinate],
            vertices as usize,
        );
        let faces = prop::collection::vec(prop::collection::vec(0..vertices, 3..6), 1..8);
        (points, faces).prop_map(move |(points, mut faces)| {
            // The index keeps the vertices apart; one proper face gives the mesh an extent.
            let points = points
                .iter()
                .enumerate()
                .map(|(k, &p)| (DVec3::from(p) + DVec3::X * 3.0 * k as f64) * 10f64.powi(scale));
            faces.push(vec![0, 1, 2]);
            PolygonMesh::from_faces(points.collect(), faces)
        })
    })
}

/// A cube of quads with its lower corner at a point.
fn cube(at: DVec3) -> PolygonMesh {
    let corner = |k: u32| at + DVec3::new((k & 1).into(), (k >> 1 & 1).into(), (k >> 2).into());
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    PolygonMesh::from_faces((0..8).map(corner).collect(), faces)
}

/// Writes every format with everything it holds, and what must be found there, for `files_elsewhere.py`.
#[test]
fn files_for_other_software_are_written() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("files");
    std::fs::create_dir_all(&folder).unwrap();
    let mut expected = serde_json::Map::new();
    let far = cube(DVec3::new(5.0e6, -3.0e6, 100.25));
    let error: Vec<f64> = (0..8).map(|v| 0.125 * f64::from(v)).collect();
    for extension in ["obj", "ply", "off", "usda", "glb", "stl"] {
        // STL alone has no way to say where a far shape is.
        let mesh = if extension == "stl" {
            cube(DVec3::ZERO)
        } else {
            far.clone()
        };
        let name = format!("dense.{extension}");
        write_surface(
            &folder.join(&name),
            &SurfaceToWrite::dense(&mesh, Some(&error)),
        )
        .unwrap();
        let faces: Vec<&[u32]> = mesh.faces().collect();
        let points: Vec<_> = mesh.positions.iter().map(|p| p.to_array()).collect();
        expected.insert(
            name,
            json!({ "points": points, "faces": faces, "error": error, "scheme": "none" }),
        );
    }
    let mut control = ControlMesh::from(cube(DVec3::ZERO));
    control.creases = [([4, 5], f64::INFINITY), ([5, 7], 2.5)]
        .map(|(edge, sharpness)| Crease { edge, sharpness })
        .into();
    control.corners = vec![0];
    let name = "control.usda";
    write_surface(
        &folder.join(name),
        &SurfaceToWrite::control(&control, Scheme::CatmullClark),
    )
    .unwrap();
    let faces: Vec<&[u32]> = control.mesh.faces().collect();
    let points: Vec<_> = control
        .mesh
        .positions
        .iter()
        .map(|p| p.to_array())
        .collect();
    expected.insert(
        name.into(),
        json!({
            "points": points, "faces": faces, "scheme": "catmullClark",
            "creases": [[4, 5, 10.0], [5, 7, 2.5]], "corners": [0],
        }),
    );
    let curve = |points: &[DVec3]| Curve {
        name: "ridge",
        points: points.to_vec(),
        values: vec![vec![8.0, 0.5]; points.len()],
        color: [205, 30, 40],
    };
    let (line, point) = ([DVec3::ZERO, DVec3::X, DVec3::ONE], [DVec3::Z]);
    let curves = [curve(&line), curve(&point)];
    write_curves(&folder.join("lines.ply"), &["kind", "strength"], &curves).unwrap();
    let points: Vec<_> = line.iter().chain(&point).map(|p| p.to_array()).collect();
    expected.insert(
        "lines.ply".into(),
        json!({ "points": points, "edges": [[0, 1], [1, 2]] }),
    );
    let text = serde_json::to_string_pretty(&expected).unwrap();
    std::fs::write(folder.join("expected.json"), text).unwrap();
}
