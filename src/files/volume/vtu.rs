//! VTK's XML format for unstructured grids, `.vtu`: read with data as text, in base64 or appended, plain or compressed by zlib; written
//! in base64 compressed by zlib, as Lagrange cells in the node order of VTK 9.1 and later (file version 2.2).

use super::VolumeToWrite;
use super::draft::Draft;
use super::scan::{DAMAGED, Number, Scanner, points};
use super::vtk;
use super::vtu_array::{self, Encoding, decode};
use crate::error::Defect;
use crate::files::quoted;
use crate::mesh::{CellShape, NodalVolume};
use roxmltree::{Document, Node};
use std::io::{self, Write};

pub(super) fn recognize(bytes: &[u8]) -> bool {
    let start = &bytes[..bytes.len().min(1000)];
    let contains = |word: &[u8]| start.windows(word.len()).any(|w| w == word);
    contains(b"<VTKFile")
}

pub(super) fn read(bytes: &[u8]) -> Result<Draft, Defect> {
    let (text, appended) = split_appended(bytes)?;
    let document = Document::parse(&text).map_err(|e| {
        let place = format!("line {}", e.pos().row);
        let message: String = e
            .to_string()
            .chars()
            .filter(|c| !c.is_control())
            .take(160)
            .collect();
        Defect::new(place, message, DAMAGED)
    })?;
    let root = document.root_element();
    let kind = root.attribute("type").unwrap_or_default();
    if kind != "UnstructuredGrid" {
        let problem = format!("it holds {}, not an UnstructuredGrid", quoted(kind));
        return Err(Defect::new(
            "VTKFile",
            problem,
            "write the volume mesh as an unstructured grid in one file",
        ));
    }
    let file = File {
        encoding: Encoding::of(&root)?,
        appended,
    };
    let version = root.attribute("version").unwrap_or_default();
    let mut draft = Draft::new(if has_old_numbering(version) {
        vtk::old_numbering
    } else {
        vtk::numbering
    });
    for piece in root.descendants().filter(|n| n.has_tag_name("Piece")) {
        file.read_piece(piece, &mut draft)?;
    }
    Ok(draft)
}

/// Version 2.1 changed the node order of hexahedra.
fn has_old_numbering(version: &str) -> bool {
    let mut parts = version.split('.').map(|part| part.parse().unwrap_or(0u32));
    (parts.next(), parts.next()) < (Some(2), Some(1))
}

/// The XML, and the appended data, which in raw encoding is none.
fn split_appended(bytes: &[u8]) -> Result<(String, &[u8]), Defect> {
    const TAG: &[u8] = b"<AppendedData";
    let not_text = |_| Defect::new("start", "it is not text", DAMAGED);
    let Some(at) = bytes.windows(TAG.len()).position(|w| w == TAG) else {
        return Ok((String::from_utf8(bytes.to_vec()).map_err(not_text)?, &[]));
    };
    let (xml, tail) = bytes.split_at(at);
    let start = tail
        .iter()
        .position(|&b| b == b'_')
        .map_or(tail.len(), |at| at + 1);
    let (tag, data) = tail.split_at(start);
    let tag = tag.split(|&b| b == b'>').next().unwrap_or_default();
    let mut text = String::from_utf8(xml.to_vec()).map_err(not_text)?;
    text += std::str::from_utf8(tag)
        .map_err(|_| Defect::new("AppendedData", "it is not text", DAMAGED))?;
    text += "/></VTKFile>";
    Ok((text, data))
}

struct File<'a> {
    encoding: Encoding,
    appended: &'a [u8],
}

