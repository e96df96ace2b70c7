//! What the cells of a mesh should look like.

use super::corners::edges;
use crate::mesh::VolumeMesh;
use crate::mesh::check_volume::boundary_faces;
use crate::model::element::{corners, reference_matrix, reference_volume};
use glam::{DMat3, DVec3};

/// Local sizes are at least this share of the mean.
const LEAST_SIZE: f64 = 1e-3;

/// The matrix A of every corner of every cell: the edges that meet there in a cell that needs no improvement \[PPL13, section 4.4\].
#[derive(Debug, Clone, PartialEq)]
pub struct Ideals {
    /// `[corners]`, cell after cell.
    pub(super) matrices: Vec<DMat3>,
}

impl Ideals {
    /// From the corners of an ideal cell for each cell, anywhere in space and in the local numbering of its shape. Those of different
    /// cells need not fit together.
    ///
    /// # Panics
    /// Where a cell gets too few corners.
    pub fn new(mesh: &VolumeMesh, mut corners_of: impl FnMut(usize) -> Vec<DVec3>) -> Self {
        let mut matrices = Vec::new();
        for (c, (shape, _)) in mesh.cells().enumerate() {
            let points = corners_of(c);
            let at = |corner: &[usize; 4]| edges(corner.map(|k| points[k]));
            matrices.extend(shape.spokes().iter().map(at));
        }
        Self { matrices }
    }

    /// Cubes, prisms and tetrahedra with edges of the given length for each cell.
    pub fn regular(mesh: &VolumeMesh, length: impl Fn(usize) -> f64) -> Self {
        Self::new(mesh, |c| {
            let shape = mesh.shape(c);
            let map = length(c) * reference_matrix(shape);
            corners(shape).iter().map(|&u| map * u).collect()
        })
    }

    /// Regular cells with edges all of the same length, which together have the given volume.
    pub fn uniform(mesh: &VolumeMesh, volume: f64) -> Self {
        let total: f64 = mesh.cells().map(|(shape, _)| reference_volume(shape)).sum();
        let length = (volume / total).cbrt();
        Self::regular(mesh, |_| length)
    }

    /// Regular cells of the sizes that the cells have where they are, evened out between neighbours, so that inverted cells have
    /// a size as well; together they fill the boundary of the mesh.
    pub fn local(mesh: &VolumeMesh) -> Self {
        let own: Vec<f64> = mesh
            .cells()
            .map(|(shape, cell)| {
                let at = |k: usize| mesh.positions[cell[k] as usize];
                let lengths = shape.edges().iter().map(|&[a, b]| at(a).distance(at(b)));
                lengths.sum::<f64>() / shape.edges().len() as f64
            })
            .collect();
        let mean = own.iter().sum::<f64>() / own.len().max(1) as f64;
        let around = vertex_means(mesh, &own);
        let length = |c: usize| {
            let cell = mesh.cell(c);
            let sum: f64 = cell.iter().map(|&v| around[v as usize]).sum();
            (sum / cell.len() as f64).max(LEAST_SIZE * mean)
        };
        let filled: f64 = (0..mesh.cell_count())
            .map(|c| length(c).powi(3) * reference_volume(mesh.shape(c)))
            .sum();
        let volume = enclosed_volume(mesh);
        let scale = if volume > 0.0 {
            (volume / filled).cbrt()
        } else {
            1.0
        };
        Self::regular(mesh, |c| scale * length(c))
    }

    /// The mean size of the cells at each vertex, 0 where there is none. `[vertices]`.
    pub(super) fn sizes(&self, mesh: &VolumeMesh) -> Vec<f64> {
        let mut rest = self.matrices.as_slice();
        let of_cells: Vec<f64> = mesh
            .cells()
            .map(|(shape, _)| {
                let (own, others) = rest.split_at(shape.spokes().len());
                rest = others;
                let ideal = reference_matrix(shape).determinant();
                own.iter()
                    .map(|a| (a.determinant() / ideal).abs().cbrt())
                    .sum::<f64>()
                    / own.len() as f64
            })
            .collect();
        vertex_means(mesh, &of_cells)
    }
}

/// The mean over the cells at each vertex of a number that every cell has.
fn vertex_means(mesh: &VolumeMesh, of_cells: &[f64]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); mesh.positions.len()];
    for ((_, cell), x) in mesh.cells().zip(of_cells) {
        for &v in cell {
            let (sum, count) = &mut sums[v as usize];
            (*sum, *count) = (*sum + x, *count + 1.0);
        }
    }
    sums.into_iter()
        .map(|(sum, count)| if count > 0.0 { sum / count } else { 0.0 })
        .collect()
}

/// The volume inside the boundary of a mesh; inverted cells do not disturb it.
fn enclosed_volume(mesh: &VolumeMesh) -> f64 {
    let origin = mesh.positions.first().copied().unwrap_or_default();
    let face_volume = |(c, f): (usize, usize)| {
        let (face, cell) = (mesh.shape(c).faces()[f], mesh.cell(c));
        let at = |k: usize| mesh.positions[cell[face[k]] as usize] - origin;
        (2..face.len())
            .map(|k| at(0).dot(at(k - 1).cross(at(k))) / 6.0)
            .sum::<f64>()
    };
    boundary_faces(mesh).into_iter().map(face_volume).sum()
}
