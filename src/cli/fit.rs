//! `vorofit fit`: a surface from a scan.

use super::job::{Job, Outputs, warn_of_flaws};
use super::session::Session;
use super::text::parse_number;
use super::{Outcome, bad_usage, terminal};
use clap::ValueEnum;
use glam::DVec3;
use std::path::{Path, PathBuf};
use vorofit::files::read_surface;
use vorofit::fit::{Options, Template};
use vorofit::mesh::{ControlMesh, Scheme};
use vorofit::report::{Settings, Stopwatch};
use vorofit::template::{Align, Axis};
use vorofit::{Error, Result};

const EXAMPLES: &str = "\
Examples:
  vorofit fit scan.ply -o control.obj
  vorofit fit scan.ply -o control.usda --control-points 6000 --surface surface.glb
  vorofit fit ring.stl -o control.obj --template torus
  vorofit fit head.obj -o control.obj --template basemesh.obj --align box";

/// Control points where nothing else is asked for: half a percent of error on most scans.
const CONTROL_POINTS: usize = 1500;

/// Fit a subdivision or polygon surface to a scan
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The scan: .obj, .ply, .stl or .off; holes, overlaps and bad triangles are fine
    target: PathBuf,
    /// Write the control mesh (.obj, .ply, .off or .usda); may be repeated
    #[arg(short, long, required = true, value_name = "FILE")]
    output: Vec<PathBuf>,
    /// Write the dense fitted surface with its distance to the scan (.ply, .glb, .obj, .stl, .off or .usda); may be repeated
    #[arg(long, value_name = "FILE")]
    surface: Vec<PathBuf>,
    /// What to start from: a box (for targets like a ball), a torus (for those with one hole), or a mesh
    #[arg(long, default_value = "bbox", value_name = "bbox|torus|FILE")]
    template: String,
    /// A point on the torus's axis and its direction [default: found through the target's widest hole]
    #[arg(long, value_name = "X,Y,Z,DX,DY,DZ", allow_hyphen_values = true, value_parser = parse_axis)]
    axis: Option<Axis>,
    /// Bring a template FILE onto the target: `box` stretches its bounding box onto the target's [default: none]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "none|box")]
    align: Option<Alignment>,
    /// The surface that the control mesh stands for
    #[arg(
        long,
        value_enum,
        default_value_t,
        hide_possible_values = true,
        value_name = "catmull-clark|loop|polygon"
    )]
    scheme: SchemeName,
    /// Control points, as nearly as the template's grid allows [default: 1500]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=10_000_000))]
    control_points: Option<u32>,
    /// Subdivisions from control mesh to dense surface [default: 2; for polygon 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=10))]
    levels: Option<u8>,
    /// Whether the dense surface's vertices are those of the limit surface [default: on]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "on|off")]
    limit: Option<Switch>,
    /// Weight of the smoothness term at the end
    #[arg(long, default_value_t = Options::default().smoothness, value_name = "λ", value_parser = parse_from_0)]
    smoothness: f64,
    /// How much more a distance along the normal counts than one across it, in the last Voronoi phase [default: no such phase; 5 with
    /// --polish off]
    #[arg(long, value_name = "s", value_parser = parse_from_1)]
    anisotropy: Option<f64>,
    /// Finish with least squares on closest points; `off` is the method of the paper alone
    #[arg(
        long,
        value_enum,
        default_value_t,
        hide_possible_values = true,
        value_name = "on|off"
    )]
    polish: Switch,
    /// Stop when no distance is larger than this, in percent of the diagonal
    #[arg(long, value_name = "%", value_parser = parse_positive)]
    max_error: Option<f64>,
    /// Stop when the mean distance is not larger than this, in percent of the diagonal
    #[arg(long, value_name = "%", value_parser = parse_positive)]
    mean_error: Option<f64>,
    /// Stop after so many iterations of all phases
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    iterations: Option<u32>,
    /// The seed of all sampling
    #[arg(long, default_value_t, value_name = "N")]
    seed: u64,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Switch {
    #[default]
    On,
    Off,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Alignment {
    None,
    Box,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum SchemeName {
    #[default]
    CatmullClark,
    Loop,
    Polygon,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        self.check_usage();
        let options = self.options();
        let outputs = Outputs {
            control: self.output.clone(),
            surface: self.surface.clone(),
        };
        outputs.check(options.scheme, &self.inputs())?;
        session.device()?;
        terminal::catch_interrupts()?;

        let stopwatch = Stopwatch::start();
        session
            .terminal
            .stage(&format!("reading {}", self.target.display()));
        let template = self.template()?;
        let target = read_surface(&self.target)?;
        warn_of_flaws(session, &self.target, &target.census);
        Job {
            command: "fit",
            name: &self.target,
            target: &target.mesh,
            template,
            settings: Settings::new(self.template.clone(), self.control_points(), &options),
            options,
            outputs,
            report: None,
        }
        .run(session, stopwatch)
    }

    /// Refuses options that would do nothing.
    fn check_usage(&self) {
        let from_file = self.template_file().is_some();
        let asks_error = self.max_error.is_some() || self.mean_error.is_some();
        let conflicts = [
            (
                self.axis.is_some() && self.template != "torus",
                "--axis needs --template torus",
            ),
            (
                self.align.is_some() && !from_file,
                "--align needs --template FILE",
            ),
            (
                self.control_points.is_some() && from_file,
                "--control-points is for bbox and torus: a template FILE brings its own",
            ),
            (
                self.limit.is_some() && self.scheme == SchemeName::Polygon,
                "--limit is for subdivision surfaces: polygons are their own limit",
            ),
            (
                asks_error && self.polish == Switch::Off,
                "--max-error and --mean-error need --polish on, which measures distances as it goes",
            ),
        ];
        if let Some((_, message)) = conflicts.into_iter().find(|(wrong, _)| *wrong) {
            bad_usage(message);
        }
    }

    fn template_file(&self) -> Option<&Path> {
        (!matches!(self.template.as_str(), "bbox" | "torus")).then(|| Path::new(&self.template))
    }

    fn inputs(&self) -> Vec<&Path> {
        let target = std::iter::once(self.target.as_path());
        target.chain(self.template_file()).collect()
    }

    /// Control points to ask of a grid; none of a template that has its own.
    fn control_points(&self) -> Option<usize> {
        let asked = self.control_points.map_or(CONTROL_POINTS, |n| n as usize);
        self.template_file().is_none().then_some(asked)
    }

    fn template(&self) -> Result<Template> {
        let control_points = self.control_points().unwrap_or_default();
        let Some(path) = self.template_file() else {
            return Ok(match self.template.as_str() {
                "torus" => Template::Torus {
                    axis: self.axis.unwrap_or(Axis::Inertia),
                    control_points,
                },
                _ => Template::BoundingBox { control_points },
            });
        };
        let control = ControlMesh::from(read_surface(path).map_err(hint_at_grids)?.mesh);
        let align = match self.align {
            Some(Alignment::Box) => Align::Box,
            Some(Alignment::None) | None => Align::None,
        };
        Ok(Template::Mesh { control, align })
    }

    fn options(&self) -> Options {
        let share = |percent: Option<f64>| percent.map(|percent| percent / 100.0);
        let scheme = match self.scheme {
            SchemeName::CatmullClark => Scheme::CatmullClark,
            SchemeName::Loop => Scheme::Loop,
            SchemeName::Polygon => Scheme::Polygon,
        };
        let defaults = Options::default();
        let levels = match scheme {
            Scheme::Polygon => 0,
            _ => defaults.levels,
        };
        Options {
            scheme,
            levels: self.levels.map_or(levels, usize::from),
            limit: self.limit != Some(Switch::Off) && scheme != Scheme::Polygon,
            smoothness: self.smoothness,
            anisotropy: self.anisotropy,
            polish: self.polish == Switch::On,
            max_error: share(self.max_error),
            mean_error: share(self.mean_error),
            iterations: self.iterations.map(|n| n as usize),
            seed: self.seed,
        }
    }
}

/// A mistyped name of a grid reads like a file that is not there.
fn hint_at_grids(error: Error) -> Error {
    match error {
        Error::Io { path, source } if source.kind() == std::io::ErrorKind::NotFound => Error::file(
            &path,
            "template",
            "there is no such file",
            "give bbox, torus or a mesh",
        ),
        other => other,
    }
}

fn parse_axis(text: &str) -> Result<Axis, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|word| word.trim().parse().ok().filter(|x: &f64| x.is_finite()))
        .collect::<Option<_>>()
        .unwrap_or_default();
    let [x, y, z, dx, dy, dz] = numbers[..] else {
        return Err("give six numbers: a point and a direction".into());
    };
    let (point, direction) = (DVec3::new(x, y, z), DVec3::new(dx, dy, dz));
    match direction.try_normalize() {
        Some(_) => Ok(Axis::Given { point, direction }),
        None => Err("the direction is zero".into()),
    }
}

fn parse_positive(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x > 0.0, "above 0")
}

fn parse_from_0(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x >= 0.0, "from 0 up")
}

fn parse_from_1(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x >= 1.0, "from 1 up")
}
