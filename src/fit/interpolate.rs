//! Loop surfaces through given points \[MKJK15\]: no iteration, one sparse system.
//!
//! The limit surface passes through the points of the template, which should lie on the target, as those of a network do. For features that bend more than a network of few
//! points can, the paper refines the network itself: halves every edge and moves the new points to the nearest vertices of the target. The same template may also be where a fit
//! by another method begins, which takes longer and comes closer.

use super::geometric::Data;
use super::record::{Fit, StopReason};
use crate::error::Result;
use crate::mesh::{Connectivity, ControlMesh, Scheme};
use crate::model;
use crate::progress::Progress;
use glam::DVec3;
use rstar::RTree;
use std::time::Instant;

/// What to make of a template.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Interpolation {
    /// How often its edges are halved first; the target should have several vertices to each new point.
    pub refinements: usize,
    /// Subdivisions from the control mesh to the surface that is returned.
    pub levels: usize,
}

/// The Loop surface through the points of a template.
///
/// `template`: triangles in the unit frame of the data, on it ([`Data::control_mesh`]). Interrupted, there are fewer refinements, or the template has fewer points
/// already.
///
/// # Errors
/// Where the template is no oriented manifold of triangles, or its points are not finite.
pub fn interpolate(
    data: &Data,
    mut template: ControlMesh,
    options: &Interpolation,
    progress: &dyn Progress,
) -> Result<Fit> {
    let begun = Instant::now();
    for _ in 0..options.refinements {
        if !progress.interrupted() {
            template = refined(data, &template)?;
        }
    }
    let stop_reason = match progress.interrupted() {
        true => StopReason::Interrupted,
        false => StopReason::Schedule,
    };
    let control = model::interpolating(&template, Scheme::Loop)?;
    Ok(Fit {
        surface: model::limit_mesh(&control, Scheme::Loop, options.levels)?,
        control,
        iterations: Vec::new(),
        data_error: None,
        stages: vec![("control points".into(), begun.elapsed().as_secs_f64())],
        stop_reason,
    })
}

/// A template with a point more on each edge, at the nearest point of the data; on boundary edges, at the nearest of the data's boundary.
fn refined(data: &Data, template: &ControlMesh) -> Result<ControlMesh> {
    // Subdivided as a polygon mesh, its vertices stay and the new ones are the middles of edges.
    let mut finer = model::subdivide(template, Scheme::Polygon)?;
    let connectivity = Connectivity::of(&finer.mesh)?;
    let all = || data.points.iter().zip(&data.rims);
    let tree = |points: Vec<[f64; 3]>| RTree::bulk_load(points);
    let inside = tree(all().map(|(p, _)| p.to_array()).collect());
    let boundary = tree(
        all()
            .filter(|(_, rim)| rim.is_some())
            .map(|(p, _)| p.to_array())
            .collect(),
    );
    for v in template.mesh.positions.len()..finer.mesh.positions.len() {
        let points = match connectivity.is_boundary_vertex(v as u32) {
            true => &boundary,
            false => &inside,
        };
        let place = &mut finer.mesh.positions[v];
        if let Some(&nearest) = points.nearest_neighbor(place.to_array()) {
            *place = DVec3::from(nearest);
        }
    }
    Ok(finer)
}
