//! Gmsh's format MSH, version 4.1, text and binary; written binary.
//!
//! Gmsh has bases for tetrahedra of orders 1 to 10, hexahedra of 1 to 9 and prisms of 1 and 2 (4.15: its types for prisms of higher orders
//! cannot be evaluated).

use super::VolumeToWrite;
use super::draft::{Draft, Kind, PYRAMIDS};
use super::numbering::{Inside, Numbering};
use super::scan::{Number, Scanner, points};
use crate::error::Defect;
use crate::files::quoted;
use crate::mesh::{CellShape, NodalVolume};
use std::collections::HashMap;
use std::io::{self, Write};

pub(super) const MAGIC: &[u8] = b"$MeshFormat";

const NUMBERINGS: [Numbering; 3] = [
    Numbering {
        edges: &[[0, 1], [1, 2], [2, 0], [3, 0], [3, 2], [3, 1]],
        faces: &[&[0, 2, 1], &[0, 1, 3], &[0, 3, 2], &[3, 1, 2]],
        triangles: Inside::Nested,
        quads: Inside::Nested,
        cell: Inside::Nested,
    },
    Numbering {
        edges: &[
            [0, 1],
            [0, 2],
            [0, 3],
            [1, 2],
            [1, 4],
            [2, 5],
            [3, 4],
            [3, 5],
            [4, 5],
        ],
        faces: &[
            &[0, 2, 1],
            &[3, 4, 5],
            &[0, 1, 4, 3],
            &[0, 3, 5, 2],
            &[1, 2, 5, 4],
        ],
        triangles: Inside::Nested,
        quads: Inside::Nested,
        cell: Inside::Rows,
    },
    Numbering {
        edges: &[
            [0, 1],
            [0, 3],
            [0, 4],
            [1, 2],
            [1, 5],
            [2, 3],
            [2, 6],
            [3, 7],
            [4, 5],
            [4, 7],
            [5, 6],
            [6, 7],
        ],
        faces: &[
            &[0, 3, 2, 1],
            &[0, 1, 5, 4],
            &[0, 4, 7, 3],
            &[1, 2, 6, 5],
            &[2, 3, 7, 6],
            &[4, 5, 6, 7],
        ],
        triangles: Inside::Nested,
        quads: Inside::Nested,
        cell: Inside::Nested,
    },
];

fn numbering(shape: CellShape, order: usize) -> Vec<usize> {
    NUMBERINGS[shape as usize].places(shape, order)
}

/// The types of cells by order from 1, as far as they are written.
const TYPES: [&[i64]; 3] = [
    &[4, 11, 29, 30, 31, 71, 72, 73, 74, 75],
    &[6, 13],
    &[5, 12, 92, 93, 94, 95, 96, 97, 98],
];

const LINEAR_PYRAMID: i64 = 7;

/// Types of lower dimension and their numbers of nodes.
const FLAT: [(i64, usize); 51] = [
    (1, 2),
    (2, 3),
    (3, 4),
    (8, 3),
    (9, 6),
    (10, 9),
    (15, 1),
    (16, 8),
    (20, 9),
    (21, 10),
    (22, 12),
    (23, 15),
    (24, 15),
    (25, 21),
    (26, 4),
    (27, 5),
    (28, 6),
    (36, 16),
    (37, 25),
    (38, 36),
    (39, 12),
    (40, 16),
    (41, 20),
    (42, 28),
    (43, 36),
    (44, 45),
    (45, 55),
    (46, 66),
    (47, 49),
    (48, 64),
    (49, 81),
    (50, 100),
    (51, 121),
    (52, 18),
    (53, 21),
    (54, 24),
    (55, 27),
    (56, 30),
    (57, 24),
    (58, 28),
    (59, 32),
    (60, 36),
    (61, 40),
    (62, 7),
    (63, 8),
    (64, 9),
    (65, 10),
    (66, 11),
    (84, 1),
    (85, 1),
    (86, 1),
];

pub(super) fn read(bytes: &[u8]) -> Result<Draft, Defect> {
    let mut scan = Scanner::new(bytes);
    read_format(&mut scan)?;
    let mut draft = Draft::new(numbering);
    let mut numbers = HashMap::new();
    while let Some(section) = scan.next()? {
        match section {
            "$Nodes" => read_nodes(&mut scan, &mut draft, &mut numbers)?,
            "$Elements" => read_elements(&mut scan, &mut draft, &numbers)?,
            _ => {
                let name = section.strip_prefix('$');
                let name = name.ok_or_else(|| {
                    scan.defect(format!(
                        "{} stands where a section should begin",
                        quoted(section)
                    ))
                })?;
                scan.skip_past(&format!("$End{name}"))?;
            }
        }
    }
    Ok(draft)
}

