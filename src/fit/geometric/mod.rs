//! Loop surfaces by the geometric algorithm \[NMM08: Y. Nishiyama, M. Morioka, T. Maekawa, *Loop subdivision surface fitting by geometric algorithms*, 2008\].
//!
//! **Theory.** Repeat: find the footpoint of every point of the data on the exact limit surface, starting from the parameters of the last time; move the
//! control points towards the data on these footpoints; once in `ROUND` iterations (the paper: five) split faces where the error is large, and flip edges. The error of a
//! surface is what the distances of the data from it are, measured at last by a full search.
//!
//! **Departures from the paper.** The paper moves each control point by the mean of the error vectors around it ([`Step::Displacement`]). By default linear least
//! squares on the same footpoints do it ([`Step::LeastSquares`]), in which a distance counts fully along its own direction and little across it, so that
//! footpoints may slide. Faces are split worst first, none that is within the tolerance, and no more than the mean error asks for at its order of convergence (`ORDER`).
//! A few peaks that are left are pulled to the tolerance with a large weight. A footpoint that has settled rests for one iteration only: left alone for a
//! whole round, it drifts along the surface, and the fit stands still. Points of the boundary of the data have their
//! footpoints on the boundary curve of the surface, from which their distances are measured. While there are many more points than control
//! points need, every second, fourth… is worked with; a full search at the end sees all, and what it finds beyond the tolerance is worked with from then on.

mod data;
mod footpoints;
mod remesh;
mod step;

pub use data::{Data, Start};

use super::voronoi::{Fit, Iteration, StopReason};
use crate::device::Device;
use crate::error::{Error, Result};
use crate::measure::Figures;
use crate::mesh::{ControlMesh, Scheme};
use crate::model::Model;
use crate::model::limit_surface::LimitSurface;
use crate::progress::{Event, Progress};
use footpoints::Sample;
use std::time::Instant;
use step::{Equations, Pull, Smoothness};

/// Iterations from one split to the next.
const ROUND: usize = 4;

/// The mean distance falls about as the number of control points to the power of -1 / [`ORDER`]: so many more are split for as it
/// asks for, within these bounds.
const ORDER: f64 = 1.3;
const GROWTH: (f64, f64) = (1.05, 1.5);
/// New control points that are always allowed.
const FEWEST: usize = 16;

/// A fit ends where this many rounds in a row lower neither the largest nor the mean distance by the share [`PROGRESS`]: without splits, and with.
const PATIENCE: usize = 2;
const PATIENCE_WITH_SPLITS: usize = 8;
const PROGRESS: f64 = 0.01;

/// Footpoints further away than so many times the root mean square may be stuck far from the closest point: they are searched for again.
const LOST: f64 = 3.0;

/// Data points to a control point that the fit works with between full searches, where there are more.
const DENSITY: usize = 16;

/// Where the root mean square is under a share of the tolerance, peaks alone keep the largest distance above it: what is beyond another share of it
/// is pulled to there with so many times the weight.
const PEAKS_FROM: f64 = 0.35;
const LIMIT: f64 = 0.9;
const PENALTY: f64 = 20.0;

/// The weight of a point of the boundary: there are few of them.
const BOUNDARY: f64 = 4.0;

/// The regularizer: enough to hold what no data holds.
const SMOOTHNESS: Smoothness = Smoothness {
    normal: 5e-5,
    tangential: 1e-4,
};

/// How control points move towards the data.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Step {
    /// By the mean of the error vectors around each: the paper's.
    Displacement,
    /// To the least squares of the distances.
    #[default]
    LeastSquares,
}

/// What to reach, and how.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// How control points move.
    pub step: Step,
    /// Stop as soon as the largest distance is at most this share of the diagonal. With neither tolerance no control points are added.
    pub max_error: Option<f64>,
    /// Stop as soon as the mean distance is at most this share of the diagonal.
    pub mean_error: Option<f64>,
    /// Control points at most; by default half the number of points of the data.
    pub max_control_points: Option<usize>,
    /// Iterations at most.
    pub iterations: Option<usize>,
    /// Subdivisions from the control mesh to the surface that is returned.
    pub levels: usize,
}

impl Options {
    fn adapts(&self) -> bool {
        self.max_error.is_some() || self.mean_error.is_some()
    }

