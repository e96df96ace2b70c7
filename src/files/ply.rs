//! The Stanford polygon file format: text and binary of both endians through the crate `ply-rs-bw`, written here as binary little endian.
//!
//! The crate's typed elements keep the time and memory of a vertex at that of its coordinates. It loops as often as a header says, so each
//! count is first compared with the bytes that are left ([`check_count`]). Writing through it would take a map per element; a fixed header
//! and the numbers in a row take less code.

use super::Draft;
use super::range_grid::RangeGrid;
use crate::error::Defect;
use crate::mesh::PolygonMesh;
use glam::DVec3;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{
    BeginList, ElementDef, Encoding, Header, PropertyAccess, PropertyAccessResult, PropertyType,
    ScalarType,
};
use std::io::{self, Write};

const DAMAGED: &str = "the file is truncated or damaged: export it again";

pub(super) fn read(bytes: &[u8]) -> Result<Draft, Defect> {
    let mut body = Body::open(bytes)?;
    let (mut vertices, mut faces, mut strips) = (Vec::new(), Vec::new(), Vec::new());
    let mut grid = Vec::new();
    let elements = body.header.elements.clone();
    for element in elements.values() {
        match element.name.as_str() {
            "vertex" => vertices = body.read::<Vertex>(element, &["x", "y", "z"])?,
            "face" => faces = body.read_lists(element)?,
            "tristrips" => strips = body.read_lists(element)?,
            "range_grid" => grid = body.read_lists(element)?,
            _ => drop(body.read::<PassedOver>(element, &[])?),
        }
    }
    let has = |name: &str| {
        let vertex = elements.get("vertex");
        vertex.is_some_and(|vertex| vertex.properties.contains_key(name))
    };
    let mut draft = Draft::new(vertices.iter().map(|v| v.position).collect());
    if ["nx", "ny", "nz"].into_iter().all(has) {
        draft.normals = vertices.iter().map(|v| v.normal).collect();
    }
    if has("confidence") {
        draft.confidence = vertices.iter().map(|v| v.confidence).collect();
    }
    let mut corners = Vec::new();
    for (f, face) in faces.iter().enumerate() {
        corners.clear();
        corners.extend(face.0.iter().map(|&v| i64::from(v)));
        draft.push_face(&corners, || format!("face {f} (counted from 0)"))?;
    }
    for strip in strips.iter().flat_map(|list| list.0.split(|&v| v < 0)) {
        push_strip(&mut draft, strip)?;
    }
    if draft.mesh.face_count() == 0 && !grid.is_empty() {
        push_range_grid(&mut draft, &body.header, &grid)?;
    }
    Ok(draft)
}

/// The triangles of a range image, where the header tells its size.
fn push_range_grid(draft: &mut Draft, header: &Header, cells: &[Corners]) -> Result<(), Defect> {
    let remarks = header.obj_infos.iter().map(String::as_str);
    let cells = cells.iter().map(|list| list.0.as_slice());
    let points = draft.mesh.positions.len();
    if let Some(grid) = RangeGrid::new(remarks, cells, points)? {
        for triangle in grid.triangles(&draft.mesh.positions) {
            draft.push_face(&triangle.map(i64::from), || "range grid".into())?;
        }
    }
    Ok(())
}

/// The property `error` of every vertex, as [`write`] writes it, where there is one.
pub(super) fn read_error(bytes: &[u8]) -> Result<Option<Vec<f64>>, Defect> {
    let mut body = Body::open(bytes)?;
    for element in body.header.elements.clone().values() {
        if element.name != "vertex" {
            body.read::<PassedOver>(element, &[])?;
        } else if element.properties.contains_key("error") {
            let vertices = body.read::<Vertex>(element, &[])?;
            return Ok(Some(vertices.into_iter().map(|v| v.error).collect()));
        } else {
            return Ok(None);
        }
    }
    Ok(None)
}

/// The triangles of a strip, every other one turned; those with a repeated corner only steer the strip and are left out.
fn push_strip(draft: &mut Draft, strip: &[i32]) -> Result<(), Defect> {
    for (k, window) in strip.windows(3).enumerate() {
        let [a, b, c] = [window[0], window[1], window[2]].map(i64::from);
        if a != b && b != c && c != a {
            let triangle = if k % 2 == 0 { [a, b, c] } else { [b, a, c] };
            draft.push_face(&triangle, || format!("triangle strip, corner {k}"))?;
        }
    }
    Ok(())
}

