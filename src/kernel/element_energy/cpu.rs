//! The f64 twin: chunks of [`LANES`] elements in parallel, each chunk by its own thread from its coefficients to its gradient.

use super::contraction::{LANES, Node, ZERO};
use super::pass::Scratch;
use super::{ElementBatch, ElementOutput, ElementTables};
use crate::geometry::distortion::{Block, Distortion};
use crate::geometry::vector::{Arithmetic, Work, fastest};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Points of a slab that are evaluated together.
const POINTS: usize = 8;

/// Energies, gradients and smallest determinants of the elements of a batch, from and into their parts of the arrays.
pub(super) fn evaluate(
    batch: &ElementBatch,
    distortion: Distortion,
    coefficients: &[DVec3],
    output: Parts<'_>,
) {
    let modes = batch.tables.modes();
    output
        .gradient
        .par_chunks_mut(LANES * modes)
        .zip(output.energies.par_chunks_mut(LANES))
        .zip(output.determinants.par_chunks_mut(LANES))
        .enumerate()
        .for_each_init(
            Room::default,
            |room, (k, ((gradient, energies), determinants))| {
                let lanes = Lanes::new(batch, energies.len(), |l| k * LANES + l);
                let sums = room.evaluate(&batch.tables, distortion, &lanes, coefficients);
                for (l, (energy, least)) in energies.iter_mut().zip(determinants).enumerate() {
                    *least = sums.least[l];
                    let is_valid = sums.least[l] > 0.0;
                    *energy = if is_valid {
                        sums.energy[l]
                    } else {
                        f64::INFINITY
                    };
                    for (g, node) in gradient[l * modes..].iter_mut().zip(&room.gradient) {
                        *g = if is_valid {
                            vector(node, l)
                        } else {
                            DVec3::ZERO
                        };
                    }
                }
            },
        );
}

/// The parts of an [`ElementOutput`] that belong to one batch.
pub(super) struct Parts<'a> {
    pub energies: &'a mut [f64],
    pub determinants: &'a mut [f64],
    pub gradient: &'a mut [DVec3],
}

impl ElementOutput {
    pub(super) fn parts(
        &mut self,
        elements: std::ops::Range<usize>,
        modes: std::ops::Range<usize>,
    ) -> Parts<'_> {
        Parts {
            energies: &mut self.energies[elements.clone()],
            determinants: &mut self.determinants[elements],
            gradient: &mut self.gradient[modes],
        }
    }
}

/// The elements of a chunk. Lanes without an element repeat the last one.
#[derive(Debug, Clone)]
pub(crate) struct Lanes {
    elements: [usize; LANES],
    /// A⁻¹, column by column.
    inverse: [[f64; LANES]; 9],
    weight: [f64; LANES],
}

impl Lanes {
    /// `count` > 0 elements of a batch: `at` gives the element of each lane below that.
    pub(crate) fn new(batch: &ElementBatch, count: usize, at: impl Fn(usize) -> usize) -> Self {
        let elements: [usize; LANES] = std::array::from_fn(|l| at(l.min(count - 1)));
        let inverses = elements.map(|e| batch.inverse_references[e].to_cols_array());
        Self {
            inverse: std::array::from_fn(|entry| inverses.map(|m| m[entry])),
            weight: elements.map(|e| batch.weights[e]),
            elements,
        }
    }

    /// The element of a lane.
    pub(crate) fn element(&self, lane: usize) -> usize {
        self.elements[lane]
    }

    /// det A⁻¹.
    pub(crate) fn inverse_determinants(&self) -> [f64; LANES] {
        std::array::from_fn(|l| {
            DMat3::from_cols_array(&self.inverse.map(|entry| entry[l])).determinant()
        })
    }

    /// Coefficients of the whole batch, `[elements, modes]`, as nodes `[modes]`.
    pub(crate) fn gather(&self, coefficients: &[DVec3], modes: usize, nodes: &mut Vec<Node>) {
        let own = self.elements.map(|e| &coefficients[e * modes..][..modes]);
        nodes.clear();
        nodes.extend((0..modes).map(|m| {
            let mut node = ZERO;
            for l in 0..LANES {
                (node[l], node[LANES + l], node[2 * LANES + l]) = own[l][m].into();
            }
            node
        }));
    }
}

/// The coordinates of a lane.
pub(crate) fn vector(node: &Node, lane: usize) -> DVec3 {
    DVec3::new(node[lane], node[LANES + lane], node[2 * LANES + lane])
}

/// What a chunk adds up.
struct Sums {
    energy: [f64; LANES],
    least: [f64; LANES],
}

/// A thread's arrays.
#[derive(Default)]
struct Room {
    scratch: Scratch,
    coefficients: Vec<Node>,
    gradient: Vec<Node>,
    block: Block<{ LANES * POINTS }>,
}