    fn is_met(&self, error: Figures) -> bool {
        let met = |tolerance: Option<f64>, error: f64| tolerance.is_none_or(|t| error <= t);
        self.adapts() && met(self.max_error, error.max) && met(self.mean_error, error.mean)
    }
}

/// Fits a Loop surface to points.
///
/// `control`: triangles in the unit frame of the data, near it ([`crate::template::simplified`]).
///
/// # Errors
/// Where the control mesh is no oriented manifold of triangles, the device fails, or the surface degenerates (not finite).
pub fn fit(
    device: &Device,
    data: &Data,
    control: ControlMesh,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Fit> {
    let mut run = Run {
        device,
        data,
        options,
        progress,
        surface: LimitSurface::new(&control, Scheme::Loop)?,
        control,
        samples: Vec::new(),
        indices: Vec::new(),
        kept: data.on_boundary.clone(),
        iterations: Vec::new(),
        stages: STAGES.map(|name| (name.into(), 0.0)).into(),
        started: Instant::now(),
    };
    progress.event(Event::Stage {
        name: "fitting",
        steps: 0,
    });
    let (stop_reason, error) = run.iterate()?;
    let model = Model::new(&run.control, Scheme::Loop, options.levels, true)?;
    let surface = model.surface(&run.control.mesh.positions);
    if surface.positions.iter().any(|p| !p.is_finite()) {
        return Err(Error::input(
            "the fitted surface is not finite",
            "try more control points to begin with",
        ));
    }
    Ok(Fit {
        control: run.control,
        surface,
        iterations: run.iterations,
        data_error: Some(error),
        stages: run.stages,
        stop_reason,
    })
}

/// The names of the stages that time is taken of, and their places.
const STAGES: [&str; 4] = [
    "closest points",
    "control points",
    "splits and flips",
    "full search",
];
const CLOSEST: usize = 0;
const SOLVE: usize = 1;
const REMESH: usize = 2;
const SEARCH: usize = 3;

struct Run<'a> {
    device: &'a Device,
    data: &'a Data,
    options: &'a Options,
    progress: &'a dyn Progress,
    control: ControlMesh,
    /// Of `control`.
    surface: LimitSurface,
    /// The points of the data that are worked with, and which they are.
    samples: Vec<Sample>,
    indices: Vec<u32>,
    /// `[points]`: whether it is always worked with: the boundary, and what a full search found too far away.
    kept: Vec<bool>,
    iterations: Vec<Iteration>,
    stages: Vec<(String, f64)>,
    started: Instant,
}

