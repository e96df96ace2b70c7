//! Volume fitting \[PPL13\]: curved elements of high order are deformed until their boundary is the target.
//!
//! E = E_S + λ E_Ω, with E_Ω the mean distortion of the elements, infinite where one is inverted, and E_S the squared distance of
//! boundary and target, both ways, over A L² with A the target's area and L = V/A.
//!
//! **Far**, at order 1: the Voronoi terms of [`crate::kernel::vsdm`] with the boundary as a model X = M P, isotropic, λ from 50 down.
//! **Close**: correspondences frozen for some iterations ([`correspondence`]), λ = 0.05 at order 1, then order by order, and
//! last a smaller λ at the order asked for: 0.05 is a floor for the accuracy from order 3 on. L-BFGS is preconditioned
//! ([`precondition`]). A [`barrier`] keeps det J positive between the points of the rule as well: on the few elements that it has to hold.
//!
//! **Departures from the paper**: it integrates over Voronoi cells to the end, ends with λ = 0.05, and stops at a gradient norm of
//! 1e-8, which is not reached. Where a template from a file lies on the target already (curving), the far phase is left out and the ideal
//! size of each element is the one that it has, not the mean of all: such meshes are graded on purpose.
//!
//! **Measured** on 56 hexahedra of order 4 and a lobed ball: with λ = 0.005, 0.002 and 0.001 at the end the largest error is 0.041, 0.018 and
//! 0.011 % of the diagonal, the least scaled Jacobian 0.67, 0.68 and 0.66. Curving an octree mesh of 8,619
//! hexahedra over a scan from which it is 0.73 % away at most: 0.043 % at order 2 and 0.041 % at order 3, all elements valid, the least scaled
//! Jacobian 0.095 and 0.086, in 193 and 114 iterations. Taking back a whole round of iterations and not only the elements that it lost took 270 and
//! 318, under a barrier weaker by λ. Without the barrier 2 elements end inverted between the points of the rule, and order 3 then has no
//! finite start.

mod barrier;
mod correspondence;
mod interior;
mod precondition;
mod start;
mod stiffness;
mod surface;
#[cfg(test)]
mod tests;

pub use start::{VolumeStart, VolumeTemplate};

use super::{Iteration, StopReason, Target, Terms};
use crate::device::Device;
use crate::error::{Error, Result};
use crate::geometry::distortion::Distortion;
use crate::kernel::restricted_voronoi::Metric;
use crate::kernel::sparse::Csr;
use crate::kernel::vsdm::{MovingSide, Vsdm};
use crate::mesh::{Frame, TriangleMesh};
use crate::model::element::{Basis, Rule};
use crate::model::volume::CurvedVolume;
use crate::optimize::{Curvature, Lbfgs, Stop};
use crate::progress::{Event, Progress};
use barrier::{Guard, Watch};
use correspondence::Correspondences;
use glam::{DMat3, DVec3};
use interior::Interior;
use precondition::Inverse;
use std::cell::Cell;
use std::time::Instant;
use surface::Surface;

/// λ of the far phase after the first one, where the template is far.
const APPROACH: [f64; 2] = [5.0, 0.5];

/// λ of the close phases but the last.
const CLOSE: f64 = 0.05;

/// Samples of the boundary in the far phase: intervals along an edge of an element.
const FAR_INTERVALS: usize = 4;

/// Iterations of a far phase at most.
const FAR_ITERATIONS: usize = 60;

/// Iterations for which correspondences stay as they are.
const FROZEN: usize = 15;

/// Such rounds in a phase at most.
const ROUNDS: usize = 12;

/// Iterations for which a preconditioner is kept.
const REFRESHED: usize = 30;

/// Pairs kept by L-BFGS.
const MEMORY: usize = 10;

/// A minimization ends where gᵀH₀g is under this share of the energy.
const TOLERANCE: f64 = 1e-5;

/// A minimization ends where five iterations lower the energy by less than this share, too.
const DECREASE: f64 = 1e-4;

