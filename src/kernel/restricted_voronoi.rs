//! Restricted Voronoi: the cells of moving seeds on a fixed surface, integrated.
//!
//! For seeds x_i and triangles of T with unit normal N and metric W = α I + (β − α) N Nᵀ, over the restricted cells
//! Ω_i ∩ T of the Euclidean Voronoi diagram: area, first moment ∫ (y − x_i) dy, the energy
//! F = Σ_i ∫ (y − x_i)ᵀ W (y − x_i) dy and its gradient. With α = 1 and β = s² this is F_T→S of \[NYL12\], section 3.6.
//!
//! **Gradient.** The integrand moves with x_i, −2 W ∫ (y − x_i) dy, and so does the bisector between i and j: where x_i
//! moves by δ it advances in the triangle's plane by (y − x_i)·δ / |P(x_j − x_i)|, P the projection into that plane, and
//! the integrand jumps there by e_i − e_j. The paper leaves the second part out; it vanishes only for α = β, and for
//! s = 5 the first part alone is wrong even in sign. In the plane of a triangle N·(y − x_i) is constant, so the jump is
//! too, and the midpoint of the edge integrates it exactly.

use super::candidates::Candidates;
use super::slots::{self, CheckReadback, GpuSlots};
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

/// The weights of a metric α I + (β − α) N Nᵀ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Metric {
    /// α, for distances in the tangent plane.
    pub tangential: f64,
    /// β, for distances along the normal.
    pub normal: f64,
}

impl Metric {
    /// The Euclidean metric.
    pub const ISOTROPIC: Self = Self {
        tangential: 1.0,
        normal: 1.0,
    };

    /// Normal anisotropy s of \[NYL12\], section 3.6: ‖A_s(N) d‖² = |d|² + (s² − 1)(N·d)².
    pub fn anisotropic(s: f64) -> Self {
        Self {
            tangential: 1.0,
            normal: s * s,
        }
    }

    /// β − α.
    pub(super) fn excess(self) -> f64 {
        self.normal - self.tangential
    }
}

/// Integrals over the restricted cells, one entry a seed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Cells {
    /// `[seeds]`.
    pub area: Vec<f64>,
    /// `[seeds]`, ∫ (y − x_i) dy.
    pub moment: Vec<DVec3>,
    /// `[seeds]`, ∂F/∂x_i.
    pub gradient: Vec<DVec3>,
    /// F.
    pub energy: f64,
}

/// What the cells of one seed on some triangles add up to.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    area: f64,
    moment: DVec3,
    gradient: DVec3,
}

/// The f64 twin: integrates over `triangles` the cells of `seeds`; `candidates` as found for them.
pub fn cpu(
    triangles: &[[DVec3; 3]],
    seeds: &[DVec3],
    candidates: &Candidates,
    metric: Metric,
) -> Cells {
    let chunks: Vec<(f64, Vec<(u32, Sums)>)> = triangles
        .par_chunks(CHUNK)
        .enumerate()
        .map_init(
            || (Clipper::default(), SparseSums::new(seeds.len())),
            |(clipper, sums), (chunk, triangles)| {
                let mut energy = 0.0;
                for (k, corners) in triangles.iter().enumerate() {
                    let surface = Facet::new(corners, metric);
                    clipper.cells(
                        corners,
                        seeds,
                        candidates.of(chunk * CHUNK + k),
                        metric.excess() != 0.0,
                        |i, moments, edges| {
                            energy += surface.add(i, seeds, moments, edges, sums.entry(i));
                        },
                    );
                }
                (energy, sums.take())
            },
        )
        .collect();
    let mut cells = Cells {
        area: vec![0.0; seeds.len()],
        moment: vec![DVec3::ZERO; seeds.len()],
        gradient: vec![DVec3::ZERO; seeds.len()],
        energy: 0.0,
    };
    for (energy, sums) in chunks {
        cells.energy += energy;
        for (i, s) in sums {
            cells.area[i as usize] += s.area;
            cells.moment[i as usize] += s.moment;
            cells.gradient[i as usize] += s.gradient;
        }
    }
    cells
}

/// A triangle with what every cell on it needs.
struct Facet {
    origin: DVec3,
    edges: [DVec3; 2],
    normal: DVec3,
    double_area: f64,
    /// The Gram matrix of the edges: |e₁|², e₁·e₂, |e₂|².
    gram: [f64; 3],
    metric: Metric,
}

