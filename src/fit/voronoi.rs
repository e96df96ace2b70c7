//! Surface fitting by Voronoi squared distance minimization \[NYL12\], from coarse to fine.
//!
//! The paper starts L-BFGS from the final control mesh. A prototype ended in folds that way: 60 s and 6 % of the triangles of
//! a 1,536-point bunny. Here the control mesh starts with about a hundred points, the smoothness weight λ falls from
//! large to small (that order decides the folds), and the control mesh is subdivided in between, which leaves the
//! surface as it is. Far phases see a decimated target and an isotropic metric. Then either the least-squares
//! [polish](super::polish) finishes, or, as in the paper, the anisotropic energies with falling λ do.
//! A template that lies on the target from the start ([`crate::template::automatic`]) is polished right away.

use super::checkpoint::{Checkpoint, Checkpoints, fingerprint};
use super::outliers;
use super::polish::{Polish, Role};
use super::record::{Fit, Iteration, StopReason, Terms};
use super::start::{Proximity, Start};
use super::target::{Far, Target};
use crate::device::Device;
use crate::energy::{Smoothness, laplacian};
use crate::error::{Error, Result};
use crate::kernel::closest_point::ClosestPoints;
use crate::kernel::restricted_voronoi::Metric;
use crate::kernel::sparse::Csr;
use crate::kernel::vsdm::{MovingSide, Vsdm};
use crate::mesh::{Connectivity, ControlMesh, Scheme, TriangleMesh};
use crate::model::{self, Model};
use crate::optimize::{Lbfgs, Stop};
use crate::progress::{Event, Progress};
use std::time::Instant;

/// (λ, iterations) of the phases up to the polish.
struct Schedule {
    /// On the coarsest control mesh.
    far: &'static [(f64, usize)],
    /// After each but the last subdivision.
    middle: &'static [(f64, usize)],
    /// After the last one.
    near: &'static [(f64, usize)],
}

/// From a box around the target: much smoothness, or it folds on the way. More steps near it gain less than the polish does in their time.
const FROM_AFAR: Schedule = Schedule {
    far: &[(300.0, 20), (30.0, 20), (3.0, 20)],
    middle: &[(10.0, 10), (1.0, 10)],
    near: &[(10.0, 10), (1.0, 10)],
};
/// From a template of about the target's shape. With the schedule above, a torus of 512 points around the rocker arm
/// ends with 2.7 % of its triangles folded and twice the error.
const FROM_NEARBY: Schedule = Schedule {
    far: &[(30.0, 60), (3.0, 60), (0.3, 60)],
    middle: &[(1.0, 60), (0.1, 60)],
    near: &[(1.0, 36), (0.1, 36)],
};
/// From a template on the target with some folds: they open in a third of the iterations that a torus takes (featuretype 0.578 / 0.0370 %; with 60 in place of 20, 0.532 /
/// 0.0371 %).
const FROM_FOLDS: Schedule = Schedule {
    far: &[(30.0, 20), (3.0, 20), (0.3, 20)],
    middle: &[(1.0, 20), (0.1, 20)],
    near: &[(1.0, 20), (0.1, 20)],
};
/// The paper's own finish, with normal anisotropy.
const PURE: [(f64, usize); 3] = [(1.0, 20), (0.1, 60), (0.01, 60)];
/// The factor on the squared Laplacian of the control mesh, in the polish of a template on the target: its cage is there to be modelled on. On the bunny from 0.0307 to
/// 0.0416 % rms, but with a calm cage and a fifth of the folds; fertility from 0.0483 to 0.0557 % and less than half of them.
const CALM: f64 = 8.0;
/// Beyond this many control points, subdivision and polish alone refine further.
const LAST_VORONOI: usize = 2_000;

/// Samples of the target that tell which share of it is farthest from the surface.
const SAMPLES: usize = 20_000;