impl Room {
    /// Leaves the gradient in the room.
    fn evaluate(
        &mut self,
        tables: &ElementTables,
        distortion: Distortion,
        lanes: &Lanes,
        coefficients: &[DVec3],
    ) -> Sums {
        lanes.gather(coefficients, tables.modes(), &mut self.coefficients);
        self.gradient.clear();
        self.gradient.resize(tables.modes(), ZERO);
        let mut sums = Sums {
            energy: [0.0; LANES],
            least: [f64::INFINITY; LANES],
        };
        let Self {
            scratch,
            coefficients,
            gradient,
            block,
        } = self;
        tables.traverse(coefficients, Some(gradient), scratch, &mut |first, slab| {
            fastest(Slab {
                lanes,
                sums: &mut sums,
                block,
                weights: &tables.weights[first..first + slab[0].len()],
                slab,
                distortion: Some(distortion),
            });
        });
        if let Some(checks) = &tables.checks {
            checks.traverse(coefficients, None, scratch, &mut |first, slab| {
                fastest(Slab {
                    lanes,
                    sums: &mut sums,
                    block,
                    weights: &checks.weights[first..first + slab[0].len()],
                    slab,
                    distortion: None,
                });
            });
        }
        sums
    }
}

/// The points of a slab: derivatives of h come in, those of the energy go out.
struct Slab<'a> {
    lanes: &'a Lanes,
    sums: &'a mut Sums,
    block: &'a mut Block<{ LANES * POINTS }>,
    weights: &'a [f64],
    slab: [&'a mut [Node]; 3],
    /// Without one, only determinants are looked at.
    distortion: Option<Distortion>,
}

impl Work for Slab<'_> {
    #[inline(always)]
    fn run<A: Arithmetic>(mut self) {
        let points = self.weights.len();
        for first in (0..points).step_by(POINTS) {
            let count = POINTS.min(points - first);
            for p in 0..POINTS {
                // A block that is not full repeats its last point.
                self.load::<A>(p, first + p.min(count - 1));
            }
            match self.distortion {
                Some(distortion) => distortion.evaluate_with::<A, _>(self.block),
                None => self.block.determinants::<A>(),
            }
            for p in 0..count {
                self.look(p);
                if self.distortion.is_some() {
                    self.store::<A>(p, first + p);
                }
            }
        }
    }
}

impl Slab<'_> {
    /// J = ∇h A⁻¹ into place `p` of the block.
    #[inline(always)]
    fn load<A: Arithmetic>(&mut self, p: usize, point: usize) {
        // Copies, here and below: what is read cannot alias what is written, and the loops over lanes become single instructions.
        let (u, v, w) = (
            self.slab[0][point],
            self.slab[1][point],
            self.slab[2][point],
        );
        for column in 0..3 {
            let inverse = &self.lanes.inverse;
            let (a, b, c) = (
                inverse[3 * column],
                inverse[3 * column + 1],
                inverse[3 * column + 2],
            );
            for row in 0..3 {
                let mut entry = [0.0; LANES];
                for l in 0..LANES {
                    let k = row * LANES + l;
                    entry[l] = A::mul_add(u[k], a[l], A::mul_add(v[k], b[l], w[k] * c[l]));
                }
                self.block.jacobian[3 * column + row].as_chunks_mut().0[p] = entry;
            }
        }
    }

    /// Takes note of the determinants at place `p`.
    #[inline(always)]
    fn look(&mut self, p: usize) {
        let determinants: [f64; LANES] = self.block.determinant.as_chunks().0[p];
        let mut least = self.sums.least;
        for l in 0..LANES {
            let det = determinants[l];
            // What is not a number fails both comparisons and counts as the least of all.
            let det = if det > f64::NEG_INFINITY {
                det
            } else {
                f64::NEG_INFINITY
            };
            least[l] = if det < least[l] { det } else { least[l] };
        }
        self.sums.least = least;
    }

    /// Adds the energy at place `p` and leaves its derivative by ∇h, (w ∂ε/∂J) A⁻ᵀ, at the point.
    #[inline(always)]
    fn store<A: Arithmetic>(&mut self, p: usize, point: usize) {
        let value: [f64; LANES] = self.block.value.as_chunks().0[p];
        let (mut weight, mut energy) = (self.lanes.weight, self.sums.energy);
        for l in 0..LANES {
            weight[l] *= self.weights[point];
            energy[l] = A::mul_add(weight[l], value[l], energy[l]);
        }
        self.sums.energy = energy;
        let mut derivatives = [ZERO; 3];
        for row in 0..3 {
            let gradient = &self.block.gradient;
            let a: [f64; LANES] = gradient[row].as_chunks().0[p];
            let b: [f64; LANES] = gradient[3 + row].as_chunks().0[p];
            let c: [f64; LANES] = gradient[6 + row].as_chunks().0[p];
            for d in 0..3 {
                let inverse = &self.lanes.inverse;
                let (x, y, z) = (inverse[d], inverse[3 + d], inverse[6 + d]);
                for l in 0..LANES {
                    let sum = A::mul_add(a[l], x[l], A::mul_add(b[l], y[l], c[l] * z[l]));
                    derivatives[d][row * LANES + l] = weight[l] * sum;
                }
            }
        }
        for (slab, derivative) in self.slab.iter_mut().zip(derivatives) {
            slab[point] = derivative;
        }
    }
}
