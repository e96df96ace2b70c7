//! Jets: for each of many groups of points the polynomial of degree 4 in x and y whose graph is nearest to them, by weighted least squares.
//!
//! Points are in a frame of their own group and within 1 of its origin, so that f32 has nothing large to lose digits to. A row of weight
//! [`weight`] stands for a point. The CPU twin reflects whole columns (Householder, in f64); the GPU twin rotates one row after another into a
//! triangle (Givens, in f32), and stores no rows. Where the points leave terms open (points of a line, few points) both give about the smallest
//! coefficients that fit, by rows that ask for 0 with a weight far below all others.
//!
//! On neighbourhoods of a mesh f32 loses up to 2e-6 of the largest height in the terms that make k and b, and 5e-6 in those that make c
//! (`tests/jet_twins.rs` measures it): nothing against what scans do.

use super::Kernel;
use crate::device::{Buffer, Device, Gpu, Shader, shared_struct, source};
use crate::error::Result;
use crate::geometry::vector::{Arithmetic, Work, fastest};
use glam::DVec3;
use rayon::prelude::*;

/// Coefficients of a polynomial of degree 4 in two variables.
pub const TERMS: usize = 15;
/// The most points of a group: more add little, and these take a thread some 15,000 iterations ([`MAX_ITERATIONS`](crate::device::MAX_ITERATIONS)).
pub const MAX_POINTS: usize = 250;

/// Weight of the rows that ask for 0: some 1e-14 of what the terms weigh is lost to them, and points that leave a term open give it 1e-9 of noise.
const DAMPING: f64 = 1e-7;
/// How far beyond 1 the weight would vanish: points on the rim still count.
const REACH: f64 = 1.1;
/// Points that go to the device at once: 64 MiB.
const BATCH: usize = 1 << 22;
/// Numbers that the device answers with for a group.
const ANSWER: usize = TERMS + 2;
/// Groups that a thread takes at a time.
const GRAIN: usize = 32;
/// Columns are padded to a multiple of this.
const LANES: usize = 8;

/// Groups of points in local coordinates.
#[derive(Debug, Clone, Default)]
pub struct JetInput {
    /// `[groups + 1]`: the points of group g are `points[offsets[g]..offsets[g + 1]]`, at most [`MAX_POINTS`].
    pub offsets: Vec<u32>,
    /// x, y and height, within 1 of the origin.
    pub points: Vec<DVec3>,
}

impl JetInput {
    /// The number of groups.
    pub fn groups(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    fn group(&self, g: usize) -> &[DVec3] {
        &self.points[self.offsets[g] as usize..self.offsets[g + 1] as usize]
    }
}

/// A polynomial through points, about.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Jet {
    /// 1, x, y, x², xy, y², x³, … : by degree, powers of x falling.
    pub coefficients: [f64; TERMS],
    /// Root mean square of the heights left over, each times its weight.
    pub residual: f64,
    /// How well the points tell the terms apart: the least share of a term that the terms before it do not make up, rms over the points. About
    /// 1e-2 for points all over a disc, 0 where they leave a term open.
    pub pivot: f64,
}

/// What a point counts in its group, as a factor of its row.
pub fn weight(p: DVec3) -> f64 {
    1.0 - p.length_squared() / REACH
}

/// The monomials that [`Jet::coefficients`] belong to.
pub fn monomials(x: f64, y: f64) -> [f64; TERMS] {
    let (xx, xy, yy) = (x * x, x * y, y * y);
    [
        1.0,
        x,
        y,
        xx,
        xy,
        yy,
        x * xx,
        xx * y,
        x * yy,
        y * yy,
        xx * xx,
        xx * xy,
        xx * yy,
        xy * yy,
        yy * yy,
    ]
}

shared_struct! {
    /// The parameters of a dispatch.
    pub struct JetParams {
        /// The number of groups.
        groups: u32,
    }
}

/// `shaders/jet.wgsl`.
pub const SHADER: Shader = Shader {
    name: "jet",
    structs: &[JetParams::LAYOUT],
    sources: &[source!("shared/grid.wgsl"), source!("jet.wgsl")],
    constants: &[],
};

