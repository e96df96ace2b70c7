//! Compressed sparse rows, and the products X = M P and Mᵀ G on three-vectors.

use super::{Kernel, worst_ratio};
use crate::device::{Batch, Buffer, Gpu, MAX_ITERATIONS, Shader, shared_struct, source};
use crate::error::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;

/// Rows that one task computes: enough to amortize its scratch, few enough to balance the load.
const ROWS_PER_TASK: usize = 1024;

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
        Self::build(rows.len(), column_count, |r, row| {
            row.extend_from_slice(&rows[r]);
        })
    }

    /// A matrix whose row `r` has the (column, value) entries that `fill(r, row)` pushes onto an empty list, in any order;
    /// entries of one column are added in the order pushed.
    pub fn build(
        row_count: usize,
        column_count: usize,
        fill: impl Fn(usize, &mut Vec<(u32, f64)>) + Sync,
    ) -> Self {
        Self::build_with(row_count, column_count, || (), |(), r, row| fill(r, row))
    }

    /// Like [`Csr::build`], with a scratch value that is reused from row to row.
    fn build_with<S>(
        row_count: usize,
        column_count: usize,
        scratch: impl Fn() -> S + Sync + Send,
        fill: impl Fn(&mut S, usize, &mut Vec<(u32, f64)>) + Sync,
    ) -> Self {
        let parts: Vec<Self> = (0..row_count.div_ceil(ROWS_PER_TASK))
            .into_par_iter()
            .map_init(scratch, |scratch, task| {
                let first = task * ROWS_PER_TASK;
                let mut part = Self {
                    offsets: vec![0],
                    ..Self::default()
                };
                let mut row = Vec::new();
                for r in first..row_count.min(first + ROWS_PER_TASK) {
                    row.clear();
                    fill(scratch, r, &mut row);
                    part.push_row(&mut row);
                }
                part
            })
            .collect();
        Self::stack(&parts, column_count)
    }

    /// Appends a row; sorts the entries given and adds those of one column.
    fn push_row(&mut self, row: &mut [(u32, f64)]) {
        row.sort_by_key(|e| e.0);
        for entries in row.chunk_by(|a, b| a.0 == b.0) {
            self.columns.push(entries[0].0);
            self.values
                .push(entries[1..].iter().fold(entries[0].1, |sum, e| sum + e.1));
        }
        self.offsets.push(self.columns.len() as u32);
    }

    /// The rows of all parts, one part below the other.
    pub(crate) fn stack(parts: &[Self], column_count: usize) -> Self {
        let entry_count = parts.iter().map(|p| p.columns.len()).sum();
        let mut matrix = Self {
            offsets: vec![0],
            columns: Vec::with_capacity(entry_count),
            values: Vec::with_capacity(entry_count),
            column_count,
        };
        for part in parts {
            let base = matrix.columns.len() as u32;
            matrix
                .offsets
                .extend(part.offsets[1..].iter().map(|o| base + o));
            matrix.columns.extend_from_slice(&part.columns);
            matrix.values.extend_from_slice(&part.values);
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

    /// The product with another matrix, each entry summed in the order of this matrix's row (Gustavson's row-wise scheme).
    pub fn multiply(&self, other: &Self) -> Self {
        assert_eq!(self.column_count, other.row_count());
        // `slots[c]` is where column c stands in the row under construction, if it stands there at all: checked by
        // looking, so that nothing need be cleared between rows.
        let slots = || vec![0u32; other.column_count];
        Self::build_with(
            self.row_count(),
            other.column_count,
            slots,
            |slots, r, row| {
                for (k, a) in self.row(r) {
                    for (c, b) in other.row(k as usize) {
                        match row.get_mut(slots[c as usize] as usize) {
                            Some((column, value)) if *column == c => *value += a * b,
                            _ => {
                                slots[c as usize] = row.len() as u32;
                                row.push((c, a * b));
                            }
                        }
                    }
                }
            },
        )
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

shared_struct! {
    /// The parameters of a dispatch.
    pub struct SparseParams {
        /// The number of rows.
        rows: u32,
    }
}

/// `shaders/sparse_product.wgsl`.
pub const SHADER: Shader = Shader {
    name: "sparse_product",
    structs: &[SparseParams::LAYOUT],
    sources: &[source!("shared/grid.wgsl"), source!("sparse_product.wgsl")],
    constants: &[],
};

/// A [`Csr`] on the device.
#[derive(Debug)]
pub struct GpuCsr {
    rows: usize,
    offsets: Buffer<u32>,
    columns: Buffer<u32>,
    values: Buffer<f32>,
}

impl GpuCsr {
    /// Uploads.
    ///
    /// # Errors
    /// Where the device has no room, or a row more entries than a thread may add.
    pub fn new(gpu: &Gpu, matrix: &Csr) -> Result<Self> {
        let longest = matrix.offsets.windows(2).map(|w| w[1] - w[0]).max();
        if longest.is_some_and(|entries| entries as usize > MAX_ITERATIONS) {
            return Err(Error::device(
                "a control point moves more than 60,000 vertices",
                "use fewer levels, or run on the CPU",
            ));
        }
        let values: Vec<_> = matrix.values.iter().map(|&v| v as f32).collect();
        Ok(Self {
            rows: matrix.row_count(),
            offsets: Buffer::from_slice(gpu, &matrix.offsets)?,
            columns: Buffer::from_slice(gpu, &matrix.columns)?,
            values: Buffer::from_slice(gpu, &values)?,
        })
    }

    /// Adds to a batch: `products = matrix · points`.
    ///
    /// # Errors
    /// Where a buffer passes the adapter's limits.
    pub fn apply(
        &self,
        gpu: &Gpu,
        batch: &mut Batch,
        points: &Buffer<[f32; 4]>,
        products: &Buffer<[f32; 4]>,
    ) -> Result<()> {
        let params = SparseParams {
            rows: self.rows as u32,
        };
        batch.dispatch(
            &gpu.pipeline(&SHADER, &[])?,
            self.rows,
            &params,
            &[
                &self.offsets.binding(),
                &self.columns.binding(),
                &self.values.binding(),
                &points.binding(),
                &products.binding(),
            ],
        )
    }
}

/// The twins of the sparse product.
#[derive(Debug)]
pub struct SparseProduct;

/// What is multiplied.
#[derive(Debug, Clone)]
pub struct SparseInput {
    /// The matrix.
    pub matrix: Csr,
    /// One a column.
    pub points: Vec<DVec3>,
}

/// A [`SparseInput`] on the device.
#[derive(Debug)]
pub struct ResidentSparse {
    matrix: GpuCsr,
    points: Buffer<[f32; 4]>,
    products: Buffer<[f32; 4]>,
}

impl Kernel for SparseProduct {
    const NAME: &'static str = SHADER.name;
    /// Of Σ|entry|·|point|, the sum that the row rounds. Points and entries lose 6e-8 each in f32, and a row of a subdivision matrix adds some
    /// twenty products. Measured: 1.5e-7.
    const TOLERANCE: f64 = 1e-6;
    type Input = SparseInput;
    /// One a row.
    type Output = Vec<DVec3>;
    type Resident = ResidentSparse;

    fn items(input: &SparseInput) -> usize {
        input.matrix.values.len()
    }

    fn cpu(input: &SparseInput) -> Vec<DVec3> {
        input.matrix.apply(&input.points)
    }

    fn upload(gpu: &Gpu, input: &SparseInput) -> Result<ResidentSparse> {
        Ok(ResidentSparse {
            matrix: GpuCsr::new(gpu, &input.matrix)?,
            points: Buffer::from_slice(gpu, &padded(&input.points))?,
            products: Buffer::zeroed(gpu, input.matrix.row_count())?,
        })
    }

    fn gpu(gpu: &Gpu, input: &mut ResidentSparse) -> Result<Vec<DVec3>> {
        let mut batch = gpu.batch();
        input
            .matrix
            .apply(gpu, &mut batch, &input.points, &input.products)?;
        let read = batch.read(&input.products);
        Ok(unpadded(&batch.submit()?.get(&read)))
    }

    fn compare(input: &SparseInput, cpu: &Vec<DVec3>, gpu: &Vec<DVec3>) -> f64 {
        worst_ratio((0..input.matrix.row_count()).map(|r| {
            let terms = input
                .matrix
                .row(r)
                .map(|(c, v)| v * input.points[c as usize]);
            let scale: f64 = terms.map(DVec3::length).sum();
            ((cpu[r] - gpu[r]).length(), scale)
        }))
    }
}

/// Points in single precision, as the device reads them: in the first three of four components.
pub(crate) fn padded(points: &[DVec3]) -> Vec<[f32; 4]> {
    points
        .iter()
        .map(|p| p.as_vec3().extend(0.0).to_array())
        .collect()
}

/// The first three of four components, in double precision.
pub(crate) fn unpadded(points: &[[f32; 4]]) -> Vec<DVec3> {
    points
        .iter()
        .map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into()))
        .collect()
}
#[cfg(test)]
mod tests {
    use super::*;

    fn dense(m: &Csr) -> Vec<Vec<f64>> {
        (0..m.row_count())
            .map(|r| {
                let mut row = vec![0.0; m.column_count];
                m.row(r).for_each(|(c, v)| row[c as usize] += v);
                row
            })
            .collect()
    }

    #[test]
    fn rows_are_sorted_and_merged() {
        let m = Csr::from_rows(&[vec![(2, 1.0), (0, 3.0), (2, 0.5)], vec![]], 4);
        assert_eq!(m.offsets, [0, 2, 2]);
        assert_eq!(m.columns, [0, 2]);
        assert_eq!(m.values, [3.0, 1.5]);
        assert_eq!(Csr::from_rows(&[], 3).row_count(), 0);
    }

    #[test]
    fn product_equals_the_dense_product_over_several_tasks() {
        let rows = 2 * ROWS_PER_TASK + 7;
        let banded = |rows: usize, columns: usize| {
            Csr::build(rows, columns, |r, row| {
                for k in [0, 5, 5, 11] {
                    row.push((((r * 7 + k * 3) % columns) as u32, (r + k) as f64 - 3.0));
                }
            })
        };
        let (a, b) = (banded(rows, 13), banded(13, 17));
        let (da, db, dc) = (dense(&a), dense(&b), dense(&a.multiply(&b)));
        for r in 0..rows {
            for c in 0..17 {
                let exact: f64 = (0..13).map(|k| da[r][k] * db[k][c]).sum();
                assert_eq!(dc[r][c], exact, "entry {r}, {c}: integers, so exact");
            }
        }
    }
}
