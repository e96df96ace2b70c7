//! What is known at every vertex: its Monge form, and how far that can be trusted.

use super::monge::{JetFrame, monge};
use super::neighbourhood::{Adjacency, Neighbourhoods};
use super::{Monge, Scale};
use crate::device::Device;
use crate::error::{Error, Result};
use crate::kernel::jet::{self, Jet};
use crate::mesh::{Frame, TriangleMesh};
use glam::DVec3;
use rayon::prelude::*;

/// Vertices whose neighbourhoods are in memory at once.
const CHUNK: usize = 1 << 15;
/// The share of the diagonal that is looked at by default, and how many edges at least.
const USUAL_RADIUS: f64 = 0.02;
const USUAL_EDGES: f64 = 4.0;
/// The largest share of the diagonal that noise makes of it, and that may be asked for.
const LARGEST_AUTOMATIC: f64 = 0.08;
const LARGEST_RADIUS: f64 = 0.25;
/// Vertices that noise is measured at, and the share of the usual radius that is looked at there: over more, shape is taken for noise.
const PROBES: usize = 512;
const PROBE_SHARE: f64 = 0.6;
/// The error of third derivatives, per square of the diagonal, that the automatic radius allows: noise σ and vertices h apart leave about σ h / r⁴ of it.
const ALLOWED_ERROR: f64 = 0.2;
/// Points whose least pivot is below this leave a term open: those of two or three lines, as on the cylinders of parts.
const OPEN: f64 = 5e-4;
/// From the residual to about the error of a third derivative, times the square of the radius. The thresholds of lines and umbilics are multiples of it.
const THIRD_ERROR: f64 = 12.0;

/// Monge forms and their errors.
pub(super) struct Vertices {
    /// `[vertices]`.
    pub forms: Vec<Monge>,
    /// `[vertices]`.
    pub trust: Vec<Trust>,
    /// That of the neighbourhoods where the vertices are close enough.
    pub usual_radius: f64,
}

/// How far a Monge form can be trusted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trust {
    /// The radius of the neighbourhood.
    pub radius: f64,
    /// About the error of third derivatives; infinite where the points leave them open.
    pub third_error: f64,
}

impl Trust {
    const NONE: Self = Self {
        radius: 0.0,
        third_error: f64::INFINITY,
    };

    fn of(jet: &Jet, frame: &JetFrame) -> Self {
        let third_error = match jet.pivot < OPEN {
            true => f64::INFINITY,
            false => THIRD_ERROR * jet.residual / frame.radius.powi(2),
        };
        Self {
            radius: frame.radius,
            third_error,
        }
    }
}

impl Vertices {
    /// Fits them. `is_barrier`: `[vertices]`, those on sharp edges, beyond which no neighbourhood reaches.
    pub fn fit(
        device: &Device,
        mesh: &TriangleMesh,
        adjacency: &Adjacency,
        is_barrier: &[bool],
        scale: Scale,
    ) -> Result<Self> {
        let normals = mesh.vertex_normals();
        let used: Vec<u32> = (0..normals.len() as u32)
            .filter(|&v| normals[v as usize] != DVec3::ZERO)
            .collect();
        let mut neighbourhoods = Neighbourhoods {
            mesh,
            normals: &normals,
            adjacency,
            is_barrier,
            radius: 0.0,
        };
        neighbourhoods.radius = radius(device, &mut neighbourhoods, &used, scale)?;
        let mut vertices = Self {
            forms: vec![Monge::default(); normals.len()],
            trust: vec![Trust::NONE; normals.len()],
            usual_radius: neighbourhoods.radius,
        };
        for chunk in used.chunks(CHUNK) {
            let (input, frames) = neighbourhoods.local(chunk);
            let jets = jet::fit(device, &input)?;
            let found: Vec<_> = jets
                .par_iter()
                .zip(&frames)
                .with_min_len(256)
                .map(|(jet, frame)| (monge(jet, frame), Trust::of(jet, frame)))
                .collect();
            for (&v, (form, trust)) in chunk.iter().zip(found) {
                vertices.forms[v as usize] = form;
                vertices.trust[v as usize] = trust;
            }
        }
        Ok(vertices)
    }
}

/// The radius of neighbourhoods. The automatic one grows with the noise, as some vertices show it.
fn radius(
    device: &Device,
    neighbourhoods: &mut Neighbourhoods<'_>,
    used: &[u32],
    scale: Scale,
) -> Result<f64> {
    let mesh = neighbourhoods.mesh;
    let diagonal = Frame::of(mesh)?.diagonal;
    if let Scale::Fraction(share) = scale {
        return match share > 0.0 && share <= LARGEST_RADIUS {
            true => Ok(share * diagonal),
            false => Err(Error::input(
                format!("a scale of {share} of the diagonal is out of range"),
                format!("give one above 0 and up to {LARGEST_RADIUS}"),
            )),
        };
    }
    let usual = usual_radius(mesh)?;
    neighbourhoods.radius = PROBE_SHARE * usual;
    let step = used.len().div_ceil(PROBES).max(1);
    let probes: Vec<u32> = used.iter().copied().step_by(step).collect();
    let (input, frames) = neighbourhoods.local(&probes);
    let jets = jet::fit(device, &input)?;
    let mut noise: Vec<f64> = jets
        .iter()
        .zip(&frames)
        .map(|(jet, frame)| jet.residual * frame.radius)
        .collect();
    noise.sort_by(f64::total_cmp);
    let noise = noise.get(noise.len() / 2).copied().unwrap_or_default();
    let quiet = (noise * mean_edge(mesh) * diagonal.powi(2) / ALLOWED_ERROR).powf(0.25);
    Ok(usual.max(quiet.min(LARGEST_AUTOMATIC * diagonal)))
}

/// The radius of neighbourhoods without noise.
pub(super) fn usual_radius(mesh: &TriangleMesh) -> Result<f64> {
    let diagonal = Frame::of(mesh)?.diagonal;
    Ok((USUAL_RADIUS * diagonal).max(USUAL_EDGES * mean_edge(mesh)))
}

/// The mean length of the sides of triangles.
fn mean_edge(mesh: &TriangleMesh) -> f64 {
    let sides = (0..mesh.triangles.len()).map(|t| {
        let [a, b, c] = mesh.corners(t);
        a.distance(b) + b.distance(c) + c.distance(a)
    });
    sides.sum::<f64>() / (3 * mesh.triangles.len()).max(1) as f64
}
