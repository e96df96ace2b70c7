//! Both twins of every kernel over sizes, side by side: how fast, and how far apart.
//!
//! The inputs are generated ([`samples`]), so that the numbers of two machines are numbers of the same work.

pub mod samples;

use crate::device::{Device, Gpu};
use crate::error::{Error, Result};
use crate::kernel::Kernel;
use crate::kernel::candidates::CandidateSeeds;
use crate::kernel::closest_point::ClosestPointTwins;
use crate::kernel::differentiated_voronoi::DifferentiatedVoronoi;
use crate::kernel::element_energy::ElementEnergyTwins;
use crate::kernel::jet::JetTwins;
use crate::kernel::limit_surface::LimitSurfaceTwins;
use crate::kernel::restricted_voronoi::RestrictedVoronoi;
use crate::kernel::sparse::SparseProduct;
use crate::kernel::sum::Sum;
use crate::kernel::vsdm::{Evaluation, Vsdm};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::hint::black_box;
use std::time::Instant;

/// How far the energies and the gradient's norm of a whole evaluation may be apart: see `tests/evaluation_twins.rs`.
const EVALUATION_TOLERANCE: f64 = 5e-6;
/// What the sphere of the whole evaluation grows by from call to call: the candidates are kept for some calls, as in a fit.
const GROWTH: f64 = 1e-5;

/// A kernel at one size.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Its name, that of its shader; "evaluation" for both terms of a fit with everything around them.
    pub kernel: String,
    /// What it was asked to be measured at: the triangles of the scene, or about as many of what the kernel works on.
    pub size: usize,
    /// The things that the work is proportional to.
    pub items: usize,
    /// Milliseconds on the CPU, f64.
    pub cpu_ms: f64,
    /// Milliseconds on the GPU, with what goes there and comes back at every call.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gpu_ms: Option<f64>,
    /// How far the GPU's output is from the CPU's, in units of the kernel's tolerance: up to 1 is what rounding explains.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub disagreement: Option<f64>,
}

/// How to measure.
#[derive(Debug, Clone)]
pub struct Bench {
    /// The GPU to measure beside the CPU, if any.
    pub gpu: Option<Gpu>,
    /// Calls are repeated for this long; the fastest counts.
    pub seconds: f64,
}

/// Measures something at a size.
pub type Measurement = fn(&Bench, usize) -> Result<Row>;

/// Every kernel, and the whole evaluation.
pub const MEASUREMENTS: &[Measurement] = &[
    |bench, size| bench.kernel::<Sum>(size, &samples::sums(size)),
    |bench, size| bench.kernel::<SparseProduct>(size, &samples::product(size)),
    |bench, size| bench.kernel::<ClosestPointTwins>(size, &samples::closest(size)),
    |bench, size| bench.kernel::<LimitSurfaceTwins>(size, &samples::limit(size)),
    |bench, size| bench.kernel::<JetTwins>(size, &samples::jets(size)),
    |bench, size| bench.kernel::<CandidateSeeds>(size, &samples::candidates(size)),
    |bench, size| bench.kernel::<RestrictedVoronoi>(size, &samples::restricted(size)),
    |bench, size| bench.kernel::<DifferentiatedVoronoi>(size, &samples::differentiated(size)),
    |bench, size| bench.kernel::<ElementEnergyTwins>(size, &samples::elements(size)?),
    Bench::evaluation,
];

impl Bench {
    fn kernel<K: Kernel>(&self, size: usize, input: &K::Input) -> Result<Row> {
        let (cpu_ms, cpu) = self.fastest(|| Ok(K::cpu(input)))?;
        let mut row = Row {
            kernel: K::NAME.into(),
            size,
            items: K::items(input),
            cpu_ms,
            gpu_ms: None,
            disagreement: None,
        };
        if let Some(gpu) = &self.gpu {
            let mut resident = K::upload(gpu, input)?;
            let (gpu_ms, output) = self.fastest(|| K::gpu(gpu, &mut resident))?;
            row.gpu_ms = Some(gpu_ms);
            row.disagreement = Some(K::compare(input, &cpu, &output) / K::TOLERANCE);
        }
        Ok(row)
    }

    fn evaluation(&self, size: usize) -> Result<Row> {
        let (fixed, moving, metric, start) = samples::evaluation(size);
        let measure = |device: &Device| {
            let mut vsdm = Vsdm::new(device, fixed.clone(), moving.clone(), metric);
            let first = vsdm.evaluate(&start)?;
            let mut points = start.clone();
            let (ms, _) = self.fastest(|| {
                points.iter_mut().for_each(|p| *p *= 1.0 + GROWTH);
                vsdm.evaluate(&points)
            })?;
            Ok::<_, Error>((ms, first))
        };
        let (cpu_ms, cpu) = measure(&Device::Cpu)?;
        let gpu = self.gpu.clone().map(|gpu| measure(&Device::Gpu(gpu)));
        let gpu = gpu.transpose()?;
        Ok(Row {
            kernel: "evaluation".into(),
            size,
            items: fixed.triangles.len(),
            cpu_ms,
            gpu_ms: gpu.as_ref().map(|(ms, _)| *ms),
            disagreement: gpu.map(|(_, gpu)| apart(&cpu, &gpu) / EVALUATION_TOLERANCE),
        })
    }

    /// Milliseconds of the fastest of some calls, and the result of the last. A first one is not counted: drivers compile then.
    fn fastest<T>(&self, mut call: impl FnMut() -> Result<T>) -> Result<(f64, T)> {
        call()?;
        let started = Instant::now();
        let mut least = f64::INFINITY;
        loop {
            let begun = Instant::now();
            let result = black_box(call()?);
            least = least.min(begun.elapsed().as_secs_f64());
            if started.elapsed().as_secs_f64() >= self.seconds {
                return Ok((1e3 * least, result));
            }
        }
    }
}

/// The largest relative difference of the energies and of the gradient as a whole.
fn apart(a: &Evaluation, b: &Evaluation) -> f64 {
    let norm = |g: &[DVec3]| g.iter().map(|v| v.length_squared()).sum::<f64>().sqrt();
    let difference: Vec<DVec3> = a
        .gradient
        .iter()
        .zip(&b.gradient)
        .map(|(a, b)| *a - *b)
        .collect();
    [
        (b.target_to_surface / a.target_to_surface - 1.0).abs(),
        (b.surface_to_target / a.surface_to_target - 1.0).abs(),
        norm(&difference) / norm(&a.gradient),
    ]
    .into_iter()
    .fold(0.0, f64::max)
}
