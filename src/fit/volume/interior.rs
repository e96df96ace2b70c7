//! The distortion of all elements of a body as a function of its unknowns, and its stiffness.

use super::body::Body;
use super::stiffness::Stiffness;
use crate::device::Device;
use crate::energy::element_tables;
use crate::error::Result;
use crate::geometry::distortion::Distortion;
use crate::kernel::element_energy::{ElementBatch, ElementEnergy, ElementOutput};
use crate::kernel::sparse::Csr;
use crate::model::element::{Quadrature, Rule, Tables, reference_volume};
use glam::DVec3;
use rayon::prelude::*;
use std::cell::RefCell;
use std::cmp::Ordering;
use std::ops::Range;
use std::sync::Arc;

/// E_Ω of a body of fixed orders as a function of its unknowns.
pub(super) struct Interior {
    /// On the device; its buffers are written in every evaluation.
    elements: RefCell<ElementEnergy>,
    /// `[batches]`.
    stiffness: Vec<Stiffness>,
    /// `[elements]`, batch by batch: the cells that they are.
    cells: Vec<u32>,
    /// `[local modes of all elements, unknowns]`.
    gather: Csr,
    scatter: Csr,
    distortion: Distortion,
}

/// The value of E_Ω.
pub(super) struct Distorted {
    /// Infinite where an element is inverted.
    pub value: f64,
    /// `[unknowns]`.
    pub gradient: Vec<DVec3>,
}

impl Interior {
    /// Of elements whose ideal shapes have edges of length `sizes`, `[cells]`.
    ///
    /// # Errors
    /// As [`element_tables`], and where the device has no room.
    pub fn new(
        device: &Device,
        body: &Body,
        sizes: &[f64],
        rule: Rule,
        distortion: Distortion,
    ) -> Result<Self> {
        let volume = body.volume();
        let groups = volume.groups();
        let cells: Vec<u32> = groups
            .iter()
            .flat_map(|g| g.cells.iter().copied())
            .collect();
        let ideal = |c: u32| sizes[c as usize].powi(3) * reference_volume(volume.shape(c as usize));
        let total: f64 = cells.iter().map(|&c| ideal(c)).sum();
        let mut batches = Vec::with_capacity(groups.len());
        let mut stiffness = Vec::with_capacity(groups.len());
        for group in &groups {
            let tables = element_tables(group.shape, volume.basis(), group.order, rule)?;
            let inverse =
                |&c: &u32| volume.reference_inverse(c as usize) * sizes[c as usize].recip();
            // |det A| is the ideal volume over that of the reference cell, to which the weights of a rule sum up.
            let quadrature = Quadrature::new(rule, group.shape, group.order);
            let reference: f64 = quadrature.weights.iter().sum();
            let share = |&c: &u32| ideal(c) / (reference * total);
            batches.push(ElementBatch {
                tables: Arc::new(tables),
                inverse_references: group.cells.iter().map(inverse).collect(),
                weights: group.cells.iter().map(share).collect(),
            });
            let tables = Tables::new(volume.basis(), group.order, &quadrature.grid);
            stiffness.push(Stiffness::new(tables, &quadrature));
        }
        let gather = body.gather(&cells);
        Ok(Self {
            elements: RefCell::new(ElementEnergy::new(device, batches)?),
            stiffness,
            cells,
            scatter: gather.transpose(),
            gather,
            distortion,
        })
    }