/// Pairs kept by L-BFGS.
const MEMORY: usize = 10;
/// A stage stops at this mean relative decrease over five iterations.
const DECREASE: f64 = 1e-4;
/// The largest motion of the first step of a stage, in diagonals.
const FIRST_STEP: f64 = 0.01;

/// What to fit and how far.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// The surface that the control mesh stands for.
    pub scheme: Scheme,
    /// Subdivisions from control mesh to surface vertices.
    pub levels: usize,
    /// Whether the last level is pushed to the limit surface.
    pub limit: bool,
    /// The final smoothness weight λ; the schedule stays above it.
    pub smoothness: f64,
    /// Normal anisotropy s of a last Voronoi phase; `None` for no such phase (with the polish) or 5 (without).
    pub anisotropy: Option<f64>,
    /// Whether least squares on closest points finish the fit.
    pub polish: bool,
    /// Stop as soon as the largest distance is at most this share of the diagonal.
    pub max_error: Option<f64>,
    /// Stop as soon as the mean distance is at most this share of the diagonal.
    pub mean_error: Option<f64>,
    /// Iterations at most, of all phases together.
    pub iterations: Option<usize>,
    /// The share of the target's samples, from 0 to 0.5, that may be far from the surface without any pull on it.
    pub outliers: f64,
    /// The seed of all sampling.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            scheme: Scheme::CatmullClark,
            levels: 2,
            limit: true,
            smoothness: 0.01,
            anisotropy: None,
            polish: true,
            max_error: None,
            mean_error: None,
            iterations: None,
            outliers: 0.0,
            seed: 0,
        }
    }
}

/// Fits a surface to a target from a template.
///
/// # Errors
/// Where the template is no manifold or does not suit the scheme, the device fails, or the surface degenerates (not
/// finite).
pub fn fit(
    device: &Device,
    target: &Target,
    start: Start,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Fit> {
    fit_with_checkpoints(
        device,
        target,
        start,
        options,
        progress,
        Checkpoints::default(),
    )
}

/// Like [`fit`], going on from a checkpoint or leaving some. Resumed, it ends with the bits of the fit that was not interrupted.
///
/// # Errors
/// As [`fit`], and where the checkpoint is of another fit or none can be written.
pub fn fit_with_checkpoints(
    device: &Device,
    target: &Target,
    start: Start,
    options: &Options,
    progress: &dyn Progress,
    mut checkpoints: Checkpoints,
) -> Result<Fit> {
    let fingerprint = fingerprint(target, &start, options);
    if let Some(checkpoint) = &checkpoints.resume {
        checkpoint.check(fingerprint)?;
    }
    checkpoints.resume.take_if(|c| c.phases == 0);
    let mut run = Run {
        device,
        target,
        options,
        progress,
        checkpoints,
        fingerprint,
        phases: 0,
        calm: match start.proximity {
            Proximity::Touching | Proximity::Opposed => CALM,
            Proximity::Far | Proximity::Near | Proximity::Folded => 1.0,
        },
        tells_sides: matches!(start.proximity, Proximity::Opposed | Proximity::Folded),
        control: start.control,
        iterations: Vec::new(),
        stages: Vec::new(),
        started: Instant::now(),
        ended: None,
    };
    if start.proximity.is_touching() && options.polish {
        run.polishes_from(start.subdivisions)?;
    } else {
        run.all_stages(start.subdivisions, start.proximity.schedule())?;
    }
    if let Some(checkpoint) = run.checkpoints.resume {
        return Err(checkpoint.damaged("phases", "there are fewer phases in the fit"));
    }
    let model = run.model()?;
    let surface = model.surface(&run.control.mesh.positions);
    if surface.positions.iter().any(|p| !p.is_finite()) {
        return Err(Error::input(
            "the fitted surface is not finite",
            "try more smoothness or another template",
        ));
    }
    Ok(Fit {
        control: run.control,
        surface,
        iterations: run.iterations,
        data_error: None,
        stages: run.stages,
        stop_reason: run.ended.unwrap_or(StopReason::Schedule),
    })
}

impl Proximity {
    fn is_touching(self) -> bool {
        matches!(self, Self::Touching | Self::Opposed)
    }

    fn schedule(self) -> &'static Schedule {
        match self {
            Self::Far => &FROM_AFAR,
            Self::Near | Self::Touching | Self::Opposed => &FROM_NEARBY,
            Self::Folded => &FROM_FOLDS,
        }
    }
}

