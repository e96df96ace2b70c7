//! What legacy VTK files and `.vtu` have in common: types of cells and the order of their nodes.

use super::draft::{Draft, Kind, PYRAMIDS, order_of};
use super::numbering::{Inside, Numbering};
use crate::error::Defect;
use crate::mesh::CellShape;

pub(super) const TETRAHEDRON: i64 = 10;
const VOXEL: i64 = 11;
pub(super) const HEXAHEDRON: i64 = 12;
pub(super) const WEDGE: i64 = 13;
const QUADRATIC_TETRAHEDRON: i64 = 24;
pub(super) const LAGRANGE_TETRAHEDRON: i64 = 71;
pub(super) const LAGRANGE_HEXAHEDRON: i64 = 72;
pub(super) const LAGRANGE_WEDGE: i64 = 73;

const LAGRANGE: [Numbering; 3] = [
    Numbering {
        edges: &[[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]],
        faces: &[&[0, 1, 3], &[2, 3, 1], &[0, 3, 2], &[0, 2, 1]],
        triangles: Inside::Nested,
        quads: Inside::Rows,
        cell: Inside::Nested,
    },
    Numbering {
        edges: &[
            [0, 1],
            [1, 2],
            [2, 0],
            [3, 4],
            [4, 5],
            [5, 3],
            [0, 3],
            [1, 4],
            [2, 5],
        ],
        faces: &[
            &[0, 1, 2],
            &[3, 4, 5],
            &[0, 1, 4, 3],
            &[1, 2, 5, 4],
            &[2, 0, 3, 5],
        ],
        triangles: Inside::Rows,
        quads: Inside::Rows,
        cell: Inside::Rows,
    },
    Numbering {
        edges: CellShape::Hexahedron.edges(),
        faces: HEXAHEDRON_FACES,
        triangles: Inside::Rows,
        quads: Inside::Rows,
        cell: Inside::Rows,
    },
];

/// Hexahedra of order 3 and more before VTK 9.1, XML files of version 2.0 and less and legacy files of version 5.0 and less: the last two edges change places.
const OLD_HEXAHEDRON: Numbering = Numbering {
    edges: &[
        [0, 1],
        [1, 2],
        [3, 2],
        [0, 3],
        [4, 5],
        [5, 6],
        [7, 6],
        [4, 7],
        [0, 4],
        [1, 5],
        [3, 7],
        [2, 6],
    ],
    ..LAGRANGE[CellShape::Hexahedron as usize]
};

const HEXAHEDRON_FACES: &[&[usize]] = &[
    &[0, 3, 7, 4],
    &[1, 2, 6, 5],
    &[0, 1, 5, 4],
    &[3, 2, 6, 7],
    &[0, 1, 2, 3],
    &[4, 5, 6, 7],
];

/// The order of nodes in Lagrange cells since VTK 9.1 (XML files of version 2.1, legacy files of version 5.1).
pub(super) fn numbering(shape: CellShape, order: usize) -> Vec<usize> {
    LAGRANGE[shape as usize].places(shape, order)
}

/// The order of nodes in Lagrange cells of older files.
pub(super) fn old_numbering(shape: CellShape, order: usize) -> Vec<usize> {
    match shape {
        CellShape::Hexahedron => OLD_HEXAHEDRON.places(shape, order),
        _ => numbering(shape, order),
    }
}

/// The type under which a cell is written.
pub(super) fn type_of(shape: CellShape, order: usize) -> u8 {
    let (linear, curved) = match shape {
        CellShape::Tetrahedron => (TETRAHEDRON, LAGRANGE_TETRAHEDRON),
        CellShape::Prism => (WEDGE, LAGRANGE_WEDGE),
        CellShape::Hexahedron => (HEXAHEDRON, LAGRANGE_HEXAHEDRON),
    };
    if order == 1 {
        linear as u8
    } else {
        curved as u8
    }
}

/// Appends all cells of a piece: the nodes of cell `c` are `nodes[ends[c - 1]..ends[c]]`.
pub(super) fn push_cells(
    draft: &mut Draft,
    types: &[i64],
    ends: &[usize],
    nodes: &[i64],
) -> Result<(), Defect> {
    let mut start = 0;
    let mut mislabelled = 0;
    for (c, (&cell_type, &end)) in types.iter().zip(ends).enumerate() {
        let place = || format!("cell {c} (counted from 0)");
        let Some(nodes) = nodes.get(start..end) else {
            let problem = format!(
                "its nodes are said to be those from {start} to {end} of {}",
                nodes.len()
            );
            return Err(Defect::new(
                place(),
                problem,
                "the file is damaged: export it again",
            ));
        };
        start = end;
        let kind = kind(cell_type, nodes.len(), &mut mislabelled).map_err(|problem| {
            Defect::new(
                place(),
                problem,
                "export the mesh again with linear or Lagrange cells",
            )
        })?;
        if cell_type == VOXEL && nodes.len() == 8 {
            let turned = [0, 1, 3, 2, 4, 5, 7, 6].map(|k| nodes[k]);
            draft.push(kind, &turned, place)?;
        } else {
            draft.push(kind, nodes, place)?;
        }
    }
    if mislabelled > 0 {
        draft.warnings.push(format!(
            "{mislabelled} cells whose type does not fit their number of vertices, taken by the number"
        ));
    }
    Ok(())
}

/// What a type of cell is here. Linear types that contradict the number of vertices are counted and taken by the number.
fn kind(cell_type: i64, nodes: usize, mislabelled: &mut usize) -> Result<Kind, String> {
    let curved = |shape: CellShape| match order_of(shape, nodes) {
        Some(order) => Ok(Kind::Cell(shape, order)),
        None => Err(format!(
            "no {} of one order up to 16 has its {nodes} nodes",
            shape.name()
        )),
    };
    match cell_type {
        TETRAHEDRON | VOXEL | HEXAHEDRON | WEDGE => {
            let (shape, by_type) = match nodes {
                4 => (CellShape::Tetrahedron, cell_type == TETRAHEDRON),
                6 => (CellShape::Prism, cell_type == WEDGE),
                8 => (
                    CellShape::Hexahedron,
                    cell_type == HEXAHEDRON || cell_type == VOXEL,
                ),
                _ => return Err(format!("it is of type {cell_type} with {nodes} vertices")),
            };
            *mislabelled += usize::from(!by_type);
            Ok(Kind::Cell(shape, 1))
        }
        QUADRATIC_TETRAHEDRON | LAGRANGE_TETRAHEDRON => curved(CellShape::Tetrahedron),
        LAGRANGE_HEXAHEDRON => curved(CellShape::Hexahedron),
        LAGRANGE_WEDGE => curved(CellShape::Prism),
        0..=9 | 21..=23 | 28 | 30 | 34..=36 | 68..=70 | 75..=77 => Ok(Kind::Flat),
        14 | 27 | 37 | 74 => Ok(Kind::Unsupported(PYRAMIDS)),
        25 | 29 | 33 => Ok(Kind::Unsupported(
            "quadratic hexahedra of VTK's older kinds (export Lagrange cells)",
        )),
        26 | 31 | 32 => Ok(Kind::Unsupported(
            "quadratic prisms of VTK's older kinds (export Lagrange cells)",
        )),
        15 | 16 | 41 | 42 => Ok(Kind::Unsupported("polyhedra")),
        78..=82 => Ok(Kind::Unsupported("Bézier cells (export Lagrange cells)")),
        _ => Err(format!("cells of type {cell_type} are not known here")),
    }
}
