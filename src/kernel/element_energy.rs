//! The distortion of curved elements: (1/|Ω|) ∫ ε(J) over each, its gradient on the coefficients of their modes, and the smallest det J.
//!
//! **Theory.** \[PPL13\], section 3.2. An element maps its reference cell by h = Σ c_m N_m; A takes the cell to the element's ideal shape,
//! and J = ∇h A⁻¹ (the paper prints A⁻ᵀ) measures what h does to that. The energy of an element is w Σ_q w_q ε(J_q), with w its share
//! |det A|/|Ω| and w_q the weights of a quadrature rule on the cell; the gradient is the transpose of what led from the coefficients to ∇h,
//! applied to w w_q (∂ε/∂J) A⁻ᵀ. An element is invalid, its energy infinite and its gradient 0, where det J ≤ 0 at a quadrature or check point.
//!
//! **Practice.** ε is any [`Distortion`]; it is pointwise and knows nothing of elements. Modes factor (see [`ElementTables`]), so that an order
//! p hexahedron takes O(p⁴) operations and not O(p⁶) (sum factorization). The CPU twin evaluates four elements side by side
//! in vector registers, slab by slab; on the GPU a workgroup serves an element, or several small ones, the slab in its workgroup memory.

mod contraction;
mod cpu;
mod gpu;
mod pass;
mod plan;
mod tables;

pub(crate) use contraction::{LANES, Node, ZERO};
pub(crate) use cpu::{Lanes, vector};
pub(crate) use pass::Scratch;
pub use tables::{Collapsed, ElementTables, Factors, Samples};

pub use plan::{BASIS, COLLAPSED, DENSE, HEXAHEDRON, PRISM};

use super::{Kernel, worst_ratio};
use crate::device::{Device, Gpu};
use crate::error::Result;
use crate::geometry::distortion::Distortion;
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// Elements of one shape, order and basis.
#[derive(Debug, Clone)]
pub struct ElementBatch {
    /// What they have in common.
    pub tables: Arc<ElementTables>,
    /// A⁻¹ of each element, the inverse of the map from the reference cell to the ideal shape. `[elements]`.
    pub inverse_references: Vec<DMat3>,
    /// |det A|/|Ω| of each element. `[elements]`.
    pub weights: Vec<f64>,
}

impl ElementBatch {
    /// The number of elements.
    pub fn len(&self) -> usize {
        self.weights.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }

    /// The number of coefficients: elements × modes.
    pub fn coefficients(&self) -> usize {
        self.len() * self.tables.modes()
    }

    /// The number of quadrature points: elements × points.
    pub fn points(&self) -> usize {
        self.len() * self.tables.points()
    }
}

/// Elements, their coefficients, and what is integrated.
#[derive(Debug, Clone)]
pub struct ElementInput {
    /// The elements.
    pub batches: Vec<ElementBatch>,
    /// The coefficients of the modes, element by element, batch by batch.
    pub coefficients: Vec<DVec3>,
    /// The density.
    pub distortion: Distortion,
}

/// The distortion of each element.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ElementOutput {
    /// Of each element, batch by batch; infinite where it is invalid.
    pub energies: Vec<f64>,
    /// The smallest det J at its quadrature and check points.
    pub determinants: Vec<f64>,
    /// Of the energy of its own element, for each coefficient; 0 where the element is invalid.
    pub gradient: Vec<DVec3>,
}

impl ElementOutput {
    fn new(batches: &[ElementBatch]) -> Self {
        let elements = batches.iter().map(ElementBatch::len).sum();
        let coefficients = batches.iter().map(ElementBatch::coefficients).sum();
        Self {
            energies: vec![0.0; elements],
            determinants: vec![0.0; elements],
            gradient: vec![DVec3::ZERO; coefficients],
        }
    }

    /// The energy of all elements; infinite where one is invalid.
    pub fn energy(&self) -> f64 {
        self.energies.iter().sum()
    }

    /// The smallest det J of all elements.
    pub fn smallest_determinant(&self) -> f64 {
        self.determinants
            .iter()
            .copied()
            .fold(f64::INFINITY, f64::min)
    }
}

/// Elements made ready for evaluation on a device.
#[derive(Debug)]
pub struct ElementEnergy {
    batches: Vec<ElementBatch>,
    resident: Option<gpu::Resident>,
}