/// The file after its header, read element by element.
struct Body<'a> {
    header: Header,
    reader: Reader<&'a [u8]>,
}

impl<'a> Body<'a> {
    fn open(bytes: &'a [u8]) -> Result<Self, Defect> {
        let mut reader = Reader::new(bytes);
        let header = Parser::<PassedOver>::new()
            .read_header(&mut reader)
            .map_err(|e| {
                let place = e
                    .line()
                    .map_or("header".into(), |line| format!("line {line}"));
                Defect::new(place, first_line(&e), DAMAGED)
            })?;
        Ok(Self { header, reader })
    }

    /// All of an element, which must have certain properties.
    fn read<E: PropertyAccess>(
        &mut self,
        element: &ElementDef,
        needed: &[&str],
    ) -> Result<Vec<E>, Defect> {
        if let Some(name) = needed
            .iter()
            .find(|&&n| !element.properties.contains_key(n))
        {
            return Err(Defect::new(
                "header",
                format!("element {} has no property {name}", element.name),
                "export the file again with positions and vertex_indices",
            ));
        }
        check_count(element, self.header.encoding, self.reader.get_ref().len())?;
        let parser = Parser::<E>::new();
        parser
            .read_payload_for_element(&mut self.reader, element, &self.header)
            .map_err(|e| {
                let place = match (self.header.encoding, e.line()) {
                    (Encoding::Ascii, Some(line)) => format!("line {line}"),
                    _ => format!("element {}", element.name),
                };
                Defect::new(place, first_line(&e), DAMAGED)
            })
    }

    fn read_lists(&mut self, element: &ElementDef) -> Result<Vec<Corners>, Defect> {
        let name = CORNER_LISTS
            .into_iter()
            .find(|&name| element.properties.contains_key(name))
            .unwrap_or(CORNER_LISTS[0]);
        self.read(element, &[name])
    }
}

/// Refuses a count of elements that the rest of the file is too short for.
fn check_count(element: &ElementDef, encoding: Encoding, rest: usize) -> Result<(), Defect> {
    let smallest: usize = match encoding {
        Encoding::Ascii => 1,
        _ => element
            .properties
            .values()
            .map(|p| match &p.data_type {
                PropertyType::Scalar(number) | PropertyType::List(number, _) => {
                    size_of_scalar(number)
                }
            })
            .sum(),
    };
    let fits = smallest > 0 && element.count <= rest / smallest;
    if fits || element.count == 0 {
        return Ok(());
    }
    Err(Defect::new(
        "header",
        format!(
            "it claims {} of element {}, but only {rest} bytes follow",
            element.count, element.name
        ),
        DAMAGED,
    ))
}

fn size_of_scalar(scalar: &ScalarType) -> usize {
    match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}

/// The crate's messages have several lines; the first says what is wrong.
fn first_line(error: &ParseError) -> String {
    let message = error.to_string();
    let line = message.lines().next().unwrap_or_default();
    // Its own "Line 12: " is the place already.
    let line = line
        .split_once(": ")
        .filter(|(l, _)| l.starts_with("Line "))
        .map_or(line, |(_, m)| m);
    line.chars().filter(|c| !c.is_control()).take(160).collect()
}

/// An element that is none of the surface's.
struct PassedOver;

impl PropertyAccess for PassedOver {
    fn new() -> Self {
        Self
    }
}

#[derive(Default)]
struct Vertex {
    position: DVec3,
    normal: DVec3,
    confidence: f64,
    error: f64,
}

