//! Compressed sparse rows, and the products X = M P and Mᵀ G on three-vectors.

use glam::DVec3;
use rayon::prelude::*;

/// A sparse matrix with scalar entries, applied to arrays of points.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Csr {
    /// `[rows + 1]`.
    pub offsets: Vec<u32>,
    /// `[entries]`, ascending within a row.
    pub columns: Vec<u32>,
    /// `[entries]`.
    pub values: Vec<f64>,
    /// The number of columns.
    pub column_count: usize,
}

impl Csr {
    /// The identity of size `n`.
    pub fn identity(n: usize) -> Self {
        Self {
            offsets: (0..=n as u32).collect(),
            columns: (0..n as u32).collect(),
            values: vec![1.0; n],
            column_count: n,
        }
    }

    /// A matrix from its rows' (column, value) entries; entries of one column are added, columns sorted.
    pub fn from_rows(rows: &[Vec<(u32, f64)>], column_count: usize) -> Self {
        let mut matrix = Self {
            offsets: vec![0],
            column_count,
            ..Self::default()
        };
        for row in rows {
            let mut row = row.clone();
            row.sort_by_key(|e| e.0);
            let start = matrix.columns.len();
            for (c, v) in row {
                match matrix.columns.last() {
                    Some(&last) if matrix.columns.len() > start && last == c => {
                        *matrix
                            .values
                            .last_mut()
                            .expect("columns and values pair up") += v;
                    }
                    _ => {
                        matrix.columns.push(c);
                        matrix.values.push(v);
                    }
                }
            }
            matrix.offsets.push(matrix.columns.len() as u32);
        }
        matrix
    }

    /// The number of rows.
    pub fn row_count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// The (column, value) entries of a row.
    pub fn row(&self, r: usize) -> impl ExactSizeIterator<Item = (u32, f64)> + Clone + '_ {
        let range = self.offsets[r] as usize..self.offsets[r + 1] as usize;
        self.columns[range.clone()]
            .iter()
            .copied()
            .zip(self.values[range].iter().copied())
    }

    /// The transpose, rows again sorted by column.
    pub fn transpose(&self) -> Self {
        let mut offsets = vec![0u32; self.column_count + 1];
        for &c in &self.columns {
            offsets[c as usize + 1] += 1;
        }
        for i in 0..self.column_count {
            offsets[i + 1] += offsets[i];
        }
        let mut next = offsets.clone();
        let mut columns = vec![0; self.columns.len()];
        let mut values = vec![0.0; self.values.len()];
        for r in 0..self.row_count() {
            for (c, v) in self.row(r) {
                let k = next[c as usize] as usize;
                next[c as usize] += 1;
                columns[k] = r as u32;
                values[k] = v;
            }
        }
        Self {
            offsets,
            columns,
            values,
            column_count: self.row_count(),
        }
    }

    /// The product with another matrix.
    pub fn multiply(&self, other: &Self) -> Self {
        assert_eq!(self.column_count, other.row_count());
        let rows: Vec<Vec<(u32, f64)>> = (0..self.row_count())
            .into_par_iter()
            .map(|r| {
                self.row(r)
                    .flat_map(|(k, a)| other.row(k as usize).map(move |(c, b)| (c, a * b)))
                    .collect()
            })
            .collect();
        Self::from_rows(&rows, other.column_count)
    }

    /// The product with an array of points, each row summed in the order of its columns.
    pub fn apply(&self, x: &[DVec3]) -> Vec<DVec3> {
        assert_eq!(x.len(), self.column_count);
        (0..self.row_count())
            .into_par_iter()
            .with_min_len(256)
            .map(|r| {
                self.row(r)
                    .fold(DVec3::ZERO, |sum, (c, v)| sum + v * x[c as usize])
            })
            .collect()
    }
}
