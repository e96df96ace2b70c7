//! The f32 twin: what is resident, what goes up and comes down at an evaluation, and how the work is split.
//!
//! Coefficients go up in local coordinates: less the centre of the element, so that an offset of many sizes costs no digits, and over its
//! size, so that all matrices are about 1. Energies and gradients are scaled back in f64.

use super::plan::{BASIS, BasisParams, ElementParams, Plan, singles, transposed};
use super::tables::Factors;
use super::{ElementBatch, ElementOutput, ElementTables};
use crate::device::{Batch, Buffer, Gpu, Readback, Results, WORKGROUP_SIZE};
use crate::error::Result;
use crate::geometry::distortion::Distortion;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Elements of several batches on a device.
#[derive(Debug)]
pub(super) struct Resident {
    gpu: Gpu,
    parts: Vec<Part>,
}

/// As many elements of a batch as fit one binding.
#[derive(Debug)]
struct Part {
    batch: usize,
    /// Within the batch.
    elements: Range<usize>,
    energy: Job,
    checks: Option<Job>,
    basis: Option<Basis>,
    coefficients: Buffer<f32>,
    gradient: Buffer<f32>,
    inverses: Buffer<f32>,
    /// 1 / the size of each element.
    scales: Vec<f64>,
}

/// A pass over the points of some elements.
#[derive(Debug)]
struct Job {
    plan: Plan,
    tables: Buffer<f32>,
    weights: Buffer<f32>,
    results: Buffer<[f32; 2]>,
}

/// A basis in which elements factor.
#[derive(Debug)]
struct Basis {
    /// `[modes, ψ]`, and `[ψ, modes]`.
    matrices: [Buffer<f32>; 2],
    coefficients: Buffer<f32>,
    gradient: Buffer<f32>,
}

/// What is read back of a part.
struct Reads {
    gradient: Readback<f32>,
    results: Readback<[f32; 2]>,
    checks: Option<Readback<[f32; 2]>>,
}

impl Resident {
    pub(super) fn new(gpu: &Gpu, batches: &[ElementBatch]) -> Result<Self> {
        let mut parts = Vec::new();
        for (index, batch) in batches.iter().enumerate() {
            let bytes = 3 * size_of::<f32>() * batch.tables.modes();
            let most = (gpu.largest_binding() as usize / bytes).max(1);
            for first in (0..batch.len()).step_by(most) {
                let elements = first..batch.len().min(first + most);
                parts.push(Part::new(gpu, index, batch, elements)?);
            }
        }
        Ok(Self {
            gpu: gpu.clone(),
            parts,
        })
    }

    pub(super) fn evaluate(
        &mut self,
        batches: &[ElementBatch],
        coefficients: &[DVec3],
        distortion: Distortion,
    ) -> Result<ElementOutput> {
        let mut submission = self.gpu.batch();
        let mut reads = Vec::new();
        let (modes, elements) = offsets(batches);
        for part in &mut self.parts {
            let batch = &batches[part.batch];
            part.upload(batch, &coefficients[modes[part.batch]..])?;
            reads.push(part.dispatch(&self.gpu, &mut submission, batch, distortion)?);
        }
        let results = submission.submit()?;
        let mut output = ElementOutput::new(batches);
        for (part, reads) in self.parts.iter().zip(&reads) {
            let batch = &batches[part.batch];
            let place = (elements[part.batch], modes[part.batch]);
            part.finish(batch, reads, &results, place, &mut output);
        }
        Ok(output)
    }
}

/// Where the coefficients and the elements of each batch begin.
fn offsets(batches: &[ElementBatch]) -> (Vec<usize>, Vec<usize>) {
    let (mut mode, mut element) = (0, 0);
    batches
        .iter()
        .map(|batch| {
            let first = (mode, element);
            mode += batch.coefficients();
            element += batch.len();
            first
        })
        .unzip()
}

