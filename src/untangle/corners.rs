//! The corners of cells: what a map does to a cell is measured by the edges that meet there.

use crate::mesh::{CellShape, VolumeMesh};
use glam::{DMat3, DVec3};

/// The edges from the first of four points to the others.
pub(super) fn edges([p, a, b, c]: [DVec3; 4]) -> DMat3 {
    DMat3::from_cols(a - p, b - p, c - p)
}

/// For each cell whether it is inverted or degenerate at a corner. Between its corners a cell may be so all the same:
/// [`crate::measure::validity`] is certain.
pub fn inverted(mesh: &VolumeMesh) -> Vec<bool> {
    let is_inverted = |(shape, cell): (CellShape, &[u32])| {
        let at = |k: usize| mesh.positions[cell[k] as usize];
        let determinant = |spokes: &[usize; 4]| edges(spokes.map(at)).determinant();
        // Not a number is no valid cell either.
        !shape
            .spokes()
            .iter()
            .all(|spokes| determinant(spokes) > 0.0)
    };
    mesh.cells().map(is_inverted).collect()
}
