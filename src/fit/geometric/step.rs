//! The two ways to move the control points towards the data on frozen footpoints.

use super::footpoints::Sample;
use crate::fit::normal_equations::{conjugate_gradients, inverse_block};
use crate::fit::symmetric::Symmetric3;
use crate::mesh::{Connectivity, PolygonMesh};
use crate::model::limit_surface::SurfaceParameter;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::ops::AddAssign;

/// μ: what a tangential distance counts against a normal one.
const SLIDING: f64 = 0.003;

/// The relative residual of the linear solves.
const TOLERANCE: f64 = 0.03;

/// Parts that rows are summed in, whatever the number of threads.
const PARTS: usize = 8;

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

/// A row of the least squares.
struct Row<'a> {
    /// A combination of control points.
    entries: &'a [(u32, f64)],
    /// How its distance from the goal counts.
    metric: Symmetric3,
    goal: DVec3,
}

impl Row<'_> {
    /// Where the control points `x` bring it.
    fn at(&self, x: &[DVec3]) -> DVec3 {
        self.entries.iter().map(|&(c, w)| w * x[c as usize]).sum()
    }

    /// Adds to each of its control points what `pull` has for its weight.
    fn spread<T: AddAssign>(&self, sums: &mut [T], pull: impl Fn(f64) -> T) {
        for &(c, w) in self.entries {
            sums[c as usize] += pull(w);
        }
    }
}

/// Moves control points, all or those that are `free`, to the least squares of the weighted distances of the footpoints from the data, with the
/// regularizer.
///
/// A row of the matrix is the combination of control points that a footpoint is, or a row of `laplacian`
/// ([`crate::energy::laplacian`]), and counts by a 3×3 metric. Conjugate gradients multiply with the matrix and its transpose row by row: with a few
/// rows for each control point that takes less than to assemble the normal equations.
pub(super) fn solve(
    samples: &[&Sample],
    laplacian: &[Vec<(u32, f64)>],
    smoothness: Smoothness,
    free: Option<&[bool]>,
    control: &mut PolygonMesh,
) {
    let count = control.positions.len();
    let share = 1.0 / samples.len().max(1) as f64;
    let smooth_share = 1.0 / count as f64;
    let normals = vertex_normals(control);
    let is_free = |c: u32| free.is_none_or(|free| free[c as usize]);
    let matters = |row: &Row| row.entries.iter().any(|&(c, _)| is_free(c));
    let distances = samples.par_iter().map(|sample| {
        let metric = match sample.rim {
            Some(_) => Symmetric3::split(sample.direction, SLIDING, 1.0),
            None => Symmetric3::split(sample.direction, 1.0, SLIDING),
        };
        Row {
            entries: &sample.row,
            metric: metric * (share * sample.weight),
            goal: sample.goal,
        }
    });
    let bends = laplacian.par_iter().zip(&normals).map(|(entries, n)| Row {
        entries,
        metric: Symmetric3::split(*n, smoothness.normal, smoothness.tangential) * smooth_share,
        goal: DVec3::ZERO,
    });
    let rows: Vec<Row> = distances.chain(bends).filter(matters).collect();
    let right = sums(&rows, count, DVec3::ZERO, |row, sums| {
        let pull = row.metric * row.goal;
        row.spread(sums, |w| w * pull);
    });
    let diagonal = sums(&rows, count, Symmetric3::ZERO, |row, sums| {
        row.spread(sums, |w| row.metric * (w * w));
    });
    let inverses: Vec<DMat3> = (diagonal.into_par_iter().enumerate())
        .map(|(c, block)| match is_free(c as u32) {
            true => inverse_block(&block.matrix()),
            false => DMat3::ZERO,
        })
        .collect();
    let apply = |x: &[DVec3]| {
        sums(&rows, count, DVec3::ZERO, |row, sums| {
            let pull = row.metric * row.at(x);
            row.spread(sums, |w| w * pull);
        })
    };
    conjugate_gradients(apply, &inverses, &right, &mut control.positions, TOLERANCE);
}

/// `[count]`: the sums of what each row adds, part by part in order.
fn sums<T: Copy + AddAssign + Send + Sync>(
    rows: &[Row<'_>],
    count: usize,
    zero: T,
    add: impl Fn(&Row<'_>, &mut [T]) + Sync,
) -> Vec<T> {
    let part = |rows: &[Row<'_>]| {
        let mut sums = vec![zero; count];
        rows.iter().for_each(|row| add(row, &mut sums));
        sums
    };
    let length = rows.len().div_ceil(PARTS).max(1);
    let mut parts: Vec<Vec<T>> = rows.par_chunks(length).map(part).collect();
    let mut total = parts.pop().unwrap_or_else(|| vec![zero; count]);
    total.par_iter_mut().enumerate().for_each(|(c, sum)| {
        parts.iter().for_each(|part| *sum += part[c]);
    });
    total
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn only_free_control_points_move_and_they_move_towards_the_data() {
        let ball = PolygonMesh::from(shapes::sphere(1.0, 1));
        let samples: Vec<Sample> = (0..ball.positions.len())
            .map(|v| {
                let mut sample = Sample::new(1.5 * ball.positions[v], None);
                sample.position = ball.positions[v];
                sample.direction = ball.positions[v].normalize();
                sample.row = vec![(v as u32, 1.0)];
                sample
            })
            .collect();
        let samples: Vec<&Sample> = samples.iter().collect();
        let weak = Smoothness {
            normal: 1e-6,
            tangential: 1e-6,
        };
        let laplacian = vec![Vec::new(); samples.len()];
        let free: Vec<bool> = (0..samples.len()).map(|c| c % 3 == 0).collect();
        let mut moved = ball.clone();
        solve(&samples, &laplacian, weak, Some(&free), &mut moved);
        for (c, is_free) in free.into_iter().enumerate() {
            let (before, after) = (ball.positions[c], moved.positions[c]);
            match is_free {
                true => assert!(after.distance(samples[c].goal) < 0.05, "{c}: {after}"),
                false => assert_eq!(before, after, "{c}"),
            }
        }
    }
}
