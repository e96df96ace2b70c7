//! Curved volumes: cells of any shape and order that share vertices, edges and faces, as a linear function of coefficients.
//!
//! A [`CurvedVolume`] has a coefficient for each vertex (its position) and for each mode inside an edge, a face and a cell. Orders are kept
//! per entity under the maximum rule: where cells are [`raised`](CurvedVolume::raised), an edge or a face has the highest order of the cells
//! around it; where only the boundary is [`graded`](CurvedVolume::graded), an edge there has that of the faces around it. A cell computes
//! at its *kernel order*, the highest of its entities; modes that an entity lacks are zero there, so any mix conforms.
//!
//! The [`gather`](CurvedVolume::gather) takes coefficients to the local modes of cells, in the order that [`crate::model::element`] defines; its transpose takes
//! gradients back. Local modes are in the cell's *frame*: tetrahedra and the triangles of prisms take their corners by ascending
//! vertex. A frame may be a mirror image; then [`reference_inverse`](CurvedVolume::reference_inverse) is one too, so that
//! J = ∇h A⁻¹ and the sign of its determinant are those of the cell as it was given.

mod boundary;
mod entities;
mod gather;
mod nodes;
mod orders;
mod subdivision;
#[cfg(test)]
mod tests;

pub use boundary::{BoundaryPoint, BoundarySurface};
pub use subdivision::{ControlVolume, Subdivided};

use crate::error::{Error, Result};
use crate::kernel::sparse::Csr;
use crate::mesh::{CellShape, VolumeMesh};
use crate::model::element::{Basis, Factor, Grid, Tables, corners, mode_count, reference_matrix};
use entities::{Entities, Face};
use glam::{DMat3, DVec3};
use orders::Modes;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Cells that one task evaluates.
const CELLS_PER_TASK: usize = 16;

/// Curved hexahedra, prisms and tetrahedra.
#[derive(Debug, Clone, PartialEq)]
pub struct CurvedVolume {
    basis: Basis,
    /// Positions of the vertices, then the modes inside edges, faces and cells; all in the unit of length of the positions.
    pub coefficients: Vec<DVec3>,
    /// Which vertices each cell has; its positions are not kept up to date.
    cells: VolumeMesh,
    entities: Entities,
    edges: Modes,
    faces: Modes,
    interiors: Modes,
}

/// Cells that a kernel can do together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Their shape.
    pub shape: CellShape,
    /// Their kernel order.
    pub order: usize,
    /// The cells, ascending.
    pub cells: Vec<u32>,
}