    /// E_Ω and its gradient.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn evaluate(&self, unknowns: &[DVec3]) -> Result<Distorted> {
        let output = self.output(unknowns)?;
        Ok(Distorted {
            value: output.energy(),
            gradient: self.scatter.apply(&output.gradient),
        })
    }

    fn output(&self, unknowns: &[DVec3]) -> Result<ElementOutput> {
        let local = self.gather.apply(unknowns);
        let mut elements = self.elements.borrow_mut();
        elements.evaluate(&local, self.distortion)
    }

    /// The cells that are inverted at a quadrature point, ascending.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn inverted(&self, unknowns: &[DVec3]) -> Result<Vec<u32>> {
        let output = self.output(unknowns)?;
        let pairs = self.cells.iter().zip(&output.energies);
        let mut cells: Vec<u32> = pairs
            .filter(|(_, e)| !e.is_finite())
            .map(|p| *p.0)
            .collect();
        cells.sort_unstable();
        Ok(cells)
    }

    /// K_ii of every unknown, weighted as in E_Ω. Where local modes are sums of unknowns, without the mixed terms.
    pub fn stiffness_diagonal(&self, unknowns: &[DVec3]) -> Vec<f64> {
        let local = self.elementwise(unknowns, |stiffness, _, local| stiffness.diagonal(local));
        let local: Vec<f64> = local.into_iter().flatten().collect();
        (0..unknowns.len())
            .map(|i| {
                self.scatter
                    .row(i)
                    .map(|(k, w)| w * w * local[k as usize])
                    .sum()
            })
            .collect()
    }

    /// K as (row, column, entry) with row ≥ column, to be added up.
    pub fn stiffness_entries(&self, unknowns: &[DVec3]) -> Vec<(u32, u32, f64)> {
        let gather = &self.gather;
        let matrices = self.elementwise(unknowns, |stiffness, modes, local| {
            stiffness.matrix(local, &present(gather, modes))
        });
        let mut entries = Vec::new();
        for (matrix, modes) in matrices.into_iter().zip(self.local_modes()) {
            let present = present(gather, modes.clone());
            let row = |a: usize| gather.row(modes.start + present[a]);
            for a in 0..present.len() {
                for b in 0..=a {
                    let k = matrix[(a, b)];
                    for (i, wi) in row(a) {
                        for (j, wj) in row(b) {
                            // A pair stands for both of its orders.
                            let times = match (a == b, i.cmp(&j)) {
                                (true, Ordering::Less) => continue,
                                (false, Ordering::Equal) => 2.0,
                                _ => 1.0,
                            };
                            entries.push((i.max(j), i.min(j), times * wi * wj * k));
                        }
                    }
                }
            }
        }
        entries
    }

    /// About how many floating-point operations [`Interior::stiffness_entries`] takes, an entry counted as a thousand.
    pub fn stiffness_operations(&self) -> f64 {
        let elements = self.elements.borrow();
        let points = elements
            .batches()
            .iter()
            .flat_map(|batch| std::iter::repeat_n(batch.tables.points() as f64, batch.len()));
        let operations = self.local_modes().zip(points).map(|(modes, points)| {
            let present = present(&self.gather, modes.clone());
            let entries: usize = present
                .iter()
                .map(|&a| self.gather.row(modes.start + a).len())
                .sum();
            3.0 * points * (present.len() as f64).powi(2) + 500.0 * (entries as f64).powi(2)
        });
        operations.sum()
    }

    /// Of each element, where its local modes are among all.
    fn local_modes(&self) -> impl Iterator<Item = Range<usize>> {
        let elements = self.elements.borrow();
        let counts = elements
            .batches()
            .iter()
            .flat_map(|batch| std::iter::repeat_n(batch.tables.modes(), batch.len()));
        let mut end = 0;
        let ranges: Vec<Range<usize>> = counts
            .map(|count| {
                end += count;
                end - count..end
            })
            .collect();
        ranges.into_iter()
    }

    /// What `work` makes of every element, from where its local modes are among all and what they are; its weight included.
    fn elementwise<R: Send + Scaled>(
        &self,
        unknowns: &[DVec3],
        work: impl Fn(&Stiffness, Range<usize>, &[DVec3]) -> R + Sync,
    ) -> Vec<R> {
        let local = self.gather.apply(unknowns);
        let mut first = 0;
        let mut results = Vec::with_capacity(self.cells.len());
        let elements = self.elements.borrow();
        for (batch, stiffness) in elements.batches().iter().zip(&self.stiffness) {
            let modes = batch.tables.modes();
            let begin = |k: usize| first + k * modes;
            results.par_extend((0..batch.len()).into_par_iter().map(|k| {
                let range = begin(k)..begin(k + 1);
                work(stiffness, range.clone(), &local[range]).scaled(batch.weights[k])
            }));
            first += batch.coefficients();
        }
        results
    }
}

/// Which of the local modes of an element there are, counted from its first: at orders that differ from entity to entity some are zero
/// whatever the unknowns.
fn present(gather: &Csr, modes: Range<usize>) -> Vec<usize> {
    let first = modes.start;
    modes
        .filter(|&row| gather.row(row).next().is_some())
        .map(|row| row - first)
        .collect()
}

/// What can be multiplied by a weight.
trait Scaled {
    fn scaled(self, weight: f64) -> Self;
}

impl Scaled for Vec<f64> {
    fn scaled(mut self, weight: f64) -> Self {
        self.iter_mut().for_each(|x| *x *= weight);
        self
    }
}

impl Scaled for faer::Mat<f64> {
    fn scaled(self, weight: f64) -> Self {
        weight * self
    }
}