/// The jet of every group.
///
/// # Errors
/// Where the device fails.
pub fn fit(device: &Device, input: &JetInput) -> Result<Vec<Jet>> {
    match device {
        Device::Cpu => Ok(on_cpu(input)),
        Device::Gpu(gpu) => on_gpu(gpu, input),
    }
}

fn on_cpu(input: &JetInput) -> Vec<Jet> {
    let mut jets = vec![Jet::default(); input.groups()];
    jets.par_chunks_mut(GRAIN)
        .enumerate()
        .for_each(|(chunk, jets)| {
            fastest(Fits {
                input,
                first: chunk * GRAIN,
                jets,
            });
        });
    jets
}

/// Consecutive groups.
struct Fits<'a> {
    input: &'a JetInput,
    first: usize,
    jets: &'a mut [Jet],
}

impl Work for Fits<'_> {
    #[inline(always)]
    fn run<A: Arithmetic>(self) {
        let mut columns = Columns::default();
        for (g, jet) in (self.first..).zip(self.jets) {
            columns.set(self.input.group(g));
            columns.reduce::<A>();
            *jet = columns.solve();
        }
    }
}

/// The system of a group, column by column: the terms, then the heights.
#[derive(Default)]
struct Columns {
    points: usize,
    height: usize,
    /// `[TERMS + 1, height]`.
    values: Vec<f64>,
    /// `[height]`.
    mirror: Vec<f64>,
}

impl Columns {
    /// A row for every point, and one for every term that asks for 0.
    fn set(&mut self, points: &[DVec3]) {
        self.points = points.len();
        self.height = (points.len() + TERMS).next_multiple_of(LANES);
        self.values.clear();
        self.values.resize((TERMS + 1) * self.height, 0.0);
        for (row, p) in points.iter().enumerate() {
            let weight = weight(*p);
            let terms = monomials(p.x, p.y);
            for (column, value) in terms.iter().chain([&p.z]).enumerate() {
                self.values[column * self.height + row] = weight * value;
            }
        }
        for term in 0..TERMS {
            self.values[term * self.height + points.len() + term] = DAMPING;
        }
    }

    /// Mirrors every column in turn onto its first entries, the later ones with it.
    #[inline(always)]
    fn reduce<A: Arithmetic>(&mut self) {
        for k in 0..TERMS {
            let (done, later) = self.values.split_at_mut((k + 1) * self.height);
            let column = &mut done[k * self.height..];
            self.mirror.clear();
            self.mirror.extend_from_slice(column);
            self.mirror[..k].fill(0.0);
            let length = dot::<A>(&self.mirror, &self.mirror).sqrt();
            let pivot = -length.copysign(column[k]);
            self.mirror[k] -= pivot;
            column[k] = pivot;
            // Never 0: each column has a damping row of its own.
            let scale = 1.0 / (pivot * self.mirror[k]);
            for column in later.chunks_exact_mut(self.height) {
                let along = scale * dot::<A>(&self.mirror, column);
                for (value, mirror) in column.iter_mut().zip(&self.mirror) {
                    *value = A::mul_add(along, *mirror, *value);
                }
            }
        }
    }

    /// The coefficients, from the last to the first.
    fn solve(&self) -> Jet {
        let mut coefficients = [0.0; TERMS];
        let heights = &self.values[TERMS * self.height..];
        for k in (0..TERMS).rev() {
            let known = (k + 1..TERMS).map(|j| self.values[j * self.height + k] * coefficients[j]);
            coefficients[k] = (heights[k] - known.sum::<f64>()) / self.values[k * self.height + k];
        }
        let left: f64 = heights[TERMS..].iter().map(|h| h * h).sum();
        let pivots = (0..TERMS).map(|k| self.values[k * self.height + k].abs());
        let count = self.points.max(1) as f64;
        Jet {
            coefficients,
            residual: (left / count).sqrt(),
            pivot: pivots.fold(f64::INFINITY, f64::min) / count.sqrt(),
        }
    }
}

/// Of two columns whose length is a multiple of [`LANES`].
#[inline(always)]
fn dot<A: Arithmetic>(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum = A::mul_add(*a, *b, *sum);
        }
    }
    sums.iter().sum()
}