impl CurvedVolume {
    /// The cells of a mesh as they are: order 1 everywhere.
    ///
    /// # Errors
    /// Where there are no cells, a vertex is not finite, a cell has a vertex out of range or twice, or a face is not between
    /// one or two cells that agree on its cycle of vertices.
    pub fn new(mesh: &VolumeMesh, basis: Basis) -> Result<Self> {
        if mesh.cell_count() == 0 {
            return Err(Error::input(
                "the volume mesh has no cells",
                "give tetrahedra, prisms or hexahedra",
            ));
        }
        if let Some(v) = mesh.positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::input(
                format!("vertex {v} (counted from 0) is not finite"),
                "remove the vertex and its cells, or export the mesh again",
            ));
        }
        let entities = Entities::of(mesh)?;
        let empty = |count| Modes::new(vec![1; count], mesh.positions.len() as u32, |_, _| 0);
        Ok(Self {
            basis,
            coefficients: mesh.positions.clone(),
            edges: empty(entities.edges.len()),
            faces: empty(entities.faces.len()),
            interiors: empty(mesh.cell_count()),
            cells: mesh.clone(),
            entities,
        })
    }

    /// The kernels of the modes.
    pub fn basis(&self) -> Basis {
        self.basis
    }

    /// The number of cells.
    pub fn cell_count(&self) -> usize {
        self.cells.cell_count()
    }

    /// The number of vertices; coefficient v < vertices is the position of vertex v.
    pub fn vertex_count(&self) -> usize {
        self.cells.positions.len()
    }

    /// The shape of cell `c`.
    pub fn shape(&self, c: usize) -> CellShape {
        self.cells.shape(c)
    }

    /// The vertices of cell `c`, in the local numbering of its shape.
    pub fn vertices(&self, c: usize) -> &[u32] {
        self.cells.cell(c)
    }

    /// The coefficients of the modes inside local edge `e` of cell `c`, by ascending mode; they run from the smaller to the
    /// larger vertex.
    pub fn edge_coefficients(&self, c: usize, e: usize) -> Range<u32> {
        self.edge_modes(self.entities.edges_of(c)[e])
    }

    /// The matrix from coefficients to the local modes of the given cells, one cell after the other, each with
    /// [`mode_count`]`(shape, kernel order)` rows. Rows of modes that an entity lacks are empty; all others have one entry of ±1, but for
    /// the tops of prisms. Its transpose adds gradients up.
    pub fn gather(&self, cells: &[u32]) -> Csr {
        let lists = gather::Lists::new(self, cells);
        let blocks: Vec<Csr> = cells
            .par_chunks(CELLS_PER_TASK)
            .map(|cells| {
                let mut block = Csr {
                    offsets: vec![0],
                    column_count: self.coefficients.len(),
                    ..Csr::default()
                };
                for &c in cells {
                    self.gather_cell(&lists, c as usize, &mut block);
                }
                block
            })
            .collect();
        Csr::stack(&blocks, self.coefficients.len())
    }

    /// Appends the rows of a cell.
    fn gather_cell(&self, lists: &gather::Lists, c: usize, block: &mut Csr) {
        let order = self.kernel_order(c);
        let mut entries = Vec::new();
        gather::entries(self, lists, c, order, |entry| entries.push(entry));
        entries.sort_by_key(|&(local, global, _)| (local, global));
        let mut rest = entries.into_iter().peekable();
        for row in 0..mode_count(self.shape(c), order) {
            while let Some((_, global, weight)) = rest.next_if(|e| e.0 == row) {
                block.columns.push(global);
                block.values.push(weight);
            }
            block.offsets.push(block.columns.len() as u32);
        }
    }

    /// Corner k of the frame of cell `c` is its vertex `frame(c)[k]`, in the local numbering of its shape.
    pub fn frame(&self, c: usize) -> Vec<usize> {
        let ids = self.vertices(c);
        match self.shape(c) {
            CellShape::Hexahedron => (0..8).collect(),
            CellShape::Tetrahedron => {
                let mut frame: Vec<usize> = (0..4).collect();
                frame.sort_by_key(|&k| ids[k]);
                frame
            }
            CellShape::Prism => {
                let mut frame: Vec<usize> = (0..3).collect();
                frame.sort_by_key(|&k| ids[k]);
                frame.extend_from_within(..);
                frame[3..].iter_mut().for_each(|k| *k += 3);
                frame
            }
        }
    }

    /// A⁻¹ in the frame of cell `c`, for ideal shapes with edges of length 1: J = ∇h A⁻¹ for the gradients of [`Tables`].
    pub fn reference_inverse(&self, c: usize) -> DMat3 {
        self.frame_map(c).inverse() * reference_matrix(self.shape(c)).inverse()
    }

    /// The derivative of a cell's own reference coordinates by those of its frame.
    fn frame_map(&self, c: usize) -> DMat3 {
        let frame = self.frame(c);
        let at = |k: usize| corners(self.shape(c))[frame[k]];
        match self.shape(c) {
            CellShape::Hexahedron => DMat3::IDENTITY,
            CellShape::Prism => DMat3::from_cols(at(1) - at(0), at(2) - at(0), DVec3::Z),
            CellShape::Tetrahedron => DMat3::from_cols(at(1) - at(0), at(2) - at(0), at(3) - at(0)),
        }
    }

    /// Positions at the points of a grid in the cells' own reference coordinates (corners in the local numbering of the shape):
    /// `[cells, points]`. All cells must have the shape of the grid.
    pub fn positions(&self, cells: &[u32], grid: &Grid) -> Vec<DVec3> {
        let mut alike: BTreeMap<(usize, Vec<usize>), Vec<usize>> = BTreeMap::new();
        for (k, &c) in cells.iter().enumerate() {
            let key = (self.kernel_order(c as usize), self.frame(c as usize));
            alike.entry(key).or_default().push(k);
        }
        let mut positions = vec![DVec3::ZERO; cells.len() * grid.len()];
        for ((order, frame), members) in alike {
            let tables = Tables::new(self.basis, order, &in_frame(grid, &frame));
            let batch: Vec<u32> = members.iter().map(|&k| cells[k]).collect();
            let coefficients = self.gather(&batch).apply(&self.coefficients);
            let count = coefficients.len() / batch.len();
            let parts: Vec<Vec<DVec3>> = coefficients
                .par_chunks(count)
                .map(|local| tables.positions(local))
                .collect();
            for (k, part) in members.into_iter().zip(parts) {
                positions[k * grid.len()..][..grid.len()].copy_from_slice(&part);
            }
        }
        positions
    }

    /// Position and derivative by the cell's own reference coordinates at one point of cell `c`.
    pub fn evaluate(&self, c: usize, u: DVec3) -> (DVec3, DMat3) {
        let grid = in_frame(&Grid::point(self.shape(c), u), &self.frame(c));
        let tables = Tables::new(self.basis, self.kernel_order(c), &grid);
        let local = self.gather(&[c as u32]).apply(&self.coefficients);
        let gradient = tables.gradients(&local)[0] * self.frame_map(c).inverse();
        (tables.positions(&local)[0], gradient)
    }

    fn frame_vertices(&self, c: usize) -> Vec<u32> {
        let ids = self.vertices(c);
        self.frame(c).into_iter().map(|k| ids[k]).collect()
    }

    fn edge_between(&self, a: u32, b: u32) -> u32 {
        self.entities.edge_between(a, b) as u32
    }

    /// The face with the vertices of a cycle.
    fn face_over(&self, cycle: &[u32]) -> u32 {
        self.entities.face_number(&Face::new(cycle)) as u32
    }

    fn edge_modes(&self, e: u32) -> Range<u32> {
        self.edges.range(e as usize)
    }

    fn face_modes(&self, f: u32) -> Range<u32> {
        self.faces.range(f as usize)
    }

    fn cell_modes(&self, c: usize) -> Range<u32> {
        self.interiors.range(c)
    }
}

/// The points of a grid in a frame's coordinates.
fn in_frame(grid: &Grid, frame: &[usize]) -> Grid {
    let mut grid = grid.clone();
    match &mut grid.factors[0] {
        Factor::Line(_) => {}
        Factor::Triangle(points) => {
            for u in points {
                let l = [1.0 - u[0] - u[1], u[0], u[1]];
                *u = [l[frame[1]], l[frame[2]]];
            }
        }
        Factor::Tetrahedron(points) => {
            for u in points {
                let l = [1.0 - u[0] - u[1] - u[2], u[0], u[1], u[2]];
                *u = [l[frame[1]], l[frame[2]], l[frame[3]]];
            }
        }
    }
    grid
}