impl File<'_> {
    fn read_piece(&self, piece: Node<'_, '_>, draft: &mut Draft) -> Result<(), Defect> {
        let vertices = attribute(piece, "NumberOfPoints")?;
        let cells = attribute(piece, "NumberOfCells")?;
        let base = draft.positions.len() as i64;
        let section = |name| {
            let section = piece.children().find(|n| n.has_tag_name(name));
            section.ok_or_else(|| Defect::new("Piece", format!("it has no {name}"), DAMAGED))
        };
        let coordinates = array(section("Points")?, None)?;
        let coordinates = self.reals(coordinates)?;
        expect(coordinates.len(), vertices.saturating_mul(3), "coordinates")?;
        draft.positions.extend(points(&coordinates));
        let lists = section("Cells")?;
        let mut nodes = self.integers(array(lists, Some("connectivity"))?)?;
        nodes.iter_mut().for_each(|v| *v = v.saturating_add(base));
        let ends = self.integers(array(lists, Some("offsets"))?)?;
        let types = self.integers(array(lists, Some("types"))?)?;
        expect(ends.len(), cells, "offsets of cells")?;
        expect(types.len(), cells, "types of cells")?;
        let ends: Vec<usize> = ends
            .into_iter()
            .map(|end| usize::try_from(end).unwrap_or(usize::MAX))
            .collect();
        vtk::push_cells(draft, &types, &ends, &nodes)
    }

    fn reals(&self, array: Node<'_, '_>) -> Result<Vec<f64>, Defect> {
        let stored = number_type(array)?;
        match self.bytes(array, stored)? {
            Some(bytes) => Ok(stored.reals(&bytes, self.encoding.big_endian)),
            None => words(array),
        }
    }

    fn integers(&self, array: Node<'_, '_>) -> Result<Vec<i64>, Defect> {
        let stored = number_type(array)?;
        match self.bytes(array, stored)? {
            Some(bytes) => stored.integers(&bytes, self.encoding.big_endian),
            None => words(array),
        }
    }

    /// The bytes of an array's numbers, unless it is text.
    fn bytes(&self, array: Node<'_, '_>, stored: Number) -> Result<Option<Vec<u8>>, Defect> {
        let defect = |problem: String| Defect::new(place_of(array), problem, DAMAGED);
        let decoded = match array.attribute("format").unwrap_or("ascii") {
            "ascii" => return Ok(None),
            "binary" => decode(
                array.text().unwrap_or_default().trim().as_bytes(),
                true,
                self.encoding,
            ),
            "appended" => {
                let offset = array.attribute("offset").and_then(|o| o.parse().ok());
                let data = offset.and_then(|offset: usize| self.appended.get(offset..));
                let data =
                    data.ok_or_else(|| defect("its offset is not in the appended data".into()))?;
                decode(data, self.appended_is_base64(array), self.encoding)
            }
            other => Err(format!("{} is no format of data", quoted(other))),
        };
        let bytes = decoded.map_err(defect)?;
        if bytes.len() % stored.size() != 0 {
            return Err(defect(format!(
                "{} bytes are no numbers of {} bytes",
                bytes.len(),
                stored.size()
            )));
        }
        Ok(Some(bytes))
    }

    fn appended_is_base64(&self, array: Node<'_, '_>) -> bool {
        let root = array.document().root_element();
        let appended = root.children().find(|n| n.has_tag_name("AppendedData"));
        appended.and_then(|n| n.attribute("encoding")) != Some("raw")
    }
}

fn place_of(node: Node<'_, '_>) -> String {
    let row = node.document().text_pos_at(node.range().start).row;
    format!("line {row}")
}

fn attribute(node: Node<'_, '_>, name: &str) -> Result<usize, Defect> {
    let value = node
        .attribute(name)
        .and_then(|value| value.trim().parse().ok());
    value.ok_or_else(|| {
        Defect::new(
            place_of(node),
            format!("{name} is missing or no count"),
            DAMAGED,
        )
    })
}

/// The first array of a section, or the one of a name.
fn array<'a, 'input>(
    section: Node<'a, 'input>,
    name: Option<&str>,
) -> Result<Node<'a, 'input>, Defect> {
    let mut arrays = section.children().filter(|n| n.has_tag_name("DataArray"));
    let found = arrays.find(|n| name.is_none() || n.attribute("Name") == name);
    found.ok_or_else(|| {
        let problem = format!("there is no array {}", name.unwrap_or("of coordinates"));
        Defect::new(place_of(section), problem, DAMAGED)
    })
}

