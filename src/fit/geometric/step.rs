//! The two ways to move the control points towards the data on frozen footpoints.

use super::footpoints::Sample;
use crate::fit::normal_equations::{conjugate_gradients, inverse_block};
use crate::fit::symmetric::Symmetric3;
use crate::kernel::sparse::Csr;
use crate::mesh::{Connectivity, PolygonMesh};
use crate::model::limit_surface::SurfaceParameter;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// μ: what a tangential distance counts against a normal one.
const SLIDING: f64 = 0.003;

/// The relative residual of the linear solves.
const TOLERANCE: f64 = 0.03;

/// The weights of the normal and tangential part of the regularizer, the mean squared Laplacian of the control mesh, against the mean squared
/// distance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Smoothness {
    pub normal: f64,
    pub tangential: f64,
}

/// The paper's step [NMM08, equations 3 to 5]: every control point moves by the mean of the error vectors around it, weighted by the
/// barycentric weights of their footpoints.
pub(super) fn displace(samples: &[&Sample], mesh: &Connectivity, control_points: &mut [DVec3]) {
    let mut sums = vec![(DVec3::ZERO, 0.0); control_points.len()];
    for sample in samples {
        let SurfaceParameter { face, u, v } = sample.at;
        let corners = mesh.face(face as usize);
        for (&corner, weight) in corners.iter().zip([1.0 - u - v, u, v]) {
            let (sum, total) = &mut sums[corner as usize];
            *sum += weight * (sample.goal - sample.position);
            *total += weight;
        }
    }
    for (p, (sum, total)) in control_points.iter_mut().zip(sums) {
        if total > 0.0 {
            *p += sum / total;
        }
    }
}

/// Moves the control points to the least squares of the weighted distances of the footpoints from the data, with the regularizer.
///
/// A row of the matrix is the combination of control points that a footpoint is, or a row of `laplacian`
/// ([`crate::energy::laplacian`]), and counts by a 3×3 metric. Conjugate gradients multiply with the matrix and its transpose: with a few rows for
/// each control point that takes less than to assemble the normal equations.
pub(super) fn solve(
    samples: &[&Sample],
    laplacian: &Csr,
    smoothness: Smoothness,
    control: &mut PolygonMesh,
) {
    let control_points = control.positions.len();
    let rows = Csr::build(
        samples.len() + control_points,
        control_points,
        |r, row| match samples.get(r) {
            Some(sample) => row.extend_from_slice(&sample.row),
            None => row.extend(laplacian.row(r - samples.len())),
        },
    );
    let share = 1.0 / samples.len().max(1) as f64;
    let smooth_share = 1.0 / control_points as f64;
    let distances = samples.iter().map(|sample| {
        let metric = match sample.rim {
            Some(_) => Symmetric3::split(sample.direction, SLIDING, 1.0),
            None => Symmetric3::split(sample.direction, 1.0, SLIDING),
        };
        metric * (share * sample.weight)
    });
    let normals = vertex_normals(control);
    let bends = normals
        .iter()
        .map(|n| Symmetric3::split(*n, smoothness.normal, smoothness.tangential) * smooth_share);
    let metrics: Vec<Symmetric3> = distances.chain(bends).collect();
    let columns = rows.transpose();
    let weigh = |v: Vec<DVec3>| -> Vec<DVec3> {
        let pairs = v.into_par_iter().zip(&metrics).with_min_len(1024);
        pairs.map(|(v, metric)| *metric * v).collect()
    };
    let mut goals: Vec<DVec3> = samples.iter().map(|s| s.goal).collect();
    goals.resize(metrics.len(), DVec3::ZERO);
    let right = columns.apply(&weigh(goals));
    let diagonal: Vec<DMat3> = (0..control_points)
        .into_par_iter()
        .map(|c| {
            let entries = columns.row(c);
            let sum = |sum, (r, w): (u32, f64)| sum + metrics[r as usize] * (w * w);
            let block = entries.fold(Symmetric3::ZERO, sum);
            inverse_block(&block.matrix())
        })
        .collect();
    let apply = |x: &[DVec3]| columns.apply(&weigh(rows.apply(x)));
    conjugate_gradients(apply, &diagonal, &right, &mut control.positions, TOLERANCE);
}

/// Area-weighted unit normals at the control points.
fn vertex_normals(mesh: &PolygonMesh) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; mesh.positions.len()];
    for face in mesh.faces() {
        let [a, b, c] = [0, 1, 2].map(|k| mesh.positions[face[k] as usize]);
        let area_vector = (b - a).cross(c - a);
        for &v in face {
            normals[v as usize] += area_vector;
        }
    }
    normals.iter().map(|n| n.normalize_or_zero()).collect()
}
