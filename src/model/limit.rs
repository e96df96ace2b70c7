//! Limit positions: where subdivision takes a vertex in the end, as a mask over the faces around it.
//!
//! The mask is the left eigenvector, for the eigenvalue 1, of the matrix that takes the faces around the vertex to those one level finer:
//! - smooth, Catmull–Clark over quads (Halstead, Kass and DeRose 1993): (n² v + 4 Σ eᵢ + Σ fᵢ) / (n (n + 5)), eᵢ the neighbours and fᵢ the vertices across the quads;
//! - smooth, Loop: (v + (8 β / 3) Σ eᵢ) / (1 + 8 n β / 3);
//! - crease and boundary (cubic B-splines): (1, 4, 1) / 6; corner: the vertex itself;
//! - *dart*, one sharp edge e₀ among n: the smooth equations hold for the other edges, with e₀ taking no part in them. They are a recurrence
//!   2 cosh θ aᵢ = aᵢ₋₁ + aᵢ₊₁ + (2 cosh θ − 2) a with a the smooth weight of an edge, solved by
//!   aᵢ = a (1 − cosh((i − n/2) θ) / cosh(n θ / 2)); cosh θ is 7/2 for Catmull–Clark and 5/2 for Loop.
//!
//! Where semi-sharp edges or faces other than quads are around a vertex, its neighbourhood alone is refined (exactly) until none are.

use super::refinement::{Level, Row, Rule, Split, loop_beta};
use crate::kernel::sparse::Csr;

impl Level {
    /// The matrix `[vertices, vertices]` that takes the points of this level to their limits.
    pub fn limit(&self) -> Csr {
        let count = self.connectivity.vertex_count();
        Csr::build(count, count, |v, row| self.limit_row(v as u32, row))
    }

    fn limit_row(&self, v: u32, row: &mut Row) {
        if self.corners[v as usize] || self.is_stationary(v) {
            return self.push_limit(v, row);
        }
        let (part, vertices) = self.neighbourhood(v);
        let (finer, refinement) = part.refine();
        let mut fine_row = Row::new();
        finer.limit_row(0, &mut fine_row);
        for (fine, weight) in fine_row {
            let coarse = refinement.row(fine as usize);
            row.extend(coarse.map(|(u, w)| (vertices[u as usize], weight * w)));
        }
    }

    /// Whether the rules around `v` are the same at all finer levels.
    fn is_stationary(&self, v: u32) -> bool {
        let mesh = &self.connectivity;
        let lasting = |s: f64| s == 0.0 || s == f64::INFINITY;
        mesh.spokes(v)
            .all(|(e, _)| lasting(self.sharpness[e as usize]))
            && (self.split == Split::Triangles
                || mesh
                    .around(v)
                    .all(|h| mesh.half_edges(mesh.face_of(h) as usize).len() == 4))
    }

    fn push_limit(&self, v: u32, row: &mut Row) {
        match self.rule(v, 0.0) {
            Rule::Corner => row.push((v, 1.0)),
            Rule::Crease(neighbours) => {
                row.push((v, 2.0 / 3.0));
                row.extend(neighbours.map(|n| (n, 1.0 / 6.0)));
            }
            Rule::Smooth => {
                let start = row.len();
                match self.split {
                    Split::Quads => self.push_catmull_clark_limit(v, row),
                    Split::Triangles => self.push_loop_limit(v, row),
                }
                let sum: f64 = row[start..].iter().map(|e| e.1).sum();
                row[start..].iter_mut().for_each(|e| e.1 /= sum);
            }
        }
    }

    /// The mask scaled so that `v` has weight 1.
    fn push_catmull_clark_limit(&self, v: u32, row: &mut Row) {
        let mesh = &self.connectivity;
        let n = mesh.around(v).count();
        let step = 1.0 / (n * n) as f64;
        let edge = self.spoke_weights(v, 4.0 * step, 3.5);
        row.push((v, 1.0));
        for (i, h) in mesh.around(v).enumerate() {
            let (before, here, after) = (edge(i + n - 1), edge(i), edge(i + 1));
            // Of a face between two edges: a third of (1/n² + a quarter of their smooth weights).
            let face = |a: Spoke, b: Spoke| (step + 0.25 * (a.smooth() + b.smooth())) / 3.0;
            let weight = match here {
                Spoke::Smooth(weight) => weight,
                Spoke::Sharp => 2.0 * (step + face(before, here) + face(here, after)),
            };
            row.push((mesh.target(h), weight));
            row.push((mesh.target(mesh.next(h)), face(here, after)));
        }
    }

    /// The mask scaled so that `v` has weight 1.
    fn push_loop_limit(&self, v: u32, row: &mut Row) {
        let mesh = &self.connectivity;
        let n = mesh.around(v).count();
        let beta = loop_beta(n);
        let edge = self.spoke_weights(v, 8.0 / 3.0 * beta, 2.5);
        row.push((v, 1.0));
        for (i, h) in mesh.around(v).enumerate() {
            let (before, after) = (edge(i + n - 1), edge(i + 1));
            let weight = match edge(i) {
                Spoke::Smooth(weight) => weight,
                Spoke::Sharp => 2.0 * (beta + 0.125 * (before.smooth() + after.smooth())),
            };
            row.push((mesh.target(h), weight));
        }
    }

    /// The weight of edge `i` around an interior vertex: `smooth`, or the dart's solution where one is sharp.
    fn spoke_weights(&self, v: u32, smooth: f64, cosh: f64) -> impl Fn(usize) -> Spoke {
        let mesh = &self.connectivity;
        let n = mesh.around(v).count();
        let sharp = mesh
            .spokes(v)
            .position(|(e, _)| self.sharpness[e as usize] > 0.0);
        let decay = cosh - (cosh * cosh - 1.0).sqrt();
        let power = move |k: usize| decay.powi(k as i32);
        move |i| match sharp.map(|sharp| (i + n - sharp) % n) {
            None => Spoke::Smooth(smooth),
            Some(0) => Spoke::Sharp,
            Some(k) => Spoke::Smooth(smooth * (1.0 - (power(k) + power(n - k)) / (1.0 + power(n)))),
        }
    }
}

/// The weight of an edge in a limit mask.
#[derive(Clone, Copy)]
enum Spoke {
    Smooth(f64),
    /// The sharp edge of a dart: takes no part in the smooth equations; its own weight follows from its neighbours'.
    Sharp,
}

impl Spoke {
    fn smooth(self) -> f64 {
        match self {
            Self::Smooth(weight) => weight,
            Self::Sharp => 0.0,
        }
    }
}
