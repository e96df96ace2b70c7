//! Both Voronoi terms of a fit on the control points, as one evaluation: X = M P, the cells of X on T, the cells of the
//! samples Y on S, and back by Mᵀ.
//!
//! G(P) = (F_T→S(M P) + F_S→T(M P)) / A_T with A_T the area of the target, so that both terms are mean squared distances
//! in the unit frame and weights mean the same on every input (\[NYL12\], algorithm 2, normalized).
//!
//! The candidates are kept while nothing has moved further than their slack. The slack follows the size of recent
//! steps, up to a tenth of a cell: longer lists cost more clipping than a search.
//!
//! On a GPU the matrix, the target, the samples and the candidates stay there; an evaluation sends the control points, runs
//! as one submission and reads back the gradient on them, sums of energies, and the triangles that it gave up. Those are done
//! again here in f64. Coordinates must be those of the unit frame, small enough for f32.

use super::candidates::Candidates;
use super::differentiated_voronoi::{Differential, GpuDifferentiated};
use super::restricted_voronoi::{CellSums, Cells, GpuRestricted, Metric};
use super::slots::{self, CheckReadback, Checked};
use super::sparse::{Csr, GpuCsr, padded, unpadded};
use super::{differentiated_voronoi, restricted_voronoi};
use crate::device::{Buffer, Device, Gpu};
use crate::error::Result;
use crate::geometry::triangle_tree::{TriangleTree, spatial_order};
use glam::DVec3;
use rayon::prelude::*;

/// The slack of kept candidates, in units of the last step.
const SLACK_STEPS: f64 = 4.0;

/// The largest slack, in units of the cell size √(A / n). At a tenth the lists grow by 3 to 9 %.
const MAX_SLACK: f64 = 0.1;

/// The fixed side of a fit: triangles of T in spatial order, and the samples Y on it with their normals.
#[derive(Debug, Clone)]
pub struct FixedSide {
    /// `[triangles]`, the corners.
    pub triangles: Vec<[DVec3; 3]>,
    tree: TriangleTree,
    /// The area of T.
    pub area: f64,
    /// `[samples]`.
    pub samples: Vec<DVec3>,
    /// `[samples]`, unit normals of T there.
    pub normals: Vec<DVec3>,
}

impl FixedSide {
    /// Sorts the triangles; the samples stay in their order.
    pub fn new(triangles: &[[DVec3; 3]], samples: Vec<DVec3>, normals: Vec<DVec3>) -> Self {
        let triangles = in_spatial_order(triangles, |t| *t);
        let area = triangles
            .iter()
            .map(|[a, b, c]| 0.5 * (*b - *a).cross(*c - *a).length())
            .sum();
        Self {
            tree: TriangleTree::new(&triangles),
            triangles,
            area,
            samples,
            normals,
        }
    }
}

/// The moving side: X = M P, and the triangles of S over X.
#[derive(Debug, Clone)]
pub struct MovingSide {
    matrix: Csr,
    transpose: Csr,
    /// In spatial order once [`sort`](Self::sort)ed.
    triangles: Vec<[u32; 3]>,
    /// The corners of each vertex as 3 × triangle + corner, in compressed sparse rows; empty before that.
    incident: (Vec<u32>, Vec<u32>),
}

impl MovingSide {
    /// `matrix`: `[vertices, control points]`; `triangles` index the vertices.
    pub fn new(matrix: Csr, triangles: Vec<[u32; 3]>) -> Self {
        Self {
            transpose: matrix.transpose(),
            incident: Default::default(),
            matrix,
            triangles,
        }
    }

    /// Brings the triangles into the spatial order that they have over the vertices `x`.
    fn sort(&mut self, x: &[DVec3]) {
        self.triangles = in_spatial_order(&self.triangles, |t| t.map(|v| x[v as usize]));
        self.incident = incident_corners(&self.triangles, x.len());
    }

