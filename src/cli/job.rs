//! What `fit` and `demo` have in common: fit, judge, write, and say so.

use super::Outcome;
use super::outputs::Outputs;
use super::session::Session;
use super::text::command_line;
use glam::DVec3;
use std::path::{Path, PathBuf};
use vorofit::files::{SurfaceToWrite, write_surface};
use vorofit::fit::geometric::{self, Data};
use vorofit::fit::{
    self, Checkpoints, Fit, Interpolation, Iteration, Options, Start, StopReason, Template,
};
use vorofit::measure::{self, Mended};
use vorofit::mesh::check::Census;
use vorofit::mesh::specks;
use vorofit::mesh::{
    Connectivity, ControlMesh, Frame, PointCloud, PolygonMesh, Scheme, TriangleMesh,
};
use vorofit::picture;
use vorofit::reconstruction;
use vorofit::report::page::{Page, Subject};
use vorofit::report::{
    CageReport, DeviceReport, ErrorReport, Report, ResultReport, Settings, Stopwatch, TargetReport,
};
use vorofit::topology::Holes;
use vorofit::{Error, Result};

/// Area samples a side by which the result is judged: the rms is then certain to about a percent.
const SAMPLES: usize = 200_000;

/// Samples of each rim.
const RIM_SAMPLES: usize = 20_000;

/// A fit in the unit frame, and what it is judged against.
struct Fitted {
    fit: Fit,
    frame: Frame,
    /// The target in the unit frame: the input, or what has been reconstructed of its points where the method needs a surface.
    target: TriangleMesh,
    /// Of `target`, where it has triangles.
    mended: Option<Mended>,
}

/// A fit to be run.
pub struct Job<'a> {
    /// The command, for the report.
    pub command: &'static str,
    /// What the target is called in messages.
    pub name: &'a Path,
    pub target: Target<'a>,
    pub method: Method,
    pub settings: Settings,
    pub outputs: Outputs,
    pub checkpoints: Checkpoints,
    /// A file for the report, beside the one that the user may ask for.
    pub report: Option<PathBuf>,
    /// A folder for the report as a page.
    pub page: Option<PagePlace>,
}

/// Where a page goes, and what is upwards on it.
pub struct PagePlace {
    pub folder: PathBuf,
    pub up: picture::Axis,
}

/// What to fit to, in its own coordinates.
#[derive(Clone, Copy)]
pub enum Target<'a> {
    Surface {
        mesh: &'a PolygonMesh,
        /// `[vertices]`, or empty where all are trusted alike.
        confidence: &'a [f64],
    },
    Points(&'a PointCloud),
}

impl Target<'_> {
    fn vertex_count(self) -> usize {
        match self {
            Self::Surface { mesh, .. } => mesh.positions.len(),
            Self::Points(points) => points.positions.len(),
        }
    }

    fn face_count(self) -> usize {
        match self {
            Self::Surface { mesh, .. } => mesh.face_count(),
            Self::Points(_) => 0,
        }
    }

    /// In the unit frame, where f64 has digits to spare; points as a mesh without triangles. The fit's own target may have its holes bridged;
    /// this is the input.
    fn in_frame(self, frame: &Frame) -> TriangleMesh {
        let mesh = match self {
            Self::Surface { mesh, .. } => mesh.triangulate(),
            Self::Points(points) => TriangleMesh {
                positions: points.positions.clone(),
                triangles: Vec::new(),
            },
        };
        in_frame(mesh, frame)
    }
}

fn in_frame(mut mesh: TriangleMesh, frame: &Frame) -> TriangleMesh {
    for p in &mut mesh.positions {
        *p = frame.to_unit(*p);
    }
    mesh
}

/// How to fit.
pub enum Method {
    /// By Voronoi squared distances.
    Voronoi {
        template: Template,
        options: Options,
    },
    /// By the surface through the start's points.
    Interpolate {
        start: geometric::Start,
        options: Interpolation,
    },
    /// By the geometric algorithm.
    Geometric {
        start: geometric::Start,
        /// Points to spread over the target, in place of its vertices, and the seed of that.
        samples: Option<usize>,
        seed: u64,
        options: geometric::Options,
    },
}

impl Method {
    pub fn scheme(&self) -> Scheme {
        match self {
            Self::Voronoi { options, .. } => options.scheme,
            Self::Interpolate { .. } | Self::Geometric { .. } => Scheme::Loop,
        }
    }

