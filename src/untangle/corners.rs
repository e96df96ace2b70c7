//! The corners of cells: what a map does to a cell is measured by the edges that meet there.

use crate::mesh::{CellShape, VolumeMesh};
use glam::{DMat3, DVec3};

/// A corner of a shape and the three corners that it has edges to, right-handed. All corners of a tetrahedron see the same map, so
/// one stands for them.
pub(super) const fn spokes(shape: CellShape) -> &'static [[usize; 4]] {
    match shape {
        CellShape::Tetrahedron => &[[0, 1, 2, 3]],
        CellShape::Prism => &[
            [0, 1, 2, 3],
            [1, 2, 0, 4],
            [2, 0, 1, 5],
            [3, 5, 4, 0],
            [4, 3, 5, 1],
            [5, 4, 3, 2],
        ],
        CellShape::Hexahedron => &[
            [0, 1, 3, 4],
            [1, 2, 0, 5],
            [2, 3, 1, 6],
            [3, 0, 2, 7],
            [4, 7, 5, 0],
            [5, 4, 6, 1],
            [6, 5, 7, 2],
            [7, 6, 4, 3],
        ],
    }
}

/// The edges from the first of four points to the others.
pub(super) fn edges([p, a, b, c]: [DVec3; 4]) -> DMat3 {
    DMat3::from_cols(a - p, b - p, c - p)
}

/// For each cell whether it is inverted or degenerate at a corner. Between its corners a cell may be so all the same:
/// [`crate::measure::validity`] is certain.
pub fn inverted(mesh: &VolumeMesh) -> Vec<bool> {
    let is_inverted = |(shape, cell): (CellShape, &[u32])| {
        let at = |k: usize| mesh.positions[cell[k] as usize];
        let determinant = |corner: &[usize; 4]| edges(corner.map(at)).determinant();
        // Not a number is no valid cell either.
        !spokes(shape).iter().all(|corner| determinant(corner) > 0.0)
    };
    mesh.cells().map(is_inverted).collect()
}