impl Part {
    fn new(gpu: &Gpu, index: usize, batch: &ElementBatch, elements: Range<usize>) -> Result<Self> {
        let tables = &batch.tables;
        let count = elements.len();
        let length = 3 * tables.modes() * count;
        let references = &batch.inverse_references[elements.clone()];
        let scales: Vec<f64> = references
            .iter()
            .map(|inverse| inverse.determinant().abs().cbrt())
            .map(|scale| if scale.is_normal() { scale } else { 1.0 })
            .collect();
        let inverses: Vec<f32> = references
            .iter()
            .zip(&scales)
            .flat_map(|(inverse, scale)| inverse.to_cols_array().map(|x| (x / scale) as f32))
            .collect();
        let basis = match &tables.factors {
            Factors::Collapsed(collapsed) => Some(Basis {
                matrices: [
                    Buffer::from_slice(
                        gpu,
                        &singles(&transposed(&collapsed.matrix, tables.modes())),
                    )?,
                    Buffer::from_slice(gpu, &singles(&collapsed.matrix))?,
                ],
                coefficients: Buffer::zeroed(gpu, length)?,
                gradient: Buffer::zeroed(gpu, length)?,
            }),
            _ => None,
        };
        let checks = tables.checks.as_deref();
        Ok(Self {
            batch: index,
            energy: Job::new(gpu, tables, count, true)?,
            checks: checks.map(|c| Job::new(gpu, c, count, false)).transpose()?,
            basis,
            coefficients: Buffer::zeroed(gpu, length)?,
            gradient: Buffer::zeroed(gpu, length)?,
            inverses: Buffer::from_slice(gpu, &inverses)?,
            scales,
            elements,
        })
    }

    /// Local coordinates, `[elements, 3, modes]`. An element with a coordinate that is not finite becomes a point, which is invalid.
    fn upload(&mut self, batch: &ElementBatch, coefficients: &[DVec3]) -> Result<()> {
        let tables = &batch.tables;
        let modes = tables.modes();
        let vertices: Vec<usize> = (0..modes)
            .filter(|&m| tables.factors.is_vertex(m))
            .collect();
        let first = self.elements.start * modes;
        let coefficients = &coefficients[first..first + self.elements.len() * modes];
        let mut local = vec![0f32; 3 * coefficients.len()];
        local
            .par_chunks_mut(3 * modes)
            .zip(coefficients.par_chunks(modes))
            .zip(&self.scales)
            .for_each(|((local, coefficients), &scale)| {
                let sum: DVec3 = vertices.iter().map(|&m| coefficients[m]).sum();
                let centre = sum / vertices.len() as f64;
                for (m, &c) in coefficients.iter().enumerate() {
                    let c = if tables.factors.is_vertex(m) {
                        c - centre
                    } else {
                        c
                    };
                    for (k, x) in (c * scale).to_array().into_iter().enumerate() {
                        local[k * modes + m] = x as f32;
                    }
                }
                if local.iter().any(|x| !x.is_finite()) {
                    local.fill(0.0);
                }
            });
        self.coefficients.write(&local)
    }