impl Run<'_> {
    /// Iterates until something ends it: what did, and the final errors.
    fn iterate(&mut self) -> Result<(StopReason, Figures)> {
        let mut equations = Equations::new(&self.surface);
        self.choose_samples(self.stride());
        let mut stall = Stall::default();
        let mut since_split = 0;
        loop {
            self.timed(CLOSEST, |run| {
                let points = &run.control.mesh.positions;
                footpoints::update(run.device, &run.surface, points, &mut run.samples)
            })?;
            let error = figures(&self.samples);
            self.record(error);
            if since_split == 1 {
                let lost = |s: &&mut Sample| s.distance() > LOST * error.rms;
                self.samples
                    .iter_mut()
                    .filter(lost)
                    .for_each(Sample::forget);
            }
            if self.options.is_met(error) {
                let exact = self.search_all()?;
                if self.options.is_met(exact) {
                    return Ok((StopReason::Tolerance, exact));
                }
            }
            if let Some(reason) = self.stopped() {
                return Ok((reason, self.search_all()?));
            }
            since_split += 1;
            if since_split < ROUND {
                self.timed(SOLVE, |run| run.step(&equations));
                continue;
            }
            since_split = 0;
            stall.see(error);
            let refined = self.timed(REMESH, |run| run.refine(error))?;
            if refined {
                equations = self.timed(SOLVE, |run| Equations::new(&run.surface));
            }
            if let Some(reason) = stall.ends(refined, self.options.adapts()) {
                return Ok((reason, self.search_all()?));
            }
        }
    }

    fn timed<T>(&mut self, stage: usize, work: impl FnOnce(&mut Self) -> T) -> T {
        let begun = Instant::now();
        let result = work(self);
        self.stages[stage].1 += begun.elapsed().as_secs_f64();
        result
    }

    fn record(&mut self, error: Figures) {
        let percent = |share: f64| Some(100.0 * share);
        self.iterations.push(Iteration {
            iteration: self.iterations.len() + 1,
            phase: "geometric".into(),
            control_points: self.control.mesh.positions.len(),
            energy: error.rms * error.rms,
            max_percent: percent(error.max),
            rms_percent: percent(error.rms),
            mean_percent: percent(error.mean),
            seconds: self.started.elapsed().as_secs_f64(),
            ..Iteration::default()
        });
        self.progress.event(Event::Step {
            done: self.iterations.len(),
            value: Some(error.max),
        });
    }

    /// Why to stop whatever the error, if there is a reason.
    fn stopped(&self) -> Option<StopReason> {
        let allowed = self.options.iterations.unwrap_or(usize::MAX);
        if self.progress.interrupted() {
            Some(StopReason::Interrupted)
        } else if self.iterations.len() >= allowed {
            Some(StopReason::Iterations)
        } else {
            None
        }
    }

    /// Moves the control points towards the data.
    fn step(&mut self, equations: &Equations) {
        match self.options.step {
            Step::Displacement => step::displace(
                &self.samples,
                self.surface.connectivity(),
                &mut self.control.mesh.positions,
            ),
            Step::LeastSquares => {
                equations.solve(
                    &self.samples,
                    &self.pulls(),
                    SMOOTHNESS,
                    &mut self.control.mesh,
                );
            }
        }
    }

    /// Splits and flips where a tolerance asks for it. Returns whether there is a new control mesh.
    fn refine(&mut self, error: Figures) -> Result<bool> {
        let errors = self.face_errors(error);
        let count = self.control.mesh.positions.len();
        let wanted = (self.growth(error) * count as f64) as usize;
        let most = self.options.max_control_points;
        let most = most.unwrap_or(self.data.points.len() / 2);
        let most = most.min(wanted.max(count + FEWEST));
        if !remesh::refine(&mut self.control, &errors, most, &mut self.samples)? {
            // What has settled is looked at again once in a round.
            self.samples.iter_mut().for_each(|s| s.is_settled = false);
            return Ok(false);
        }
        self.surface = LimitSurface::new(&self.control, Scheme::Loop)?;
        self.choose_samples(self.stride());
        Ok(true)
    }

    /// How many times as many control points to go on with: as many as the mean asks for, or the largest distance once the mean is met.
    fn growth(&self, error: Figures) -> f64 {
        let mean = in_tolerances(error.mean, self.options.mean_error);
        let max = in_tolerances(error.max, self.options.max_error);
        let ratio = if mean > 1.0 { mean } else { max };
        ratio.powf(ORDER).clamp(GROWTH.0, GROWTH.1)
    }

    /// What the samples pull with: one-sided penalties on peaks beside the least squares.
    fn pulls(&self) -> Vec<Pull> {
        let limit = match self.options.max_error {
            Some(tolerance) if figures(&self.samples).rms < PEAKS_FROM * tolerance => {
                LIMIT * tolerance
            }
            _ => f64::INFINITY,
        };
        let pull = |sample: &Sample| {
            let weight = if sample.on_boundary { BOUNDARY } else { 1.0 };
            let distance = sample.distance();
            if distance <= limit {
                let goal = sample.goal;
                return Pull { weight, goal };
            }
            // Of one pull to the goal and a strong one to the limit before it, the sum.
            let back = PENALTY / (1.0 + PENALTY) * limit / distance;
            Pull {
                weight: weight * (1.0 + PENALTY),
                goal: sample.goal.lerp(sample.position, back),
            }
        };
        self.samples.iter().map(pull).collect()
    }

    /// `[faces]`: errors in tolerances, the largest distance's or the mean's where that is not met yet; 0 without any.
    fn face_errors(&self, error: Figures) -> Vec<f64> {
        let mut faces = vec![(0.0f64, 0.0, 0usize); self.control.mesh.face_count()];
        for sample in &self.samples {
            let (max, sum, count) = &mut faces[sample.at.face as usize];
            let distance = sample.distance();
            *max = max.max(distance);
            *sum += distance;
            *count += 1;
        }
        let Options {
            max_error,
            mean_error,
            ..
        } = *self.options;
        let mean_error = mean_error.filter(|&t| error.mean > t);
        let ratio = |&(max, sum, count): &(f64, f64, usize)| {
            let mean = sum / count.max(1) as f64;
            in_tolerances(max, max_error).max(in_tolerances(mean, mean_error))
        };
        faces.iter().map(ratio).collect()
    }

    /// Every which point of the data is enough to work with: a power of two.
    fn stride(&self) -> usize {
        let enough = DENSITY * self.control.mesh.positions.len();
        let ratio = (self.data.points.len() / enough.max(1)).max(1);
        1 << ratio.ilog2()
    }

    /// Works with every `stride`-th point, and with those that are kept; what is known of footpoints stays known.
    fn choose_samples(&mut self, stride: usize) {
        let mut known = self
            .indices
            .drain(..)
            .zip(self.samples.drain(..))
            .peekable();
        let (mut indices, mut samples) = (Vec::new(), Vec::new());
        for (i, &goal) in self.data.points.iter().enumerate() {
            let old = known.next_if(|(k, _)| *k as usize == i).map(|k| k.1);
            if self.kept[i] || i.is_multiple_of(stride) {
                indices.push(i as u32);
                samples.push(old.unwrap_or_else(|| Sample::new(goal, self.data.on_boundary[i])));
            }
        }
        drop(known);
        (self.indices, self.samples) = (indices, samples);
    }

    /// The errors of all the data by a full search. Points that are beyond a tolerance are worked with from now on; where it is the mean
    /// that fails, all are.
    fn search_all(&mut self) -> Result<Figures> {
        self.timed(SEARCH, |run| {
            let points = run.data.points.iter().zip(&run.data.on_boundary);
            let mut all: Vec<Sample> = points.map(|(&p, &b)| Sample::new(p, b)).collect();
            let control_points = &run.control.mesh.positions;
            footpoints::search(run.device, &run.surface, control_points, &mut all)?;
            let tolerance = run.options.max_error.unwrap_or(f64::INFINITY);
            for (kept, sample) in run.kept.iter_mut().zip(&all) {
                *kept |= sample.distance() > tolerance;
            }
            let exact = figures(&all);
            let only_mean = exact.max <= tolerance;
            run.choose_samples(if only_mean { 1 } else { run.stride() });
            for (&i, sample) in run.indices.iter().zip(&mut run.samples) {
                sample.clone_from(&all[i as usize]);
            }
            Ok(exact)
        })
    }
}