struct Run<'a> {
    device: &'a Device,
    target: &'a Target,
    options: &'a Options,
    progress: &'a dyn Progress,
    checkpoints: Checkpoints,
    fingerprint: u64,
    /// Phases done.
    phases: usize,
    /// The factor on the squared Laplacian of the control mesh.
    calm: f64,
    /// Whether the polish has to tell the sides of thin walls apart.
    tells_sides: bool,
    control: ControlMesh,
    iterations: Vec<Iteration>,
    stages: Vec<(String, f64)>,
    started: Instant,
    ended: Option<StopReason>,
}

impl Run<'_> {
    fn all_stages(&mut self, subdivisions: usize, schedule: &Schedule) -> Result<()> {
        self.save()?;
        self.voronoi("far", schedule.far, Metric::ISOTROPIC)?;
        for left in (0..subdivisions).rev() {
            self.control = model::subdivide(&self.control, self.options.scheme)?;
            let next_is_large = 4 * self.points() > LAST_VORONOI;
            if self.points() <= LAST_VORONOI || !self.options.polish {
                let last = left == 0 || next_is_large;
                let steps = if last { schedule.near } else { schedule.middle };
                self.voronoi("near", steps, Metric::ISOTROPIC)?;
            }
            // Polished, a coarse surface is a better start for many points than more Voronoi steps.
            if self.options.polish && next_is_large && left > 0 {
                self.polish(Role {
                    approaches: false,
                    tells_sides: self.tells_sides,
                    finishes: false,
                })?;
            }
        }
        let anisotropy = match (self.options.anisotropy, self.options.polish) {
            (None, false) => Some(5.0),
            (s, _) => s,
        };
        if let Some(s) = anisotropy {
            self.voronoi("anisotropic", &PURE, Metric::anisotropic(s))?;
        }
        if self.options.polish {
            self.polish(Role {
                approaches: false,
                tells_sides: self.tells_sides,
                finishes: true,
            })?;
        }
        Ok(())
    }

    /// Polishes a template on the target, and each of its subdivisions. Voronoi steps before would take several times as long and not lower the error
    /// (fertility: 0.390 / 0.0511 % with them, 0.340 / 0.0484 % without), so they are left to who asks for an anisotropy.
    fn polishes_from(&mut self, subdivisions: usize) -> Result<()> {
        self.save()?;
        for level in 0..subdivisions {
            self.polish(Role {
                approaches: level == 0,
                tells_sides: self.tells_sides,
                finishes: false,
            })?;
            self.control = model::subdivide(&self.control, self.options.scheme)?;
        }
        if let Some(s) = self.options.anisotropy {
            self.voronoi("anisotropic", &PURE, Metric::anisotropic(s))?;
        }
        self.polish(Role {
            approaches: subdivisions == 0 && self.options.anisotropy.is_none(),
            tells_sides: self.tells_sides,
            finishes: true,
        })
    }

    /// Whether the next phase is to be run: not once the fit has ended, and not where the checkpoint has it done.
    fn begins_phase(&mut self) -> Result<bool> {
        if self.ended.is_some() {
            return Ok(false);
        }
        let done = self.checkpoints.resume.as_ref().map_or(0, |c| c.phases);
        if self.phases >= done {
            return Ok(true);
        }
        self.phases += 1;
        if self.phases == done
            && let Some(checkpoint) = self.checkpoints.resume.take()
        {
            self.control.mesh.positions = checkpoint.positions_for(self.points())?;
            self.iterations = checkpoint.iterations;
            self.stages = checkpoint.stages;
        }
        Ok(false)
    }

    /// Counts a phase that has run to its end.
    fn end_phase(&mut self, stage: String, begun: Instant) -> Result<()> {
        self.stages.push((stage, begun.elapsed().as_secs_f64()));
        if self.ended.is_none() {
            self.phases += 1;
            self.save()?;
        }
        Ok(())
    }

    /// Leaves a checkpoint, unless it would tell less than the one that is to be resumed.
    fn save(&self) -> Result<()> {
        match &self.checkpoints.file {
            Some(path) if self.checkpoints.resume.is_none() => Checkpoint::new(
                self.fingerprint,
                self.phases,
                &self.control.mesh.positions,
                &self.iterations,
                &self.stages,
            )
            .write(path),
            _ => Ok(()),
        }
    }

    fn points(&self) -> usize {
        self.control.mesh.positions.len()
    }

    fn model(&self) -> Result<Model> {
        let Options {
            scheme,
            levels,
            limit,
            ..
        } = *self.options;
        Model::new(&self.control, scheme, levels, limit)
    }

    /// Iterations left of those that the caller allows.
    fn left(&self, wanted: usize) -> usize {
        let allowed = self.options.iterations.unwrap_or(usize::MAX);
        wanted.min(allowed.saturating_sub(self.iterations.len()))
    }

    /// Minimizes the Voronoi objective for each (λ, iterations) of a schedule.
    fn voronoi(&mut self, name: &str, schedule: &[(f64, usize)], metric: Metric) -> Result<()> {
        if !self.begins_phase()? {
            return Ok(());
        }
        let begun = Instant::now();
        let model = self.model()?;
        let smoothness = Smoothness::new(&model.connectivity, &model.matrix);
        let far = self.far_from(&model)?;
        let fixed =
            self.target
                .trimmed_fixed_side(model.matrix.row_count(), self.options.seed, far)?;
        let moving = MovingSide::new(model.matrix, model.triangles);
        let mut terms = Vsdm::new(self.device, fixed, moving, metric);
        let steps = schedule.iter().map(|s| s.1).sum();
        let stage = format!("{name}, {} control points", self.points());
        self.progress.event(Event::Stage {
            name: &stage,
            steps,
        });
        let mut done = 0;
        for &(weight, iterations) in schedule {
            let weight = weight.max(self.options.smoothness);
            self.minimize(&mut terms, &smoothness, weight, iterations, done)?;
            done += iterations;
            if self.ended.is_some() {
                break;
            }
        }
        self.end_phase(stage, begun)
    }

    /// What of the target the Voronoi terms pass over: what is so far from the surface.
    fn far_from(&self, model: &Model) -> Result<Option<Far>> {
        if self.options.outliers == 0.0 {
            return Ok(None);
        }
        let surface = ClosestPoints::new(
            self.device,
            &TriangleMesh {
                positions: model.positions(&self.control.mesh.positions),
                triangles: model.triangles.clone(),
            },
        )?;
        let samples = self.target.samples(SAMPLES, self.options.seed).positions;
        let distances = surface
            .query(&samples)?
            .into_iter()
            .map(|c| c.distance_squared.sqrt());
        Ok(Some(Far {
            cutoff: outliers::cutoff(distances, self.options.outliers),
            surface,
        }))
    }

    fn minimize(
        &mut self,
        terms: &mut Vsdm,
        smoothness: &Smoothness,
        weight: f64,
        iterations: usize,
        done_before: usize,
    ) -> Result<()> {
        let settings = Lbfgs {
            memory: MEMORY,
            iterations: self.left(iterations),
            decrease: DECREASE,
            first_step: FIRST_STEP,
        };
        let start = std::mem::take(&mut self.control.mesh.positions);
        let control_points = start.len();
        // The terms of the lowest value seen: what the line search accepts.
        let last = std::cell::Cell::new(Terms::default());
        let end = settings.minimize(
            start,
            |p| {
                let evaluation = terms.evaluate(p)?;
                let (r, r_gradient) = smoothness.evaluate(p);
                let parts = Terms {
                    target_to_surface: evaluation.target_to_surface,
                    surface_to_target: evaluation.surface_to_target,
                    smoothness: weight * r,
                    distortion: 0.0,
                };
                last.set(parts);
                let value = parts.target_to_surface + parts.surface_to_target + parts.smoothness;
                let gradient = evaluation
                    .gradient
                    .iter()
                    .zip(&r_gradient)
                    .map(|(g, r)| *g + weight * *r)
                    .collect();
                Ok::<_, Error>((value, gradient))
            },
            |it| {
                self.iterations.push(Iteration {
                    iteration: self.iterations.len() + 1,
                    phase: "voronoi".into(),
                    control_points,
                    energy: it.value,
                    terms: Some(last.get()),
                    gradient_norm: Some(it.gradient_norm),
                    seconds: self.started.elapsed().as_secs_f64(),
                    ..Iteration::default()
                });
                self.progress.event(Event::Step {
                    done: done_before + it.iteration,
                    value: Some(it.value),
                });
                !self.progress.interrupted()
            },
        )?;
        self.control.mesh.positions = end.x;
        self.ended = match end.stop {
            Stop::Observer => Some(StopReason::Interrupted),
            _ if self.left(1) == 0 => Some(StopReason::Iterations),
            _ => None,
        };
        Ok(())
    }

    /// Runs the least-squares polish on the present control mesh.
    fn polish(&mut self, role: Role) -> Result<()> {
        if !self.begins_phase()? {
            return Ok(());
        }
        let begun = Instant::now();
        let model = self.model()?;
        let smoothness = Smoothness::new(&model.connectivity, &model.matrix);
        let cage = laplacian(&Connectivity::of(&self.control.mesh)?);
        let cage = scaled(&cage.multiply(&cage), self.calm);
        let mut polish = Polish::new(
            self.device,
            self.target,
            &model,
            &smoothness,
            &cage,
            role,
            self.options,
        );
        let stage = format!("polish, {} control points", self.points());
        self.progress.event(Event::Stage {
            name: &stage,
            steps: polish.steps(),
        });
        let mut positions = std::mem::take(&mut self.control.mesh.positions);
        let control_points = positions.len();
        let outcome = polish.run(&mut positions, |step| {
            self.iterations.push(Iteration {
                iteration: self.iterations.len() + 1,
                phase: "polish".into(),
                control_points,
                energy: step.mean_square,
                max_percent: Some(100.0 * step.max),
                seconds: self.started.elapsed().as_secs_f64(),
                ..Iteration::default()
            });
            self.progress.event(Event::Step {
                done: step.done,
                value: Some(step.mean_square),
            });
            let met = |tolerance: Option<f64>, error: f64| tolerance.is_none_or(|t| error <= t);
            let asked = self.options.max_error.is_some() || self.options.mean_error.is_some();
            if asked
                && met(self.options.max_error, step.max)
                && met(self.options.mean_error, step.mean)
            {
                self.ended = Some(StopReason::Tolerance);
            } else if self.progress.interrupted() {
                self.ended = Some(StopReason::Interrupted);
            } else if self.left(1) == 0 {
                self.ended = Some(StopReason::Iterations);
            }
            self.ended.is_none()
        });
        self.control.mesh.positions = positions;
        outcome?;
        self.end_phase(stage, begun)
    }
}

fn scaled(matrix: &Csr, factor: f64) -> Csr {
    let row = |r| matrix.row(r).map(|(c, v)| (c, factor * v)).collect();
    let rows: Vec<_> = (0..matrix.row_count()).map(row).collect();
    Csr::from_rows(&rows, matrix.column_count)
}