impl Facet {
    fn new(corners: &[DVec3; 3], metric: Metric) -> Self {
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
            metric,
        }
    }

    /// Adds the cell of seed `i` to its sums and returns its energy.
    fn add(
        &self,
        i: u32,
        seeds: &[DVec3],
        m: &Moments,
        edges: &[BisectorEdge],
        sums: &mut Sums,
    ) -> f64 {
        let x = seeds[i as usize];
        let [e1, e2] = self.edges;
        let d = self.origin - x;
        let height = self.normal.dot(d);
        let excess = self.metric.excess();
        let area = self.double_area * m.one;
        let moment = self.double_area * (d * m.one + e1 * m.u + e2 * m.v);
        sums.area += area;
        sums.moment += moment;
        let mut gradient =
            -2.0 * (self.metric.tangential * moment + excess * height * area * self.normal);
        for edge in edges {
            gradient += self.bisector(x, seeds[edge.other as usize], height, edge);
        }
        sums.gradient += gradient;
        let squared = d.length_squared() * m.one
            + 2.0 * (d.dot(e1) * m.u + d.dot(e2) * m.v + self.gram[1] * m.uv)
            + self.gram[0] * m.uu
            + self.gram[2] * m.vv;
        self.metric.tangential * self.double_area * squared + excess * height * height * area
    }

    /// What the motion of a bisector adds to the gradient of the seed `x`.
    fn bisector(&self, x: DVec3, other: DVec3, height: f64, edge: &BisectorEdge) -> DVec3 {
        let apart = other - x;
        let in_plane = apart - self.normal * self.normal.dot(apart);
        let speed = in_plane.length();
        if speed == 0.0 {
            return DVec3::ZERO;
        }
        let [a, b] = edge.ends;
        let [e1, e2] = self.edges;
        let length = (e1 * (b[0] - a[0]) + e2 * (b[1] - a[1])).length();
        let middle = self.origin + 0.5 * (e1 * (a[0] + b[0]) + e2 * (a[1] + b[1]));
        let other_height = self.normal.dot(self.origin - other);
        let jump = self.metric.excess() * (height * height - other_height * other_height);
        (middle - x) * (jump * length / speed)
    }
}

/// Sums for the few seeds that one chunk meets.
struct SparseSums {
    /// `[seeds]`: the place of a seed in `entries`, or `u32::MAX`.
    place: Vec<u32>,
    entries: Vec<(u32, Sums)>,
}

impl SparseSums {
    fn new(seeds: usize) -> Self {
        Self {
            place: vec![u32::MAX; seeds],
            entries: Vec::new(),
        }
    }

    fn entry(&mut self, seed: u32) -> &mut Sums {
        let place = &mut self.place[seed as usize];
        if *place == u32::MAX {
            *place = self.entries.len() as u32;
            self.entries.push((seed, Sums::default()));
        }
        &mut self.entries[*place as usize].1
    }

    fn take(&mut self) -> Vec<(u32, Sums)> {
        for (seed, _) in &self.entries {
            self.place[*seed as usize] = u32::MAX;
        }
        std::mem::take(&mut self.entries)
    }
}

shared_struct! {
    /// The parameters of a dispatch.
    pub struct RestrictedParams {
        /// The number of slots.
        slots: u32,
        /// α.
        tangential: f32,
        /// β − α.
        excess: f32,
    }
}

shared_struct! {
    /// A triangle of T on the device, prepared in f64: normals and areas of slivers do not survive f32.
    pub struct GpuFacet {
        /// The first corner.
        origin: [f32; 3],
        /// Twice the area.
        double_area: f32,
        /// From the first corner to the second.
        e1: [f32; 3],
        /// None.
        padding1: f32,
        /// From the first corner to the third.
        e2: [f32; 3],
        /// None.
        padding2: f32,
        /// The unit normal; zero where the triangle is degenerate.
        normal: [f32; 3],
        /// None.
        padding3: f32,
    }
}

impl GpuFacet {
    fn new(corners: &[DVec3; 3], origin: DVec3) -> Self {
        let facet = Facet::new(corners, Metric::ISOTROPIC);
        let single = |v: DVec3| v.as_vec3().to_array();
        Self {
            origin: single(facet.origin - origin),
            double_area: facet.double_area as f32,
            e1: single(facet.edges[0]),
            e2: single(facet.edges[1]),
            normal: single(facet.normal),
            ..bytemuck::Zeroable::zeroed()
        }
    }
}

/// `shaders/restricted_voronoi.wgsl`.
pub const SHADER: Shader = Shader {
    name: "restricted_voronoi",
    structs: &[RestrictedParams::LAYOUT, GpuFacet::LAYOUT],
    sources: &[
        source!("shared/grid.wgsl"),
        source!("shared/clip.wgsl"),
        source!("restricted_voronoi.wgsl"),
    ],
    constants: &[],
};

