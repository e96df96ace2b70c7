//! Templates: where a model starts and how it is connected.
//!
//! [`automatic`] for anything that encloses something, [`bounding_box`] for targets like a ball, [`torus`] for those with one hole, [`simplified`] for any
//! target of triangles, [`adaptive`] and [`ridges`] for triangles on it whose points are where they tell most, [`placed`] for a mesh of the user's own. All work in
//! the coordinates of what they are given; a fit gives them its unit frame.

mod align;
mod auto;
mod hole;
mod network;
pub mod shell;
mod torus;
pub mod volume;
mod voxels;

pub use align::alignment;
pub use auto::{Automatic, Genus, automatic, skin};
pub use network::{adaptive, ridges};
pub use torus::{Axis, torus};

use crate::error::{Error, Result};
use crate::mesh::{ControlMesh, PolygonMesh, TriangleMesh, shapes};
use crate::topology;
use glam::DVec3;

/// The least thickness of a box, as a share of its diagonal: the two sides of a flat target's box must not coincide.
const LEAST_THICKNESS: f64 = 0.01;

/// The box from `lo` to `hi` as a quad grid of about `control_points` points (never under 8).
///
/// A count of the form 6 m² + 2 (8, 26, 98, 386, 1,538, 6,146 …) is met exactly, by m cells along each edge; subdividing such a box makes the next one in
/// that list. Otherwise the cells are nearly square, and their number is the nearest that those allow. A flat box is thickened to 1 %
/// of its diagonal.
pub fn bounding_box(lo: DVec3, hi: DVec3, control_points: usize) -> ControlMesh {
    let center = 0.5 * (lo + hi);
    let least = LEAST_THICKNESS * (hi - lo).length();
    let half = 0.5 * (hi - lo).max(DVec3::splat(least));
    let cells = box_cells(2.0 * half, control_points);
    shapes::box_grid(center - half, center + half, cells).into()
}

/// The points of a box grid.
fn box_points([a, b, c]: [u32; 3]) -> usize {
    let [a, b, c] = [a as usize, b as usize, c as usize];
    2 * (a * b + b * c + c * a) + 2
}

fn box_cells(size: DVec3, control_points: usize) -> [u32; 3] {
    let equal = (control_points.saturating_sub(2) as f64 / 6.0)
        .sqrt()
        .round() as u32;
    if equal > 0 && box_points([equal; 3]) == control_points {
        return [equal; 3];
    }
    // The count falls as the cells grow: halve the interval of cell sizes until it holds a single step.
    let cells = |h: f64| size.to_array().map(|l| ((l / h).round() as u32).max(1));
    let mut large = size.max_element();
    let mut small = size.length() / (control_points.max(8) as f64);
    for _ in 0..100 {
        let h = 0.5 * (small + large);
        if box_points(cells(h)) < control_points {
            large = h;
        } else {
            small = h;
        }
    }
    let distance = |h: &f64| box_points(cells(*h)).abs_diff(control_points);
    match distance(&small) < distance(&large) {
        true => cells(small),
        false => cells(large),
    }
}

/// A target simplified to `control_points` by the quadric error metric, and cut into an oriented manifold where it is none ([`topology::manifold`]).
///
/// # Errors
/// Where the target cannot be simplified so far without changing its topology, as a soup of triangles cannot.
pub fn simplified(target: &TriangleMesh, control_points: usize) -> Result<ControlMesh> {
    let (control, is_reached) = simplified_towards(target, control_points);
    if !is_reached {
        let reached = control.mesh.positions.len();
        return Err(Error::input(
            format!("simplified to {control_points} vertices the target would change its topology"),
            format!("ask for {reached} control points or more, or mend the target"),
        ));
    }
    Ok(control)
}

/// Like [`simplified`], but only as far as the target's topology allows. Also returns whether that is as far as asked for.
pub fn simplified_towards(target: &TriangleMesh, control_points: usize) -> (ControlMesh, bool) {
    let to = |count| topology::simplify(target, topology::Target::Vertices(count));
    let mut simplified = to(control_points);
    let mut manifold = topology::manifold(&simplified.mesh);
    if manifold.added_vertices > 0 {
        // Cutting adds vertices, about as many the second time.
        simplified = to(control_points.saturating_sub(manifold.added_vertices));
        manifold = topology::manifold(&simplified.mesh);
    }
    let reached = manifold.mesh.positions.len();
    log::info!(
        "simplified to {reached} control points, at most {:.3e} from the planes that they stand for",
        simplified.deviation
    );
    (PolygonMesh::from(manifold.mesh).into(), simplified.reached)
}

/// How a template from a file is brought onto the target.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Align {
    /// It is in the target's coordinates already.
    #[default]
    None,
    /// Its bounding box is stretched onto the target's.
    Box,
    /// It is turned and moved onto the target.
    Rigid,
    /// It is turned, moved and scaled onto the target.
    Similarity,
}

/// A control mesh of the user's own, brought onto a target; vertices that no face uses are dropped.
///
/// # Errors
/// Where the mesh has no faces, and as [`alignment`].
pub fn placed(control: &ControlMesh, align: Align, target: &TriangleMesh) -> Result<ControlMesh> {
    let mut control = without_unused_vertices(control);
    if control.mesh.positions.is_empty() {
        return Err(Error::input(
            "the template has no faces",
            "give a mesh with faces",
        ));
    }
    let map = alignment(align, &control.mesh.triangulate(), target)?;
    for p in &mut control.mesh.positions {
        *p = map.transform_point3(*p);
    }
    Ok(control)
}

fn without_unused_vertices(control: &ControlMesh) -> ControlMesh {
    let mut used = vec![false; control.mesh.positions.len()];
    for &v in control.mesh.corners() {
        used[v as usize] = true;
    }
    let mut index = vec![0u32; used.len()];
    let mut positions = Vec::new();
    for (v, _) in used.iter().enumerate().filter(|&(_, &used)| used) {
        index[v] = positions.len() as u32;
        positions.push(control.mesh.positions[v]);
    }
    let renamed = |face: &[u32]| face.iter().map(|&v| index[v as usize]).collect::<Vec<_>>();
    let faces: Vec<_> = control.mesh.faces().map(renamed).collect();
    let mut creases = control.creases.clone();
    creases.retain(|c| c.edge.iter().all(|&v| used[v as usize]));
    for crease in &mut creases {
        crease.edge = crease.edge.map(|v| index[v as usize]);
    }
    let corners = control.corners.iter().filter(|&&v| used[v as usize]);
    ControlMesh {
        corners: corners.map(|&v| index[v as usize]).collect(),
        mesh: PolygonMesh::from_faces(positions, faces),
        creases,
    }
}

#[cfg(test)]
mod tests;