impl Vertex {
    fn set(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        match name {
            "x" => self.position.x = value,
            "y" => self.position.y = value,
            "z" => self.position.z = value,
            "nx" => self.normal.x = value,
            "ny" => self.normal.y = value,
            "nz" => self.normal.z = value,
            "confidence" => self.confidence = value,
            "error" => self.error = value,
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

macro_rules! setters {
    ($convert:expr; $($name:ident: $type:ty),*) => {
        $(fn $name(&mut self, name: &str, value: $type) -> PropertyAccessResult {
            $convert(self, name, value)
        })*
    };
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    setters! { Self::set; set_double: f64 }
    setters! { |v: &mut Self, name, x| v.set(name, f64::from(x));
        set_char: i8, set_uchar: u8, set_short: i16, set_ushort: u16, set_int: i32, set_uint: u32,
        set_float: f32
    }
}

/// The names that the list of a face's corners goes by.
const CORNER_LISTS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// The corners of a face or of a strip with separators (−1), as the file has them.
struct Corners(Vec<i32>);

impl Corners {
    fn set(&mut self, name: &str, values: impl Iterator<Item = i32>) -> PropertyAccessResult {
        if !CORNER_LISTS.contains(&name) {
            return PropertyAccessResult::Ignored;
        }
        self.0 = values.collect();
        PropertyAccessResult::Set
    }
}

fn unsupported_corners<T>(_: &mut Corners, name: &str, _: T) -> PropertyAccessResult {
    if CORNER_LISTS.contains(&name) {
        PropertyAccessResult::UnsupportedType
    } else {
        PropertyAccessResult::Ignored
    }
}

impl PropertyAccess for Corners {
    fn new() -> Self {
        Self(Vec::new())
    }

    fn begin_list_int(&mut self, name: &str, _: usize) -> BeginList<'_, i32> {
        if CORNER_LISTS.contains(&name) {
            BeginList::Fill(&mut self.0)
        } else {
            BeginList::UseSetter
        }
    }

    setters! { |c: &mut Self, name, list: Vec<_>| c.set(name, list.into_iter().map(i32::from));
        set_list_char: Vec<i8>, set_list_uchar: Vec<u8>, set_list_short: Vec<i16>,
        set_list_ushort: Vec<u16>
    }

    // Unsigned numbers past i32 become negative and are refused as such, unless they separate strips.
    setters! { |c: &mut Self, name, list: Vec<u32>| c.set(name, list.into_iter().map(|v| v as i32));
        set_list_uint: Vec<u32>
    }

    setters! { unsupported_corners;
        set_char: i8, set_uchar: u8, set_short: i16, set_ushort: u16, set_int: i32, set_uint: u32,
        set_float: f32, set_double: f64, set_list_float: Vec<f32>, set_list_double: Vec<f64>
    }
}

pub(super) fn write(
    out: &mut dyn Write,
    mesh: &PolygonMesh,
    error: Option<&[f64]>,
) -> io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment vorofit")?;
    writeln!(out, "element vertex {}", mesh.positions.len())?;
    for name in ["x", "y", "z"].into_iter().chain(error.map(|_| "error")) {
        writeln!(out, "property double {name}")?;
    }
    writeln!(out, "element face {}", mesh.face_count())?;
    // Most software reads no other type of count than uchar; it is left where a face is larger.
    let small = mesh.faces().all(|f| f.len() <= usize::from(u8::MAX));
    let count_type = if small { "uchar" } else { "uint" };
    writeln!(
        out,
        "property list {count_type} uint vertex_indices\nend_header"
    )?;
    for (v, p) in mesh.positions.iter().enumerate() {
        for x in p.to_array().into_iter().chain(error.map(|e| e[v])) {
            out.write_all(&x.to_le_bytes())?;
        }
    }
    for face in mesh.faces() {
        let count = (face.len() as u32).to_le_bytes();
        out.write_all(if small { &count[..1] } else { &count })?;
        for v in face {
            out.write_all(&v.to_le_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: [[f32; 3]; 4] = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.5],
        [0.0, 1.0, 0.0],
    ];

    fn vertices() -> &'static str {
        "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    }

    fn binary(big: bool, lists: &str, list_bytes: &[u8]) -> Vec<u8> {
        let endian = if big { "big" } else { "little" };
        let header = format!(
            "ply\nformat binary_{endian}_endian 1.0\n{}{lists}\nend_header\n",
            vertices()
        );
        let numbers = POINTS.as_flattened().iter();
        let mut bytes = header.into_bytes();
        bytes.extend(numbers.flat_map(|x| {
            if big {
                x.to_be_bytes()
            } else {
                x.to_le_bytes()
            }
        }));
        bytes.extend(list_bytes);
        bytes
    }

    fn text(lists: &str, body: &str) -> Vec<u8> {
        let points = POINTS.map(|[x, y, z]| format!("{x} {y} {z}\n")).concat();
        format!(
            "ply\nformat ascii 1.0\ncomment c\n{}{lists}\nend_header\n{points}{body}",
            vertices()
        )
        .into_bytes()
    }

    fn faces(bytes: &[u8]) -> Vec<Vec<u32>> {
        let draft = read(bytes).unwrap();
        assert_eq!(
            draft.mesh.positions,
            POINTS.map(|p| DVec3::from(p.map(f64::from)))
        );
        draft.mesh.faces().map(<[u32]>::to_vec).collect()
    }

    #[test]
    fn every_encoding_and_type_of_list_is_read() {
        let quad = [[0, 1, 2, 3]];
        let face = "element face 1\nproperty list";
        assert_eq!(
            faces(&text(
                &format!("{face} uchar int vertex_indices"),
                "4 0 1 2 3\n"
            )),
            quad
        );
        assert_eq!(
            faces(&text(
                &format!("{face} uint8 uint32 vertex_index"),
                "4 0 1 2 3"
            )),
            quad
        );
        let crlf = text(&format!("{face} uchar short vertex_index"), "4 0 1 2 3\n");
        let crlf = String::from_utf8(crlf).unwrap().replace('\n', "\r\n");
        assert_eq!(faces(crlf.as_bytes()), quad);
        assert_eq!(
            faces(&binary(
                false,
                &format!("{face} uchar uchar vertex_index"),
                &[4, 0, 1, 2, 3]
            )),
            quad
        );
        let big: Vec<u8> = [4u32, 0, 1, 2, 3]
            .iter()
            .flat_map(|v| v.to_be_bytes())
            .collect();
        assert_eq!(
            faces(&binary(
                true,
                &format!("{face} int uint vertex_indices"),
                &big
            )),
            quad
        );
        assert_eq!(
            faces(&binary(
                true,
                &format!("{face} int int vertex_indices"),
                &big
            )),
            quad
        );
    }

    #[test]
    fn elements_and_properties_of_others_are_passed_over() {
        let lists = "element camera 1\nproperty float f\nproperty list uchar float g\nelement face 2\n\
                     property uchar red\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord";
        let body = "0.5 2 0.1 0.2\n255 3 0 1 2 2 0.5 0.5\n255 2 0 1 0\n";
        assert_eq!(faces(&text(lists, body)), [[0, 1, 2]]);
    }

    #[test]
    fn strips_turn_every_other_triangle_and_restart() {
        let strips = "element tristrips 1\nproperty list int int vertex_indices";
        assert_eq!(
            faces(&text(strips, "12 0 1 3 2 -1 2 3 1 0 -1 0 1")),
            [[0, 1, 3], [3, 1, 2], [2, 3, 1], [1, 3, 0]]
        );
        // A repeated corner steers the strip and makes no triangle.
        assert_eq!(faces(&text(strips, "5 0 1 1 3 2")), [[1, 3, 2]]);
    }

    #[test]
    fn claims_that_the_file_does_not_keep_are_refused_at_once() {
        let face = "element face 1\nproperty list uchar int vertex_indices";
        let cases = [
            ("ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n".into(), "header"),
            (b"ply\nformat binary_little_endian 1.0\nelement nothing 18446744073709551615\nend_header\n".to_vec(), "header"),
            (binary(false, "element face 4000000000\nproperty list uchar int vertex_indices", &[]), "header"),
            (binary(false, "element face 1\nproperty list uint int vertex_indices", &[255; 8]), "element face"),
            (binary(false, face, &[3, 0, 0, 0, 0]), "element face"),
            (binary(false, face, &[3, 0, 0, 0, 0, 1, 0, 0, 0, 4, 0, 0, 0]), "face 0 (counted from 0)"),
            (binary(false, face, &[3, 0, 0, 0, 0, 1, 0, 0, 0, 255, 255, 255, 255]), "face 0 (counted from 0)"),
            (text(face, "3 0 1\n"), "line 15"),
            (text(face, "99999999999 0 1\n"), "line 15"),
            (text(face, ""), "header"),
            (text("element face 1\nproperty int vertex_indices", "3\n"), "line 15"),
            (text("element face 1\nproperty list uchar float vertex_indices", "3 0 1 2\n"), "line 15"),
            (text("element face 1\nproperty int a", "3\n"), "header"),
            ("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n".into(), "header"),
            ("ply\nformat ascii 1.0\nelement vertex -1\nend_header\n".into(), "line 3"),
            ("ply\nformat ascii 1.0\n".into(), "line 3"),
            ("ply\n".into(), "line 2"),
        ];
        for (bytes, place) in cases {
            let defect = read(&bytes).err().unwrap();
            let start = String::from_utf8_lossy(&bytes).into_owned();
            assert_eq!(defect.place, place, "{start}: {defect:?}");
            assert!(!defect.problem.contains('\n') && !defect.problem.is_empty());
        }
    }
}
