//! Stereolithography files, text and binary, through the crate `stl_io`; always written binary. Coordinates are f32 in both kinds.
//!
//! stl_io takes every file that starts with "solid " for text, although many binary ones do, reads only the first solid of a text, and
//! knows keywords in small letters only. So the kind is told here by the length, and text is put into the one shape that it reads.

use super::{Draft, bounds};
use crate::error::Defect;
use crate::mesh::{PolygonMesh, weld};
use glam::DVec3;
use std::io::{self, Cursor, Write};

const HEADER: usize = 80;
const TRIANGLE: usize = 50;
const TRUNCATED: &str = "the file is truncated or no STL: export it again";

/// The largest rounding of a coordinate to f32, as a share of the diagonal, at which the shape is still written.
/// A thousandth of the diagonal is about a hundred times the error of a good fit.
const LARGEST_ROUNDING: f64 = 1e-3;

/// The two kinds of file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Text,
    Binary,
}

/// The kind, where the content is clearly of this format: of the length that a binary file states, or starting as text does and
/// without the zeros that binary numbers have.
pub(super) fn recognize(bytes: &[u8]) -> Option<Kind> {
    let binary_length = stated_triangles(bytes).map(|n| HEADER as u64 + 4 + TRIANGLE as u64 * n);
    if binary_length == Some(bytes.len() as u64) {
        return Some(Kind::Binary);
    }
    let is_text =
        keyword(bytes.trim_ascii_start()).eq_ignore_ascii_case(b"solid") && !bytes.contains(&0);
    is_text.then_some(Kind::Text)
}

/// The number of triangles in the header of a binary file.
fn stated_triangles(bytes: &[u8]) -> Option<u64> {
    let count = bytes.get(HEADER..HEADER + 4)?;
    Some(u64::from(u32::from_le_bytes(count.try_into().ok()?)))
}

pub(super) fn read(bytes: &[u8]) -> Result<Draft, Defect> {
    let content = match recognize(bytes) {
        Some(Kind::Binary) => {
            let mut content = bytes.to_vec();
            // So that no header reads "solid ".
            content[..HEADER].fill(0);
            content
        }
        Some(Kind::Text) => one_solid(bytes)?,
        None => return Err(neither(bytes)),
    };
    let mut content = Cursor::new(content);
    let defect = |place: String, e: io::Error| {
        let message: String = e.to_string().chars().take(160).collect();
        Defect::new(place, message, TRUNCATED)
    };
    let triangles =
        stl_io::create_stl_reader(&mut content).map_err(|e| defect("header".into(), e))?;
    let mut positions = Vec::new();
    for (t, triangle) in triangles.enumerate() {
        let triangle = triangle.map_err(|e| defect(format!("facet {t} (counted from 0)"), e))?;
        positions.extend(triangle.vertices.map(|p| DVec3::from(p.0.map(f64::from))));
    }
    let mut draft = Draft::new(positions);
    for t in 0..draft.mesh.positions.len() as i64 / 3 {
        draft.push_face(&[3 * t, 3 * t + 1, 3 * t + 2], || format!("facet {t}"))?;
    }
    draft.mesh = weld(&draft.mesh);
    Ok(draft)
}

fn neither(bytes: &[u8]) -> Defect {
    let problem = match stated_triangles(bytes) {
        Some(n) => format!(
            "it neither starts as text nor is its length, {} bytes, that of the {n} triangles it states",
            bytes.len()
        ),
        None => "it is too short for an STL file".into(),
    };
    Defect::new("header", problem, TRUNCATED)
}

fn keyword(line: &[u8]) -> &[u8] {
    line.split(u8::is_ascii_whitespace)
        .next()
        .unwrap_or_default()
}

/// All solids of a text as one, in small letters.
fn one_solid(bytes: &[u8]) -> Result<Vec<u8>, Defect> {
    let text = bytes.to_ascii_lowercase();
    let (mut started, mut ended) = (0, 0);
    let mut joined = b"solid \n".to_vec();
    for line in text.split(|&b| b == b'\n').map(<[u8]>::trim_ascii) {
        match keyword(line) {
            b"solid" => started += 1,
            b"endsolid" => ended += 1,
            _ => {
                joined.extend_from_slice(line);
                joined.push(b'\n');
            }
        }
    }
    if started != ended {
        return Err(Defect::new(
            "end of file",
            format!("{started} solids are started and {ended} ended"),
            TRUNCATED,
        ));
    }
    joined.extend_from_slice(b"endsolid\n");
    Ok(joined)
}