/// Rounds without progress.
#[derive(Default)]
struct Stall {
    best: Option<Figures>,
    rounds: usize,
}

impl Stall {
    /// Takes note of the errors at the end of a round.
    fn see(&mut self, error: Figures) {
        let Some(best) = &mut self.best else {
            self.best = Some(error);
            return;
        };
        let better = |now: f64, before: f64| now < (1.0 - PROGRESS) * before;
        self.rounds = match better(error.max, best.max) || better(error.mean, best.mean) {
            true => 0,
            false => self.rounds + 1,
        };
        best.max = best.max.min(error.max);
        best.mean = best.mean.min(error.mean);
    }

    /// Why to stop, if it is time to.
    fn ends(&self, refined: bool, adapts: bool) -> Option<StopReason> {
        match (refined, adapts) {
            (true, _) if self.rounds < PATIENCE_WITH_SPLITS => None,
            (false, _) if self.rounds < PATIENCE => None,
            (false, true) => Some(StopReason::ControlPoints),
            _ => Some(StopReason::Stagnation),
        }
    }
}

/// An error in units of its tolerance; 0 without one.
fn in_tolerances(error: f64, tolerance: Option<f64>) -> f64 {
    tolerance.map_or(0.0, |t| error / t)
}

/// The largest, mean and root mean square distance of samples from their footpoints; zero without any.
fn figures(samples: &[Sample]) -> Figures {
    let count = samples.len().max(1) as f64;
    let distances = || samples.iter().map(Sample::distance);
    Figures {
        max: distances().fold(0.0, f64::max),
        mean: distances().sum::<f64>() / count,
        rms: (distances().map(|d| d * d).sum::<f64>() / count).sqrt(),
    }
}