fn number_type(array: Node<'_, '_>) -> Result<Number, Defect> {
    let name = array.attribute("type").unwrap_or_default();
    Ok(match name {
        "Int8" => Number::I8,
        "UInt8" => Number::U8,
        "Int16" => Number::I16,
        "UInt16" => Number::U16,
        "Int32" => Number::I32,
        "UInt32" => Number::U32,
        "Int64" => Number::I64,
        "UInt64" => Number::U64,
        "Float32" => Number::F32,
        "Float64" => Number::F64,
        _ => {
            return Err(Defect::new(
                place_of(array),
                format!("{} is no type of numbers", quoted(name)),
                DAMAGED,
            ));
        }
    })
}

/// All words of an array as numbers.
fn words<T: std::str::FromStr>(array: Node<'_, '_>) -> Result<Vec<T>, Defect> {
    let text = array.text().unwrap_or_default();
    let mut scan = Scanner::new(text.as_bytes());
    let mut numbers = Vec::new();
    while scan.peek().is_some() {
        let number = scan.number("a number");
        numbers.push(number.map_err(|defect| Defect {
            place: place_of(array),
            ..defect
        })?);
    }
    Ok(numbers)
}

fn expect(found: usize, wanted: usize, what: &str) -> Result<(), Defect> {
    if found == wanted {
        return Ok(());
    }
    Err(Defect::new(
        "Piece",
        format!("it should have {wanted} {what}, but has {found}"),
        DAMAGED,
    ))
}

pub(super) fn write(out: &mut dyn Write, volume: &VolumeToWrite<'_>) -> io::Result<()> {
    let nodes = volume.nodes;
    // Some readers know no later version than 1.0, which has all that straight cells need.
    let version = if nodes.order() == 1 { "1.0" } else { "2.2" };
    writeln!(out, r#"<?xml version="1.0"?>"#)?;
    writeln!(
        out,
        r#"<VTKFile type="UnstructuredGrid" version="{version}" byte_order="LittleEndian" header_type="UInt64" compressor="vtkZLibDataCompressor">"#
    )?;
    let (points, cells) = (nodes.positions.len(), nodes.cell_count());
    writeln!(
        out,
        r#"<UnstructuredGrid><Piece NumberOfPoints="{points}" NumberOfCells="{cells}">"#
    )?;
    for (section, data) in [
        ("PointData", volume.node_data),
        ("CellData", volume.cell_data),
    ] {
        writeln!(out, "<{section}>")?;
        for (name, values) in data {
            write_array(
                out,
                "Float64",
                name,
                1,
                values.iter().map(|x| x.to_le_bytes()),
            )?;
        }
        writeln!(out, "</{section}>")?;
    }
    writeln!(out, "<Points>")?;
    let coordinates = nodes.positions.iter().flat_map(|p| p.to_array());
    write_array(
        out,
        "Float64",
        "Points",
        3,
        coordinates.map(f64::to_le_bytes),
    )?;
    writeln!(out, "</Points>\n<Cells>")?;
    write_cells(out, nodes)?;
    writeln!(out, "</Cells>\n</Piece></UnstructuredGrid></VTKFile>")
}

fn write_cells(out: &mut dyn Write, nodes: &NodalVolume) -> io::Result<()> {
    let places = CellShape::ALL.map(|shape| vtk::numbering(shape, nodes.order()));
    let lists = nodes
        .cells()
        .flat_map(|(shape, cell)| places[shape as usize].iter().map(|&at| cell[at]));
    write_array(
        out,
        "Int64",
        "connectivity",
        1,
        lists.map(|node| i64::from(node).to_le_bytes()),
    )?;
    let ends = nodes.cells().scan(0, |end, (_, cell)| {
        *end += cell.len() as i64;
        Some(*end)
    });
    write_array(out, "Int64", "offsets", 1, ends.map(i64::to_le_bytes))?;
    let types = nodes
        .cells()
        .map(|(shape, _)| [vtk::type_of(shape, nodes.order())]);
    write_array(out, "UInt8", "types", 1, types)
}

fn write_array<const N: usize>(
    out: &mut dyn Write,
    number: &str,
    name: &str,
    components: usize,
    values: impl Iterator<Item = [u8; N]>,
) -> io::Result<()> {
    write!(
        out,
        r#"<DataArray type="{number}" Name="{name}" NumberOfComponents="{components}" format="binary">"#
    )?;
    let bytes: Vec<u8> = values.flatten().collect();
    vtu_array::write(out, &bytes)?;
    writeln!(out, "</DataArray>")
}
