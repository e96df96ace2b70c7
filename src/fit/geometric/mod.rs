//! Loop surfaces by the geometric algorithm \[NMM08: Y. Nishiyama, M. Morioka, T. Maekawa, *Loop subdivision surface fitting by geometric algorithms*, 2008\].
//!
//! **Theory.** Repeat: find the footpoint of every point of the data on the exact limit surface, starting from the parameters of the last time; move the
//! control points towards the data on these footpoints; once in `ROUND` iterations (the paper: five) split faces where the error is large, and flip edges. The error of a
//! surface is what the distances of the data from it are, measured at last by a full search.
//!
//! **Departures from the paper.** The paper moves each control point by the mean of the error vectors around it ([`Step::Displacement`]). By default linear least
//! squares on the same footpoints do it ([`Step::LeastSquares`]), in which a distance counts fully along its own direction and little across it, so that
//! footpoints may slide. Faces are split worst first, none that is within the tolerance, and no more than the mean error asks for at its order of convergence (`ORDER`).
//! Footpoints are taken along over splits and flips, and a step on them at once undoes most of what those did to the surface. A few peaks that are left become
//! heavier step by step, and then only the control points around them move. Points along a rim of the data have their footpoints on the loop of the surface's boundary
//! that became of it, from which their distances are measured. While there are many more points than control points need, every second, fourth… is worked
//! with; all are once peaks alone are left, or nothing gets better. Newton's method takes its last step on trust, which saves half of its evaluations; a full search at the end
//! finds what that left behind.

mod data;
mod footpoints;
mod peaks;
mod remesh;
mod rims;
mod step;

pub use data::{Data, Start};

use super::record::{Fit, Iteration, StopReason};
use crate::device::Device;
use crate::energy::laplacian;
use crate::error::{Error, Result};
use crate::measure::Figures;
use crate::mesh::{Connectivity, ControlMesh, Scheme};
use crate::model::{self, limit_surface::LimitSurface};
use crate::progress::{Event, Progress};
use footpoints::Sample;
use rayon::prelude::*;
use rims::Rims;
use std::time::Instant;
use step::Smoothness;

/// Iterations from one split to the next.
const ROUND: usize = 4;

/// The mean distance falls about as the number of control points to the power of -1 / [`ORDER`]: so many more are split for as it
/// asks for, within these bounds.
const ORDER: f64 = 1.1;
const GROWTH: (f64, f64) = (1.05, 2.5);
/// New control points that are always allowed.
const FEWEST: usize = 16;

/// A fit ends where this many rounds in a row lower neither the largest nor the mean distance by the share [`PROGRESS`]: without splits, and with.
const PATIENCE: usize = 2;
const PATIENCE_WITH_SPLITS: usize = 8;
const PROGRESS: f64 = 0.01;

/// Footpoints further away than so many times the root mean square may be stuck far from the closest point: they are searched for again.
const LOST: f64 = 3.0;

/// How near footpoints are to be found, as a share of the root mean square; and before that is known, in diagonals. A foot that is beside the
/// closest point by a tenth of its distance is further away by half a percent.
const NEAR: f64 = 0.03;
const NEAR_AT_FIRST: f64 = 1e-4;

/// Data points to a control point that the fit works with until it is nearly done, where there are more.
const DENSITY: usize = 8;

/// Samples that one task looks at.
const SAMPLES_PER_TASK: usize = 4096;

/// The regularizer: enough to hold what no data holds. A sixth of it leaves waves between the points of the bunny, a third more rms from the surface to the scan.
const SMOOTHNESS: Smoothness = Smoothness {
    normal: 3e-4,
    tangential: 3e-4,
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
    /// Control points at most; by default three quarters of the number of points of the data.
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
    let surface = LimitSurface::new(&control, Scheme::Loop)?;
    let mesh = surface.connectivity();
    let is_open = (0..mesh.edge_count() as u32).any(|e| mesh.is_boundary_edge(e));
    let rim_of: Vec<Option<u32>> = data.rims.iter().map(|r| r.filter(|_| is_open)).collect();
    let rims = Rims::matched(data, mesh, &control.mesh.positions)?;
    let mut run = Run {
        device,
        data,
        options,
        progress,
        laplacian: laplacian_rows(mesh),
        surface,
        rims,
        control,
        samples: Vec::new(),
        indices: Vec::new(),
        spread: Vec::new(),
        near: NEAR_AT_FIRST,
        rim_of,
        sees_all: false,
        iterations: Vec::new(),
        stages: STAGES.map(|name| (name.into(), 0.0)).into(),
        started: Instant::now(),
    };
    progress.event(Event::Stage {
        name: "fitting",
        steps: 0,
    });
    let (stop_reason, error) = run.iterate()?;
    let surface = model::limit_mesh(&run.control, Scheme::Loop, options.levels)?;
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
    /// Of `control`.
    rims: Rims,
    /// Of `control`: the rows of the regularizer.
    laplacian: Vec<Vec<(u32, f64)>>,
    /// The points of the data that are worked with, and which they are.
    samples: Vec<Sample>,
    indices: Vec<u32>,
    /// Points of the boundary of the surface, as footpoints of the nearest points of the data's rims.
    spread: Vec<Sample>,
    /// How near footpoints are to be found, in diagonals.
    near: f64,
    /// `[points]`: the rim that it lies on, unless the surface is closed.
    rim_of: Vec<Option<u32>>,
    /// Whether all points are worked with from now on.
    sees_all: bool,
    iterations: Vec<Iteration>,
    stages: Vec<(String, f64)>,
    started: Instant,
}