/// The last phase ends where a round changes the root mean square distance by less than this share.
const STEADY: f64 = 1e-2;

/// The same where a higher order follows.
const STEADY_BETWEEN: f64 = 5e-2;

/// Preconditioners are factored up to this many unknowns and this order; beyond, blocks on the diagonal serve.
const FACTORED: (usize, usize) = (50_000, 6);

/// Triangles of a dense boundary, about, and the intervals at most along an edge of an element.
const DENSE: usize = 500_000;
const FINEST: usize = 64;

/// What to fit and how.
#[derive(Debug, Clone, PartialEq)]
pub struct VolumeOptions {
    /// The order of every element, 1 to 16.
    pub order: usize,
    /// The modes.
    pub basis: Basis,
    /// How distortion is measured.
    pub distortion: Distortion,
    /// Where it is sampled.
    pub rule: Rule,
    /// λ of the first phase, from afar.
    pub far: f64,
    /// λ at the end.
    pub close: f64,
    /// Iterations at most, of all phases together.
    pub iterations: Option<usize>,
    /// The seed of all sampling.
    pub seed: u64,
}

impl Default for VolumeOptions {
    fn default() -> Self {
        Self {
            order: 2,
            basis: Basis::default(),
            distortion: Distortion::default(),
            rule: Rule::default(),
            far: 50.0,
            close: 0.002,
            iterations: None,
            seed: 0,
        }
    }
}

/// The result of a fit, in the unit frame.
#[derive(Debug, Clone)]
pub struct VolumeFit {
    /// The elements.
    pub volume: CurvedVolume,
    /// Every iteration.
    pub iterations: Vec<Iteration>,
    /// Seconds by stage, in the order they ran.
    pub stages: Vec<(String, f64)>,
    /// Why it ended.
    pub stop_reason: StopReason,
}

impl VolumeFit {
    /// The boundary as triangles, fine enough to stand for it, in the unit frame.
    pub fn dense_surface(&self) -> TriangleMesh {
        let faces = self.volume.boundary().len().max(1);
        let coarsest = 2 * self.volume.highest_order();
        let intervals = ((DENSE / (2 * faces)) as f64).sqrt() as usize;
        let surface = self
            .volume
            .boundary_surface(intervals.clamp(coarsest, FINEST));
        surface.mesh(&self.volume.coefficients)
    }

    /// The volume in the input's own coordinates.
    pub fn in_input_frame(mut self, frame: &Frame) -> CurvedVolume {
        let vertices = self.volume.vertex_count();
        let (positions, modes) = self.volume.coefficients.split_at_mut(vertices);
        for p in positions {
            *p = frame.to_input(*p);
        }
        for c in modes {
            *c *= frame.diagonal;
        }
        self.volume
    }
}

/// Fits a volume mesh to a closed target.
///
/// # Errors
/// Where the target encloses no volume, the order is out of range, the start has an inverted element, or the device fails.
pub fn fit_volume(
    device: &Device,
    target: &Target,
    start: VolumeStart,
    options: &VolumeOptions,
    progress: &dyn Progress,
) -> Result<VolumeFit> {
    let measure = Enclosure::of(target)?;
    let mut run = Run {
        device,
        target,
        options,
        progress,
        measure,
        sizes: start.ideal_sizes(measure.volume),
        volume: CurvedVolume::new(&start.mesh, options.basis)?,
        watched: Vec::new(),
        iterations: Vec::new(),
        stages: Vec::new(),
        started: Instant::now(),
        ended: None,
    };
    if !start.nearby {
        run.approach()?;
    }
    run.close_in()?;
    Ok(VolumeFit {
        volume: run.volume,
        iterations: run.iterations,
        stages: run.stages,
        stop_reason: run.ended.unwrap_or(StopReason::Schedule),
    })
}

/// What a closed surface encloses.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Enclosure {
    area: f64,
    volume: f64,
}

impl Enclosure {
    /// The least V/A of a target, in diagonals: a sheet, or one whose triangles face either way, encloses nothing.
    const LEAST: f64 = 1e-4;