    /// The corners of the triangles.
    fn corners(&self, x: &[DVec3]) -> Vec<[DVec3; 3]> {
        self.triangles
            .par_iter()
            .with_min_len(1024)
            .map(|t| t.map(|v| x[v as usize]))
            .collect()
    }

    /// The gradient on the vertices: that of the seeds plus that of the incident corners.
    fn gather(&self, seeds: &[DVec3], corners: &[[DVec3; 3]], scale: f64) -> Vec<DVec3> {
        let (offsets, incident) = &self.incident;
        seeds
            .par_iter()
            .enumerate()
            .with_min_len(1024)
            .map(|(v, &g)| {
                let range = offsets[v] as usize..offsets[v + 1] as usize;
                let sum = incident[range]
                    .iter()
                    .fold(g, |sum, &c| sum + corners[c as usize / 3][c as usize % 3]);
                sum * scale
            })
            .collect()
    }
}

/// The value of both terms and their gradient on the control points.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evaluation {
    /// F_T→S / A_T.
    pub target_to_surface: f64,
    /// F_S→T / A_T.
    pub surface_to_target: f64,
    /// `[control points]`.
    pub gradient: Vec<DVec3>,
}

/// Evaluates both terms again and again for moving control points.
#[derive(Debug)]
pub struct Vsdm {
    device: Device,
    /// On a GPU, from the first evaluation on.
    resident: Option<Resident>,
    fixed: FixedSide,
    moving: MovingSide,
    metric: Metric,
    /// Over the triangles of S, sorted at their first positions.
    tree: TriangleTree,
    kept: Option<Kept>,
    last: Vec<DVec3>,
}

/// Candidates and the vertices they were found for.
#[derive(Debug)]
struct Kept {
    vertices: Vec<DVec3>,
    on_target: Candidates,
    on_surface: Candidates,
}

impl Vsdm {
    /// Prepares the evaluation on a device.
    pub fn new(device: &Device, fixed: FixedSide, moving: MovingSide, metric: Metric) -> Self {
        Self {
            device: device.clone(),
            resident: None,
            fixed,
            moving,
            metric,
            tree: TriangleTree::default(),
            kept: None,
            last: Vec::new(),
        }
    }