    /// The control mesh of the user's own that it starts from, if any.
    pub fn template(&self) -> Option<&ControlMesh> {
        match self {
            Self::Voronoi {
                template: Template::Mesh { control, .. },
                ..
            }
            | Self::Interpolate {
                start: geometric::Start::Mesh { control, .. },
                ..
            }
            | Self::Geometric {
                start: geometric::Start::Mesh { control, .. },
                ..
            } => Some(control),
            _ => None,
        }
    }
}

/// How good a fit is.
struct Verdict {
    error: ErrorReport,
    cage: CageReport,
    /// `[surface vertices]`: from the target, if they are to be shown.
    distances: Option<Vec<f64>>,
}

/// A fit that has run, in input coordinates.
struct Finished {
    control: ControlMesh,
    surface: PolygonMesh,
    /// `[surface vertices]`: from the target; for surfaces that are written, of targets with faces.
    distances: Option<Vec<f64>>,
    diagonal: f64,
    error: ErrorReport,
    cage: CageReport,
    iterations: Vec<Iteration>,
    stop_reason: StopReason,
    page: Option<Page>,
}

impl Job<'_> {
    /// Runs it, with a stopwatch that has measured the reading so far.
    pub fn run(&self, session: &Session, mut stopwatch: Stopwatch) -> Result<Outcome> {
        stopwatch.lap("read");
        let mut finished = self.fit(session, &mut stopwatch)?;
        session.terminal.stage("writing");
        self.write(&finished)?;
        stopwatch.lap("write");
        session.terminal.clear();
        let outcome = match finished.stop_reason {
            StopReason::Interrupted => Outcome::Interrupted,
            _ => Outcome::Done,
        };
        let page = finished.page.take();
        let report = self.report(session, finished, &stopwatch)?;
        if let Some(path) = &self.report {
            report.write(path)?;
        }
        if let (Some(place), Some(page)) = (&self.page, &page) {
            page.write(&place.folder, &report, &command_line())?;
        }
        session.finish(&report, &self.summary(&report))?;
        Ok(outcome)
    }

    fn fit(&self, session: &Session, stopwatch: &mut Stopwatch) -> Result<Finished> {
        session.terminal.stage("preparing the target");
        let progress = &session.terminal;
        let fitted = match &self.method {
            Method::Voronoi { template, options } => {
                self.fit_voronoi(session, template, options, stopwatch)?
            }
            Method::Interpolate { start, options } => {
                let data = self.data(None, 0)?;
                self.fit_data(session, &data, start, stopwatch, |control| {
                    fit::interpolate(&data, control, options, progress)
                })?
            }
            Method::Geometric {
                start,
                samples,
                seed,
                options,
            } => {
                let data = self.data(*samples, *seed)?;
                let device = session.device()?;
                self.fit_data(session, &data, start, stopwatch, |control| {
                    geometric::fit(device, &data, control, options, progress)
                })?
            }
        };
        let Fitted {
            fit,
            frame,
            target,
            mended,
        } = fitted;
        session.terminal.stage("measuring the error");
        let mended = mended.as_ref();
        let Verdict {
            error,
            cage,
            distances,
        } = self.judge(&target, mended, &frame, &fit)?;
        stopwatch.lap("measure");
        let page = self.draw(session, &target, mended, &fit, distances.as_deref())?;
        if page.is_some() {
            stopwatch.lap("report");
        }
        let mut finished = Finished {
            control: fit.control,
            surface: fit.surface,
            distances,
            diagonal: frame.diagonal,
            error,
            cage,
            iterations: fit.iterations,
            stop_reason: fit.stop_reason,
            page,
        };
        let control = &mut finished.control.mesh.positions;
        for p in control.iter_mut().chain(&mut finished.surface.positions) {
            *p = frame.to_input(*p);
        }
        for d in finished.distances.iter_mut().flatten() {
            *d *= frame.diagonal;
        }
        Ok(finished)
    }

    fn fit_voronoi(
        &self,
        session: &Session,
        template: &Template,
        options: &Options,
        stopwatch: &mut Stopwatch,
    ) -> Result<Fitted> {
        let (surface, confidence) = match self.target {
            Target::Surface { mesh, confidence } => (mesh.triangulate(), confidence),
            Target::Points(points) => {
                let surface = reconstruction::surface(points);
                (
                    surface.map_err(|e| in_file(e, self.name, "points"))?,
                    [].as_slice(),
                )
            }
        };
        let device = session.device()?;
        let target = fit::Target::with(device, &surface, confidence, self.holes())
            .map_err(|e| in_file(e, self.name, "faces"))?;
        stopwatch.lap("prepare");
        let about_template = |e| in_file(e, self.template_file(), "template");
        let start = Start::with_progress(&target, template, options.scheme, &session.terminal)
            .map_err(about_template)?;
        stopwatch.lap("template");
        let checkpoints = self.checkpoints.clone();
        let terminal = &session.terminal;
        let fit = fit::fit_with_checkpoints(device, &target, start, options, terminal, checkpoints)
            .map_err(about_template)?;
        stopwatch.laps(fit.stages.iter().cloned());
        Ok(Fitted {
            fit,
            frame: target.frame,
            target: in_frame(surface, &target.frame),
            // The fit's own, so that nothing is mended twice.
            mended: Some(target.mended()?),
        })
    }

    /// The points of the target that are fitted to, or `samples` spread over it.
    fn data(&self, samples: Option<usize>, seed: u64) -> Result<Data> {
        let data = match self.target {
            Target::Surface { mesh, .. } => Data::of_mesh(&mesh.triangulate(), samples, seed),
            Target::Points(points) => Data::of_points(&points.positions),
        };
        data.map_err(|e| in_file(e, self.name, "target"))
    }

    /// Fits to points from a start, while the target is made ready for judging.
    fn fit_data(
        &self,
        session: &Session,
        data: &Data,
        start: &geometric::Start,
        stopwatch: &mut Stopwatch,
        fit: impl FnOnce(ControlMesh) -> Result<Fit>,
    ) -> Result<Fitted> {
        stopwatch.lap("prepare");
        let target = self.target.in_frame(&data.frame);
        let mut mended = None;
        let fit = rayon::in_place_scope(|scope| {
            if !target.triangles.is_empty() {
                scope.spawn(|_| mended = Some(Mended::of(&target, self.holes())));
            }
            let about_template = |e| in_file(e, self.template_file(), "template");
            let control = data
                .control_mesh(session.device()?, start, &session.terminal)
                .map_err(about_template)?;
            stopwatch.lap("template");
            fit(control).map_err(about_template)
        })?;
        stopwatch.laps(fit.stages.iter().cloned());
        Ok(Fitted {
            fit,
            frame: data.frame,
            mended: mended.transpose()?,
            target,
        })
    }

    /// How good a fit to the target, in the unit frame, is; `mended` is the target's, if it has triangles.
    fn judge(
        &self,
        target: &TriangleMesh,
        mended: Option<&Mended>,
        frame: &Frame,
        fit: &Fit,
    ) -> Result<Verdict> {
        let diagonal = frame.diagonal;
        let control = &fit.control.mesh;
        let mut cage = CageReport {
            euler_characteristic: Connectivity::of(control)?.euler_characteristic(),
            target_euler_characteristic: None,
            least_angle: measure::least_angle(control),
            folded_percent: None,
        };
        let Some(mended) = mended else {
            let error = fit.data_error.unwrap_or_default();
            return Ok(Verdict {
                error: ErrorReport::of_points(error, diagonal),
                cage,
                distances: None,
            });
        };
        let surface = fit.surface.triangulate();
        let (error, characteristic) = rayon::join(
            || mended.surface_error(target, &surface, SAMPLES),
            || mended.euler_characteristic(),
        );
        let mut error = error.map_err(|e| in_file(e, self.name, "result"))?;
        cage.target_euler_characteristic = characteristic;
        cage.folded_percent = Some(100.0 * error.share_folded);
        if let Target::Points(points) = self.target {
            let points: Vec<DVec3> = points.positions.iter().map(|&p| frame.to_unit(p)).collect();
            error.target_to_surface = measure::point_error(&points, &surface)?;
        }
        let shown = self.page.is_some() || !self.outputs.surface.is_empty();
        let distances = shown.then(|| measure::distances(target, &fit.surface.positions));
        let mut report = ErrorReport::of_fit(&error, diagonal).with_data(fit.data_error, diagonal);
        if self.holes() == Holes::Follow {
            let rims = measure::rim_error(target, &surface, RIM_SAMPLES);
            report = report.with_rims(rims, diagonal);
        }
        Ok(Verdict {
            error: report,
            cage,
            distances: distances.transpose()?,
        })
    }

    /// The page, if one is wanted.
    fn draw(
        &self,
        session: &Session,
        target: &TriangleMesh,
        mended: Option<&Mended>,
        fit: &Fit,
        distances: Option<&[f64]>,
    ) -> Result<Option<Page>> {
        let Some(place) = &self.page else {
            return Ok(None);
        };
        session.terminal.stage("drawing the report");
        let name = self.name.file_name().unwrap_or_default();
        let covered = mended.map(|mended| mended.covered(&fit.surface.positions));
        let subject = Subject {
            name: &name.to_string_lossy(),
            target,
            cage: &fit.control.mesh,
            surface: &fit.surface,
            distances,
            covered: &covered.unwrap_or_default(),
            up: place.up,
        };
        Page::new(session.device()?, &subject).map(Some)
    }

    /// What becomes of the target's holes.
    fn holes(&self) -> Holes {
        self.settings.holes.unwrap_or_default()
    }

    fn write(&self, finished: &Finished) -> Result<()> {
        let control = SurfaceToWrite::control(&finished.control, self.method.scheme());
        for path in &self.outputs.control {
            write_surface(path, &control)?;
        }
        let surface = SurfaceToWrite::dense(&finished.surface, finished.distances.as_deref());
        for path in &self.outputs.surface {
            write_surface(path, &surface)?;
        }
        Ok(())
    }

    /// The file to name where the template is at fault: grids come from the target.
    fn template_file(&self) -> &Path {
        match self.method.template() {
            Some(_) => Path::new(&self.settings.template),
            None => self.name,
        }
    }

    fn report(
        &self,
        session: &Session,
        finished: Finished,
        stopwatch: &Stopwatch,
    ) -> Result<Report> {
        let Finished {
            control,
            surface,
            error,
            cage,
            stop_reason,
            ..
        } = finished;
        Ok(Report {
            device: Some(DeviceReport::of(session.device()?)),
            settings: Some(self.settings.clone()),
            target: Some(TargetReport {
                vertices: self.target.vertex_count(),
                faces: self.target.face_count(),
                bbox_diagonal: finished.diagonal,
            }),
            result: Some(ResultReport {
                control_points: Some(control.mesh.positions.len()),
                control_faces: Some(control.mesh.face_count()),
                surface_vertices: surface.positions.len(),
                surface_faces: surface.face_count(),
                ..Default::default()
            }),
            iterations: Some(finished.iterations),
            converged: Some(match stop_reason {
                StopReason::Tolerance => true,
                StopReason::Schedule => self.meets_tolerance(&error),
                StopReason::Stagnation => self.meets_tolerance(&error),
                StopReason::Iterations | StopReason::ControlPoints | StopReason::Interrupted => {
                    false
                }
            }),
            stop_reason: Some(stop_reason),
            error: Some(error),
            cage: Some(cage),
            timing: Some(stopwatch.timing()),
            ..Report::new(self.command)
        })
    }

    /// Whether the error is what was asked for, if anything was.
    fn meets_tolerance(&self, error: &ErrorReport) -> bool {
        let Settings {
            max_error_percent,
            mean_error_percent,
            ..
        } = self.settings;
        max_error_percent.is_none_or(|asked| error.max_percent <= asked)
            && mean_error_percent.is_none_or(|asked| error.mean_percent <= asked)
    }
}

/// Tells the flaws of an input in one line.
pub fn warn_of_flaws(session: &Session, path: &Path, census: &Census) {
    let warnings = census.warnings();
    if !warnings.is_empty() {
        session
            .terminal
            .warn(&format!("{}: {}", path.display(), warnings.join(", ")));
    }
}

/// Takes the specks out of a mesh, and says so.
pub fn sweep(session: &Session, path: &Path, mesh: &mut PolygonMesh) {
    if let Some(swept) = specks::swept(mesh) {
        session.terminal.warn(&format!(
            "{}: {} faces are left out, in specks up to {:.1} % of the diagonal outside of the rest",
            path.display(),
            swept.faces,
            100.0 * swept.farthest
        ));
        *mesh = swept.mesh;
    }
}

/// An error about a mesh, with the file that the mesh came from.
pub fn in_file(error: Error, path: &Path, place: &str) -> Error {
    match error {
        Error::Input { problem, remedy } => Error::file(path, place, problem, remedy),
        other => other,
    }
}
