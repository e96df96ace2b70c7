//! What a fit says on the screen at its end.

use super::job::{Job, Method};
use super::text::{INTERRUPTED, Summary, count, significant};
use std::path::PathBuf;
use vorofit::fit::{Iteration, StopReason, Template};
use vorofit::mesh::Scheme;
use vorofit::report::page::PAGE;
use vorofit::report::{CageReport, ErrorReport, Figures, Report, Timing};
use vorofit::template::Genus;

impl Job<'_> {
    /// The report in words.
    pub(super) fn summary(&self, report: &Report) -> String {
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
        if let Some(cage) = &report.cage {
            summary.line("cage", self.cage(cage));
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
        if let Some(rims) = &error.rims {
            let larger = |figure: fn(&Figures) -> f64| {
                let [a, b] = [&rims.target_to_surface, &rims.surface_to_target];
                significant(figure(a).max(figure(b)), 3)
            };
            summary.line(
                "rims",
                format!(
                    "largest {} %, rms {} % of the diagonal between the boundaries of scan and surface",
                    larger(|f| f.max_percent),
                    larger(|f| f.rms_percent)
                ),
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

    fn cage(&self, cage: &CageReport) -> String {
        let found = cage.euler_characteristic;
        let topology = match cage.target_euler_characteristic {
            Some(_) if cage.has_targets_topology() => {
                format!("Euler characteristic {found} as the scan's")
            }
            Some(target) => {
                let why = match self.method {
                    Method::Voronoi {
                        template:
                            Template::Automatic {
                                genus: Genus::Simplify,
                                ..
                            },
                        ..
                    } => {
                        "handles under 3.5 % of the diagonal around are closed; --genus keep keeps what the grid shows"
                    }
                    Method::Voronoi {
                        template: Template::Automatic { .. },
                        ..
                    } => "what is smaller than a cell of the template's grid is lost",
                    _ => "a fit keeps its template's handles; --template auto takes the scan's",
                };
                format!("Euler characteristic {found}, but the scan's is {target} ({why})")
            }
            None => format!("Euler characteristic {found}"),
        };
        let angle = significant(cage.least_angle, 3);
        let folded = match cage.folded_percent {
            Some(0.0) => "; no face of the surface is flipped".into(),
            Some(percent) => format!("; {} % of the surface is flipped", significant(percent, 2)),
            None => String::new(),
        };
        format!("{topology}; smallest angle {angle}°{folded}")
    }

    fn time(&self, report: &Report) -> String {
        let settings = &self.settings;
        let asked = settings.max_error_percent.is_some() || settings.mean_error_percent.is_some();
        let why = match (report.stop_reason, report.converged) {
            (Some(StopReason::Interrupted), _) if self.checkpoints.file.is_some() => {
                "interrupted: this is the best so far; --resume goes on"
            }
            (Some(StopReason::Interrupted), _) => INTERRUPTED,
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
