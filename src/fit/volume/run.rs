//! The phases of a volume fit: from afar, then nearby, each a minimization of λ E_Ω + E_S under the barrier.

use super::VolumeOptions;
use super::barrier::{Guard, Watch};
use super::body::Body;
use super::correspondence::Correspondences;
use super::interior::{Distorted, Interior};
use super::precondition::Inverse;
use super::surface::{Gap, Surface};
use super::target::{Enclosure, VolumeTarget};
use crate::device::Device;
use crate::error::{Error, Result};
use crate::fit::{Iteration, StopReason, Target, Terms};
use crate::kernel::restricted_voronoi::Metric;
use crate::kernel::sparse::Csr;
use crate::kernel::vsdm::{MovingSide, Vsdm};
use crate::optimize::vectors::{add_to, scale_by};
use crate::optimize::{Curvature, Lbfgs, Stop};
use crate::progress::{Event, Progress};
use glam::{DMat3, DVec3};
use std::cell::Cell;
use std::time::Instant;

/// λ of the far phase after the first one, where the template is far.
const APPROACH: [f64; 2] = [5.0, 0.5];

/// λ of the close phases but the last.
const CLOSE: f64 = 0.05;

/// From this order on raises go on with λ as it is at the end: orders beyond are hardly factored ([`FACTORED`]), and to lower λ there would take
/// many more iterations. (56 hexahedra of order 12 ended 0.36 % away where only the last phase lowered λ.)
const FINE: usize = 6;

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

/// Preconditioners are factored up to this many unknowns, and where the matrix takes no more operations than this (77 hexahedra of order
/// 6, which is as many unknowns); beyond, blocks on the diagonal serve.
const FACTORED: (usize, f64) = (50_000, 2e10);

/// A volume fit under way.
pub(super) struct Run<'a> {
    device: &'a Device,
    target: VolumeTarget<'a>,
    pub options: &'a VolumeOptions,
    progress: &'a dyn Progress,
    measure: Enclosure,
    /// `[cells]`: the edge lengths of their ideal shapes.
    pub sizes: Vec<f64>,
    pub body: Body,
    /// The elements that the barrier once had to hold, ascending.
    watched: Vec<u32>,
    pub iterations: Vec<Iteration>,
    pub stages: Vec<(String, f64)>,
    started: Instant,
    /// Why it ended, if it did before all phases were through.
    pub ended: Option<StopReason>,
}

impl<'a> Run<'a> {
    /// Ready to fit elements whose ideal shapes have edges of length `sizes`, `[cells]`.
    ///
    /// # Errors
    /// Where the target encloses nothing.
    pub fn new(
        device: &'a Device,
        target: VolumeTarget<'a>,
        options: &'a VolumeOptions,
        progress: &'a dyn Progress,
        body: Body,
        sizes: Vec<f64>,
    ) -> Result<Self> {
        Ok(Self {
            device,
            target,
            options,
            progress,
            measure: target.enclosure()?,
            sizes,
            body,
            watched: Vec::new(),
            iterations: Vec::new(),
            stages: Vec::new(),
            started: Instant::now(),
            ended: None,
        })
    }

    /// Goes on with other elements.
    pub fn replace(&mut self, body: Body, sizes: Vec<f64>) {
        self.body = body;
        self.sizes = sizes;
        self.watched = Vec::new();
    }

    /// From afar, at order 1.
    pub fn approach(&mut self) -> Result<()> {
        let far = self.options.far;
        let between = APPROACH.into_iter().filter(|&w| w < far && w > CLOSE);
        let weights: Vec<f64> = std::iter::once(far).chain(between).collect();
        match self.target {
            VolumeTarget::Surface(target) => self.approach_surface(target, &weights),
            VolumeTarget::Points(_) => weights
                .into_iter()
                .try_for_each(|weight| self.close(weight, STEADY_BETWEEN)),
        }
    }

