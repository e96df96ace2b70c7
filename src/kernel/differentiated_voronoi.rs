//! Restricted Voronoi, differentiated: the cells of fixed seeds on a moving surface.
//!
//! For samples y_j of T with unit normal N_j and metric W_j = α I + (β − α) N_j N_jᵀ, and triangles of S:
//! F = Σ_j ∫_{S ∩ Ω_j} (x − y_j)ᵀ W_j (x − y_j) dx, with its gradient on the corners of each triangle. With α = 1 and
//! β = s² this is F_S→T of \[NYL12\], section 3.6.
//!
//! **Gradient.** With λ_k the barycentric coordinate of corner p_k, three parts: the integrand, ∫ 2 λ_k W_j (x − y_j) dx;
//! the area, (F_t / A_t) ∂A_t/∂p_k over the whole triangle; and the bisectors. A bisector j|l is fixed in space and the
//! surface slides through it: moving p_k by δ shifts it, within the triangle, by λ_k (y_j − y_l)·δ / |P(y_l − y_j)|
//! towards l, where the integrand jumps by e_j − e_l. Each of the two cells adds half. On the bisector |x − y_j| =
//! |x − y_l|, so the jump is (β − α)(h_j² − h_l²) with h = N·(x − y): a cubic with λ_k, for which Simpson's rule is exact.
//!
//! \[NYL12\] appendix 2 propagates the same derivative through the Jacobians of the cut vertices (equations 13 and 14);
//! a test holds the two against each other.

use super::candidates::Candidates;
use super::restricted_voronoi::Metric;
use super::slots::{self, CheckReadback, GpuSlots};
use super::sparse::unpadded;
use super::sum::{GpuSegments, Records, Segments};
use super::{Kernel, worst_ratio};
use crate::device::{Batch, Buffer, Gpu, Shader, shared_struct, source};
use crate::error::Result;
use crate::geometry::clip::{BisectorEdge, Clipper, Moments};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Triangles summed by one task. Fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 1024;

/// The energy of a moving surface and its gradient.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Differential {
    /// F.
    pub energy: f64,
    /// `[triangles]`, ∂F/∂p_k on the three corners.
    pub gradient: Vec<[DVec3; 3]>,
    /// The area of the surface.
    pub area: f64,
}

/// The f64 twin. `seeds` and `normals`: `[samples]`; `candidates` as found for `triangles`.
pub fn cpu(
    triangles: &[[DVec3; 3]],
    seeds: &[DVec3],
    normals: &[DVec3],
    candidates: &Candidates,
    metric: Metric,
) -> Differential {
    let samples = Samples {
        seeds,
        normals,
        metric,
    };
    let mut gradient = vec![[DVec3::ZERO; 3]; triangles.len()];
    let sums: Vec<(f64, f64)> = gradient
        .par_chunks_mut(CHUNK)
        .zip(triangles.par_chunks(CHUNK))
        .enumerate()
        .map_init(Clipper::default, |clipper, (chunk, (out, triangles))| {
            let (mut energy, mut area) = (0.0, 0.0);
            for (k, (g, corners)) in out.iter_mut().zip(triangles).enumerate() {
                let facet = Facet::new(corners);
                let mut e = 0.0;
                clipper.cells(
                    corners,
                    seeds,
                    candidates.of(chunk * CHUNK + k),
                    metric.excess() != 0.0,
                    |j, moments, edges| e += facet.add(j, &samples, moments, edges, g),
                );
                facet.add_area_derivative(corners, e, g);
                energy += e;
                area += 0.5 * facet.double_area;
            }
            (energy, area)
        })
        .collect();
    let (energy, area) = sums
        .into_iter()
        .fold((0.0, 0.0), |(e, a), (de, da)| (e + de, a + da));
    Differential {
        energy,
        gradient,
        area,
    }
}

struct Samples<'a> {
    seeds: &'a [DVec3],
    normals: &'a [DVec3],
    metric: Metric,
}

struct Facet {
    origin: DVec3,
    edges: [DVec3; 2],
    normal: DVec3,
    double_area: f64,
    gram: [f64; 3],
}

impl Facet {
    fn new(corners: &[DVec3; 3]) -> Self {
        let [e1, e2] = [corners[1] - corners[0], corners[2] - corners[0]];
        let area_vector = e1.cross(e2);
        let double_area = area_vector.length();
        Self {
            origin: corners[0],
            edges: [e1, e2],
            normal: if double_area > 0.0 {
                area_vector / double_area
            } else {
                DVec3::ZERO
            },
            double_area,
            gram: [e1.length_squared(), e1.dot(e2), e2.length_squared()],
        }
    }