    fn dispatch(
        &self,
        gpu: &Gpu,
        submission: &mut Batch,
        batch: &ElementBatch,
        distortion: Distortion,
    ) -> Result<Reads> {
        let modes = batch.tables.modes();
        let params = BasisParams {
            vectors: 3 * self.elements.len() as u32,
            modes: modes as u32,
        };
        let threads = 3 * modes * self.elements.len();
        let change =
            |submission: &mut Batch, matrix: &Buffer<f32>, from: &Buffer<f32>, to: &Buffer<f32>| {
                let buffers = [&matrix.binding(), &from.binding(), &to.binding()];
                submission.dispatch(&gpu.pipeline(&BASIS, &[])?, threads, &params, &buffers)
            };
        let (coefficients, gradient) = match &self.basis {
            Some(basis) => (&basis.coefficients, &basis.gradient),
            None => (&self.coefficients, &self.gradient),
        };
        if let Some(basis) = &self.basis {
            change(
                submission,
                &basis.matrices[0],
                &self.coefficients,
                coefficients,
            )?;
        }
        submission.clear(gradient);
        let buffers = [coefficients, &self.inverses, gradient];
        self.energy
            .dispatch(gpu, submission, distortion, buffers, self.elements.len())?;
        if let Some(basis) = &self.basis {
            change(submission, &basis.matrices[1], gradient, &self.gradient)?;
        }
        if let Some(checks) = &self.checks {
            let buffers = [&self.coefficients, &self.inverses, &self.gradient];
            checks.dispatch(gpu, submission, distortion, buffers, self.elements.len())?;
        }
        Ok(Reads {
            gradient: submission.read(&self.gradient),
            results: submission.read(&self.energy.results),
            checks: self.checks.as_ref().map(|c| submission.read(&c.results)),
        })
    }

    /// Scales back in f64. `place`: the first element and the first coefficient of the batch.
    fn finish(
        &self,
        batch: &ElementBatch,
        reads: &Reads,
        results: &Results,
        place: (usize, usize),
        output: &mut ElementOutput,
    ) {
        let modes = batch.tables.modes();
        let gradients = results.get(&reads.gradient);
        let sums = results.get(&reads.results);
        let checks = reads.checks.as_ref().map(|read| results.get(read));
        for (k, element) in self.elements.clone().enumerate() {
            let [energy, least] = sums[k];
            let least = checks.as_ref().map_or(least, |c| least.min(c[k][1]));
            let is_valid = least > 0.0;
            let weight = batch.weights[element];
            output.determinants[place.0 + element] = f64::from(least);
            output.energies[place.0 + element] = match is_valid {
                true => weight * f64::from(energy),
                false => f64::INFINITY,
            };
            if is_valid {
                let local = &gradients[3 * modes * k..][..3 * modes];
                let first = place.1 + element * modes;
                for (m, gradient) in output.gradient[first..first + modes].iter_mut().enumerate() {
                    let x = [0, 1, 2].map(|c| f64::from(local[c * modes + m]));
                    *gradient = weight * self.scales[k] * DVec3::from(x);
                }
            }
        }
    }
}

impl Job {
    fn new(
        gpu: &Gpu,
        tables: &ElementTables,
        elements: usize,
        with_gradient: bool,
    ) -> Result<Self> {
        let plan = Plan::new(tables, with_gradient)?;
        Ok(Self {
            tables: Buffer::from_slice(gpu, &plan.tables(&tables.factors))?,
            weights: Buffer::from_slice(gpu, &singles(&tables.weights))?,
            results: Buffer::zeroed(gpu, elements)?,
            plan,
        })
    }

    /// `buffers`: coefficients, inverses, gradient.
    fn dispatch(
        &self,
        gpu: &Gpu,
        submission: &mut Batch,
        distortion: Distortion,
        [coefficients, inverses, gradient]: [&Buffer<f32>; 3],
        elements: usize,
    ) -> Result<()> {
        let pipeline =
            gpu.pipeline(self.plan.shader, self.plan.constants(distortion).as_slice())?;
        let groups = elements.div_ceil(self.plan.elements_a_group);
        for first in (0..self.plan.slabs).step_by(self.plan.slabs_at_once) {
            let params = ElementParams {
                elements: elements as u32,
                first_slab: first as u32,
                end_slab: self.plan.slabs.min(first + self.plan.slabs_at_once) as u32,
            };
            let buffers = [
                &coefficients.binding(),
                &inverses.binding(),
                &self.tables.binding(),
                &self.weights.binding(),
                &gradient.binding(),
                &self.results.binding(),
            ];
            submission.dispatch(
                &pipeline,
                groups * WORKGROUP_SIZE as usize,
                &params,
                &buffers,
            )?;
        }
        Ok(())
    }
}
