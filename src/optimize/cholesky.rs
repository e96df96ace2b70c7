//! The Cholesky factor of a sparse symmetric positive definite matrix, by faer's supernodal elimination after an approximate
//! minimum degree ordering.
//!
//! On one thread: a parallel elimination would split its sums by the number of threads, and results must not depend on that.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

/// The lower triangle of a symmetric matrix, column by column.
#[derive(Debug, Clone, PartialEq)]
pub struct LowerTriangle {
    /// `[columns + 1]`.
    pub offsets: Vec<u32>,
    /// `[entries]`: rows, ascending within a column and not less than it.
    pub rows: Vec<u32>,
    /// `[entries]`.
    pub values: Vec<f64>,
}

/// A factored matrix.
#[derive(Debug)]
pub struct Cholesky {
    symbolic: SymbolicCholesky<u32>,
    values: Vec<f64>,
}

impl Cholesky {
    /// Factors a matrix; `None` where it is not positive definite to working precision, or memory does not suffice.
    pub fn new(matrix: &LowerTriangle) -> Option<Self> {
        let n = matrix.offsets.len() - 1;
        let pattern =
            SymbolicSparseColMatRef::new_checked(n, n, &matrix.offsets, None, &matrix.rows);
        let symbolic = factorize_symbolic_cholesky(
            pattern,
            Side::Lower,
            SymmetricOrdering::Amd,
            CholeskySymbolicParams::default(),
        )
        .ok()?;
        let mut values = vec![0.0; symbolic.len_val()];
        let need = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let mut memory = MemBuffer::try_new(need).ok()?;
        symbolic
            .factorize_numeric_llt(
                &mut values,
                SparseColMatRef::new(pattern, &matrix.values),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Default::default(),
            )
            .ok()?;
        Some(Self { symbolic, values })
    }

    /// Replaces a right side by the solution.
    ///
    /// # Panics
    /// Where its length is not the matrix's.
    pub fn solve(&self, right: &mut [f64]) {
        let n = right.len();
        let need = self.symbolic.solve_in_place_scratch::<f64>(1, Par::Seq);
        LltRef::new(&self.symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(right, n, 1),
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(need)),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid's Laplacian plus `shift` on the diagonal.
    fn grid(side: u32, shift: f64) -> LowerTriangle {
        let mut matrix = LowerTriangle {
            offsets: vec![0],
            rows: Vec::new(),
            values: Vec::new(),
        };
        for v in 0..side * side {
            matrix.rows.push(v);
            matrix.values.push(4.0 + shift);
            if v % side + 1 < side {
                matrix.rows.push(v + 1);
                matrix.values.push(-1.0);
            }
            if v + side < side * side {
                matrix.rows.push(v + side);
                matrix.values.push(-1.0);
            }
            matrix.offsets.push(matrix.rows.len() as u32);
        }
        matrix
    }

    fn product(matrix: &LowerTriangle, x: &[f64]) -> Vec<f64> {
        let mut y = vec![0.0; x.len()];
        for column in 0..x.len() {
            for k in matrix.offsets[column] as usize..matrix.offsets[column + 1] as usize {
                let row = matrix.rows[k] as usize;
                y[row] += matrix.values[k] * x[column];
                if row != column {
                    y[column] += matrix.values[k] * x[row];
                }
            }
        }
        y
    }

    #[test]
    fn solves_what_it_factored_and_refuses_what_is_indefinite() {
        for side in [1, 2, 40] {
            let matrix = grid(side, 0.1);
            let x: Vec<f64> = (0..side * side)
                .map(|k| f64::from(k * 7 % 11) - 5.0)
                .collect();
            let mut solution = product(&matrix, &x);
            Cholesky::new(&matrix).unwrap().solve(&mut solution);
            let error = x.iter().zip(&solution).map(|(a, b)| (a - b).abs());
            assert!(error.fold(0.0, f64::max) < 1e-10);
        }
        assert!(Cholesky::new(&grid(10, -4.0)).is_none());
    }
}