    fn approach_surface(&mut self, target: &Target, weights: &[f64]) -> Result<()> {
        let interior = self.interior()?;
        let mut guard = Guard::new(&self.body, &self.sizes, &[])?;
        let boundary = self.body.boundary_surface(FAR_INTERVALS);
        let vertices = boundary.matrix.row_count();
        let scale = self.measure.scale() * self.measure.area;
        // Either term pulls on a sample with its share of the area.
        let pull = 4.0 * scale / vertices as f64;
        let surface: Vec<DMat3> = squares_by_column(&boundary.matrix)
            .into_iter()
            .map(|square| DMat3::from_diagonal(DVec3::splat(pull * square)))
            .collect();
        let fixed = target.fixed_side(vertices, self.options.seed)?;
        let moving = MovingSide::new(boundary.matrix, boundary.triangles);
        let mut terms = Vsdm::new(self.device, fixed, moving, Metric::ISOTROPIC);
        for &weight in weights {
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

    /// From nearby, all elements order by order up to `last`.
    pub fn close_in(&mut self, last: usize) -> Result<()> {
        for order in 1..=last {
            let volume = self.body.volume();
            if order > volume.highest_order() {
                self.body = volume.raised(&vec![order; volume.cell_count()])?.into();
            }
            if order == 1 || order < last && order <= FINE {
                self.close(CLOSE.max(self.options.close), STEADY_BETWEEN)?;
            }
            if order < last && order >= FINE {
                self.settle_between()?;
            }
        }
        self.settle()
    }

    /// The last phase at the present orders.
    pub fn settle(&mut self) -> Result<()> {
        self.close(self.options.close, STEADY)
    }

    /// The same where others follow.
    pub fn settle_between(&mut self) -> Result<()> {
        self.close(self.options.close, STEADY_BETWEEN)
    }

    /// Rounds of correspondences, until a round changes the root mean square distance by a share less than `steady`.
    fn close(&mut self, weight: f64, steady: f64) -> Result<()> {
        if self.ended.is_some() {
            return Ok(());
        }
        let order = self.body.volume().highest_order();
        let stage = self.begin(&format!("order {order}, λ {weight}"), ROUNDS * FROZEN);
        let interior = self.interior()?;
        let mut guard = Guard::new(&self.body, &self.sizes, &self.watched)?;
        let body = self.body.clone();
        let scale = self.measure.scale();
        let surface = Surface::new(self.device, self.target, &body, scale, self.options.seed);
        let mut before = f64::INFINITY;
        let mut kept: Option<(usize, Inverse)> = None;
        for round in 0..ROUNDS {
            let found = surface.correspond(self.body.unknowns())?;
            let rms = found.rms(self.body.unknowns());
            if (before - rms).abs() <= steady * rms || self.ended.is_some() {
                break;
            }
            before = rms;
            let done = self.iterations.len();
            let (since, inverse) = kept
                .take()
                .filter(|(since, _)| done - since < REFRESHED)
                .unwrap_or_else(|| (done, self.inverse(&interior, &found, &guard, weight)));
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

    /// How far the boundary is from the target.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn gap(&self) -> Result<Gap> {
        let scale = self.measure.scale();
        let seed = self.options.seed;
        let surface = Surface::new(self.device, self.target, &self.body, scale, seed);
        surface.gap(self.body.unknowns())
    }

    /// E_Ω of elements that may start a minimization.
    ///
    /// # Errors
    /// Where some are inverted, or the device fails.
    pub fn interior(&self) -> Result<Interior> {
        let VolumeOptions {
            rule, distortion, ..
        } = *self.options;
        let interior = Interior::new(self.device, &self.body, &self.sizes, rule, distortion)?;
        let inverted = interior.inverted(self.body.unknowns())?;
        match inverted.first() {
            None => Ok(interior),
            Some(first) => Err(Error::input(
                format!(
                    "{} of {} elements are inverted or degenerate; the first is element {first} (counted from 0)",
                    inverted.len(),
                    self.body.volume().cell_count()
                ),
                "mend the template or use more smoothness",
            )),
        }
    }

    fn weighted_diagonal(&self, interior: &Interior, weight: f64) -> Vec<f64> {
        let mut diagonal = interior.stiffness_diagonal(self.body.unknowns());
        diagonal.iter_mut().for_each(|k| *k *= weight);
        diagonal
    }

    fn inverse(
        &self,
        interior: &Interior,
        surface: &Correspondences,
        guard: &Guard,
        weight: f64,
    ) -> Inverse {
        let unknowns = self.body.unknowns();
        let of_barrier = barrier_weight(weight);
        let (most, operations) = FACTORED;
        if 3 * unknowns.len() <= most && interior.stiffness_operations() <= operations {
            let stiffness = interior.stiffness_entries(unknowns);
            let stiffness = stiffness.into_iter().map(|(i, j, k)| (i, j, weight * k));
            let barrier = guard.watch().blocks(unknowns).into_iter();
            let barrier = barrier.map(|(i, j, block)| (i, j, of_barrier * block));
            let blocks = surface.blocks().into_iter().chain(barrier);
            if let Some(factored) = Inverse::factored(unknowns.len(), stiffness, blocks) {
                return factored;
            }
        }
        let barrier = guard.watch().diagonal(unknowns);
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
        let before = self.body.unknowns().to_vec();
        self.descend(goal, guard.watch(), iterations, done_before, surface)?;
        guard.settle(&mut self.body, &before, goal.interior)
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
        let start = self.body.unknowns().to_vec();
        let nodes = start.len();
        let of_barrier = barrier_weight(goal.weight);
        let last = Cell::new(Terms::default());
        let end = settings.minimize_preconditioned(
            start,
            |p| {
                let Distorted {
                    value,
                    mut gradient,
                } = goal.interior.evaluate(p)?;
                scale_by(&mut gradient, goal.weight);
                let barrier = watch.evaluate(p, of_barrier, &mut gradient);
                if !(value + barrier).is_finite() {
                    return Ok::<_, Error>((f64::INFINITY, vec![DVec3::ZERO; p.len()]));
                }
                let ([forth, back], of_surface) = surface(p)?;
                add_to(&mut gradient, &of_surface, 1.0);
                let terms = Terms {
                    target_to_surface: forth,
                    surface_to_target: back,
                    distortion: goal.weight * value + of_barrier * barrier,
                    ..Terms::default()
                };
                last.set(terms);
                Ok((forth + back + terms.distortion, gradient))
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
        self.body.set_unknowns(end.x);
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
