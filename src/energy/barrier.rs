//! A barrier that keeps det J positive between the quadrature points too.
//!
//! **Theory.** det J is a polynomial on an element, so it is at least the smallest of its Bernstein coefficients B_k: of degree 3p − 1 along the
//! axes of hexahedra and prisms, and on triangles and tetrahedra of total degree 3p − 2 and 3p − 3, which in collapsed coordinates is a
//! degree along each axis. The term is β/(n_e n) Σ_{B_k < τ} ln²((B_k − ε)/(τ − ε)), n_e the number of elements and n that of the coefficients of one; it
//! is infinite where a B_k is not above the floor ε, and 0 with its slope where none is below τ. Raising the order of the modes adds nothing to
//! a polynomial and its coefficients stay above the floor, so every raise starts feasible.
//!
//! **Practice.** det J is sampled at the Chebyshev points of each axis by the passes of the energy's kernel, and a small matrix along each axis
//! takes the samples to the B_k; the gradient goes back by the transpose and the cofactors. Bernstein coefficients of a high degree are
//! unstable, so past [`STABLE_NODES`] an axis is cut into boxes of [`BOX_NODES`] and the coefficients are those of the interpolant on each box: then, and for
//! the Fourier basis, whose determinants are no polynomials, they are close to bounds but no certificate (`measure` has one). The energy's
//! own quadrature does not see what the barrier sees, and the barrier costs more, so only elements near the limit are to be given to it.

use super::element_tables::{collapsed, samples};
use crate::error::Result;
use crate::geometry::distortion::cofactors;
use crate::kernel::element_energy::{
    ElementBatch, ElementTables, Factors, LANES, Lanes, Node, Scratch, ZERO, vector,
};
use crate::mesh::CellShape;
use crate::model::element::quadrature::collapse;
use crate::model::element::{Basis, Factor, Table};
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::sync::Arc;

/// β: with it a coefficient at a tenth of the threshold costs about what a strain of a few tenths does in its element.
const WEIGHT: f64 = 5.0;
/// τ: determinants above this share of the ideal one are left alone.
pub const THRESHOLD: f64 = 0.25;
/// Determinants up to this share of the ideal one cost infinitely much. With 0 here elements came to rest at 1e-12, for ln² grows too slowly
/// to be seen under a small λ, and nobody could tell whether they were inverted.
pub const FLOOR: f64 = 1e-3;
/// Slopes of an element that count in what is known of the barrier's curvature: those of its least coefficients, where it is steepest.
const STEEPEST: usize = 64;
/// Nodes of an axis up to which the Bernstein coefficients of the whole axis are taken: those of order 5.
const STABLE_NODES: usize = 15;
/// Nodes of a box of an axis that is cut.
const BOX_NODES: usize = 6;
/// Boxes of an axis where the modes do not factor, so that the tables stay small.
const DENSE_BOXES: usize = 2;

/// The barrier of elements of one shape, basis and order.
#[derive(Debug, Clone)]
pub struct BernsteinBarrier {
    batch: ElementBatch,
    /// In the order in which points are visited, the fastest first.
    axes: [Axis; 3],
    /// 1/n_e.
    share: f64,
}

/// An axis as boxes of equal length, each with Chebyshev points.
#[derive(Debug, Clone)]
struct Axis {
    boxes: usize,
    nodes: usize,
    /// Bernstein coefficients on a box from values at its points, `[nodes, nodes]`.
    matrix: Vec<f64>,
}

