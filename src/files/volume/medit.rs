//! Medit's meshes: text (`.mesh`) and binary (`.meshb`, versions 1 to 4 of the library libMeshb).

use super::draft::{Draft, Kind, PYRAMIDS};
use super::scan::{Number, Scanner, points};
use super::vtk;
use crate::error::Defect;
use crate::mesh::CellShape;

/// Keyword, its code in binary files, the number of vertices, and what the element is here.
const ELEMENTS: [(&str, i64, usize, Kind); 8] = [
    ("Edges", 5, 2, Kind::Flat),
    ("Triangles", 6, 3, Kind::Flat),
    ("Quadrilaterals", 7, 4, Kind::Flat),
    ("Tetrahedra", 8, 4, Kind::Cell(CellShape::Tetrahedron, 1)),
    ("Prisms", 9, 6, Kind::Cell(CellShape::Prism, 1)),
    ("Pentahedra", 9, 6, Kind::Cell(CellShape::Prism, 1)),
    ("Hexahedra", 10, 8, Kind::Cell(CellShape::Hexahedron, 1)),
    ("Pyramids", 49, 5, Kind::Unsupported(PYRAMIDS)),
];

const DIMENSION: i64 = 3;
const VERTICES: i64 = 4;
const END: i64 = 54;

/// Whether the content is a Medit file in text.
pub(super) fn recognize(bytes: &[u8]) -> bool {
    Scanner::with_comments(bytes).peek() == Some("MeshVersionFormatted")
}

pub(super) fn read(bytes: &[u8]) -> Result<Draft, Defect> {
    let mut scan = Scanner::with_comments(bytes);
    scan.keyword("MeshVersionFormatted")?;
    scan.number::<i64>("the version")?;
    let mut draft = Draft::new(vtk::numbering);
    while let Some(keyword) = scan.next()? {
        let element = ELEMENTS.iter().find(|element| element.0 == keyword);
        match (keyword, element) {
            ("End", _) => return Ok(draft),
            ("Dimension", _) => check_dimension(&mut scan, Number::I32)?,
            ("Vertices", _) => {
                let count = scan.count("the number of vertices", Number::I32)?;
                read_vertices(&mut scan, count, Number::F64, Number::I32, &mut draft)?;
            }
            (_, Some(&(_, _, vertices, kind))) => {
                let count = scan.count("the number of elements", Number::I32)?;
                read_elements(&mut scan, count, vertices, kind, Number::I32, &mut draft)?;
            }
            // A section that says nothing about cells: numbers up to the next keyword.
            _ => {
                while scan
                    .peek()
                    .is_some_and(|w| !w.starts_with(char::is_alphabetic))
                {
                    scan.next()?;
                }
            }
        }
    }
    // Some programs leave out the word End.
    Ok(draft)
}

pub(super) fn read_binary(bytes: &[u8]) -> Result<Draft, Defect> {
    let mut scan = Scanner::new(bytes);
    scan.binary = true;
    // The first number is 1, from which the endianness is told.
    scan.big_endian = bytes.starts_with(&[0, 0, 0, 1]);
    if scan.integers(1, Number::I32)? != [1] {
        return Err(Defect::new(
            "start",
            "it is no binary Medit file",
            "give the file the extension of its content",
        ));
    }
    let version = scan.integers(1, Number::I32)?[0];
    if !(1..=4).contains(&version) {
        return Err(scan.defect(format!("version {version} is not known here")));
    }
    let real = if version == 1 {
        Number::F32
    } else {
        Number::F64
    };
    let integer = if version == 4 {
        Number::I64
    } else {
        Number::I32
    };
    let position = if version >= 3 {
        Number::I64
    } else {
        Number::I32
    };
    let mut draft = Draft::new(vtk::numbering);
    loop {
        let keyword = scan.integers(1, Number::I32)?[0];
        if keyword == END {
            return Ok(draft);
        }
        // Where the next keyword stands.
        let next = scan.count("a position", position)?;
        let element = ELEMENTS.iter().find(|element| element.1 == keyword);
        match (keyword, element) {
            (DIMENSION, _) => check_dimension(&mut scan, Number::I32)?,
            (VERTICES, _) => {
                let count = scan.count("the number of vertices", integer)?;
                read_vertices(&mut scan, count, real, integer, &mut draft)?;
            }
            (_, Some(&(_, _, vertices, kind))) => {
                let count = scan.count("the number of elements", integer)?;
                read_elements(&mut scan, count, vertices, kind, integer, &mut draft)?;
            }
            _ => {
                let rest = next.checked_sub(bytes.len() - scan.remaining());
                let rest = rest.ok_or_else(|| {
                    scan.defect(format!("a section ends at byte {next}, before it starts"))
                })?;
                scan.raw(rest, 1)?;
            }
        }
    }
}

fn check_dimension(scan: &mut Scanner<'_>, stored: Number) -> Result<(), Defect> {
    match scan.count("the dimension", stored)? {
        3 => Ok(()),
        other => Err(Defect::new(
            scan.place(),
            format!("the mesh has {other} dimensions"),
            "give a mesh in three dimensions",
        )),
    }
}

/// Vertices: three coordinates and a reference.
fn read_vertices(
    scan: &mut Scanner<'_>,
    count: usize,
    real: Number,
    integer: Number,
    draft: &mut Draft,
) -> Result<(), Defect> {
    for _ in 0..count {
        draft.positions.extend(points(&scan.reals(3, real)?));
        // References are whole numbers, but not to all programs.
        if scan.binary {
            scan.raw(1, integer.size())?;
        } else {
            scan.number::<f64>("a reference")?;
        }
    }
    Ok(())
}

/// Elements: vertices counted from 1 and a reference.
fn read_elements(
    scan: &mut Scanner<'_>,
    count: usize,
    vertices: usize,
    kind: Kind,
    integer: Number,
    draft: &mut Draft,
) -> Result<(), Defect> {
    for _ in 0..count {
        let mut row = scan.integers(vertices + 1, integer)?;
        row.truncate(vertices);
        row.iter_mut().for_each(|v| *v = v.saturating_sub(1));
        draft.push(kind, &row, || scan.place())?;
    }
    Ok(())
}
