//! What `fit` and `demo` have in common: fit, judge, write, and say so.

use super::Outcome;
use super::outputs::Outputs;
use super::session::Session;
use super::text::{Summary, command_line, count, significant};
use glam::DVec3;
use std::path::{Path, PathBuf};
use vorofit::files::{SurfaceToWrite, write_surface};
use vorofit::fit::geometric::{self, Data};
use vorofit::fit::{self, Checkpoints, Fit, Iteration, Options, Start, StopReason, Template};
use vorofit::measure;
use vorofit::mesh::check::Census;
use vorofit::mesh::{ControlMesh, Frame, PointCloud, PolygonMesh, Scheme, TriangleMesh};
use vorofit::picture;
use vorofit::reconstruction;
use vorofit::report::page::{PAGE, Page, Subject};
use vorofit::report::{
    DeviceReport, ErrorReport, Figures, Report, ResultReport, Settings, Stopwatch, TargetReport,
    Timing,
};
use vorofit::{Error, Result};

/// Area samples a side by which the result is judged: the rms is then certain to about a percent.
const SAMPLES: usize = 200_000;

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
    fn scheme(&self) -> Scheme {
        match self {
            Self::Voronoi { options, .. } => options.scheme,
            Self::Geometric { .. } => Scheme::Loop,
        }
    }

    /// The control mesh of the user's own that it starts from, if any.
    pub fn template(&self) -> Option<&ControlMesh> {
        match self {
            Self::Voronoi {
                template: Template::Mesh { control, .. },
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

/// A fit that has run, in input coordinates.
struct Finished {
    control: ControlMesh,
    surface: PolygonMesh,
    /// `[surface vertices]`: from the target; for surfaces that are written, of targets with faces.
    distances: Option<Vec<f64>>,
    diagonal: f64,
    error: ErrorReport,
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
        // Of a cloud, where the method needs one.
        let mut reconstructed = None;
        let (frame, fit) = match &self.method {
            Method::Voronoi { template, options } => {
                let (surface, confidence) = match self.target {
                    Target::Surface { mesh, confidence } => (mesh.triangulate(), confidence),
                    Target::Points(points) => {
                        let surface = reconstruction::surface(points);
                        let surface = surface.map_err(|e| in_file(e, self.name, "points"))?;
                        reconstructed = Some(surface.clone());
                        (surface, [].as_slice())
                    }
                };
                let device = session.device()?;
                let target = fit::Target::with_confidence(device, &surface, confidence)
                    .map_err(|e| in_file(e, self.name, "faces"))?;
                stopwatch.lap("prepare");
                self.fit_voronoi(session, &target, template, options, stopwatch)?
            }
            Method::Geometric {
                start,
                samples,
                seed,
                options,
            } => {
                let data = match self.target {
                    Target::Surface { mesh, .. } => {
                        Data::of_mesh(&mesh.triangulate(), *samples, *seed)
                    }
                    Target::Points(points) => Data::of_points(&points.positions),
                };
                let data = data.map_err(|e| in_file(e, self.name, "target"))?;
                stopwatch.lap("prepare");
                self.fit_geometric(session, &data, start, options, stopwatch)?
            }
        };
        session.terminal.stage("measuring the error");
        let target = match &reconstructed {
            Some(surface) => in_frame(surface.clone(), &frame),
            None => self.target.in_frame(&frame),
        };
        let (error, distances) = self.judge(&target, &frame, &fit)?;
        stopwatch.lap("measure");
        let page = self.draw(session, &target, &fit, distances.as_deref())?;
        if page.is_some() {
            stopwatch.lap("report");
        }
        let mut finished = Finished {
            control: fit.control,
            surface: fit.surface,
            distances,
            diagonal: frame.diagonal,
            error,
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
        target: &fit::Target,
        template: &Template,
        options: &Options,
        stopwatch: &mut Stopwatch,
    ) -> Result<(Frame, Fit)> {
        let about_template = |e| in_file(e, self.template_file(), "template");
        let start = Start::new(target, template, options.scheme).map_err(about_template)?;
        stopwatch.lap("template");
        let fit = fit::fit_with_checkpoints(
            session.device()?,
            target,
            start,
            options,
            &session.terminal,
            self.checkpoints.clone(),
        )
        .map_err(about_template)?;
        stopwatch.laps(fit.stages.iter().cloned());
        Ok((target.frame, fit))
    }

    fn fit_geometric(
        &self,
        session: &Session,
        data: &Data,
        start: &geometric::Start,
        options: &geometric::Options,
        stopwatch: &mut Stopwatch,
    ) -> Result<(Frame, Fit)> {
        let about_template = |e| in_file(e, self.template_file(), "template");
        let control = data.control_mesh(start).map_err(about_template)?;
        stopwatch.lap("template");
        let device = session.device()?;
        let fit = geometric::fit(device, data, control, options, &session.terminal)
            .map_err(about_template)?;
        stopwatch.laps(fit.stages.iter().cloned());
        Ok((data.frame, fit))
    }

    /// The error of a fit to the target in the unit frame, and the distances of the surface's vertices from it if they are to be shown.
    fn judge(
        &self,
        target: &TriangleMesh,
        frame: &Frame,
        fit: &Fit,
    ) -> Result<(ErrorReport, Option<Vec<f64>>)> {
        let diagonal = frame.diagonal;
        if target.triangles.is_empty() {
            let error = fit.data_error.unwrap_or_default();
            return Ok((ErrorReport::of_points(error, diagonal), None));
        }
        let surface = fit.surface.triangulate();
        let mut error = measure::surface_error(target, &surface, SAMPLES)
            .map_err(|e| in_file(e, self.name, "result"))?;
        if let Target::Points(points) = self.target {
            let points: Vec<DVec3> = points.positions.iter().map(|&p| frame.to_unit(p)).collect();
            error.target_to_surface = measure::point_error(&points, &surface)?;
        }
        let shown = self.page.is_some() || !self.outputs.surface.is_empty();
        let distances = shown.then(|| measure::distances(target, &fit.surface.positions));
        let report = ErrorReport::of_fit(&error, diagonal).with_data(fit.data_error, diagonal);
        Ok((report, distances.transpose()?))
    }

    /// The page, if one is wanted.
    fn draw(
        &self,
        session: &Session,
        target: &TriangleMesh,
        fit: &Fit,
        distances: Option<&[f64]>,
    ) -> Result<Option<Page>> {
        let Some(place) = &self.page else {
            return Ok(None);
        };
        session.terminal.stage("drawing the report");
        let name = self.name.file_name().unwrap_or_default();
        let page = Page::new(&Subject {
            name: &name.to_string_lossy(),
            target,
            cage: &fit.control.mesh,
            surface: &fit.surface,
            distances,
            up: place.up,
        })?;
        Ok(Some(page))
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

    /// The report in words.
    fn summary(&self, report: &Report) -> String {
        let mut summary = Summary::default();
        if let Some(size) = &report.result {
            let control = format!(
                "{} control points, {} faces",
                count(size.control_points.unwrap_or_default()),
                count(size.control_faces.unwrap_or_default())
            );
            let surface = format!(
                "{} vertices, {} faces",
                count(size.surface_vertices),
                count(size.surface_faces)
            );
            let controls = self.outputs.control.iter().map(|path| (path, &control));
            let surfaces = self.outputs.surface.iter().map(|path| (path, &surface));
            let files: Vec<_> = controls.chain(surfaces).collect();
            let page = self.page.as_ref().map(|place| place.folder.join(PAGE));
            let shows = "scan, cage and surface to turn, with figures and charts".to_owned();
            let files: Vec<_> = page
                .iter()
                .map(|path| (path, &shows))
                .chain(files)
                .collect();
            let width = files
                .iter()
                .map(|(path, _)| path.display().to_string().chars().count());
            let width = width.max().unwrap_or_default();
            for (path, size) in files {
                summary.line(
                    "wrote",
                    format!("{:width$}   {size}", path.display().to_string()),
                );
            }
        }
        if let Some(error) = &report.error {
            self.summarize_error(error, &mut summary);
        }
        if let (Method::Geometric { .. }, Some(iterations)) = (&self.method, &report.iterations) {
            tabulate(iterations, &mut summary);
        }
        if let Some(timing) = &report.timing {
            summary.line("stages", stages(timing));
        }
        summary.line("time", self.time(report));
        summary.line("open", self.what_to_open());
        summary.text()
    }

    fn summarize_error(&self, error: &ErrorReport, summary: &mut Summary) {
        let line = |[largest, rms, mean]: [f64; 3], of: &str| {
            let [largest, rms, mean] = [largest, rms, mean].map(|x| significant(x, 3));
            format!("largest {largest} %, rms {rms} %, mean {mean} % {of}")
        };
        let directions = || {
            let back = error.surface_to_target.as_ref();
            std::iter::once(&error.target_to_surface).chain(back)
        };
        let larger = |figure: fn(&Figures) -> f64| {
            let largest = directions().map(|d| figure(&d.figures)).fold(0.0, f64::max);
            significant(largest, 3)
        };
        let name = self.name.display();
        summary.line(
            "result",
            format!(
                "{name} and the surface are nowhere further apart than {} of its units, and {} on average",
                larger(|f| f.max),
                larger(|f| f.mean)
            ),
        );
        let percent = [error.max_percent, error.rms_percent, error.mean_percent];
        summary.line("error", line(percent, "of the bounding box's diagonal"));
        if let Some(Figures {
            max_percent,
            rms_percent,
            mean_percent,
            ..
        }) = error.data_to_limit.as_ref().map(|d| d.figures)
        {
            let percent = [max_percent, rms_percent, mean_percent];
            summary.line(
                "error",
                line(percent, "at the data points, from the limit surface"),
            );
        }
        if let Some(holes) = &error.over_holes {
            summary.line(
                "holes",
                format!(
                    "{} % of the surface spans holes of the scan, at most {} % of the diagonal away from it; not counted above",
                    significant(holes.area_percent, 3),
                    significant(holes.max_percent, 3)
                ),
            );
        }
    }

    fn time(&self, report: &Report) -> String {
        let settings = &self.settings;
        let asked = settings.max_error_percent.is_some() || settings.mean_error_percent.is_some();
        let why = match (report.stop_reason, report.converged) {
            (Some(StopReason::Interrupted), _) if self.checkpoints.file.is_some() => {
                "interrupted: this is the best so far; --resume goes on"
            }
            (Some(StopReason::Interrupted), _) => "interrupted: this is the best so far",
            (Some(StopReason::Iterations), _) => "stopped at the iterations allowed",
            (Some(StopReason::Tolerance), _) => "stopped at the error asked for",
            (Some(StopReason::ControlPoints), _) => {
                "stopped short of the error asked for: try a larger --max-control-points"
            }
            (Some(StopReason::Stagnation), Some(true)) => "ran until nothing got better",
            (Some(StopReason::Stagnation), _) => {
                "nothing got better any more, short of the error asked for"
            }
            (_, Some(false)) if asked => {
                "ran to the end without reaching the error asked for: try more control points"
            }
            _ => "ran to the end",
        };
        let seconds = report.timing.as_ref().map_or(0.0, |timing| timing.total_s);
        let iterations = report.iterations.as_ref().map_or(0, Vec::len);
        format!("{seconds:.1} s, {} iterations; {why}", count(iterations))
    }

    fn what_to_open(&self) -> String {
        if let Some(place) = &self.page {
            let page = place.folder.join(PAGE);
            return format!("{} in any browser", page.display());
        }
        let with = |extension: &str| {
            let all = self.outputs.surface.iter().chain(&self.outputs.control);
            let has = |path: &&PathBuf| {
                path.extension()
                    .is_some_and(|e| e.eq_ignore_ascii_case(extension))
            };
            all.into_iter().find(has)
        };
        if let Some(path) = with("glb") {
            return format!(
                "{} in any glTF viewer: its colours are the error",
                path.display()
            );
        }
        if let Some(path) = with("usda") {
            return format!(
                "{} in Blender or usdview: it is a subdivision surface there",
                path.display()
            );
        }
        let first = self
            .outputs
            .control
            .first()
            .map(|path| path.display().to_string());
        let first = first.unwrap_or_default();
        match self.method.scheme() {
            Scheme::CatmullClark => {
                format!("{first} in Blender, with a Subdivision Surface modifier on it")
            }
            Scheme::Loop => format!("{first} in MeshLab, with Loop subdivision applied to it"),
            Scheme::Polygon => format!("{first} in any mesh viewer"),
        }
    }
}

/// The last iteration with each number of control points, as the papers tabulate them.
fn tabulate(iterations: &[Iteration], summary: &mut Summary) {
    let row = |cells: [&str; 6]| {
        let [first, others @ ..] = cells.map(|cell| format!("{cell:>9}"));
        format!("{first}{}", others.join(""))
    };
    summary.line(
        "fit",
        row(["iteration", "points", "E_max %", "E_rms %", "E_ave %", "s"]),
    );
    for same in iterations.chunk_by(|a, b| a.control_points == b.control_points) {
        let last = &same[same.len() - 1];
        let percent = |share: Option<f64>| significant(share.unwrap_or_default(), 3);
        let cells = [
            count(last.iteration),
            count(last.control_points),
            percent(last.max_percent),
            percent(last.rms_percent),
            percent(last.mean_percent),
            format!("{:.2}", last.seconds),
        ];
        summary.line("fit", row(cells.each_ref().map(String::as_str)));
    }
}

/// Where the time went, longest first.
fn stages(timing: &Timing) -> String {
    let mut stages: Vec<_> = timing.stages.iter().collect();
    stages.sort_by(|a, b| b.1.total_cmp(&a.1));
    let share = |(name, seconds): &(String, f64)| {
        format!("{name} {:.0} %", 100.0 * seconds / timing.total_s)
    };
    stages.into_iter().map(share).collect::<Vec<_>>().join(", ")
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

/// An error about a mesh, with the file that the mesh came from.
pub fn in_file(error: Error, path: &Path, place: &str) -> Error {
    match error {
        Error::Input { problem, remedy } => Error::file(path, place, problem, remedy),
        other => other,
    }
}