fn read_format(scan: &mut Scanner<'_>) -> Result<(), Defect> {
    scan.keyword("$MeshFormat")?;
    let version = scan.word("the version")?;
    if version != "4.1" {
        return Err(Defect::new(
            scan.place(),
            format!("the version is {}, not 4.1", quoted(version)),
            "convert it: gmsh FILE -save -format msh41 -o OUT.msh",
        ));
    }
    let binary = scan.number::<i64>("the kind, 0 or 1")? == 1;
    if scan.number::<i64>("the size of numbers")? != 8 {
        return Err(scan.defect("indices do not have eight bytes"));
    }
    if binary {
        scan.binary = true;
        scan.begin_array();
        let one = scan.raw(1, 4)?;
        scan.big_endian = one == [0, 0, 0, 1];
        if !scan.big_endian && one != [1, 0, 0, 0] {
            return Err(scan.defect("the number that tells the endianness is not 1"));
        }
    }
    scan.keyword("$EndMeshFormat")
}

/// The head of a section of blocks: the number of blocks and of all nodes or elements, and their smallest and largest tag.
fn read_blocks(scan: &mut Scanner<'_>) -> Result<usize, Defect> {
    scan.begin_array();
    let blocks = scan.count("the number of blocks", Number::U64)?;
    scan.integers(3, Number::U64)?;
    Ok(blocks)
}

/// Nodes; `numbers` takes the place of each tag in the list of positions.
fn read_nodes(
    scan: &mut Scanner<'_>,
    draft: &mut Draft,
    numbers: &mut HashMap<i64, i64>,
) -> Result<(), Defect> {
    for _ in 0..read_blocks(scan)? {
        let [dimension, _, parametric] = three(scan)?;
        let count = scan.count("the number of nodes", Number::U64)?;
        for tag in scan.integers(count, Number::U64)? {
            if numbers.insert(tag, numbers.len() as i64).is_some() {
                return Err(scan.defect(format!("there are two nodes {tag}")));
            }
        }
        let parameters = if parametric == 0 {
            0
        } else {
            dimension.clamp(0, 3) as usize
        };
        for _ in 0..count {
            let row = scan.reals(3 + parameters, Number::F64)?;
            draft.positions.extend(points(&row[..3]));
        }
    }
    scan.keyword("$EndNodes")
}

fn three(scan: &mut Scanner<'_>) -> Result<[i64; 3], Defect> {
    let numbers = scan.integers(3, Number::I32)?;
    Ok([numbers[0], numbers[1], numbers[2]])
}

fn read_elements(
    scan: &mut Scanner<'_>,
    draft: &mut Draft,
    numbers: &HashMap<i64, i64>,
) -> Result<(), Defect> {
    for _ in 0..read_blocks(scan)? {
        let [_, _, element_type] = three(scan)?;
        let count = scan.count("the number of elements", Number::U64)?;
        let (kind, nodes) = kind(element_type).map_err(|name| {
            Defect::new(
                scan.place(),
                format!("here are {count} {name}, which are not supported"),
                "mesh again with complete tetrahedra, prisms and hexahedra only",
            )
        })?;
        for _ in 0..count {
            let mut row = scan.integers(1 + nodes, Number::U64)?;
            let tag = row[0];
            if let Kind::Cell(..) = kind {
                for node in &mut row[1..] {
                    *node = *numbers.get(node).ok_or_else(|| {
                        scan.defect(format!(
                            "element {tag} names node {node}, which does not exist"
                        ))
                    })?;
                }
            }
            draft.push(kind, &row[1..], || format!("element {tag}"))?;
        }
    }
    scan.keyword("$EndElements")
}

/// What a type of element is here, and its number of nodes.
fn kind(element_type: i64) -> Result<(Kind, usize), &'static str> {
    if element_type == LINEAR_PYRAMID {
        return Ok((Kind::Unsupported(PYRAMIDS), 5));
    }
    if let Some(&(_, nodes)) = FLAT.iter().find(|&&(flat, _)| flat == element_type) {
        return Ok((Kind::Flat, nodes));
    }
    for (shape, types) in CellShape::ALL.into_iter().zip(TYPES) {
        if let Some(at) = types.iter().position(|&t| t == element_type) {
            let order = at + 1;
            return Ok((
                Kind::Cell(shape, order),
                NodalVolume::node_count(shape, order),
            ));
        }
    }
    Err(match element_type {
        14 | 19 | 118..=131 => "curved pyramids",
        90 | 91 | 106..=110 => "prisms of order 3 and more, for which Gmsh has no basis",
        17 | 18 | 32 | 33 | 79..=83 | 99..=105 | 111..=117 | 137 => {
            "cells without inner nodes (serendipity)"
        }
        35 => "polyhedra",
        _ => "elements of an unknown type",
    })
}

