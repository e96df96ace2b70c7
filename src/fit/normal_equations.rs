//! Normal equations of least squares whose rows fall into parts: sparse symmetric matrices of symmetric 3×3 blocks, assembled part by part, and their solution.
//!
//! A part (a face of the control mesh, say) sees few control points, its *support*. Its share of the matrix is a small dense one, of which only pairs
//! of control points that share a row are stored: a quarter less in a polish. Parts are computed in
//! parallel and added up in order, so that the result does not depend on the number of threads. Conjugate gradients with 3×3 block-Jacobi
//! preconditioning solve the system.

use super::symmetric::Symmetric3;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Parts assembled in parallel while those before them are added up in order.
const BATCH: usize = 64;

/// Conjugate-gradient steps at most.
const STEPS: usize = 500;

/// The control points that a part sees.
pub(super) struct Support {
    /// Ascending.
    pub controls: Vec<u32>,
    /// `[controls, controls]`: whether the two share a row.
    related: Vec<bool>,
}

impl Support {
    /// Of the part's rows, each by the control points that it is over. Several rows may stand as one over all of theirs.
    pub fn of(rows: &[Vec<u32>]) -> Self {
        let mut controls = rows.concat();
        controls.sort_unstable();
        controls.dedup();
        let n = controls.len();
        let mut related = vec![false; n * n];
        for row in rows {
            let local = |x| controls.binary_search(x).expect("listed above");
            let row: Vec<usize> = row.iter().map(local).collect();
            for &i in &row {
                for &j in &row {
                    related[i * n + j] = true;
                }
            }
        }
        Self { controls, related }
    }

    /// The pairs of a row, as places in the support, from the diagonal on.
    fn upper(&self) -> impl Iterator<Item = (usize, usize)> {
        let n = self.controls.len();
        let pairs = (0..n).flat_map(move |i| (i..n).map(move |j| (i, j)));
        pairs.filter(move |&(i, j)| self.related[i * n + j])
    }
}

/// Which control points share a row; reused while the parts stay.
pub(super) struct Pattern {
    parts: Vec<Part>,
    /// `[control points + 1]` and `[blocks]`: the block pattern.
    offsets: Vec<u32>,
    columns: Vec<u32>,
}

struct Part {
    support: Vec<u32>,
    pairs: Vec<Pair>,
}

/// Two control points of a part that share a row.
struct Pair {
    /// The place in the part's matrix.
    local: u32,
    /// The places in the block pattern, of the block and of its mirror image.
    places: [u32; 2],
}

/// A part's share: the matrix `[support, support]`, needed from the diagonal on, and the right-hand side.
pub(super) type Share = (Vec<Symmetric3>, Vec<DVec3>);

impl Pattern {
    /// The pattern of parts with these supports.
    pub fn new(supports: Vec<Support>, control_points: usize) -> Self {
        let mut pairs: Vec<u64> = supports
            .iter()
            .flat_map(|support| {
                let of = |i: usize| u64::from(support.controls[i]);
                support
                    .upper()
                    .flat_map(move |(i, j)| [of(i) << 32 | of(j), of(j) << 32 | of(i)])
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
        let place = |i: u32, j: u32| -> u32 {
            let begin = offsets[i as usize] as usize;
            let row = &columns[begin..offsets[i as usize + 1] as usize];
            let at = row.binary_search(&j).expect("every pair is in the pattern");
            (begin + at) as u32
        };
        let parts = supports
            .into_par_iter()
            .map(|support| Part {
                pairs: support
                    .upper()
                    .map(|(i, j)| {
                        let (a, b) = (support.controls[i], support.controls[j]);
                        Pair {
                            local: (i * support.controls.len() + j) as u32,
                            places: [place(a, b), place(b, a)],
                        }
                    })
                    .collect(),
                support: support.controls,
            })
            .collect();
        Self {
            parts,
            offsets,
            columns,
        }
    }

    /// The sum of the parts' shares, which are symmetric.
    pub fn assemble(&self, share: impl Fn(usize) -> Share + Sync) -> System<'_> {
        let mut system = System {
            pattern: self,
            blocks: vec![Symmetric3::ZERO; self.columns.len()],
            right: vec![DVec3::ZERO; self.offsets.len() - 1],
        };
        let shares = |first: usize| -> Vec<Share> {
            let end = (first + BATCH).min(self.parts.len());
            (first..end).into_par_iter().map(&share).collect()
        };
        let mut next = shares(0);
        for first in (0..self.parts.len()).step_by(BATCH) {
            let ready = std::mem::take(&mut next);
            rayon::join(
                || system.add(&self.parts[first..], ready),
                || next = shares(first + BATCH),
            );
        }
        system
    }
}

/// A symmetric matrix of symmetric 3×3 blocks and a right-hand side.
pub(super) struct System<'a> {
    pattern: &'a Pattern,
    blocks: Vec<Symmetric3>,
    right: Vec<DVec3>,
}

impl System<'_> {
    /// Adds the shares of the first of these parts.
    fn add(&mut self, parts: &[Part], shares: Vec<Share>) {
        for (part, (blocks, right)) in parts.iter().zip(shares) {
            for &Pair { local, places } in &part.pairs {
                let [upper, lower] = places;
                self.blocks[upper as usize] += blocks[local as usize];
                if lower != upper {
                    self.blocks[lower as usize] += blocks[local as usize];
                }
            }
            for (&control, r) in part.support.iter().zip(right) {
                self.right[control as usize] += r;
            }
        }
    }

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
                inverse_block(&self.blocks[begin + at].matrix())
            })
            .collect()
    }

    /// Moves `x` towards the solution until the residual is `tolerance` of the first one.
    pub fn conjugate_gradients(&self, x: &mut [DVec3], tolerance: f64) {
        let apply = |x: &[DVec3]| self.apply(x);
        conjugate_gradients(apply, &self.preconditioner(), &self.right, x, tolerance);
    }
}

/// Moves `x` towards the solution of A x = `right` until the residual is `tolerance` of the first one. `apply`: the product of A, symmetric and
/// positive, with a vector; `preconditioner`: about the inverse of its diagonal blocks, or zero for what is to stay.
pub(super) fn conjugate_gradients(
    apply: impl Fn(&[DVec3]) -> Vec<DVec3>,
    preconditioner: &[DMat3],
    right: &[DVec3],
    x: &mut [DVec3],
    tolerance: f64,
) {
    let dot = |a: &[DVec3], b: &[DVec3]| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum() };
    let precondition = |r: &[DVec3]| -> Vec<DVec3> {
        let pairs = r.iter().zip(preconditioner);
        pairs.map(|(r, m)| *m * *r).collect()
    };
    let pairs = right.iter().zip(apply(x));
    let mut r: Vec<DVec3> = pairs.map(|(b, ax)| *b - ax).collect();
    let mut z = precondition(&r);
    let mut p = z.clone();
    let mut rz = dot(&r, &z);
    let goal = tolerance * tolerance * rz;
    for _ in 0..STEPS {
        if rz <= goal || rz <= 0.0 {
            return;
        }
        let ap = apply(&p);
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

/// The inverse of a diagonal block; a control point that nothing pulls on stays where it is.
pub(super) fn inverse_block(block: &DMat3) -> DMat3 {
    let scale = block.x_axis.x + block.y_axis.y + block.z_axis.z;
    if block.determinant() > 1e-30 * scale * scale * scale {
        block.inverse()
    } else {
        DMat3::IDENTITY
    }
}