    /// Adds the cell of sample `j` to the gradient, but for the area's derivative, and returns its energy.
    fn add(
        &self,
        j: u32,
        samples: &Samples,
        m: &Moments,
        edges: &[BisectorEdge],
        gradient: &mut [DVec3; 3],
    ) -> f64 {
        let [e1, e2] = self.edges;
        let d = self.origin - samples.seeds[j as usize];
        let n = samples.normals[j as usize];
        let (alpha, excess) = (samples.metric.tangential, samples.metric.excess());
        let [h0, h1, h2] = [n.dot(d), n.dot(e1), n.dot(e2)];
        // ∫ W d weighted by 1, u and v.
        let weighted = |one: f64, u: f64, v: f64| {
            self.double_area
                * (alpha * (d * one + e1 * u + e2 * v)
                    + n * (excess * (h0 * one + h1 * u + h2 * v)))
        };
        let all = weighted(m.one, m.u, m.v);
        let by_u = weighted(m.u, m.uu, m.uv);
        let by_v = weighted(m.v, m.uv, m.vv);
        gradient[0] += 2.0 * (all - by_u - by_v);
        gradient[1] += 2.0 * by_u;
        gradient[2] += 2.0 * by_v;
        for edge in edges {
            self.add_bisector(j, samples, edge, gradient);
        }
        let quadratic = |q00: f64, q01: f64, q02: f64, q11: f64, q12: f64, q22: f64| {
            q00 * m.one + 2.0 * (q01 * m.u + q02 * m.v + q12 * m.uv) + q11 * m.uu + q22 * m.vv
        };
        let [g11, g12, g22] = self.gram;
        let squared = quadratic(d.length_squared(), d.dot(e1), d.dot(e2), g11, g12, g22);
        let along = quadratic(h0 * h0, h0 * h1, h0 * h2, h1 * h1, h1 * h2, h2 * h2);
        self.double_area * (alpha * squared + excess * along)
    }

    /// Half of what the sliding of a bisector adds.
    fn add_bisector(
        &self,
        j: u32,
        samples: &Samples,
        edge: &BisectorEdge,
        gradient: &mut [DVec3; 3],
    ) {
        let l = edge.other as usize;
        let j = j as usize;
        let towards = samples.seeds[j] - samples.seeds[l];
        let speed = (towards - self.normal * self.normal.dot(towards)).length();
        if speed == 0.0 {
            return;
        }
        let [e1, e2] = self.edges;
        let [a, b] = edge.ends;
        let length = (e1 * (b[0] - a[0]) + e2 * (b[1] - a[1])).length();
        let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        let mut integral = [0.0; 3];
        for ([u, v], weight) in [(a, 1.0), (middle, 4.0), (b, 1.0)] {
            let x = self.origin + e1 * u + e2 * v;
            let hj = samples.normals[j].dot(x - samples.seeds[j]);
            let hl = samples.normals[l].dot(x - samples.seeds[l]);
            let jump = weight * (hj * hj - hl * hl);
            integral[0] += jump * (1.0 - u - v);
            integral[1] += jump * u;
            integral[2] += jump * v;
        }
        let scale = 0.5 * samples.metric.excess() * length / (6.0 * speed);
        for (g, part) in gradient.iter_mut().zip(integral) {
            *g += towards * (scale * part);
        }
    }

    /// Adds (F_t / A_t) ∂A_t/∂p_k = F_t / (2 A_t) N × (the opposite edge).
    fn add_area_derivative(&self, corners: &[DVec3; 3], energy: f64, gradient: &mut [DVec3; 3]) {
        if self.double_area > 0.0 {
            let scaled = self.normal * (energy / self.double_area);
            for k in 0..3 {
                gradient[k] += scaled.cross(corners[(k + 2) % 3] - corners[(k + 1) % 3]);
            }
        }
    }
}

shared_struct! {
    /// The parameters of a dispatch.
    pub struct DifferentiatedParams {
        /// The number of slots.
        slots: u32,
        /// α.
        tangential: f32,
        /// β − α.
        excess: f32,
    }
}

/// `shaders/differentiated_voronoi.wgsl`.
pub const SHADER: Shader = Shader {
    name: "differentiated_voronoi",
    structs: &[DifferentiatedParams::LAYOUT],
    sources: &[
        source!("shared/grid.wgsl"),
        source!("shared/clip.wgsl"),
        source!("differentiated_voronoi.wgsl"),
    ],
    constants: &[],
};

/// Four-vectors a record: the gradient on each corner.
const WIDTH: usize = 3;

/// The fixed samples and the triangles of the moving surface on the device, with the candidates of the moment.
#[derive(Debug)]
pub struct GpuDifferentiated {
    gpu: Gpu,
    metric: Metric,
    samples: Buffer<[f32; 4]>,
    chunks: Vec<GpuChunk>,
}