impl ElementEnergy {
    /// Uploads what does not change.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn new(device: &Device, batches: Vec<ElementBatch>) -> Result<Self> {
        let resident = match device {
            Device::Cpu => None,
            Device::Gpu(gpu) => Some(gpu::Resident::new(gpu, &batches)?),
        };
        Ok(Self { batches, resident })
    }

    /// The elements.
    pub fn batches(&self) -> &[ElementBatch] {
        &self.batches
    }

    /// Energies, determinants and gradient for coefficients, element by element, batch by batch. One submission and one readback on a GPU.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn evaluate(
        &mut self,
        coefficients: &[DVec3],
        distortion: Distortion,
    ) -> Result<ElementOutput> {
        match &mut self.resident {
            None => Ok(cpu(&self.batches, coefficients, distortion)),
            Some(resident) => resident.evaluate(&self.batches, coefficients, distortion),
        }
    }
}

/// In double precision on the CPU. The same bits for any number of threads.
///
/// # Panics
/// Where there are fewer coefficients than the elements have modes.
pub fn cpu(
    batches: &[ElementBatch],
    coefficients: &[DVec3],
    distortion: Distortion,
) -> ElementOutput {
    let mut output = ElementOutput::new(batches);
    let (mut element, mut mode) = (0, 0);
    for batch in batches {
        let (elements, modes) = (
            element..element + batch.len(),
            mode..mode + batch.coefficients(),
        );
        (element, mode) = (elements.end, modes.end);
        let parts = output.parts(elements, modes.clone());
        cpu::evaluate(batch, distortion, &coefficients[modes], parts);
    }
    output
}

/// The twins of the element energy.
#[derive(Debug)]
pub struct ElementEnergyTwins;

impl Kernel for ElementEnergyTwins {
    const NAME: &'static str = HEXAHEDRON.name;
    /// In the measure of `compare`, whose unit is what a strain of 1 everywhere does: f32 rounds the entries of J to 6e-8, sums of up to 17
    /// terms along three axes add to that, and logarithms pass it on as it is. Measured: 3e-7 up to order 8, 2.3e-6 at most.
    const TOLERANCE: f64 = 5e-6;
    type Input = ElementInput;
    type Output = ElementOutput;
    type Resident = (ElementEnergy, Vec<DVec3>, Distortion);

    /// Quadrature points.
    fn items(input: &ElementInput) -> usize {
        input.batches.iter().map(ElementBatch::points).sum()
    }

    fn cpu(input: &ElementInput) -> ElementOutput {
        cpu(&input.batches, &input.coefficients, input.distortion)
    }

    fn upload(gpu: &Gpu, input: &ElementInput) -> Result<Self::Resident> {
        let elements = ElementEnergy::new(&Device::Gpu(gpu.clone()), input.batches.clone())?;
        Ok((elements, input.coefficients.clone(), input.distortion))
    }

    fn gpu(
        _: &Gpu,
        (elements, coefficients, distortion): &mut Self::Resident,
    ) -> Result<ElementOutput> {
        elements.evaluate(coefficients, *distortion)
    }

    /// Energies and gradients against those of a strain of 1 (modes have gradients of about 1), plus their own size. Determinants against 1
    /// plus their own size; those past the range of f32 need only be invalid on both sides. Where one twin finds an element invalid and the
    /// other does not, its determinant must be of rounding size.
    fn compare(input: &ElementInput, cpu: &ElementOutput, gpu: &ElementOutput) -> f64 {
        let mut worst = 0.0;
        let (mut element, mut mode) = (0, 0);
        for batch in &input.batches {
            let modes = batch.tables.modes();
            let volume: f64 = batch.tables.weights.iter().sum();
            for (weight, inverse) in batch.weights.iter().zip(&batch.inverse_references) {
                let part = mode..mode + modes;
                let strained = weight * volume;
                let size = inverse.determinant().abs().cbrt();
                let [a, b] = [cpu, gpu].map(|output| output.determinants[element]);
                let [e, f] = [cpu, gpu].map(|output| output.energies[element]);
                let mut pairs = Vec::new();
                if a.abs() < f64::from(f32::MAX) || b > 0.0 {
                    pairs.push(((a - b).abs(), 1.0 + a.abs()));
                }
                if (a > 0.0) == (b > 0.0) {
                    let gradients = || {
                        cpu.gradient[part.clone()]
                            .iter()
                            .zip(&gpu.gradient[part.clone()])
                    };
                    let largest = gradients().map(|(a, _)| a.length()).fold(0.0, f64::max);
                    let scale = strained * size + largest;
                    pairs.extend(gradients().map(|(a, b)| ((*a - *b).length(), scale)));
                    let difference = if e == f { 0.0 } else { (e - f).abs() };
                    pairs.push((difference, if e.is_finite() { strained + e } else { 1.0 }));
                }
                worst = f64::max(worst, worst_ratio(pairs.into_iter()));
                element += 1;
                mode += modes;
            }
        }
        worst
    }
}