fn on_gpu(gpu: &Gpu, input: &JetInput) -> Result<Vec<Jet>> {
    let mut jets = Vec::with_capacity(input.groups());
    while jets.len() < input.groups() {
        let first = jets.len();
        let begin = input.offsets[first];
        let fits = |&&end: &&u32| (end - begin) as usize <= BATCH;
        let count = input.offsets[first + 1..]
            .iter()
            .take_while(fits)
            .count()
            .max(1);
        jets.extend(batch(gpu, input, first..first + count)?);
    }
    Ok(jets)
}

/// The jets of consecutive groups.
fn batch(gpu: &Gpu, input: &JetInput, groups: std::ops::Range<usize>) -> Result<Vec<Jet>> {
    let offsets = &input.offsets[groups.start..=groups.end];
    let local: Vec<u32> = offsets.iter().map(|end| end - offsets[0]).collect();
    let range = offsets[0] as usize..offsets[groups.len()] as usize;
    let points: Vec<[f32; 4]> = input.points[range]
        .par_iter()
        .map(|&p| p.extend(weight(p)).as_vec4().to_array())
        .collect();
    let offsets = Buffer::from_slice(gpu, &local)?;
    let points = Buffer::from_slice(gpu, &points)?;
    let answers = Buffer::<[f32; ANSWER]>::zeroed(gpu, groups.len())?;
    let mut batch = gpu.batch();
    batch.dispatch(
        &gpu.pipeline(&SHADER, &[])?,
        groups.len(),
        &JetParams {
            groups: groups.len() as u32,
        },
        &[&offsets.binding(), &points.binding(), &answers.binding()],
    )?;
    let read = batch.read(&answers);
    let answers = batch.submit()?.get(&read);
    let jet = |answer: &[f32; ANSWER]| Jet {
        coefficients: std::array::from_fn(|k| f64::from(answer[k])),
        residual: f64::from(answer[TERMS]),
        pivot: f64::from(answer[TERMS + 1]),
    };
    Ok(answers.iter().map(jet).collect())
}

/// The twins of the jet.
#[derive(Debug)]
pub struct JetTwins;

impl Kernel for JetTwins {
    const NAME: &'static str = SHADER.name;
    /// Of the sum of all terms, however they cancel, and the heights: what some hundred rotations in f32 leave. Measured: 1.5e-6, and
    /// 3.3e-6 on fewer points than terms, where the damping of the twins differs.
    const TOLERANCE: f64 = 1e-5;
    type Input = JetInput;
    type Output = Vec<Jet>;
    type Resident = JetInput;

    fn items(input: &JetInput) -> usize {
        input.groups()
    }

    fn cpu(input: &JetInput) -> Vec<Jet> {
        on_cpu(input)
    }

    fn upload(_: &Gpu, input: &JetInput) -> Result<JetInput> {
        Ok(input.clone())
    }

    fn gpu(gpu: &Gpu, input: &mut JetInput) -> Result<Vec<Jet>> {
        on_gpu(gpu, input)
    }

    /// Heights of the polynomials at the points, and what is left over: points may leave coefficients open, but not these.
    fn compare(input: &JetInput, cpu: &Vec<Jet>, gpu: &Vec<Jet>) -> f64 {
        if cpu.len() != gpu.len() {
            return f64::INFINITY;
        }
        super::worst_ratio((0..cpu.len()).map(|g| apart(input.group(g), &cpu[g], &gpu[g])))
    }
}

/// The largest difference of two jets at points, and the size that it is judged against.
fn apart(points: &[DVec3], cpu: &Jet, gpu: &Jet) -> (f64, f64) {
    let mut error = (cpu.residual - gpu.residual).abs();
    let mut scale = 0.0f64;
    for p in points {
        let terms = monomials(p.x, p.y);
        let both = || cpu.coefficients.iter().zip(&gpu.coefficients).zip(terms);
        let difference: f64 = both().map(|((a, b), t)| (a - b) * t).sum();
        let size: f64 = both().map(|((a, _), t)| (a * t).abs()).sum();
        error = error.max(difference.abs());
        scale = scale.max(size + p.z.abs());
    }
    (error, scale)
}