    /// The value and gradient at `control_points`.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn evaluate(&mut self, control_points: &[DVec3]) -> Result<Evaluation> {
        let x = self.moving.matrix.apply(control_points);
        if self.kept.is_none() {
            self.moving.sort(&x);
        }
        let corners = self.moving.corners(&x);
        let found = self.find_candidates(&x, &corners)?;
        match self.device.clone() {
            Device::Cpu => Ok(self.on_cpu(&x, &corners)),
            Device::Gpu(gpu) => self.on_gpu(&gpu, control_points, &x, &corners, found),
        }
    }

    fn on_cpu(&self, x: &[DVec3], corners: &[[DVec3; 3]]) -> Evaluation {
        let kept = self.kept();
        let (cells, differential) = rayon::join(
            || restricted_voronoi::cpu(&self.fixed.triangles, x, &kept.on_target, self.metric),
            || {
                differentiated_voronoi::cpu(
                    corners,
                    &self.fixed.samples,
                    &self.fixed.normals,
                    &kept.on_surface,
                    self.metric,
                )
            },
        );
        let Differential {
            energy, gradient, ..
        } = differential;
        self.evaluation(&cells, &gradient, energy)
    }

    /// What the integrals over T and S make on the control points.
    fn evaluation(&self, cells: &Cells, corners: &[[DVec3; 3]], surface_energy: f64) -> Evaluation {
        let scale = 1.0 / self.fixed.area;
        let on_vertices = self.moving.gather(&cells.gradient, corners, scale);
        Evaluation {
            target_to_surface: cells.energy * scale,
            surface_to_target: surface_energy * scale,
            gradient: self.moving.transpose.apply(&on_vertices),
        }
    }

    fn on_gpu(
        &mut self,
        gpu: &Gpu,
        control_points: &[DVec3],
        x: &[DVec3],
        corners: &[[DVec3; 3]],
        new_candidates: bool,
    ) -> Result<Evaluation> {
        let mut resident = match self.resident.take() {
            Some(resident) => resident,
            None => Resident::new(gpu, self)?,
        };
        if new_candidates {
            resident.write(self.kept(), x.len())?;
        }
        let parts = resident.evaluate(control_points)?;
        self.resident = Some(resident);
        Ok(match (&parts.target.failures, &parts.surface.failures) {
            (Some(on_target), Some(on_surface)) => {
                let mut evaluation = self.again(x, corners, on_target, on_surface);
                let scale = 1.0 / self.fixed.area;
                evaluation.target_to_surface += parts.target.energy * scale;
                evaluation.surface_to_target += parts.surface.energy * scale;
                for (sum, g) in evaluation.gradient.iter_mut().zip(&parts.gradient) {
                    *sum += scale * *g;
                }
                evaluation
            }
            _ => self.on_cpu(x, corners),
        })
    }

    /// The share of those triangles that the device gave up.
    fn again(
        &self,
        x: &[DVec3],
        corners: &[[DVec3; 3]],
        on_target: &[u32],
        on_surface: &[u32],
    ) -> Evaluation {
        if on_target.is_empty() && on_surface.is_empty() {
            return Evaluation {
                gradient: vec![DVec3::ZERO; self.moving.matrix.column_count],
                ..Evaluation::default()
            };
        }
        let (kept, fixed) = (self.kept(), &self.fixed);
        let cells =
            restricted_voronoi::redo(&fixed.triangles, x, &kept.on_target, self.metric, on_target);
        let some = differentiated_voronoi::redo(
            corners,
            [&fixed.samples, &fixed.normals],
            &kept.on_surface,
            self.metric,
            on_surface,
        );
        let mut gradient = vec![[DVec3::ZERO; 3]; corners.len()];
        for (&t, g) in on_surface.iter().zip(&some.gradient) {
            gradient[t as usize] = *g;
        }
        self.evaluation(&cells, &gradient, some.energy)
    }

    fn kept(&self) -> &Kept {
        self.kept
            .as_ref()
            .expect("every evaluation finds candidates first")
    }

    /// Finds candidates anew unless those kept still hold. Whether it did.
    fn find_candidates(&mut self, x: &[DVec3], corners: &[[DVec3; 3]]) -> Result<bool> {
        let moved = |from: &[DVec3]| {
            from.iter()
                .zip(x)
                .map(|(a, b)| (*a - *b).length_squared())
                .fold(0.0, f64::max)
                .sqrt()
        };
        if let Some(kept) = &self.kept
            && moved(&kept.vertices) <= kept.on_target.slack
        {
            self.last = x.to_vec();
            return Ok(false);
        }
        let step = if self.last.is_empty() {
            f64::INFINITY
        } else {
            moved(&self.last)
        };
        self.last = x.to_vec();
        let largest = MAX_SLACK * (self.fixed.area / x.len() as f64).sqrt();
        // Steps that would use the slack up at once are not worth it.
        let slack = if step < largest {
            (SLACK_STEPS * step).min(largest)
        } else {
            0.0
        };
        self.tree.refit(corners);
        let (device, fixed) = (&self.device, &self.fixed);
        let (on_target, on_surface) = rayon::join(
            || Candidates::find_on(device, &fixed.tree, &fixed.triangles, x, slack),
            || Candidates::find_on(device, &self.tree, corners, &fixed.samples, slack),
        );
        self.kept = Some(Kept {
            vertices: x.to_vec(),
            on_target: on_target?,
            on_surface: on_surface?,
        });
        Ok(true)
    }
}