/// Whether f32 coordinates keep the shape.
pub(super) fn check_holds(mesh: &PolygonMesh) -> Result<(), Defect> {
    let (lo, hi) = bounds(mesh);
    let largest = lo.abs().max(hi.abs()).max_element();
    let rounding = largest * f64::from(f32::EPSILON) / 2.0;
    if largest > f64::from(f32::MAX) || rounding > LARGEST_ROUNDING * (hi - lo).length() {
        return Err(Defect::new(
            "coordinates",
            format!("f32, all that STL has, loses this shape at coordinates up to {largest}"),
            "write .ply, .obj or .off",
        ));
    }
    Ok(())
}

pub(super) fn write(out: &mut dyn Write, mesh: &PolygonMesh) -> io::Result<()> {
    let mesh = mesh.triangulate();
    let triangles: Vec<stl_io::Triangle> = (0..mesh.triangles.len())
        .map(|t| stl_io::Triangle {
            normal: stl_io::Normal::new(
                mesh.area_vector(t).normalize_or_zero().as_vec3().to_array(),
            ),
            vertices: mesh
                .corners(t)
                .map(|p| stl_io::Vertex::new(p.as_vec3().to_array())),
        })
        .collect();
    let mut out = out;
    stl_io::write_stl(&mut out, triangles.iter())
}

#[cfg(test)]
mod tests {
    use super::*;

    const FACET: &str = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";

    fn binary(header: &[u8], stated: u32, triangles: usize) -> Vec<u8> {
        let mut bytes = header.to_vec();
        bytes.resize(HEADER, b' ');
        bytes.extend(stated.to_le_bytes());
        for _ in 0..triangles {
            let numbers = [
                0.0f32, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, -0.0,
            ];
            bytes.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
            bytes.extend([0, 0]);
        }
        bytes
    }

    #[test]
    fn both_kinds_give_the_same_whatever_their_first_line() {
        let texts = [
            format!("solid\n{FACET}endsolid\n"),
            format!(
                "solid a name\r\n{}endsolid a name",
                FACET.replace('\n', "\r\n")
            ),
            format!("  SOLID A\n\n{}\tENDSOLID A\n", FACET.to_uppercase()),
        ];
        let binaries = [&b"solid a name"[..], b"", b"solid \n\xff"].map(|h| binary(h, 1, 1));
        for bytes in texts.map(String::into_bytes).into_iter().chain(binaries) {
            let draft = read(&bytes).unwrap();
            assert_eq!(draft.mesh.positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
            assert_eq!(draft.mesh.face_count(), 1);
        }
    }

    #[test]
    fn all_solids_of_a_text_are_read_and_their_seams_closed() {
        let other = FACET.replace("vertex 0 0 0", "vertex 1 1 -0");
        let draft =
            read(format!("solid a\n{FACET}endsolid a\nsolid b\n{other}endsolid b\n").as_bytes());
        let mesh = draft.unwrap().mesh;
        assert_eq!((mesh.positions.len(), mesh.face_count()), (4, 2));
    }

    #[test]
    fn truncated_and_foreign_files_are_refused() {
        let long = format!("solid\n{FACET}{FACET}");
        let cases = [
            (b"solid".to_vec(), "end of file"),
            (long.clone().into_bytes(), "end of file"),
            (
                long.replace("vertex 1 0 0\n", "").into_bytes(),
                "end of file",
            ),
            (
                format!("{}endsolid", long.replace("1 0 0", "1 0 x")).into_bytes(),
                "facet 0 (counted from 0)",
            ),
            (
                format!("{}endsolid", long.replace("0 1 0", "nan 1 0")).into_bytes(),
                "facet 0 (counted from 0)",
            ),
            (binary(b"", u32::MAX, 1), "header"),
            (binary(b"", 2, 1), "header"),
            (b"\x00\x01\x02".to_vec(), "header"),
        ];
        for (bytes, place) in cases {
            assert_eq!(read(&bytes).err().unwrap().place, place);
        }
    }

    #[test]
    fn a_shape_that_f32_would_lose_is_not_written() {
        let far = |offset: f64| {
            let points = [DVec3::ZERO, DVec3::X, DVec3::Y].map(|p| p + offset);
            check_holds(&PolygonMesh::from_faces(points.to_vec(), [[0, 1, 2]]))
        };
        assert!(far(0.0).is_ok() && far(1e3).is_ok());
        assert!(far(5e6).is_err() && far(1e200).is_err());
    }
}
