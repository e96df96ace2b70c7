//! Small dense matrices applied along one axis of an array: the inner loop of sum factorization.
//!
//! Elements are evaluated [`LANES`] at a time, side by side, so that the loop over an axis is the same for every order and shape and always
//! full: each entry of a matrix multiplies a [`Node`], the three coordinates of all lanes.

use crate::geometry::vector::{Arithmetic, Work, fastest};

/// Elements evaluated side by side: one AVX2 register of f64.
pub const LANES: usize = 4;

/// Three coordinates of a mode or a point for every lane: `3 × LANES`, lanes fastest.
pub type Node = [f64; 3 * LANES];

/// Nothing.
pub const ZERO: Node = [0.0; 3 * LANES];

/// Rows computed together: with these, sums and operands fill the 16 vector registers of AVX2.
const TILE: usize = 4;

/// A dense matrix, stored as the inner loop reads it: rows in tiles of at most [`TILE`], column by column within a tile.
#[derive(Debug, Clone, PartialEq)]
pub struct Matrix {
    rows: usize,
    columns: usize,
    packed: Vec<f64>,
}

impl Matrix {
    /// From its entries.
    pub fn from_fn(rows: usize, columns: usize, entry: impl Fn(usize, usize) -> f64) -> Self {
        let mut packed = Vec::with_capacity(rows * columns);
        for (first, height) in tiles(rows) {
            for column in 0..columns {
                packed.extend((first..first + height).map(|row| entry(row, column)));
            }
        }
        Self {
            rows,
            columns,
            packed,
        }
    }

    /// From entries row by row.
    pub fn from_rows(columns: usize, entries: &[f64]) -> Self {
        Self::from_fn(entries.len() / columns, columns, |r, c| {
            entries[r * columns + c]
        })
    }

    /// With rows and columns exchanged, from entries row by row.
    pub fn transposed(columns: usize, entries: &[f64]) -> Self {
        Self::from_fn(columns, entries.len() / columns, |r, c| {
            entries[c * columns + r]
        })
    }

    /// The number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// `output[row, k] = Σ_column entry · input[column, k]` for k below `run`, the fast axis of both arrays.
    pub fn apply(&self, input: &[Node], run: usize, output: &mut [Node]) {
        self.multiply(input, run, output, false);
    }

    /// The same, added to what is there.
    pub fn add(&self, input: &[Node], run: usize, output: &mut [Node]) {
        self.multiply(input, run, output, true);
    }

    fn multiply(&self, input: &[Node], run: usize, output: &mut [Node], accumulate: bool) {
        fastest(Product {
            matrix: self,
            input: &input[..self.columns * run],
            run,
            output: &mut output[..self.rows * run],
            accumulate,
        });
    }
}

/// First row and height of the tiles, as equal as can be.
fn tiles(rows: usize) -> impl Iterator<Item = (usize, usize)> {
    let count = rows.div_ceil(TILE);
    (0..count).map(move |k| {
        let (first, next) = (k * rows / count, (k + 1) * rows / count);
        (first, next - first)
    })
}

struct Product<'a> {
    matrix: &'a Matrix,
    input: &'a [Node],
    run: usize,
    output: &'a mut [Node],
    accumulate: bool,
}

impl Work for Product<'_> {
    #[inline(always)]
    fn run<A: Arithmetic>(mut self) {
        let mut packed = self.matrix.packed.as_slice();
        for (first, height) in tiles(self.matrix.rows) {
            let (tile, rest) = packed.split_at(height * self.matrix.columns);
            packed = rest;
            match height {
                4 => self.rows::<A, 4>(tile, first),
                3 => self.rows::<A, 3>(tile, first),
                2 => self.rows::<A, 2>(tile, first),
                _ => self.rows::<A, 1>(tile, first),
            }
        }
    }
}

impl Product<'_> {
    #[inline(always)]
    fn rows<A: Arithmetic, const ROWS: usize>(&mut self, tile: &[f64], first: usize) {
        let run = self.run;
        for k in 0..run {
            let mut sums = [ZERO; ROWS];
            if self.accumulate {
                for (row, sum) in sums.iter_mut().enumerate() {
                    *sum = self.output[(first + row) * run + k];
                }
            }
            let mut at = k;
            for entries in tile.as_chunks::<ROWS>().0 {
                let node = &self.input[at];
                for (sum, &entry) in sums.iter_mut().zip(entries) {
                    for (s, &x) in sum.iter_mut().zip(node) {
                        *s = A::mul_add(entry, x, *s);
                    }
                }
                at += run;
            }
            for (row, sum) in sums.iter().enumerate() {
                self.output[(first + row) * run + k] = *sum;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;

    #[test]
    fn products_are_those_of_the_definition() {
        let random = &mut Random::new(1);
        for (rows, columns, run) in [(1, 1, 1), (2, 5, 3), (3, 2, 1), (14, 13, 4), (9, 1, 2)] {
            let entries: Vec<f64> = (0..rows * columns).map(|_| random.normal()).collect();
            let mut nodes = |n: usize| -> Vec<Node> {
                (0..n)
                    .map(|_| std::array::from_fn(|_| random.normal()))
                    .collect()
            };
            let (input, before) = (nodes(columns * run), nodes(rows * run));
            let expected = |row: usize, k: usize, l: usize| -> f64 {
                (0..columns)
                    .map(|c| entries[row * columns + c] * input[c * run + k][l])
                    .sum()
            };
            let matrix = Matrix::from_rows(columns, &entries);
            let (mut set, mut added) = (before.clone(), before.clone());
            matrix.apply(&input, run, &mut set);
            matrix.add(&input, run, &mut added);
            for row in 0..rows {
                for k in 0..run {
                    for l in 0..3 * LANES {
                        let (at, x) = (row * run + k, expected(row, k, l));
                        assert!((set[at][l] - x).abs() < 1e-13);
                        assert!((added[at][l] - before[at][l] - x).abs() < 1e-13);
                    }
                }
            }
            let transposed: Vec<f64> = (0..rows * columns)
                .map(|k| entries[k % rows * columns + k / rows])
                .collect();
            assert_eq!(matrix, Matrix::transposed(rows, &transposed));
        }
    }
}
