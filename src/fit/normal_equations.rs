//! Normal equations of least squares whose rows fall into parts: sparse symmetric matrices of 3×3 blocks, assembled part by part, and their solution.
//!
//! A part (a face of the control mesh, say) sees few control points, its *support*. Its share of the matrix is a small dense one. Parts are computed in
//! parallel and added up in order, so that the result does not depend on the number of threads. Conjugate gradients with 3×3 block-Jacobi
//! preconditioning solve the system.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Parts assembled in parallel before they are added up in order.
const BATCH: usize = 256;

/// Conjugate-gradient steps at most.
const STEPS: usize = 500;

/// Which control points share a part; reused while the parts stay.
pub(super) struct Pattern {
    parts: Vec<Part>,
    /// `[control points + 1]` and `[blocks]`: the block pattern.
    offsets: Vec<u32>,
    columns: Vec<u32>,
}

struct Part {
    support: Vec<u32>,
    /// The place of each pair of the support in the block pattern.
    places: Vec<u32>,
}

/// A part's share: the matrix `[support, support]`, needed from the diagonal on, and the right-hand side.
pub(super) type Share = (Vec<DMat3>, Vec<DVec3>);

impl Pattern {
    /// The pattern of parts with these supports, each ascending.
    pub fn new(supports: Vec<Vec<u32>>, control_points: usize) -> Self {
        let mut pairs: Vec<u64> = supports
            .iter()
            .flat_map(|support| {
                let pair = |i: u32, j: u32| u64::from(i) << 32 | u64::from(j);
                support
                    .iter()
                    .flat_map(move |&i| support.iter().map(move |&j| pair(i, j)))
            })
            .collect();
        pairs.par_sort_unstable();
        pairs.dedup();
        let mut offsets = vec![0u32; control_points + 1];
        for &pair in &pairs {
            offsets[(pair >> 32) as usize + 1] += 1;
        }
        for i in 0..control_points {
            offsets[i + 1] += offsets[i];
        }
        let columns: Vec<u32> = pairs.iter().map(|&pair| pair as u32).collect();
        let places = |support: &[u32]| -> Vec<u32> {
            let place = |&i: &u32, j: &u32| {
                let begin = offsets[i as usize] as usize;
                let row = &columns[begin..offsets[i as usize + 1] as usize];
                let at = row.binary_search(j).expect("every pair is in the pattern");
                (begin + at) as u32
            };
            let row = |i| support.iter().map(move |j| place(i, j));
            support.iter().flat_map(row).collect()
        };
        let parts = supports
            .into_par_iter()
            .map(|support| Part {
                places: places(&support),
                support,
            })
            .collect();
        Self {
            parts,
            offsets,
            columns,
        }
    }

    /// The control points that part `k` sees, ascending.
    pub fn support(&self, k: usize) -> &[u32] {
        &self.parts[k].support
    }

    /// The sum of the parts' shares, which are symmetric.
    pub fn assemble(&self, share: impl Fn(usize) -> Share + Sync) -> System<'_> {
        let mut system = System {
            pattern: self,
            blocks: vec![DMat3::ZERO; self.columns.len()],
            right: vec![DVec3::ZERO; self.offsets.len() - 1],
        };
        for first in (0..self.parts.len()).step_by(BATCH) {
            let end = (first + BATCH).min(self.parts.len());
            let shares: Vec<Share> = (first..end).into_par_iter().map(&share).collect();
            for (part, (blocks, right)) in self.parts[first..end].iter().zip(shares) {
                part.add_symmetric(&blocks, &mut system.blocks);
                for (&control, r) in part.support.iter().zip(right) {
                    system.right[control as usize] += r;
                }
            }
        }
        system
    }
}

impl Part {
    /// Adds its share of the matrix, given from the diagonal on, to the whole.
    fn add_symmetric(&self, upper: &[DMat3], blocks: &mut [DMat3]) {
        let n = self.support.len();
        for i in 0..n {
            blocks[self.places[i * n + i] as usize] += upper[i * n + i];
            for j in i + 1..n {
                let block = upper[i * n + j];
                blocks[self.places[i * n + j] as usize] += block;
                blocks[self.places[j * n + i] as usize] += block.transpose();
            }
        }
    }
}

/// A symmetric matrix of 3×3 blocks and a right-hand side.
pub(super) struct System<'a> {
    pattern: &'a Pattern,
    blocks: Vec<DMat3>,
    right: Vec<DVec3>,
}

impl System<'_> {
    fn apply(&self, x: &[DVec3]) -> Vec<DVec3> {
        let Pattern {
            offsets, columns, ..
        } = self.pattern;
        (0..x.len())
            .into_par_iter()
            .with_min_len(128)
            .map(|i| {
                let range = offsets[i] as usize..offsets[i + 1] as usize;
                columns[range.clone()]
                    .iter()
                    .zip(&self.blocks[range])
                    .fold(DVec3::ZERO, |sum, (&j, block)| sum + *block * x[j as usize])
            })
            .collect()
    }

    fn preconditioner(&self) -> Vec<DMat3> {
        (0..self.right.len())
            .map(|i| {
                let begin = self.pattern.offsets[i] as usize;
                let row = &self.pattern.columns[begin..self.pattern.offsets[i + 1] as usize];
                let Ok(at) = row.binary_search(&(i as u32)) else {
                    return DMat3::IDENTITY;
                };
                let block = self.blocks[begin + at];
                let scale = block.x_axis.x + block.y_axis.y + block.z_axis.z;
                // A control point that nothing pulls on stays where it is.
                if block.determinant() > 1e-30 * scale * scale * scale {
                    block.inverse()
                } else {
                    DMat3::IDENTITY
                }
            })
            .collect()
    }

    /// Moves `x` towards the solution until the residual is `tolerance` of the first one.
    pub fn conjugate_gradients(&self, x: &mut [DVec3], tolerance: f64) {
        let inverse = self.preconditioner();
        let dot =
            |a: &[DVec3], b: &[DVec3]| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum() };
        let mut r: Vec<DVec3> = self
            .right
            .iter()
            .zip(self.apply(x))
            .map(|(b, ax)| *b - ax)
            .collect();
        let precondition =
            |r: &[DVec3]| -> Vec<DVec3> { r.iter().zip(&inverse).map(|(r, m)| *m * *r).collect() };
        let mut z = precondition(&r);
        let mut p = z.clone();
        let mut rz = dot(&r, &z);
        let goal = tolerance * tolerance * rz;
        for _ in 0..STEPS {
            if rz <= goal || rz <= 0.0 {
                return;
            }
            let ap = self.apply(&p);
            let curvature = dot(&p, &ap);
            if curvature <= 0.0 {
                return;
            }
            let alpha = rz / curvature;
            for i in 0..x.len() {
                x[i] += alpha * p[i];
                r[i] -= alpha * ap[i];
            }
            z = precondition(&r);
            let next = dot(&r, &z);
            let beta = next / rz;
            rz = next;
            for (p, z) in p.iter_mut().zip(&z) {
                *p = *z + beta * *p;
            }
        }
    }
}

/// along · n nᵀ + across · (I − n nᵀ).
pub(super) fn split(n: DVec3, along: f64, across: f64) -> DMat3 {
    let outer = DMat3::from_cols(n * n.x, n * n.y, n * n.z);
    DMat3::from_diagonal(DVec3::splat(across)) + outer * (along - across)
}