#[derive(Debug)]
struct GpuChunk {
    triangles: Buffer<u32>,
    slots: GpuSlots,
    /// `[triangles, 3]`, the gradient on each corner.
    corners: Buffer<[f32; 4]>,
    /// The corners of each point.
    by_point: GpuSegments,
}

impl GpuDifferentiated {
    /// Uploads samples, with `origin` subtracted in f64, and triangles that index `points` points.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn new(
        gpu: &Gpu,
        samples: [&[DVec3]; 2],
        origin: DVec3,
        triangles: &[[u32; 3]],
        points: usize,
        metric: Metric,
    ) -> Result<Self> {
        let positions = slots::local(samples[0], origin);
        let normals = slots::local(samples[1], DVec3::ZERO);
        let samples: Vec<_> = positions
            .into_iter()
            .zip(normals)
            .flat_map(|(y, n)| [y, n])
            .collect();
        let chunk = |range: Range<usize>| -> Result<GpuChunk> {
            let corners = triangles[range.clone()].as_flattened();
            let by_point = Segments::by_key(corners.iter().copied(), points);
            Ok(GpuChunk {
                triangles: Buffer::from_slice(gpu, corners)?,
                slots: GpuSlots::new(gpu, range, WIDTH)?,
                corners: Buffer::zeroed(gpu, corners.len())?,
                by_point: GpuSegments::new(gpu, &by_point)?,
            })
        };
        Ok(Self {
            gpu: gpu.clone(),
            metric,
            samples: Buffer::from_slice(gpu, &samples)?,
            chunks: slots::chunks(triangles.len())
                .map(chunk)
                .collect::<Result<_>>()?,
        })
    }

    /// Replaces the candidates.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn write(&mut self, candidates: &Candidates) -> Result<()> {
        self.chunks
            .iter_mut()
            .try_for_each(|chunk| chunk.slots.write(candidates).map(drop))
    }

    /// Adds the integration over the surface with these points to a batch. The gradient on the points is added to `gradient`.
    ///
    /// # Errors
    /// Where a buffer passes the adapter's limits.
    pub fn integrate(
        &self,
        batch: &mut Batch,
        points: &Buffer<[f32; 4]>,
        gradient: &Buffer<[f32; 4]>,
    ) -> Result<Vec<CheckReadback>> {
        let pipeline = self.gpu.pipeline(&SHADER, &[])?;
        let mut checks = Vec::new();
        for chunk in &self.chunks {
            let slots = &chunk.slots;
            let params = DifferentiatedParams {
                slots: slots.len() as u32,
                tangential: self.metric.tangential as f32,
                excess: self.metric.excess() as f32,
            };
            batch.dispatch(
                &pipeline,
                slots.len(),
                &params,
                &[
                    &chunk.triangles.binding(),
                    &points.binding(),
                    &self.samples.binding(),
                    &slots.offsets.binding(),
                    &slots.candidates.binding(),
                    &slots.order.binding(),
                    &slots.records.binding(),
                    &slots.fractions.binding(),
                ],
            )?;
            checks.push(slots.check(batch)?);
            let records = Records::whole(&slots.records, WIDTH as u32);
            slots
                .by_triangle()
                .sum(&self.gpu, batch, records, false, &chunk.corners)?;
            let corners = Records::whole(&chunk.corners, 1);
            chunk
                .by_point
                .sum(&self.gpu, batch, corners, true, gradient)?;
        }
        Ok(checks)
    }
}

/// The twins of the differentiated Voronoi cells.
#[derive(Debug)]
pub struct DifferentiatedVoronoi;

/// What is integrated.
#[derive(Debug, Clone)]
pub struct DifferentiatedInput {
    /// S, in a spatial order; index `points`.
    pub triangles: Vec<[u32; 3]>,
    /// The vertices of S.
    pub points: Vec<DVec3>,
    /// y.
    pub samples: Vec<DVec3>,
    /// Unit normals there; the same where samples coincide.
    pub normals: Vec<DVec3>,
    /// As found for these.
    pub candidates: Candidates,
    /// α and β of the W_j.
    pub metric: Metric,
}

impl DifferentiatedInput {
    fn corners(&self) -> Vec<[DVec3; 3]> {
        self.triangles
            .iter()
            .map(|t| t.map(|v| self.points[v as usize]))
            .collect()
    }

    /// Adds a gradient on corners to one on points.
    fn scatter(&self, triangles: &[[u32; 3]], corners: &[[DVec3; 3]], points: &mut [DVec3]) {
        for (t, gradient) in triangles.iter().zip(corners) {
            for (&v, g) in t.iter().zip(gradient) {
                points[v as usize] += *g;
            }
        }
    }
}

