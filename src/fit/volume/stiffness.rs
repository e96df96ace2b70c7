//! The stiffness matrix of a curved element, K_ab = ∫ ∇N_a · ∇N_b with the gradients taken in space: what the second derivatives
//! of the distortion are near a rigid map, component by component. Preconditioners are made of it.
//!
//! With J = ∇h the spatial gradient of a mode is J⁻ᵀ ∇N, so K_ab = Σ_q w_q ∇N_aᵀ (JᵀJ)⁻¹ ∇N_b. On its diagonal each of the
//! six entries of (JᵀJ)⁻¹ multiplies products of functions of one factor each, so that it costs six sum factorizations.

use crate::model::element::{Quadrature, Table, Tables};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, Mat, MatRef, Par};
use glam::{DMat3, DVec3};

/// The stiffness of elements of one shape, basis and order.
#[derive(Debug, Clone)]
pub(super) struct Stiffness {
    tables: Tables,
    weights: Vec<f64>,
}

/// The upper triangle of a symmetric 3 × 3 matrix, by rows.
const PAIRS: [[usize; 2]; 6] = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]];

impl Stiffness {
    /// Of elements whose modes at the points of the rule are `tables`.
    pub fn new(tables: Tables, quadrature: &Quadrature) -> Self {
        Self {
            tables,
            weights: quadrature.weights.clone(),
        }
    }

    /// w_q (JᵀJ)⁻¹ at the points of an element with these coefficients.
    fn metrics(&self, coefficients: &[DVec3]) -> Vec<DMat3> {
        let gradients = self.tables.gradients(coefficients);
        gradients
            .iter()
            .zip(&self.weights)
            .map(|(j, &weight)| (j.transpose() * *j).inverse() * weight)
            .collect()
    }

    /// K_aa of every local mode.
    pub fn diagonal(&self, coefficients: &[DVec3]) -> Vec<f64> {
        let metrics = self.metrics(coefficients);
        let modes = self.tables.factors.iter().map(|t| t.modes).product();
        let mut diagonal = vec![0.0; modes];
        for [i, j] in PAIRS {
            let twice = if i == j { 1.0 } else { 2.0 };
            let mut array: Vec<f64> = metrics.iter().map(|m| twice * m.col(i)[j]).collect();
            let (mut inner, mut first) = (1, 0);
            for table in &self.tables.factors {
                let (a, b) = (part(table, first, i), part(table, first, j));
                array = project(&array, a, b, table.modes, inner);
                inner *= table.modes;
                first += table.derivatives.len();
            }
            diagonal.iter_mut().zip(&array).for_each(|(d, x)| *d += x);
        }
        diagonal
    }

    /// K of the local modes in `present`, of which only the lower triangle is meant.
    pub fn matrix(&self, coefficients: &[DVec3], present: &[usize]) -> Mat<f64> {
        let metrics = self.metrics(coefficients);
        let modes = present.len();
        let mut roots = vec![0.0; modes * 3 * metrics.len()];
        for (q, (column, metric)) in roots.chunks_exact_mut(3 * modes).zip(&metrics).enumerate() {
            let root = cholesky(metric);
            let gradients = mode_gradients(&self.tables, q);
            for (m, &mode) in present.iter().enumerate() {
                let scaled = root.transpose() * gradients[mode];
                for k in 0..3 {
                    column[k * modes + m] = scaled[k];
                }
            }
        }
        let roots = MatRef::from_column_major_slice(&roots, modes, 3 * metrics.len());
        let mut matrix = Mat::zeros(modes, modes);
        matmul(
            matrix.as_mut(),
            BlockStructure::TriangularLower,
            Accum::Replace,
            roots,
            BlockStructure::Rectangular,
            roots.transpose(),
            BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
        matrix
    }
}

/// ∇N of every local mode at a point.
fn mode_gradients(tables: &Tables, mut point: usize) -> Vec<DVec3> {
    let mut modes = vec![(1.0, DVec3::ZERO)];
    let mut first = 0;
    for table in &tables.factors {
        let points = table.values.len() / table.modes;
        let begin = point % points * table.modes;
        point /= points;
        let mut next = Vec::with_capacity(modes.len() * table.modes);
        for k in begin..begin + table.modes {
            let value = table.values[k];
            let mut slope = DVec3::ZERO;
            for (axis, derivative) in table.derivatives.iter().enumerate() {
                slope[first + axis] = derivative[k];
            }
            next.extend(
                modes
                    .iter()
                    .map(|&(v, g)| (v * value, g * value + v * slope)),
            );
        }
        modes = next;
        first += table.derivatives.len();
    }
    modes.into_iter().map(|m| m.1).collect()
}

/// The derivatives of a factor by coordinate `axis`, where `first` is its first one; its values if that is not one of its own.
fn part(table: &Table, first: usize, axis: usize) -> &[f64] {
    axis.checked_sub(first)
        .and_then(|k| table.derivatives.get(k))
        .unwrap_or(&table.values)
}

/// Σ over the points of a factor of a ∘ b, both `[points, modes]`, times the array's entries there; `inner` entries are before it.
fn project(array: &[f64], a: &[f64], b: &[f64], modes: usize, inner: usize) -> Vec<f64> {
    let points = a.len() / modes;
    let mut result = vec![0.0; array.len() / points * modes];
    let blocks = array.chunks_exact(points * inner);
    for (block, sums) in blocks.zip(result.chunks_exact_mut(modes * inner)) {
        for (q, line) in block.chunks_exact(inner).enumerate() {
            for (m, sum) in sums.chunks_exact_mut(inner).enumerate() {
                let weight = a[q * modes + m] * b[q * modes + m];
                sum.iter_mut().zip(line).for_each(|(s, x)| *s += weight * x);
            }
        }
    }
    result
}

/// The lower triangular L with L Lᵀ = m, for a positive definite matrix.
fn cholesky(m: &DMat3) -> DMat3 {
    let a = m.x_axis.x.sqrt();
    let (b, c) = (m.x_axis.y / a, m.x_axis.z / a);
    let d = (m.y_axis.y - b * b).max(0.0).sqrt();
    let e = if d > 0.0 {
        (m.y_axis.z - b * c) / d
    } else {
        0.0
    };
    let f = (m.z_axis.z - c * c - e * e).max(0.0).sqrt();
    DMat3::from_cols(
        DVec3::new(a, b, c),
        DVec3::new(0.0, d, e),
        DVec3::new(0.0, 0.0, f),
    )
}