/// Whether Gmsh has elements of these shapes and this order.
pub(super) fn check_holds(nodes: &NodalVolume) -> Result<(), Defect> {
    let order = nodes.order();
    let missing = nodes
        .cells()
        .find(|&(shape, _)| order > TYPES[shape as usize].len());
    let Some((shape, _)) = missing else {
        return Ok(());
    };
    let highest = TYPES[shape as usize].len();
    Err(Defect::new(
        "extension",
        format!(
            "Gmsh has a {} of order {highest} at most, not {order}",
            shape.name()
        ),
        "write a .vtu or .mesh (MFEM) file, or use a lower order",
    ))
}

pub(super) fn write(out: &mut dyn Write, volume: &VolumeToWrite<'_>) -> io::Result<()> {
    let nodes = volume.nodes;
    out.write_all(b"$MeshFormat\n4.1 1 8\n")?;
    out.write_all(&1i32.to_le_bytes())?;
    out.write_all(b"\n$EndMeshFormat\n$Nodes\n")?;
    let count = nodes.positions.len() as u64;
    write_sizes(out, [1, count, 1, count])?;
    write_integers(out, [3, 1, 0])?;
    write_sizes(out, [count])?;
    write_sizes(out, 1..=count)?;
    for x in nodes.positions.iter().flat_map(|p| p.to_array()) {
        out.write_all(&x.to_le_bytes())?;
    }
    out.write_all(b"\n$EndNodes\n$Elements\n")?;
    write_elements(out, nodes)?;
    out.write_all(b"\n$EndElements\n")?;
    for (section, data) in [
        ("NodeData", volume.node_data),
        ("ElementData", volume.cell_data),
    ] {
        for (name, values) in data {
            write_data(out, section, name, values)?;
        }
    }
    Ok(())
}

/// Elements of one shape after the other, each with the number that it has in the volume, from 1.
fn write_elements(out: &mut dyn Write, nodes: &NodalVolume) -> io::Result<()> {
    let counts =
        CellShape::ALL.map(|shape| nodes.cells().filter(|&(s, _)| s == shape).count() as u64);
    let cells = nodes.cell_count() as u64;
    write_sizes(
        out,
        [
            counts.iter().filter(|&&n| n > 0).count() as u64,
            cells,
            1,
            cells,
        ],
    )?;
    for (shape, count) in CellShape::ALL
        .into_iter()
        .zip(counts)
        .filter(|&(_, n)| n > 0)
    {
        let element_type = TYPES[shape as usize][nodes.order() - 1];
        write_integers(out, [3, 1, element_type as i32])?;
        write_sizes(out, [count])?;
        let places = numbering(shape, nodes.order());
        for (number, (_, cell)) in (1..).zip(nodes.cells()).filter(|(_, (s, _))| *s == shape) {
            write_sizes(out, [number])?;
            write_sizes(out, places.iter().map(|&at| u64::from(cell[at]) + 1))?;
        }
    }
    Ok(())
}

/// A number for each node or element.
fn write_data(out: &mut dyn Write, section: &str, name: &str, values: &[f64]) -> io::Result<()> {
    let count = values.len();
    write!(out, "${section}\n1\n\"{name}\"\n1\n0\n3\n0\n1\n{count}\n")?;
    for (number, value) in (1i32..).zip(values) {
        write_integers(out, [number])?;
        out.write_all(&value.to_le_bytes())?;
    }
    write!(out, "\n$End{section}\n")
}

fn write_sizes(out: &mut dyn Write, numbers: impl IntoIterator<Item = u64>) -> io::Result<()> {
    numbers
        .into_iter()
        .try_for_each(|n| out.write_all(&n.to_le_bytes()))
}

fn write_integers(out: &mut dyn Write, numbers: impl IntoIterator<Item = i32>) -> io::Result<()> {
    numbers
        .into_iter()
        .try_for_each(|n| out.write_all(&n.to_le_bytes()))
}