/// Four-vectors a record: moment and area, gradient and energy.
const WIDTH: usize = 2;

/// The fixed triangles of T on the device, with the candidates of the moment.
#[derive(Debug)]
pub struct GpuRestricted {
    gpu: Gpu,
    metric: Metric,
    chunks: Vec<GpuChunk>,
}

#[derive(Debug)]
struct GpuChunk {
    facets: Buffer<GpuFacet>,
    slots: GpuSlots,
    by_seed: GpuSegments,
}

impl GpuRestricted {
    /// Uploads triangles, with `origin` subtracted in f64: coordinates should be small near the surface.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn new(gpu: &Gpu, triangles: &[[DVec3; 3]], origin: DVec3, metric: Metric) -> Result<Self> {
        let chunk = |range: Range<usize>| -> Result<GpuChunk> {
            let facets: Vec<_> = triangles[range.clone()]
                .iter()
                .map(|corners| GpuFacet::new(corners, origin))
                .collect();
            Ok(GpuChunk {
                facets: Buffer::from_slice(gpu, &facets)?,
                slots: GpuSlots::new(gpu, range, WIDTH)?,
                by_seed: GpuSegments::new(gpu, &Segments::default())?,
            })
        };
        Ok(Self {
            gpu: gpu.clone(),
            metric,
            chunks: slots::chunks(triangles.len())
                .map(chunk)
                .collect::<Result<_>>()?,
        })
    }

    /// Replaces the candidates.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn write(&mut self, candidates: &Candidates, seeds: usize) -> Result<()> {
        for chunk in &mut self.chunks {
            let owners = chunk.slots.write(candidates)?;
            let segments = Segments::by_key(owners.iter().copied(), seeds);
            chunk.by_seed.write(&segments)?;
        }
        Ok(())
    }

    /// Adds the integration to a batch. What is summed a seed is `what`, into `sums`.
    ///
    /// # Errors
    /// Where a buffer passes the adapter's limits.
    pub fn integrate(
        &self,
        batch: &mut Batch,
        seeds: &Buffer<[f32; 4]>,
        what: CellSums,
        sums: &Buffer<[f32; 4]>,
    ) -> Result<Vec<CheckReadback>> {
        let pipeline = self.gpu.pipeline(&SHADER, &[])?;
        let first = match what {
            CellSums::All => 0,
            CellSums::Gradient => 1,
        };
        let mut checks = Vec::new();
        for (k, chunk) in self.chunks.iter().enumerate() {
            let slots = &chunk.slots;
            let params = RestrictedParams {
                slots: slots.len() as u32,
                tangential: self.metric.tangential as f32,
                excess: self.metric.excess() as f32,
            };
            batch.dispatch(
                &pipeline,
                slots.len(),
                &params,
                &[
                    &chunk.facets.binding(),
                    &seeds.binding(),
                    &slots.offsets.binding(),
                    &slots.candidates.binding(),
                    &slots.order.binding(),
                    &slots.records.binding(),
                    &slots.fractions.binding(),
                ],
            )?;
            checks.push(slots.check(batch)?);
            let records = Records {
                values: &slots.records,
                stride: WIDTH as u32,
                first,
                width: WIDTH as u32 - first,
            };
            chunk.by_seed.sum(&self.gpu, batch, records, k > 0, sums)?;
        }
        Ok(checks)
    }
}

/// What is summed over the cells of each seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellSums {
    /// Two four-vectors: moment and area, gradient and energy.
    All,
    /// One four-vector: gradient and energy.
    Gradient,
}

/// The twins of the restricted Voronoi cells.
#[derive(Debug)]
pub struct RestrictedVoronoi;

/// What is integrated.
#[derive(Debug, Clone)]
pub struct RestrictedInput {
    /// T, in a spatial order.
    pub triangles: Vec<[DVec3; 3]>,
    /// x.
    pub seeds: Vec<DVec3>,
    /// As found for these.
    pub candidates: Candidates,
    /// W.
    pub metric: Metric,
}

/// A [`RestrictedInput`] on the device.
#[derive(Debug)]
pub struct ResidentRestricted {
    input: RestrictedInput,
    surface: GpuRestricted,
    seeds: Buffer<[f32; 4]>,
    sums: Buffer<[f32; 4]>,
}

impl Kernel for RestrictedVoronoi {
    const NAME: &'static str = SHADER.name;
    /// Of the scales of [`compare`](Self::compare). f32 rounds the seeds' offsets, the clip and some twenty products a cell,
    /// 6e-8 each; bisectors of seeds that lie above one another magnify that. Measured: 1.1e-5 for such seeds and s = 50,
    /// below 4e-6 elsewhere.
    const TOLERANCE: f64 = 2e-5;
    type Input = RestrictedInput;
    type Output = Cells;
    type Resident = ResidentRestricted;