/// What an evaluation needs on the device, and what it leaves there.
#[derive(Debug)]
struct Resident {
    gpu: Gpu,
    matrix: GpuCsr,
    transpose: GpuCsr,
    target: GpuRestricted,
    surface: GpuDifferentiated,
    control_points: Buffer<[f32; 4]>,
    vertices: Buffer<[f32; 4]>,
    on_vertices: Buffer<[f32; 4]>,
    gradient: Buffer<[f32; 4]>,
}

/// What the device makes of an evaluation, not yet divided by the area of T.
struct Parts {
    target: Checked,
    surface: Checked,
    gradient: Vec<DVec3>,
}

impl Resident {
    fn new(gpu: &Gpu, vsdm: &Vsdm) -> Result<Self> {
        let (fixed, moving) = (&vsdm.fixed, &vsdm.moving);
        let (vertices, points) = (moving.matrix.row_count(), moving.matrix.column_count);
        Ok(Self {
            gpu: gpu.clone(),
            matrix: GpuCsr::new(gpu, &moving.matrix)?,
            transpose: GpuCsr::new(gpu, &moving.transpose)?,
            target: GpuRestricted::new(gpu, &fixed.triangles, DVec3::ZERO, vsdm.metric)?,
            surface: GpuDifferentiated::new(
                gpu,
                [&fixed.samples, &fixed.normals],
                DVec3::ZERO,
                &moving.triangles,
                vertices,
                vsdm.metric,
            )?,
            control_points: Buffer::zeroed(gpu, points)?,
            vertices: Buffer::zeroed(gpu, vertices)?,
            on_vertices: Buffer::zeroed(gpu, vertices)?,
            gradient: Buffer::zeroed(gpu, points)?,
        })
    }

    /// Replaces the candidates.
    fn write(&mut self, kept: &Kept, vertices: usize) -> Result<()> {
        self.target.write(&kept.on_target, vertices)?;
        self.surface.write(&kept.on_surface)
    }

    fn evaluate(&mut self, control_points: &[DVec3]) -> Result<Parts> {
        self.control_points.write(&padded(control_points))?;
        let gpu = &self.gpu;
        let mut batch = gpu.batch();
        let (x, g) = (&self.vertices, &self.on_vertices);
        self.matrix
            .apply(gpu, &mut batch, &self.control_points, x)?;
        let on_target = self
            .target
            .integrate(&mut batch, x, CellSums::Gradient, g)?;
        let on_surface = self.surface.integrate(&mut batch, x, g)?;
        self.transpose.apply(gpu, &mut batch, g, &self.gradient)?;
        let gradient = batch.read(&self.gradient);
        let results = batch.submit()?;
        let checked =
            |checks: &[CheckReadback]| slots::merge(checks.iter().map(|check| check.get(&results)));
        Ok(Parts {
            target: checked(&on_target),
            surface: checked(&on_surface),
            gradient: unpadded(&results.get(&gradient)),
        })
    }
}

/// Triangles in the spatial order of their centres.
fn in_spatial_order<T: Copy>(triangles: &[T], corners: impl Fn(&T) -> [DVec3; 3]) -> Vec<T> {
    let centers: Vec<DVec3> = triangles
        .iter()
        .map(|t| corners(t).iter().sum::<DVec3>() / 3.0)
        .collect();
    let order = spatial_order(&centers);
    order.iter().map(|&t| triangles[t as usize]).collect()
}

/// The corners around each vertex, as 3 × triangle + corner in ascending order.
fn incident_corners(triangles: &[[u32; 3]], vertices: usize) -> (Vec<u32>, Vec<u32>) {
    let mut offsets = vec![0u32; vertices + 1];
    for v in triangles.iter().flatten() {
        offsets[*v as usize + 1] += 1;
    }
    for v in 0..vertices {
        offsets[v + 1] += offsets[v];
    }
    let mut next = offsets.clone();
    let mut corners = vec![0; 3 * triangles.len()];
    for (c, v) in triangles.iter().flatten().enumerate() {
        corners[next[*v as usize] as usize] = c as u32;
        next[*v as usize] += 1;
    }
    (offsets, corners)
}
