//! The heavy operations, each as one call with two implementations: f64 on the CPU (rayon), f32 in WGSL on the GPU.
//!
//! A [`Kernel`] states what both twins of an operation must agree on, so that one test and one benchmark serve all of them.

mod candidate_search;
pub mod candidates;
pub mod closest_point;
pub mod differentiated_voronoi;
pub mod element_energy;
pub mod jet;
pub mod limit_surface;
pub mod restricted_voronoi;
mod seed_tree;
pub mod slots;
pub mod sparse;
pub mod sum;
pub mod vsdm;

use crate::device::{Gpu, Shader};
use crate::error::Result;

/// An operation with two implementations of the same mathematics.
pub trait Kernel {
    /// The stem of its shader, and its row in the benchmark.
    const NAME: &'static str;
    /// The largest disagreement that rounding explains, in the measure of [`compare`](Self::compare). Its documentation says
    /// where it comes from.
    const TOLERANCE: f64;
    /// Plain arrays.
    type Input;
    /// Plain arrays.
    type Output;
    /// An input on the device.
    type Resident;

    /// The number of things that the work is proportional to.
    fn items(input: &Self::Input) -> usize;

    /// In double precision on the CPU.
    fn cpu(input: &Self::Input) -> Self::Output;

    /// Puts an input on the device.
    ///
    /// # Errors
    /// Where the device fails or has no room.
    fn upload(gpu: &Gpu, input: &Self::Input) -> Result<Self::Resident>;

    /// In single precision on the device.
    ///
    /// # Errors
    /// Where the device fails.
    fn gpu(gpu: &Gpu, input: &mut Self::Resident) -> Result<Self::Output>;

    /// The largest disagreement of two outputs for an input, relative to what the result is a sum of.
    fn compare(input: &Self::Input, cpu: &Self::Output, gpu: &Self::Output) -> f64;
}

/// Every shader of the program.
pub const SHADERS: &[&Shader] = &[
    &candidates::SHADER,
    &closest_point::SHADER,
    &jet::SHADER,
    &limit_surface::SHADER,
    &restricted_voronoi::SHADER,
    &differentiated_voronoi::SHADER,
    &slots::SHADER,
    &sum::SHADER,
    &sparse::SHADER,
    &element_energy::HEXAHEDRON,
    &element_energy::PRISM,
    &element_energy::DENSE,
    &element_energy::COLLAPSED,
    &element_energy::BASIS,
];

/// The largest of some ratios `error / scale`; 0 / 0 counts as 0, and what is not a number as infinite.
fn worst_ratio(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    pairs.fold(0.0, |worst, (error, scale)| {
        let ratio = if error == 0.0 { 0.0 } else { error / scale };
        if ratio.is_nan() {
            f64::INFINITY
        } else {
            f64::max(worst, ratio)
        }
    })
}