impl BernsteinBarrier {
    /// For elements given by A⁻¹ of each, among `total` elements of a mesh.
    ///
    /// # Errors
    /// Never in practice: the tables of the model fit together.
    pub fn new(
        shape: CellShape,
        basis: Basis,
        order: usize,
        inverse_references: Vec<DMat3>,
        total: usize,
    ) -> Result<Self> {
        let samples = |factor: Factor| samples(Table::new(basis, order, &factor));
        let along = Axis::new(3 * order, usize::MAX);
        let line = || samples(Factor::Line(along.points()));
        let (factors, axes) = match shape {
            CellShape::Hexahedron => (
                Factors::Hexahedron(line()),
                [along.clone(), along.clone(), along.clone()],
            ),
            CellShape::Prism => {
                let across = Axis::new(3 * order - 1, usize::MAX);
                let points = across.points();
                let triangle = points
                    .iter()
                    .flat_map(|&t| points.iter().map(move |&s| collapse(s, t, 0.0)))
                    .map(|[u, v, _]| [u, v]);
                let triangle = samples(Factor::Triangle(triangle.collect()));
                (
                    Factors::Prism(triangle, line()),
                    [across.clone(), across, along],
                )
            }
            CellShape::Tetrahedron => {
                let most = if basis == Basis::Legendre {
                    usize::MAX
                } else {
                    DENSE_BOXES
                };
                let axis = Axis::new(3 * order - 2, most);
                let points = axis.points();
                let factors = match basis {
                    Basis::Legendre => collapsed(order, [(); 3].map(|()| points.clone())),
                    Basis::Fourier => {
                        let points = &points;
                        let all = points.iter().flat_map(|&r| {
                            points
                                .iter()
                                .flat_map(move |&s| points.iter().map(move |&t| collapse(s, t, r)))
                        });
                        Factors::Dense(samples(Factor::Tetrahedron(all.collect())))
                    }
                };
                (factors, [axis.clone(), axis.clone(), axis])
            }
        };
        let points = axes.iter().map(Axis::len).product();
        let tables = ElementTables::new(factors, vec![0.0; points], None)?;
        Ok(Self {
            batch: ElementBatch {
                tables: Arc::new(tables),
                weights: vec![0.0; inverse_references.len()],
                inverse_references,
            },
            axes,
            share: 1.0 / total as f64,
        })
    }

    /// The smallest B_k of every element, from the coefficients `[elements, modes]`.
    pub fn bounds(&self, coefficients: &[DVec3]) -> Vec<f64> {
        let chunks = self.chunks(|room, lanes| {
            room.sample(self, lanes, coefficients);
            room.least()
        });
        chunks
            .into_iter()
            .flatten()
            .take(self.batch.len())
            .collect()
    }

    /// The term and its gradient, both from and on coefficients `[elements, modes]`. The gradient is of no use where the term is infinite.
    pub fn evaluate(&self, coefficients: &[DVec3]) -> (f64, Vec<DVec3>) {
        let modes = self.batch.tables.modes();
        let chunks = self.chunks(|room, lanes| {
            room.sample(self, lanes, coefficients);
            let energy = room.penalize(self.share);
            if energy.iter().any(|e| e.is_finite() && *e > 0.0) {
                room.differentiate(self, lanes);
                (energy, Some(room.gradient.clone()))
            } else {
                (energy, None)
            }
        });
        let mut total = 0.0;
        let mut gradient = vec![DVec3::ZERO; coefficients.len()];
        for (members, (energy, nodes)) in gradient.chunks_mut(modes * LANES).zip(chunks) {
            for (l, own) in members.chunks_exact_mut(modes).enumerate() {
                total += energy[l];
                for (g, node) in own.iter_mut().zip(nodes.iter().flatten()) {
                    *g = vector(node, l);
                }
            }
        }
        (total, gradient)
    }

    /// What there is to know of the second derivatives: folds, for each element, over s_k = √f″(B_k) ∇B_k of its least B_k below τ, with f
    /// what the term makes of a coefficient. Σ s_k s_kᵀ is the Hessian but for the curvature of the B_k, and positive semidefinite.
    ///
    /// `new` starts an element's result, `add` takes it and an s_k on the element's `[modes]`. Elements outside the domain have no s_k.
    pub fn fold_slopes<T: Send>(
        &self,
        coefficients: &[DVec3],
        new: impl Fn() -> T + Sync,
        add: impl Fn(usize, &mut T, &[DVec3]) + Sync,
    ) -> Vec<T> {
        let folded = self.chunks(|room, lanes| {
            room.sample(self, lanes, coefficients);
            let steepest: [_; LANES] = std::array::from_fn(|l| room.steepest(l, self.share));
            let mut results: [T; LANES] = std::array::from_fn(|_| new());
            let passes = steepest.iter().map(Vec::len).max().unwrap_or(0);
            for pass in 0..passes {
                room.values.fill([0.0; LANES]);
                for (l, list) in steepest.iter().enumerate() {
                    if let Some(&(k, scale)) = list.get(pass) {
                        room.values[k][l] = scale;
                    }
                }
                room.differentiate(self, lanes);
                for (l, result) in results.iter_mut().enumerate() {
                    if pass < steepest[l].len() {
                        let slope: Vec<DVec3> =
                            room.gradient.iter().map(|node| vector(node, l)).collect();
                        add(lanes.element(l), result, &slope);
                    }
                }
            }
            results
        });
        folded
            .into_iter()
            .flatten()
            .take(self.batch.len())
            .collect()
    }

