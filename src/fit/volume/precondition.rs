//! What is known of the curvature of the objective: the second derivatives of λ E_Ω near a rigid map, and those of E_S.
//!
//! H ≈ λ K(x) I + (2/(A L²)) Σ w n nᵀ B Bᵀ, K the stiffness matrix at the present shape, and what is known of the barrier on the elements
//! that it holds ([`super::barrier`]). Its 3 × 3 blocks on the diagonal are cheap and serve everywhere; what matters in them is that they
//! tell the normal of S from the tangents. Where the unknowns are few, all of H is factored: then a minimization takes a handful of
//! iterations where it would take a hundred.

use crate::optimize::cholesky::{Cholesky, LowerTriangle};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Nodes that one task takes at least.
const PER_TASK: usize = 1 << 14;

/// An approximate inverse of the Hessian.
#[derive(Debug)]
pub(super) enum Inverse {
    /// Of each node's own block. `[nodes]`.
    Blocks(Vec<DMat3>),
    /// Of all of it.
    Factor(Box<Cholesky>),
}

impl Inverse {
    /// From λ K_ii and the blocks of E_S on the diagonal. `[nodes]` both.
    pub fn of_diagonal(stiffness: &[f64], surface: &[DMat3]) -> Self {
        let blocks = stiffness.iter().zip(surface).map(|(&k, s)| {
            let block = DMat3::from_diagonal(DVec3::splat(k)) + *s;
            // A node that nothing holds stays where it is.
            if block.determinant() > 0.0 {
                block.inverse()
            } else {
                DMat3::ZERO
            }
        });
        Self::Blocks(blocks.collect())
    }

    /// From λ K and E_S, as (row, column, entry) with row ≥ column, to be added up. `None` where that is not positive definite.
    pub fn factored(
        nodes: usize,
        stiffness: impl Iterator<Item = (u32, u32, f64)>,
        surface: impl Iterator<Item = (u32, u32, DMat3)>,
    ) -> Option<Self> {
        let mut columns: Vec<Vec<(u32, Entry)>> = vec![Vec::new(); nodes];
        for (row, column, k) in stiffness {
            columns[column as usize].push((row, Entry::Isotropic(k)));
        }
        for (row, column, block) in surface {
            columns[column as usize].push((row, Entry::Block(block)));
        }
        columns.par_iter_mut().for_each(merge);
        Cholesky::new(&lower_triangle(&columns)).map(|factor| Self::Factor(Box::new(factor)))
    }

    /// H⁻¹ g.
    pub fn apply(&self, gradient: &[DVec3]) -> Vec<DVec3> {
        match self {
            Self::Blocks(blocks) => {
                let pairs = blocks.par_iter().zip(gradient).with_min_len(PER_TASK);
                pairs.map(|(b, g)| *b * *g).collect()
            }
            Self::Factor(factor) => {
                let mut right: Vec<f64> = gradient.iter().flat_map(|g| g.to_array()).collect();
                factor.solve(&mut right);
                right.chunks_exact(3).map(DVec3::from_slice).collect()
            }
        }
    }
}

/// What two nodes have to do with each other.
#[derive(Debug, Clone, Copy)]
enum Entry {
    /// A multiple of the identity: without contact to the surface the coordinates are independent.
    Isotropic(f64),
    Block(DMat3),
}

impl Entry {
    fn block(self) -> DMat3 {
        match self {
            Self::Isotropic(k) => DMat3::from_diagonal(DVec3::splat(k)),
            Self::Block(block) => block,
        }
    }

    fn plus(self, other: Self) -> Self {
        match (self, other) {
            (Self::Isotropic(a), Self::Isotropic(b)) => Self::Isotropic(a + b),
            (a, b) => Self::Block(a.block() + b.block()),
        }
    }
}

/// Sorts the entries of a column by row and adds up those of one row.
fn merge(column: &mut Vec<(u32, Entry)>) {
    column.sort_by_key(|e| e.0);
    column.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 = kept.1.plus(next.1);
        }
        same
    });
}

/// The matrix over coordinates, three to a node.
fn lower_triangle(columns: &[Vec<(u32, Entry)>]) -> LowerTriangle {
    let mut lower = LowerTriangle {
        offsets: vec![0],
        rows: Vec::new(),
        values: Vec::new(),
    };
    for (node, column) in columns.iter().enumerate() {
        for c in 0..3 {
            for &(row, entry) in column {
                let from = if row as usize == node { c } else { 0 };
                for d in from..3 {
                    let value = match entry {
                        Entry::Isotropic(_) if d != c => continue,
                        Entry::Isotropic(k) => k,
                        Entry::Block(block) => block.col(c)[d],
                    };
                    lower.rows.push(3 * row + d as u32);
                    lower.values.push(value);
                }
            }
            lower.offsets.push(lower.rows.len() as u32);
        }
    }
    lower
}