/// A [`DifferentiatedInput`] on the device.
#[derive(Debug)]
pub struct ResidentDifferentiated {
    input: DifferentiatedInput,
    surface: GpuDifferentiated,
    points: Buffer<[f32; 4]>,
    gradient: Buffer<[f32; 4]>,
}

impl Kernel for DifferentiatedVoronoi {
    const NAME: &'static str = SHADER.name;
    /// Of the scales of [`compare`](Self::compare). Beside what [`RestrictedVoronoi`](super::restricted_voronoi::RestrictedVoronoi)
    /// rounds, the normal and the area of a moving triangle are f32 here. Measured: 1.2e-5 among slivers, below 9e-6 elsewhere.
    const TOLERANCE: f64 = 2e-5;
    type Input = DifferentiatedInput;
    /// The energy, and its gradient on each point.
    type Output = (f64, Vec<DVec3>);
    type Resident = ResidentDifferentiated;

    fn items(input: &DifferentiatedInput) -> usize {
        input.triangles.len()
    }

    fn cpu(input: &DifferentiatedInput) -> Self::Output {
        let differential = cpu(
            &input.corners(),
            &input.samples,
            &input.normals,
            &input.candidates,
            input.metric,
        );
        let mut gradient = vec![DVec3::ZERO; input.points.len()];
        input.scatter(&input.triangles, &differential.gradient, &mut gradient);
        (differential.energy, gradient)
    }

    fn upload(gpu: &Gpu, input: &DifferentiatedInput) -> Result<ResidentDifferentiated> {
        let origin = slots::center(&input.points);
        let mut surface = GpuDifferentiated::new(
            gpu,
            [&input.samples, &input.normals],
            origin,
            &input.triangles,
            input.points.len(),
            input.metric,
        )?;
        surface.write(&input.candidates)?;
        Ok(ResidentDifferentiated {
            input: input.clone(),
            surface,
            points: Buffer::from_slice(gpu, &slots::local(&input.points, origin))?,
            gradient: Buffer::zeroed(gpu, input.points.len())?,
        })
    }

    fn gpu(gpu: &Gpu, resident: &mut ResidentDifferentiated) -> Result<Self::Output> {
        let ResidentDifferentiated {
            input,
            surface,
            points,
            gradient,
        } = resident;
        let mut batch = gpu.batch();
        batch.clear(gradient);
        let checks = surface.integrate(&mut batch, points, gradient)?;
        let read = batch.read(gradient);
        let results = batch.submit()?;
        let checked = slots::merge(checks.iter().map(|c| c.get(&results)));
        let Some(failures) = checked.failures else {
            return Ok(Self::cpu(input));
        };
        let again = redo(
            &input.corners(),
            [&input.samples, &input.normals],
            &input.candidates,
            input.metric,
            &failures,
        );
        let mut gradient = unpadded(&results.get(&read));
        let some: Vec<_> = failures
            .iter()
            .map(|&t| input.triangles[t as usize])
            .collect();
        input.scatter(&some, &again.gradient, &mut gradient);
        Ok((checked.energy + again.energy, gradient))
    }

    /// Energy against a tenth of itself, since all its terms are positive. The gradient on a point against the mean over the points of
    /// 2 √(area · β F), which bounds the sum of |terms| of the integrand by Cauchy and Schwarz, plus F / area times the longest edge,
    /// the size of the area's derivative. What the rounding of coordinates to f32 moves the first by is granted on top.
    fn compare(input: &DifferentiatedInput, cpu: &Self::Output, gpu: &Self::Output) -> f64 {
        let (mut area, mut longest) = (0.0, 0.0);
        for facet in input.corners().iter().map(Facet::new) {
            area += 0.5 * facet.double_area;
            longest = f64::max(longest, facet.gram[0].max(facet.gram[2]).sqrt());
        }
        let weight = input.metric.tangential.max(input.metric.normal);
        let rounding = slots::rounding(&input.points) / Self::TOLERANCE * area;
        let integrand = (area * weight * cpu.0).sqrt() + weight * rounding;
        let scale = 2.0 * integrand / input.points.len() as f64 + cpu.0 / area * longest;
        let gradients = cpu.1.iter().zip(&gpu.1);
        worst_ratio(
            std::iter::once(((cpu.0 - gpu.0).abs(), 0.1 * cpu.0))
                .chain(gradients.map(|(a, b)| ((*a - *b).length(), scale))),
        )
    }
}

/// The cells on some of the triangles, in f64: those that the device gave up.
pub(super) fn redo(
    corners: &[[DVec3; 3]],
    [samples, normals]: [&[DVec3]; 2],
    candidates: &Candidates,
    metric: Metric,
    which: &[u32],
) -> Differential {
    let some: Vec<_> = which.iter().map(|&t| corners[t as usize]).collect();
    cpu(&some, samples, normals, &candidates.select(which), metric)
}