    /// Runs `work` on every [`LANES`] elements, in parallel; results in order.
    fn chunks<T: Send>(&self, work: impl Fn(&mut Room, &Lanes) -> T + Sync) -> Vec<T> {
        let count = self.batch.len();
        (0..count.div_ceil(LANES))
            .into_par_iter()
            .map_init(Room::default, |room, chunk| {
                let first = chunk * LANES;
                let members = LANES.min(count - first);
                work(room, &Lanes::new(&self.batch, members, |l| first + l))
            })
            .collect()
    }

    /// Applies the matrix of each axis, or its transpose, to an array over all points.
    fn transform(&self, values: &mut [[f64; LANES]], transpose: bool) {
        let mut stride = 1;
        for axis in &self.axes {
            axis.apply(values, stride, transpose);
            stride *= axis.len();
        }
    }
}

/// A thread's arrays.
#[derive(Default)]
struct Room {
    scratch: Scratch,
    coefficients: Vec<Node>,
    gradient: Vec<Node>,
    /// det J at the points; then the B_k; then derivatives by the B_k; then those by det J at the points.
    values: Vec<[f64; LANES]>,
}

impl Room {
    /// The B_k of the elements of all lanes.
    fn sample(&mut self, barrier: &BernsteinBarrier, lanes: &Lanes, coefficients: &[DVec3]) {
        let tables = &barrier.batch.tables;
        lanes.gather(coefficients, tables.modes(), &mut self.coefficients);
        let inverse = lanes.inverse_determinants();
        let values = &mut self.values;
        values.clear();
        tables.traverse(
            &self.coefficients,
            None,
            &mut self.scratch,
            &mut |_, [u, v, w]| {
                for ((u, v), w) in u.iter().zip(v.iter()).zip(w.iter()) {
                    values.push(std::array::from_fn(|l| {
                        let [a, b, c] = [u, v, w].map(|node| vector(node, l));
                        a.cross(b).dot(c) * inverse[l]
                    }));
                }
            },
        );
        barrier.transform(&mut self.values, false);
    }

    fn least(&self) -> [f64; LANES] {
        // A value that is not a number counts as the least of all.
        let order = |x: f64| if x.is_nan() { f64::NEG_INFINITY } else { x };
        std::array::from_fn(|l| {
            let values = self.values.iter().map(|v| order(v[l]));
            values.fold(f64::INFINITY, f64::min)
        })
    }

    /// The least B_k of a lane below τ, with √f″(B_k) each; none where one is not above the floor.
    fn steepest(&self, lane: usize, share: f64) -> Vec<(usize, f64)> {
        let weight = WEIGHT * share / self.values.len() as f64;
        let values = self.values.iter().map(|v| v[lane]).enumerate();
        let mut low: Vec<(usize, f64)> = values.filter(|(_, b)| *b < THRESHOLD).collect();
        low.sort_by(|a, b| a.1.total_cmp(&b.1));
        if low.first().is_some_and(|(_, b)| *b <= FLOOR) {
            return Vec::new();
        }
        low.truncate(STEEPEST);
        for (_, b) in &mut low {
            let above = *b - FLOOR;
            let l = (above / (THRESHOLD - FLOOR)).ln();
            *b = (2.0 * weight * (1.0 - l)).sqrt() / above;
        }
        low
    }

    /// Replaces the B_k by the derivatives of the term; returns the term of each lane.
    fn penalize(&mut self, share: f64) -> [f64; LANES] {
        let weight = WEIGHT * share / self.values.len() as f64;
        let mut energy = [0.0; LANES];
        for value in &mut self.values {
            for (b, energy) in value.iter_mut().zip(&mut energy) {
                (*b, *energy) = if *b >= THRESHOLD {
                    (0.0, *energy)
                } else if *b > FLOOR {
                    let l = ((*b - FLOOR) / (THRESHOLD - FLOOR)).ln();
                    (2.0 * weight * l / (*b - FLOOR), *energy + weight * l * l)
                } else {
                    (0.0, f64::INFINITY)
                };
            }
        }
        energy
    }

    /// The gradient on the coefficients, from the derivatives by the B_k.
    fn differentiate(&mut self, barrier: &BernsteinBarrier, lanes: &Lanes) {
        barrier.transform(&mut self.values, true);
        let tables = &barrier.batch.tables;
        let inverse = lanes.inverse_determinants();
        self.gradient.clear();
        self.gradient.resize(tables.modes(), ZERO);
        let values = &self.values;
        tables.traverse(
            &self.coefficients,
            Some(&mut self.gradient),
            &mut self.scratch,
            &mut |first, [u, v, w]| {
                for (point, ((u, v), w)) in u.iter_mut().zip(v).zip(w).enumerate() {
                    for l in 0..LANES {
                        let weight = values[first + point][l] * inverse[l];
                        let columns = [&*u, &*v, &*w].map(|node| vector(node, l).to_array());
                        for (node, column) in [&mut *u, &mut *v, &mut *w]
                            .into_iter()
                            .zip(cofactors(columns))
                        {
                            for (r, x) in column.into_iter().enumerate() {
                                node[r * LANES + l] = weight * x;
                            }
                        }
                    }
                }
            },
        );
    }
}