impl Run<'_> {
    /// Iterates until something ends it: what did, and the final errors.
    fn iterate(&mut self) -> Result<(StopReason, Figures)> {
        self.choose_samples(self.stride());
        let mut stall = Stall::default();
        let mut since_split = 0;
        let mut mean_before = f64::INFINITY;
        loop {
            self.track()?;
            let error = self.figures();
            self.near = NEAR * error.rms;
            self.record(error);
            if since_split == 0 {
                self.forget_lost(error);
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
            let at_peaks = self.options.are_peaks_left(error);
            if at_peaks && !self.sees_all {
                self.sees_all = true;
                self.choose_samples(self.stride());
                continue;
            }
            if since_split < if at_peaks { peaks::ROUND } else { ROUND } {
                if at_peaks {
                    self.weigh_peaks();
                }
                let is_calm = since_split > 1 && error.mean > peaks::CALM * mean_before;
                let free = (at_peaks && is_calm).then(|| self.around_peaks());
                mean_before = error.mean;
                self.timed(SOLVE, |run| run.step(free.as_deref()));
                continue;
            }
            since_split = 0;
            stall.see(error);
            let refined = self.timed(REMESH, |run| run.refine(error))?;
            if let Some(reason) = stall.ends(refined, self.options.adapts()) {
                if self.sees_all {
                    return Ok((reason, self.search_all()?));
                }
                self.sees_all = true;
                stall = Stall::default();
            }
            // On a new mesh the old footpoints, which know what the surface was to reach, undo most of what splits and flips did to it.
            self.timed(SOLVE, |run| run.step(None));
            self.choose_samples(self.stride());
        }
    }

    /// Brings the footpoints up to date.
    fn track(&mut self) -> Result<()> {
        self.timed(CLOSEST, |run| {
            let mut spread = footpoints::update(
                run.device,
                &run.surface,
                &run.control.mesh.positions,
                &run.rims,
                &mut run.samples,
                run.near,
            )?;
            // Without splits in between they are at the same parameters.
            for (now, before) in spread.iter_mut().zip(&run.spread) {
                now.weight = before.weight;
            }
            run.spread = spread;
            Ok(())
        })
    }

    /// The largest, mean and root mean square distance of samples from their footpoints; the largest also of the surface's boundary from rims.
    fn figures(&self) -> Figures {
        let sums = |part: &[Sample]| {
            let distances = part.iter().map(Sample::distance);
            distances.fold([0.0; 3], |[max, first, second], d| {
                [f64::max(max, d), first + d, second + d * d]
            })
        };
        let parts: Vec<[f64; 3]> = self
            .samples
            .par_chunks(SAMPLES_PER_TASK)
            .map(sums)
            .collect();
        let all = |[a, b, c]: [f64; 3], part: &[f64; 3]| [a.max(part[0]), b + part[1], c + part[2]];
        let [max, first, second] = parts.iter().fold([0.0; 3], all);
        let count = self.samples.len().max(1) as f64;
        Figures {
            max: self.spread.iter().map(Sample::distance).fold(max, f64::max),
            mean: first / count,
            rms: (second / count).sqrt(),
        }
    }

    /// Has footpoints that may be stuck far from the closest point searched for.
    fn forget_lost(&mut self, error: Figures) {
        let lost = |s: &&mut Sample| s.distance() > LOST * error.rms;
        let samples = self.samples.iter_mut();
        samples.filter(lost).for_each(Sample::forget);
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

    /// Moves the control points, or those that are `free`, towards the data.
    fn step(&mut self, free: Option<&[bool]>) {
        let samples: Vec<&Sample> = self.samples.iter().chain(&self.spread).collect();
        match self.options.step {
            Step::Displacement => step::displace(
                &samples,
                self.surface.connectivity(),
                &mut self.control.mesh.positions,
            ),
            Step::LeastSquares => step::solve(
                &samples,
                &self.laplacian,
                SMOOTHNESS,
                free,
                &mut self.control.mesh,
            ),
        }
    }

    /// Splits and flips where a tolerance asks for it. Returns whether there is a new control mesh.
    fn refine(&mut self, error: Figures) -> Result<bool> {
        let errors = self.face_errors(error);
        let count = self.control.mesh.positions.len();
        let wanted = (self.growth(error) * count as f64) as usize;
        let most = self.options.max_control_points;
        let most = most.unwrap_or(3 * self.data.points.len() / 4);
        let most = most.min(wanted.max(count + FEWEST));
        let control = &mut self.control;
        if !remesh::refine(control, &self.surface, &errors, most, &mut self.samples)? {
            return Ok(false);
        }
        self.surface = LimitSurface::new(&self.control, Scheme::Loop)?;
        let mesh = self.surface.connectivity();
        self.laplacian = laplacian_rows(mesh);
        self.rims.carry_over(mesh);
        self.spread.clear();
        footpoints::carry_over(
            &self.surface,
            &self.control.mesh.positions,
            &mut self.samples,
        );
        Ok(true)
    }

    /// How many times as many control points to go on with: as many as the mean asks for, or the largest distance once the mean is met.
    fn growth(&self, error: Figures) -> f64 {
        let mean = in_tolerances(error.mean, self.options.mean_error) / peaks::MARGIN;
        let max = in_tolerances(error.max, self.options.max_error);
        let ratio = if mean > 1.0 { mean } else { max };
        ratio.powf(ORDER).clamp(GROWTH.0, GROWTH.1)
    }

    /// `[faces]`: errors in tolerances, the largest distance's or the mean's where that is not met yet; 0 without any.
    fn face_errors(&self, error: Figures) -> Vec<f64> {
        let mut faces = vec![(0.0f64, 0.0); self.control.mesh.face_count()];
        for sample in self.samples.iter().chain(&self.spread) {
            let (max, sum) = &mut faces[sample.at.face as usize];
            let distance = sample.distance();
            *max = max.max(distance);
            *sum += distance;
        }
        let Options {
            max_error,
            mean_error,
            ..
        } = *self.options;
        let mean_error = mean_error
            .map(|t| peaks::MARGIN * t)
            .filter(|&t| error.mean > t);
        let of_max = match self.options.are_peaks_left(error) {
            true => peaks::SPLIT,
            false => 1.0,
        };
        let max_error = max_error.map(|t| of_max * t);
        // A face may have as much of the sum of distances as every other: that is what fewest faces reach a mean with.
        let samples_to_a_face = self.samples.len() as f64 / faces.len() as f64;
        let ratio = |&(max, sum): &(f64, f64)| {
            in_tolerances(max, max_error).max(in_tolerances(sum / samples_to_a_face, mean_error))
        };
        faces.iter().map(ratio).collect()
    }

    /// Every which point of the data is enough to work with: a power of two.
    fn stride(&self) -> usize {
        if self.sees_all {
            return 1;
        }
        let enough = DENSITY * self.control.mesh.positions.len();
        let ratio = (self.data.points.len() / enough.max(1)).max(1);
        1 << ratio.ilog2()
    }

    /// Works with every `stride`-th point, and with all of rims; what is known of footpoints stays known, and new points begin from those of
    /// neighbours.
    fn choose_samples(&mut self, stride: usize) {
        if stride == 1 && self.samples.len() == self.data.points.len() {
            return;
        }
        let known = std::mem::take(&mut self.samples);
        let mut known = self.indices.drain(..).zip(known).peekable();
        let (mut indices, mut samples) = (Vec::new(), Vec::new());
        let mut last: Option<Sample> = None;
        for (i, (&goal, &rim)) in (self.data.points.iter()).zip(&self.rim_of).enumerate() {
            let old = known.next_if(|(k, _)| *k as usize == i).map(|k| k.1);
            let begin = || {
                let neighbours = last.iter().chain(known.peek().map(|k| &k.1));
                let distance = |s: &&Sample| s.goal.distance_squared(goal);
                let nearest = neighbours.min_by(|a, b| distance(a).total_cmp(&distance(b)));
                match nearest {
                    Some(nearest) => Sample::beside(goal, rim, nearest),
                    None => Sample::new(goal, rim),
                }
            };
            let here = old.as_ref().map(|s| Sample::beside(goal, rim, s));
            if self.rim_of[i].is_some() || i.is_multiple_of(stride) {
                indices.push(i as u32);
                samples.push(old.unwrap_or_else(begin));
            }
            last = here.or(last);
        }
        drop(known);
        (self.indices, self.samples) = (indices, samples);
    }

    /// The errors of all the data by a full search. All are worked with from now on.
    fn search_all(&mut self) -> Result<Figures> {
        self.sees_all = true;
        self.choose_samples(self.stride());
        self.track()?;
        // What is well within the tolerance may be nearer still.
        let enough = peaks::LIMIT * self.options.max_error.unwrap_or(0.0);
        let exact_beyond = enough.max(LOST * self.figures().rms);
        self.timed(SEARCH, |run| {
            let points = &run.control.mesh.positions;
            footpoints::search(
                run.device,
                &run.surface,
                points,
                &mut run.samples,
                exact_beyond,
            )
        })?;
        Ok(self.figures())
    }
}

/// The rows of the regularizer.
fn laplacian_rows(mesh: &Connectivity) -> Vec<Vec<(u32, f64)>> {
    let matrix = laplacian(mesh);
    (0..matrix.row_count())
        .map(|r| matrix.row(r).collect())
        .collect()
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