    fn items(input: &RestrictedInput) -> usize {
        input.triangles.len()
    }

    fn cpu(input: &RestrictedInput) -> Cells {
        cpu(
            &input.triangles,
            &input.seeds,
            &input.candidates,
            input.metric,
        )
    }

    fn upload(gpu: &Gpu, input: &RestrictedInput) -> Result<ResidentRestricted> {
        let origin = slots::center(input.triangles.as_flattened());
        let mut surface = GpuRestricted::new(gpu, &input.triangles, origin, input.metric)?;
        surface.write(&input.candidates, input.seeds.len())?;
        Ok(ResidentRestricted {
            input: input.clone(),
            surface,
            seeds: Buffer::from_slice(gpu, &slots::local(&input.seeds, origin))?,
            sums: Buffer::zeroed(gpu, WIDTH * input.seeds.len())?,
        })
    }

    fn gpu(gpu: &Gpu, resident: &mut ResidentRestricted) -> Result<Cells> {
        let ResidentRestricted {
            input,
            surface,
            seeds,
            sums,
        } = resident;
        let mut batch = gpu.batch();
        let checks = surface.integrate(&mut batch, seeds, CellSums::All, sums)?;
        let read = batch.read(sums);
        let results = batch.submit()?;
        let checked = slots::merge(checks.iter().map(|c| c.get(&results)));
        let Some(failures) = checked.failures else {
            return Ok(Self::cpu(input));
        };
        let mut cells = Cells {
            energy: checked.energy,
            ..Cells::default()
        };
        for record in results.get(&read).chunks_exact(WIDTH) {
            let [moment, gradient] = [record[0], record[1]].map(|r| r.map(f64::from));
            cells.area.push(moment[3]);
            cells.moment.push(DVec3::from_slice(&moment));
            cells.gradient.push(DVec3::from_slice(&gradient));
        }
        cells.add(&redo(
            &input.triangles,
            &input.seeds,
            &input.candidates,
            input.metric,
            &failures,
        ));
        Ok(cells)
    }

    /// Energy and total area against a tenth of themselves: all their terms are positive. Per seed against the mean over the
    /// seeds of area, √(area · ∫|y − x|²) and 2 √(area · β F): by Cauchy and Schwarz the sums of |terms| are about that. What
    /// the rounding of coordinates to f32 moves the last two by is granted on top.
    fn compare(input: &RestrictedInput, cpu: &Cells, gpu: &Cells) -> f64 {
        let isotropic = RestrictedInput {
            metric: Metric::ISOTROPIC,
            ..input.clone()
        };
        let count = input.seeds.len() as f64;
        let total = |cells: &Cells| cells.area.iter().sum::<f64>();
        let area = total(cpu);
        let weight = input.metric.tangential.max(input.metric.normal);
        let rounding = slots::rounding(input.triangles.as_flattened()) / Self::TOLERANCE * area;
        let moment = ((area * Self::cpu(&isotropic).energy).sqrt() + rounding) / count;
        let gradient = 2.0 * ((area * weight * cpu.energy).sqrt() + weight * rounding) / count;
        let whole = [(cpu.energy, gpu.energy), (area, total(gpu))];
        let areas = cpu.area.iter().zip(&gpu.area);
        let moments = cpu.moment.iter().zip(&gpu.moment);
        let gradients = cpu.gradient.iter().zip(&gpu.gradient);
        worst_ratio(
            whole
                .into_iter()
                .map(|(a, b)| ((a - b).abs(), 0.1 * a))
                .chain(areas.map(|(a, b)| ((a - b).abs(), area / count)))
                .chain(moments.map(|(a, b)| ((*a - *b).length(), moment)))
                .chain(gradients.map(|(a, b)| ((*a - *b).length(), gradient))),
        )
    }
}

/// The cells on some of the triangles, in f64: those that the device gave up.
pub(super) fn redo(
    triangles: &[[DVec3; 3]],
    seeds: &[DVec3],
    candidates: &Candidates,
    metric: Metric,
    which: &[u32],
) -> Cells {
    let some: Vec<_> = which.iter().map(|&t| triangles[t as usize]).collect();
    cpu(&some, seeds, &candidates.select(which), metric)
}

impl Cells {
    /// Adds the integrals over other triangles, for the same seeds.
    fn add(&mut self, other: &Self) {
        self.energy += other.energy;
        for (i, area) in self.area.iter_mut().enumerate() {
            *area += other.area[i];
            self.moment[i] += other.moment[i];
            self.gradient[i] += other.gradient[i];
        }
    }
}