impl Axis {
    /// With the points that `nodes` coefficients need: in one box if that is stable, else in at most `most` boxes.
    fn new(nodes: usize, most: usize) -> Self {
        let (boxes, nodes) = if nodes <= STABLE_NODES {
            (1, nodes)
        } else {
            (nodes.div_ceil(BOX_NODES).min(most), BOX_NODES)
        };
        Self {
            boxes,
            nodes,
            matrix: bernstein_from_values(&chebyshev(nodes)),
        }
    }

    fn len(&self) -> usize {
        self.boxes * self.nodes
    }

    fn points(&self) -> Vec<f64> {
        let local = chebyshev(self.nodes);
        (0..self.boxes)
            .flat_map(|b| local.iter().map(move |x| b as f64 + x))
            .map(|x| x / self.boxes as f64)
            .collect()
    }

    /// Multiplies along an axis of an array, `stride` values from one point to the next.
    fn apply(&self, values: &mut [[f64; LANES]], stride: usize, transpose: bool) {
        let n = self.nodes;
        let mut column = vec![[0.0; LANES]; n];
        for part in values.chunks_exact_mut(n * stride) {
            for first in 0..stride {
                for (k, value) in column.iter_mut().enumerate() {
                    *value = part[first + k * stride];
                }
                for row in 0..n {
                    let mut sum = [0.0; LANES];
                    for (k, value) in column.iter().enumerate() {
                        let at = if transpose { k * n + row } else { row * n + k };
                        for l in 0..LANES {
                            sum[l] += self.matrix[at] * value[l];
                        }
                    }
                    part[first + row * stride] = sum;
                }
            }
        }
    }
}

/// The Chebyshev points of (0, 1).
fn chebyshev(n: usize) -> Vec<f64> {
    (0..n)
        .map(|k| 0.5 - 0.5 * ((2 * k + 1) as f64 / (2 * n) as f64 * PI).cos())
        .collect()
}

/// The inverse of the matrix of Bernstein polynomials (columns) at points (rows), by elimination with pivots.
fn bernstein_from_values(points: &[f64]) -> Vec<f64> {
    let n = points.len();
    let binomial = |k: usize| (0..k).fold(1.0, |b, i| b * (n - 1 - i) as f64 / (i + 1) as f64);
    let polynomial =
        |x: f64, k: usize| binomial(k) * x.powi(k as i32) * (1.0 - x).powi((n - 1 - k) as i32);
    let mut rows: Vec<Vec<f64>> = points
        .iter()
        .enumerate()
        .map(|(i, &x)| {
            let unit = (0..n).map(|k| if k == i { 1.0 } else { 0.0 });
            (0..n).map(|k| polynomial(x, k)).chain(unit).collect()
        })
        .collect();
    for k in 0..n {
        let larger = |&a: &usize, &b: &usize| rows[a][k].abs().total_cmp(&rows[b][k].abs());
        let pivot = (k..n).max_by(larger).unwrap_or(k);
        rows.swap(k, pivot);
        let scale = 1.0 / rows[k][k];
        rows[k].iter_mut().for_each(|x| *x *= scale);
        let pivot = rows[k].clone();
        for (_, row) in rows.iter_mut().enumerate().filter(|(i, _)| *i != k) {
            let factor = row[k];
            row.iter_mut()
                .zip(&pivot)
                .for_each(|(x, p)| *x -= factor * p);
        }
    }
    rows.iter().flat_map(|row| row[n..].to_vec()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bernstein_coefficients_reproduce_values() {
        for n in [1, 2, 6, 12, 15] {
            let points = chebyshev(n);
            let matrix = bernstein_from_values(&points);
            // x² has the coefficients k (k − 1)/(d (d − 1)), and 1 has ones.
            let d = (n - 1) as f64;
            for row in 0..n {
                let of = |f: &dyn Fn(f64) -> f64| -> f64 {
                    (0..n).map(|k| matrix[row * n + k] * f(points[k])).sum()
                };
                assert!((of(&|_| 1.0) - 1.0).abs() < 1e-10);
                if n > 2 {
                    let k = row as f64;
                    assert!((of(&|x| x * x) - k * (k - 1.0) / (d * (d - 1.0))).abs() < 1e-10);
                }
            }
        }
    }
}