    fn of(target: &Target) -> Result<Self> {
        let mesh = &target.mesh;
        let volume = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                a.dot(b.cross(c)) / 6.0
            })
            .sum::<f64>()
            .abs();
        let area = mesh.area();
        if volume > Self::LEAST * area {
            return Ok(Self { area, volume });
        }
        Err(Error::input(
            "the target encloses no volume",
            "give a closed surface whose faces are oriented consistently",
        ))
    }

    /// 1/(A L²), L = V/A.
    fn scale(&self) -> f64 {
        self.area / (self.volume * self.volume)
    }
}

struct Run<'a> {
    device: &'a Device,
    target: &'a Target,
    options: &'a VolumeOptions,
    progress: &'a dyn Progress,
    measure: Enclosure,
    /// `[cells]`: the edge lengths of their ideal shapes.
    sizes: Vec<f64>,
    volume: CurvedVolume,
    /// The elements that the barrier once had to hold, ascending.
    watched: Vec<u32>,
    iterations: Vec<Iteration>,
    stages: Vec<(String, f64)>,
    started: Instant,
    ended: Option<StopReason>,
}

impl Run<'_> {
    /// From afar, at order 1.
    fn approach(&mut self) -> Result<()> {
        let interior = self.interior()?;
        let mut guard = Guard::new(&self.volume, &self.sizes, &[])?;
        let boundary = self.volume.boundary_surface(FAR_INTERVALS);
        let vertices = boundary.matrix.row_count();
        let scale = self.measure.scale() * self.measure.area;
        // Either term pulls on a sample with its share of the area.
        let pull = 4.0 * scale / vertices as f64;
        let surface: Vec<DMat3> = squares_by_column(&boundary.matrix)
            .into_iter()
            .map(|square| DMat3::from_diagonal(DVec3::splat(pull * square)))
            .collect();
        let fixed = self.target.fixed_side(vertices, self.options.seed)?;
        let moving = MovingSide::new(boundary.matrix, boundary.triangles);
        let mut terms = Vsdm::new(self.device, fixed, moving, Metric::ISOTROPIC);
        let far = self.options.far;
        let between = APPROACH.into_iter().filter(|&w| w < far && w > CLOSE);
        for weight in std::iter::once(far).chain(between) {
            let stage = self.begin(&format!("far, λ {weight}"), FAR_ITERATIONS);
            let stiffness = self.weighted_diagonal(&interior, weight);
            let inverse = Inverse::of_diagonal(&stiffness, &surface);
            let goal = Goal {
                interior: &interior,
                weight,
                inverse: &inverse,
            };
            self.minimize(&goal, &mut guard, FAR_ITERATIONS, 0, |p| {
                let e = terms.evaluate(p)?;
                let parts = [e.target_to_surface, e.surface_to_target].map(|part| scale * part);
                Ok((parts, e.gradient.iter().map(|g| scale * *g).collect()))
            })?;
            self.end(stage);
            if self.ended.is_some() {
                break;
            }
        }
        self.watched = guard.watched().to_vec();
        Ok(())
    }

    /// From nearby, order by order.
    fn close_in(&mut self) -> Result<()> {
        let last = self.options.order;
        for order in 1..=last {
            self.volume = self.volume.raised(&vec![order; self.volume.cell_count()])?;
            if order == 1 || order < last {
                self.close(order, CLOSE.max(self.options.close), STEADY_BETWEEN)?;
            }
        }
        self.close(last, self.options.close, STEADY)
    }

    /// Rounds of correspondences at one order, until a round changes the root mean square distance by a share less than `steady`.
    fn close(&mut self, order: usize, weight: f64, steady: f64) -> Result<()> {
        if self.ended.is_some() {
            return Ok(());
        }
        let stage = self.begin(&format!("order {order}, λ {weight}"), ROUNDS * FROZEN);
        let interior = self.interior()?;
        let mut guard = Guard::new(&self.volume, &self.sizes, &self.watched)?;
        let volume = self.volume.clone();
        let scale = self.measure.scale();
        let surface = Surface::new(self.device, self.target, &volume, scale, self.options.seed);
        let mut before = f64::INFINITY;
        let mut kept: Option<(usize, Inverse)> = None;
        for round in 0..ROUNDS {
            let found = surface.correspond(&self.volume.coefficients)?;
            let rms = found.rms(&self.volume.coefficients);
            if (before - rms).abs() <= steady * rms || self.ended.is_some() {
                break;
            }
            before = rms;
            let done = self.iterations.len();
            let (since, inverse) = kept
                .take()
                .filter(|(since, _)| done - since < REFRESHED)
                .unwrap_or_else(|| (done, self.inverse(&interior, &found, &guard, weight, order)));
            let goal = Goal {
                interior: &interior,
                weight,
                inverse: &inverse,
            };
            let lost = self.minimize(&goal, &mut guard, FROZEN, round * FROZEN, |p| {
                Ok(found.evaluate(p))
            })?;
            kept = (!lost).then_some((since, inverse));
        }
        self.watched = guard.watched().to_vec();
        self.end(stage);
        Ok(())
    }

    fn interior(&self) -> Result<Interior> {
        let VolumeOptions {
            rule, distortion, ..
        } = *self.options;
        let interior = Interior::new(self.device, &self.volume, &self.sizes, rule, distortion)?;
        let inverted = interior.inverted(&self.volume.coefficients)?;
        match inverted.first() {
            None => Ok(interior),
            Some(first) => Err(Error::input(
                format!(
                    "{} of {} elements are inverted or degenerate; the first is element {first} (counted from 0)",
                    inverted.len(),
                    self.volume.cell_count()
                ),
                "mend the template or use more smoothness",
            )),
        }
    }

    fn weighted_diagonal(&self, interior: &Interior, weight: f64) -> Vec<f64> {
        let mut diagonal = interior.stiffness_diagonal(&self.volume.coefficients);
        diagonal.iter_mut().for_each(|k| *k *= weight);
        diagonal
    }

    fn inverse(
        &self,
        interior: &Interior,
        surface: &Correspondences,
        guard: &Guard,
        weight: f64,
        order: usize,
    ) -> Inverse {
        let coefficients = &self.volume.coefficients;
        let of_barrier = barrier_weight(weight);
        let (unknowns, highest) = FACTORED;
        if 3 * coefficients.len() <= unknowns && order <= highest {
            let stiffness = interior.stiffness_entries(coefficients);
            let stiffness = stiffness.into_iter().map(|(i, j, k)| (i, j, weight * k));
            let barrier = guard.watch().blocks(coefficients).into_iter();
            let barrier = barrier.map(|(i, j, block)| (i, j, of_barrier * block));
            let blocks = surface.blocks().into_iter().chain(barrier);
            if let Some(factored) = Inverse::factored(coefficients.len(), stiffness, blocks) {
                return factored;
            }
        }
        let barrier = guard.watch().diagonal(coefficients);
        let blocks = surface.diagonal().into_iter().zip(barrier);
        let blocks: Vec<DMat3> = blocks.map(|(s, b)| s + of_barrier * b).collect();
        Inverse::of_diagonal(&self.weighted_diagonal(interior, weight), &blocks)
    }

    /// Minimizes λ E_Ω + E_S and the barrier for `iterations` at most, and puts elements back that it lost. Whether there were any.
    fn minimize(
        &mut self,
        goal: &Goal,
        guard: &mut Guard,
        iterations: usize,
        done_before: usize,
        surface: impl FnMut(&[DVec3]) -> Result<([f64; 2], Vec<DVec3>)>,
    ) -> Result<bool> {
        let before = self.volume.coefficients.clone();
        self.descend(goal, guard.watch(), iterations, done_before, surface)?;
        guard.settle(&mut self.volume, &before, goal.interior)
    }

    /// Minimizes λ E_Ω + E_S and the barrier for `iterations` at most; `surface` gives both parts of E_S and its gradient.
    fn descend(
        &mut self,
        goal: &Goal,
        watch: &Watch,
        iterations: usize,
        done_before: usize,
        mut surface: impl FnMut(&[DVec3]) -> Result<([f64; 2], Vec<DVec3>)>,
    ) -> Result<()> {
        let settings = Lbfgs {
            memory: MEMORY,
            iterations: self.left(iterations),
            decrease: DECREASE / 5.0,
            first_step: 1.0,
        };
        let curvature = Curvature {
            inverse: &|g: &[DVec3]| goal.inverse.apply(g),
            tolerance: TOLERANCE,
        };
        let start = std::mem::take(&mut self.volume.coefficients);
        let nodes = start.len();
        let of_barrier = barrier_weight(goal.weight);
        let last = Cell::new(Terms::default());
        let end = settings.minimize_preconditioned(
            start,
            |p| {
                let distorted = goal.interior.evaluate(p)?;
                let (barrier, push) = watch.evaluate(p);
                if !(distorted.value + barrier).is_finite() {
                    return Ok::<_, Error>((f64::INFINITY, vec![DVec3::ZERO; p.len()]));
                }
                let ([forth, back], gradient) = surface(p)?;
                let terms = Terms {
                    target_to_surface: forth,
                    surface_to_target: back,
                    distortion: goal.weight * distorted.value + of_barrier * barrier,
                    ..Terms::default()
                };
                last.set(terms);
                let sum = gradient.iter().zip(&distorted.gradient).zip(&push);
                let sum = sum.map(|((s, d), b)| *s + goal.weight * *d + of_barrier * *b);
                Ok((forth + back + terms.distortion, sum.collect()))
            },
            |it| {
                self.iterations.push(Iteration {
                    iteration: self.iterations.len() + 1,
                    phase: "volume".into(),
                    control_points: nodes,
                    energy: it.value,
                    terms: Some(last.get()),
                    gradient_norm: Some(it.gradient_norm),
                    max_percent: None,
                    rms_percent: None,
                    mean_percent: None,
                    seconds: self.started.elapsed().as_secs_f64(),
                });
                self.progress.event(Event::Step {
                    done: done_before + it.iteration,
                    value: Some(it.value),
                });
                !self.progress.interrupted()
            },
            curvature,
        )?;
        self.volume.coefficients = end.x;
        self.ended = match end.stop {
            Stop::Observer => Some(StopReason::Interrupted),
            _ if self.left(1) == 0 => Some(StopReason::Iterations),
            _ => None,
        };
        Ok(())
    }

    /// Iterations left of those that the caller allows.
    fn left(&self, wanted: usize) -> usize {
        let allowed = self.options.iterations.unwrap_or(usize::MAX);
        wanted.min(allowed.saturating_sub(self.iterations.len()))
    }

    fn begin(&self, name: &str, steps: usize) -> (String, Instant) {
        self.progress.event(Event::Stage { name, steps });
        (name.into(), Instant::now())
    }

    fn end(&mut self, (name, begun): (String, Instant)) {
        self.stages.push((name, begun.elapsed().as_secs_f64()));
    }
}

/// What a minimization is about, apart from the surface.
struct Goal<'a> {
    interior: &'a Interior,
    /// λ.
    weight: f64,
    inverse: &'a Inverse,
}

/// The weight of the barrier under λ: not less than that of the first close phase. Under a small one, elements that the surface pulls flat come to
/// rest where the barrier is so steep that no step is short enough.
fn barrier_weight(lambda: f64) -> f64 {
    lambda.max(CLOSE)
}

/// The sum of the squares in each column.
fn squares_by_column(matrix: &Csr) -> Vec<f64> {
    let mut squares = vec![0.0; matrix.column_count];
    for (&c, v) in matrix.columns.iter().zip(&matrix.values) {
        squares[c as usize] += v * v;
    }
    squares
}
