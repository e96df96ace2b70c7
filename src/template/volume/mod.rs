//! Volume templates: grids, balls, and edits that compose \[PPL13, figure 11\].
//!
//! A [`grid`] over a target's box is [`carve`]d to what lies inside the target; a layer of cells under its boundary ([`pillow`]) takes the edges
//! and corners of the stairs into the volume; single edges of the boundary are taken away by [`collapse`], which makes prisms of hexahedra; and
//! [`extrude`] makes layers of cells over a surface mesh. A [`ball`] has no edge on its boundary from the start.
//!
//! ```
//! use glam::DVec3;
//! use vorofit::mesh::shapes;
//! use vorofit::template::volume::{carve, grid, pillow};
//!
//! let ball = shapes::sphere(1.0, 3);
//! let cubes = grid(DVec3::splat(-1.2), DVec3::splat(1.2), [6; 3]);
//! let carved = carve(&cubes, &ball, 0.5)?;
//! let template = pillow(&carved, 0.35)?;
//! assert!(template.cell_count() > carved.cell_count());
//! # Ok::<(), vorofit::Error>(())
//! ```
//!
//! [`automatic`] does all of this by itself, and looks for the best grid. Every edit takes a mesh that is sound ([`check_volume::sound`]) and gives one that is [`checked`], or says what hinders it.

mod automatic;
mod ball;
mod carve;
mod collapse;
mod extrude;
mod grid;
mod offset;
mod pillow;
mod refine;

pub use automatic::{ELEMENTS, MOST_ELEMENTS, automatic};
pub use ball::ball;
pub use carve::carve;
pub use collapse::{collapse, strip};
pub use extrude::{Course, extrude};
pub use grid::grid;
pub use pillow::pillow;

use crate::error::{Error, Result};
use crate::measure::validity::{Validity, validities};
use crate::mesh::{Connectivity, PolygonMesh, VolumeMesh, check_volume};
use crate::model::element::Basis;
use crate::model::volume::CurvedVolume;

/// The faces of one cell only, facing outwards, over the vertices of the volume: those inside are in no face.
pub fn boundary(mesh: &VolumeMesh) -> PolygonMesh {
    let faces = check_volume::boundary_faces(mesh);
    let faces = faces.into_iter().map(|(c, f)| {
        let local = mesh.shape(c).faces()[f].iter();
        local.map(|&k| mesh.cell(c)[k]).collect::<Vec<_>>()
    });
    PolygonMesh::from_faces(mesh.positions.clone(), faces)
}

/// The mesh, if curved cells can be fitted from it: its cells match ([`check_volume::sound`]), its boundary is a closed 2-manifold, and no straight-edged cell is
/// inverted or degenerate anywhere ([`validities`]).
///
/// # Errors
/// The first cell, edge or vertex where that is not so.
pub fn checked(mesh: VolumeMesh) -> Result<VolumeMesh> {
    check_volume::sound(&mesh)?;
    Connectivity::of(&boundary(&mesh))?;
    let inverted = inverted(&mesh)?;
    let Some(&first) = inverted.first() else {
        return Ok(mesh);
    };
    Err(Error::input(
        format!(
            "{} of {} cells would be inverted or degenerate; the first is cell {first} (counted from 0)",
            inverted.len(),
            mesh.cell_count()
        ),
        "edit elsewhere or by less, or optimize the mesh before",
    ))
}

/// The cells whose Jacobian is not positive everywhere, ascending.
fn inverted(mesh: &VolumeMesh) -> Result<Vec<usize>> {
    let validities = validities(&CurvedVolume::new(mesh, Basis::Legendre)?);
    let bad = |c: &usize| validities[*c] != Validity::Valid;
    Ok((0..mesh.cell_count()).filter(bad).collect())
}

/// The cells for which `is_kept`, in order, and the vertices that they use, in order.
fn part(mesh: &VolumeMesh, is_kept: impl Fn(usize) -> bool) -> VolumeMesh {
    const NONE: u32 = u32::MAX;
    let kept = (0..mesh.cell_count()).filter(|&c| is_kept(c));
    let mut number = vec![NONE; mesh.positions.len()];
    for c in kept.clone() {
        for &v in mesh.cell(c) {
            number[v as usize] = 0;
        }
    }
    let mut part = VolumeMesh::default();
    for (number, p) in number.iter_mut().zip(&mesh.positions) {
        if *number != NONE {
            *number = part.positions.len() as u32;
            part.positions.push(*p);
        }
    }
    for c in kept {
        let vertices: Vec<u32> = mesh.cell(c).iter().map(|&v| number[v as usize]).collect();
        part.push_cell(mesh.shape(c), &vertices);
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The determinants at the corners of all cells, and the sum of the cells' volumes by the mean of their corners.
    pub fn corner_determinants(mesh: &VolumeMesh) -> Vec<f64> {
        mesh.cells()
            .flat_map(|(shape, cell)| {
                let at = |k: usize| mesh.positions[cell[k] as usize];
                shape.spokes().iter().map(move |&[k, a, b, c]| {
                    let [a, b, c] = [a, b, c].map(|l| at(l) - at(k));
                    a.dot(b.cross(c))
                })
            })
            .collect()
    }
}
