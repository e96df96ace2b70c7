//! Legacy VTK: unstructured grids, text and binary, up to version 4 with counted cells, from version 5 with offsets.

use super::draft::Draft;
use super::scan::{DAMAGED, Number, Scanner, points};
use super::vtk;
use crate::error::Defect;
use crate::files::quoted;

pub(super) const MAGIC: &[u8] = b"# vtk DataFile Version";

/// Where the nodes of each cell end, and the nodes of all cells.
type Cells = (Vec<usize>, Vec<i64>);

pub(super) fn read(bytes: &[u8]) -> Result<Draft, Defect> {
    let mut scan = Scanner::new(bytes);
    let version = read_header(&mut scan)?;
    let old = version < (5, 1);
    let mut draft = Draft::new(if old {
        vtk::old_numbering
    } else {
        vtk::numbering
    });
    let mut cells = Cells::default();
    let mut types = Vec::new();
    while let Some(section) = scan.next()? {
        match section {
            "POINTS" => {
                let count = multiple(&scan.clone(), scan.number("the number of points")?, 3)?;
                let stored = number_type(&mut scan)?;
                scan.begin_array();
                draft.positions = points(&scan.reals(count, stored)?);
            }
            "CELLS" if version.0 < 5 => cells = read_counted_cells(&mut scan)?,
            "CELLS" => cells = read_offset_cells(&mut scan)?,
            "CELL_TYPES" => {
                let count = scan.number("the number of cells")?;
                scan.begin_array();
                types = scan.integers(count, Number::I32)?;
            }
            "FIELD" => skip_field(&mut scan)?,
            "METADATA" => {
                scan.rest_of_line();
                while !scan.rest_of_line().is_empty() {}
            }
            // What follows belongs to points or cells, which are complete.
            "POINT_DATA" | "CELL_DATA" => break,
            other => return Err(scan.defect(format!("{} is no section known here", quoted(other)))),
        }
    }
    let (ends, nodes) = cells;
    if types.len() != ends.len() {
        let problem = format!(
            "there are {} cells, but {} types of cells",
            ends.len(),
            types.len()
        );
        return Err(Defect::new("CELL_TYPES", problem, DAMAGED));
    }
    vtk::push_cells(&mut draft, &types, &ends, &nodes)?;
    Ok(draft)
}

/// Reads as far as the kind of data set, and gives the version.
fn read_header(scan: &mut Scanner<'_>) -> Result<(u32, u32), Defect> {
    let first = String::from_utf8_lossy(scan.rest_of_line());
    let version = first.rsplit(' ').next().and_then(|v| v.split_once('.'));
    let version =
        version.and_then(|(major, minor)| Some((major.parse().ok()?, minor.parse().ok()?)));
    let version =
        version.ok_or_else(|| scan.defect(format!("{} has no version", quoted(&first))))?;
    // The title.
    scan.rest_of_line();
    match scan.word("ASCII or BINARY")? {
        "ASCII" => {}
        "BINARY" => (scan.binary, scan.big_endian) = (true, true),
        other => return Err(scan.defect(format!("{} is neither ASCII nor BINARY", quoted(other)))),
    }
    scan.keyword("DATASET")?;
    let kind = scan.word("UNSTRUCTURED_GRID")?;
    if kind == "UNSTRUCTURED_GRID" {
        return Ok(version);
    }
    let problem = format!("the data set is {}, not UNSTRUCTURED_GRID", quoted(kind));
    Err(Defect::new(
        scan.place(),
        problem,
        "write the volume mesh as an unstructured grid",
    ))
}

fn number_type(scan: &mut Scanner<'_>) -> Result<Number, Defect> {
    Ok(
        match scan
            .word("the type of numbers")?
            .to_ascii_lowercase()
            .as_str()
        {
            "char" | "signed_char" => Number::I8,
            "unsigned_char" => Number::U8,
            "short" => Number::I16,
            "unsigned_short" => Number::U16,
            "int" => Number::I32,
            "unsigned_int" => Number::U32,
            "long" | "vtktypeint64" => Number::I64,
            "unsigned_long" | "vtktypeuint64" => Number::U64,
            // The text of version 4 says vtkIdType and holds int.
            "vtkidtype" => Number::I32,
            "float" => Number::F32,
            "double" => Number::F64,
            other => return Err(scan.defect(format!("{} is no type of numbers", quoted(other)))),
        },
    )
}

fn multiple(scan: &Scanner<'_>, count: usize, factor: usize) -> Result<usize, Defect> {
    count
        .checked_mul(factor)
        .ok_or_else(|| scan.defect(format!("{count} is no count")))
}

/// `CELLS n size`, then for each cell the number of its nodes and the nodes.
fn read_counted_cells(scan: &mut Scanner<'_>) -> Result<Cells, Defect> {
    let count: usize = scan.number("the number of cells")?;
    let size: usize = scan.number("the size of the list")?;
    let start = scan.clone();
    scan.begin_array();
    let list = scan.integers(size, Number::I32)?;
    let (mut ends, mut nodes) = Cells::default();
    let mut rest = list.as_slice();
    while let Some((&wanted, others)) = rest.split_first() {
        let cell = usize::try_from(wanted)
            .ok()
            .and_then(|wanted| others.split_at_checked(wanted));
        let Some((cell, others)) = cell else {
            let problem = format!(
                "cell {} (counted from 0) should have {wanted} nodes, but {} follow",
                ends.len(),
                others.len()
            );
            return Err(start.defect(problem));
        };
        nodes.extend_from_slice(cell);
        ends.push(nodes.len());
        rest = others;
    }
    if ends.len() != count {
        return Err(start.defect(format!(
            "{count} cells are announced and {} listed",
            ends.len()
        )));
    }
    Ok((ends, nodes))
}

/// `CELLS n + 1 size`, then `OFFSETS type` and `CONNECTIVITY type`.
fn read_offset_cells(scan: &mut Scanner<'_>) -> Result<Cells, Defect> {
    let count: usize = scan.number("the number of offsets")?;
    let size: usize = scan.number("the size of the list")?;
    let mut array = |name, count| {
        scan.keyword(name)?;
        let stored = number_type(scan)?;
        scan.begin_array();
        scan.integers(count, stored)
    };
    let offsets = array("OFFSETS", count)?;
    let nodes = array("CONNECTIVITY", size)?;
    // Offsets that are none are past the end of any list.
    let ends = offsets
        .iter()
        .skip(1)
        .map(|&end| usize::try_from(end).unwrap_or(usize::MAX));
    Ok((ends.collect(), nodes))
}

/// `FIELD name n`, then n times `name components tuples type` and the numbers.
fn skip_field(scan: &mut Scanner<'_>) -> Result<(), Defect> {
    scan.word("the name of the field")?;
    let arrays: usize = scan.number("the number of arrays")?;
    for _ in 0..arrays {
        scan.word("the name of an array")?;
        let components: usize = scan.number("the number of components")?;
        let tuples = scan.number("the number of tuples")?;
        let stored = number_type(scan)?;
        let count = multiple(scan, tuples, components)?;
        scan.begin_array();
        scan.reals(count, stored)?;
    }
    Ok(())
}
