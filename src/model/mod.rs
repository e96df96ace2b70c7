//! What is deformed: control points P, and a constant sparse matrix M to the vertices X = M P of a fine mesh S.
//!
//! A [`Model`] is made once for a control mesh; during a fit only P moves. Rows of M come from subdividing the unit vectors of the control
//! points, one sparse product a level, and by choice the last level is pushed to the limit surface. Gradients go back as Mᵀ.
//! [`limit_surface`] evaluates the limit surface itself at any parameter. [`element`] and [`volume`] are curved volumes, whose boundary is
//! of the form M P too.

pub mod element;
mod interpolation;
mod limit;
pub mod limit_surface;
mod refinement;
#[cfg(test)]
mod tests;
pub mod volume;

pub use interpolation::interpolating;

use crate::error::{Error, Result};
use crate::kernel::sparse::Csr;
pub use crate::mesh::Scheme;
use crate::mesh::{Connectivity, ControlMesh, Crease, PolygonMesh};
use glam::DVec3;
use refinement::Level;

/// The finest mesh that indices of 32 bits still serve, with some twenty entries of M to a vertex: half-edges.
const MAX_HALF_EDGES: usize = 1 << 29;

/// A surface S that depends linearly on control points.
#[derive(Debug, Clone)]
pub struct Model {
    /// M, `[surface vertices, control points]`; every row sums to 1. Vertex i < control points belongs to control point i.
    pub matrix: Csr,
    /// The triangles of S, indices of surface vertices; each polygon is cut from its first corner.
    pub triangles: Vec<[u32; 3]>,
    /// `[triangles]`: the control face that each comes from, ascending.
    pub patches: Vec<u32>,
    /// The polygons of S (quads for Catmull–Clark) and who is next to whom.
    pub connectivity: Connectivity,
}

impl Model {
    /// The model of a control mesh after `levels` refinements, on the limit surface if `limit`.
    ///
    /// Boundary edges are creases, and a boundary vertex of a single face is a corner (USD's `edgeAndCorner`).
    ///
    /// # Errors
    /// Names the element where the control mesh is no oriented manifold, has an unused vertex, a crease that is no edge or (Loop) a face
    /// other than a triangle; where `levels` would make a mesh beyond 32-bit indices.
    pub fn new(control: &ControlMesh, scheme: Scheme, levels: usize, limit: bool) -> Result<Self> {
        let mut level = Level::of(control, scheme)?;
        check_size(level.connectivity.half_edge_count(), levels)?;
        let mut matrix = Csr::identity(level.connectivity.vertex_count());
        let mut patches: Vec<u32> = (0..level.connectivity.face_count() as u32).collect();
        for _ in 0..levels {
            let (finer, refinement) = level.refine();
            patches = (0..finer.connectivity.face_count())
                .map(|f| patches[level.parent_face(f) as usize])
                .collect();
            matrix = refinement.multiply(&matrix);
            level = finer;
        }
        if limit {
            matrix = level.limit().multiply(&matrix);
        }
        Ok(Self::from_parts(matrix, &patches, level.connectivity))
    }

    fn from_parts(matrix: Csr, face_patches: &[u32], connectivity: Connectivity) -> Self {
        let mut triangles = Vec::with_capacity(connectivity.half_edge_count() / 2);
        let mut patches = Vec::with_capacity(connectivity.half_edge_count() / 2);
        for (f, &patch) in connectivity.faces().zip(face_patches) {
            for k in 2..f.len() {
                triangles.push([f[0], f[k - 1], f[k]]);
                patches.push(patch);
            }
        }
        Self {
            matrix,
            triangles,
            patches,
            connectivity,
        }
    }

    /// X = M P: the surface's vertices.
    pub fn positions(&self, control_points: &[DVec3]) -> Vec<DVec3> {
        self.matrix.apply(control_points)
    }

    /// S with its polygons, to be written to a file.
    pub fn surface(&self, control_points: &[DVec3]) -> PolygonMesh {
        PolygonMesh::from_faces(self.positions(control_points), self.connectivity.faces())
    }
}

/// Refuses more levels than 32-bit indices serve; every level has four times the half-edges of the one before.
fn check_size(half_edges: usize, levels: usize) -> Result<()> {
    let possible = (MAX_HALF_EDGES / half_edges).checked_ilog(4).unwrap_or(0) as usize;
    if levels <= possible {
        return Ok(());
    }
    Err(Error::input(
        format!("{levels} levels of subdivision make more than {MAX_HALF_EDGES} corners"),
        format!("use at most {possible} levels or fewer control points"),
    ))
}

/// The mesh of a control mesh after `levels` refinements, its vertices on the limit surface: what [`Model::surface`] makes, without the matrix that
/// control points in motion want.
///
/// # Errors
/// As [`Model::new`].
pub fn limit_mesh(control: &ControlMesh, scheme: Scheme, levels: usize) -> Result<PolygonMesh> {
    let mut level = Level::of(control, scheme)?;
    check_size(level.connectivity.half_edge_count(), levels)?;
    let mut positions = control.mesh.positions.clone();
    for _ in 0..levels {
        let (finer, refinement) = level.refine();
        positions = refinement.apply(&positions);
        level = finer;
    }
    let positions = level.limit().apply(&positions);
    Ok(PolygonMesh::from_faces(
        positions,
        level.connectivity.faces(),
    ))
}

/// One refinement of the control mesh itself: a finer control mesh of the same limit surface.
///
/// Vertices keep their indices, with edge and face points after them; creases are inherited with their sharpness less one, corners as they are.
///
/// # Errors
/// As [`Model::new`].
pub fn subdivide(control: &ControlMesh, scheme: Scheme) -> Result<ControlMesh> {
    let (finer, refinement) = Level::of(control, scheme)?.refine();
    let positions = refinement.apply(&control.mesh.positions);
    let mesh = &finer.connectivity;
    let creases = (0..mesh.edge_count() as u32)
        .filter(|&e| finer.sharpness[e as usize] > 0.0 && !mesh.is_boundary_edge(e))
        .map(|e| Crease {
            edge: mesh.ends(e),
            sharpness: finer.sharpness[e as usize],
        })
        .collect();
    Ok(ControlMesh {
        mesh: PolygonMesh::from_faces(positions, mesh.faces()),
        creases,
        corners: control.corners.clone(),
    })
}
