//! The scaled Jacobian of curved elements, sampled: det J / (|c₁| |c₂| |c₃|) over the columns of J = ∇h A⁻¹.
//!
//! It is 1 where the map is conformal and at most 1 everywhere; 0 or less where the element is degenerate or inverted. Samples see what is at
//! the samples: whether an element is valid in between is for [`validity`](super::validity).

use crate::model::element::{Grid, Tables};
use crate::model::volume::CurvedVolume;
use glam::DMat3;
use rayon::prelude::*;

/// Scaled Jacobian of one element.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    /// The mean over the samples.
    pub mean: f64,
    /// The least of the samples.
    pub min: f64,
}

/// The quality of every cell, from 2p + 3 equally spaced samples an axis, p its kernel order, those on the boundary included.
pub fn qualities(volume: &CurvedVolume) -> Vec<Quality> {
    let mut qualities = vec![
        Quality {
            mean: 0.0,
            min: 0.0
        };
        volume.cell_count()
    ];
    for group in volume.groups() {
        let grid = Grid::lattice(group.shape, 2 * group.order + 2);
        let tables = Tables::new(volume.basis(), group.order, &grid);
        let of_cell = |c: usize, local: &[_]| {
            let inverse = volume.reference_inverse(c);
            let mut quality = Quality {
                mean: 0.0,
                min: f64::INFINITY,
            };
            for gradient in tables.gradients(local) {
                let value = scaled_jacobian(gradient * inverse);
                quality.mean += value / grid.len() as f64;
                quality.min = quality.min.min(value);
            }
            quality
        };
        for (c, quality) in map_cells(volume, &group.cells, of_cell) {
            qualities[c] = quality;
        }
    }
    qualities
}

/// det J over the lengths of its columns; 0 where a column vanishes.
pub fn scaled_jacobian(j: DMat3) -> f64 {
    let lengths = j.x_axis.length() * j.y_axis.length() * j.z_axis.length();
    if lengths > 0.0 {
        j.determinant() / lengths
    } else {
        0.0
    }
}

/// Cells whose local modes are held at a time.
const BATCH: usize = 1024;

/// `f(cell, its local modes)` for cells of one kernel order, in parallel.
pub(super) fn map_cells<T: Send>(
    volume: &CurvedVolume,
    cells: &[u32],
    f: impl Fn(usize, &[glam::DVec3]) -> T + Sync,
) -> Vec<(usize, T)> {
    let mut results = Vec::with_capacity(cells.len());
    for batch in cells.chunks(BATCH) {
        let local = volume.gather(batch).apply(&volume.coefficients);
        let count = local.len() / batch.len();
        let mut part: Vec<(usize, T)> = batch
            .par_iter()
            .zip(local.par_chunks(count))
            .map(|(&c, local)| (c as usize, f(c as usize, local)))
            .collect();
        results.append(&mut part);
    }
    results
}
