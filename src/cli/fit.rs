//! `vorofit fit`: a surface from a scan.

use super::choices::{Alignment, GenusName, MethodName, SchemeName, StepName, Switch};
use super::job::{Job, Method, PagePlace, Target, sweep, warn_of_flaws};
use super::outputs::Outputs;
use super::render::AxisName;
use super::session::Session;
use super::text::parse_number;
use super::{Outcome, bad_usage, terminal};
use glam::DVec3;
use std::path::{Path, PathBuf};
use vorofit::files::{Scan, check_place, read_control, read_scans};
use vorofit::fit::{Checkpoint, Checkpoints, Interpolation, Options, Template, geometric};
use vorofit::mesh::{ControlMesh, Scheme};
use vorofit::report::page::check_folder;
use vorofit::report::{Settings, Stopwatch};
use vorofit::template::{Align, Axis, Genus};
use vorofit::topology::Holes;
use vorofit::{Error, Result};

const EXAMPLES: &str = "\
Examples:
  vorofit fit scan.ply -o control.obj --report seen
  vorofit fit scan.ply -o control.usda --control-points 6000 --surface surface.glb
  vorofit fit shell.ply -o control.obj --open
  vorofit fit ring.stl -o control.obj --template torus
  vorofit fit scan.ply -o control.obj --template simplify --method geometric --scheme loop --max-error 0.1
  vorofit fit scan.ply -o control.obj --method interpolate --template adaptive --control-points 400
  vorofit fit points.xyz -o control.obj --template near.obj --method geometric
  vorofit fit head.obj -o control.obj --template basemesh.obj --align box";

/// The templates that are no files.
const TEMPLATES: [&str; 6] = ["auto", "bbox", "torus", "simplify", "ridges", "adaptive"];

/// Control points where nothing else is asked for: half a percent of error on most scans.
const CONTROL_POINTS: usize = 1500;

/// Fit a subdivision or polygon surface to a scan
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The scan: .obj, .ply, .stl, .off or .usda; holes, overlaps and bad triangles are fine. Points without faces: .ply or .xyz. Several files are one
    /// scan; a .conf among them places them (bmesh FILE tx ty tz qx qy qz qw), and stands for all that it names where it is alone
    #[arg(required = true)]
    target: Vec<PathBuf>,
    /// Write the control mesh (.obj, .ply, .off or .usda); may be repeated
    #[arg(short, long, required = true, value_name = "FILE")]
    output: Vec<PathBuf>,
    /// Write the dense fitted surface with its distance to the scan (.ply, .glb, .obj, .stl, .off or .usda); may be repeated
    #[arg(long, value_name = "FILE")]
    surface: Vec<PathBuf>,
    /// Write a report into this folder: a page (index.html) that shows scan, cage and surface from all sides with figures and charts, and its pictures
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// The axis that is upwards on the page
    #[arg(
        long,
        value_enum,
        default_value_t,
        requires = "report",
        hide_possible_values = true,
        value_name = "x|y|z"
    )]
    up: AxisName,
    /// What to start from: quads around the scan with its handles, a box (for targets like a ball), a torus (for those with one hole), the
    /// simplified target, triangles on it whose points are on its ridges or follow its curvature, or a mesh, whose creases and corners (.usda, .obj with OpenSubdiv's tags) stay sharp [default: auto; simplify with
    /// --method geometric, ridges with --method interpolate]
    #[arg(long, value_name = "auto|bbox|torus|simplify|ridges|adaptive|FILE")]
    template: Option<String>,
    /// What becomes of handles and tunnels that are less than 3.5 % of the diagonal around, in --template auto [default: simplify, which closes
    /// them]
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "keep|simplify"
    )]
    genus: Option<GenusName>,
    /// Follow the scan's boundaries: the surface is open where the scan is, except at tiny holes [default: holes up to a diagonal around are bridged;
    /// of several scans they are left to each other]
    #[arg(long)]
    open: bool,
    /// How to fit: by Voronoi squared distances; by closest points on the exact limit surface, with more control points where a tolerance
    /// asks for them; or not at all, by the surface through the template's points
    #[arg(
        long,
        value_enum,
        default_value_t,
        hide_possible_values = true,
        value_name = "vsdm|geometric|interpolate"
    )]
    method: MethodName,
    /// How --method geometric moves control points: as its paper does, or by least squares [default: least-squares]
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "displacement|least-squares"
    )]
    step: Option<StepName>,
    /// Whether edges of --template ridges are flipped along ridges of one colour: that follows features, mostly at the cost of the error [default: off]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "on|off")]
    flips: Option<Switch>,
    /// Halve the edges of the template so often, with the new points on the scan (--method interpolate) [default: 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=4))]
    refinements: Option<u8>,
    /// Fit to so many points spread evenly over the scan, in place of its vertices (--method geometric)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000_000))]
    samples: Option<u32>,
    /// A point on the torus's axis and its direction [default: found through the target's widest hole]
    #[arg(long, value_name = "X,Y,Z,DX,DY,DZ", allow_hyphen_values = true, value_parser = parse_axis)]
    axis: Option<Axis>,
    /// Bring a template FILE onto the target: `box` stretches its bounding box onto the target's, `rigid` turns and moves
    /// it, `similarity` scales it as well [default: none]
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "none|box|rigid|similarity"
    )]
    align: Option<Alignment>,
    /// The surface that the control mesh stands for [default: catmull-clark; loop with --template ridges or adaptive and
    /// with --method geometric or interpolate]
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "catmull-clark|loop|polygon"
    )]
    scheme: Option<SchemeName>,
    /// Control points, as nearly as the template's grid allows [default: 1500]; with --method geometric those to start from [default: 2 % of
    /// the vertices, and as many more as lie on rims]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=10_000_000))]
    control_points: Option<u32>,
    /// Control points that --method geometric may end with [default: three quarters of the points to fit to]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(4..=10_000_000))]
    max_control_points: Option<u32>,
    /// Subdivisions from control mesh to dense surface [default: 2; for polygon 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=10))]
    levels: Option<u8>,
    /// Whether the dense surface's vertices are those of the limit surface [default: on]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "on|off")]
    limit: Option<Switch>,
    /// Weight of the smoothness term at the end [default: 0.01]
    #[arg(long, value_name = "λ", value_parser = parse_from_0)]
    smoothness: Option<f64>,
    /// How much more a distance along the normal counts than one across it, in the last Voronoi phase [default: no such phase; 5 with
    /// --polish off]
    #[arg(long, value_name = "s", value_parser = parse_from_1)]
    anisotropy: Option<f64>,
    /// Finish with least squares on closest points; `off` is the method of the paper alone [default: on]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "on|off")]
    polish: Option<Switch>,
    /// Stop when no distance is larger than this, in percent of the diagonal
    #[arg(long, value_name = "%", value_parser = parse_positive)]
    max_error: Option<f64>,
    /// Stop when the mean distance is not larger than this, in percent of the diagonal
    #[arg(long, value_name = "%", value_parser = parse_positive)]
    mean_error: Option<f64>,
    /// Stop after so many iterations of all phases
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    iterations: Option<u32>,
    /// The share of the scan that may be far from the surface without pulling at it, in percent from 0 to 50: stray points, spikes, what stood behind
    #[arg(long, value_name = "%", default_value_t = 0.0, hide_default_value = true, value_parser = parse_outliers)]
    outliers: f64,
    /// Keep the state of the fit in a file after every phase, for --resume [default: the file of --resume, if any]
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Go on from a checkpoint of the same fit; only --max-error, --mean-error and --iterations may differ
    #[arg(long, value_name = "FILE")]
    resume: Option<PathBuf>,
    /// The seed of all sampling
    #[arg(long, default_value_t, value_name = "N")]
    seed: u64,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        self.check_usage();
        let outputs = Outputs {
            control: self.output.clone(),
            surface: self.surface.clone(),
        };
        outputs.check(self.scheme(), &self.inputs())?;
        self.report.as_deref().map_or(Ok(()), check_folder)?;
        let checkpoints = self.checkpoints()?;
        session.device()?;
        terminal::catch_interrupts()?;

        let stopwatch = Stopwatch::start();
        session
            .terminal
            .stage(&format!("reading {}", self.target[0].display()));
        let (method, settings) = self.method()?;
        outputs.check_sharp(method.template(), self.scheme())?;
        let mut scan = read_scans(&self.target)?;
        let target = match &mut scan {
            Scan::Surface(surface) => {
                warn_of_flaws(session, &self.target[0], &surface.census);
                sweep(session, &self.target[0], &mut surface.mesh);
                Target::Surface {
                    mesh: &surface.mesh,
                    confidence: &surface.confidence,
                }
            }
            Scan::Points(points) => Target::Points(points),
        };
        Job {
            command: "fit",
            name: &self.target[0],
            target,
            method,
            settings,
            outputs,
            checkpoints,
            report: None,
            page: self.report.clone().map(|folder| PagePlace {
                folder,
                up: self.up.into(),
            }),
        }
        .run(session, stopwatch)
    }

    /// Refuses options that would do nothing.
    fn check_usage(&self) {
        let from_file = self.template_file().is_some();
        let asks_error = self.max_error.is_some() || self.mean_error.is_some();
        let vsdm = self.method == MethodName::Vsdm;
        let geometric = self.method == MethodName::Geometric;
        let interpolate = self.method == MethodName::Interpolate;
        let conflicts = [
            (
                self.axis.is_some() && self.template_name() != "torus",
                "--axis needs --template torus",
            ),
            (
                self.genus.is_some() && self.template_name() != "auto",
                "--genus needs --template auto",
            ),
            (
                self.flips.is_some() && self.template_name() != "ridges",
                "--flips needs --template ridges",
            ),
            (
                self.open && (!vsdm || matches!(self.template_name(), "bbox" | "torus")),
                "--open needs --method vsdm and a template that is open: auto, simplify, ridges, adaptive or FILE",
            ),
            (
                self.align.is_some() && !from_file,
                "--align needs --template FILE",
            ),
            (
                self.control_points.is_some() && from_file,
                "--control-points is for auto, bbox, torus, simplify, ridges and adaptive: a template FILE brings its own",
            ),
            (
                self.limit.is_some() && self.scheme() == Scheme::Polygon,
                "--limit is for subdivision surfaces: polygons are their own limit",
            ),
            (
                asks_error && self.polish == Some(Switch::Off),
                "--max-error and --mean-error need --polish on, which measures distances as it goes",
            ),
            (
                !geometric
                    && (self.step.is_some()
                        || self.samples.is_some()
                        || self.max_control_points.is_some()),
                "--step, --samples and --max-control-points need --method geometric",
            ),
            (
                !vsdm && self.scheme() != Scheme::Loop,
                "--method geometric and interpolate make Loop surfaces: --scheme loop",
            ),
            (
                !vsdm && matches!(self.template_name(), "auto" | "bbox" | "torus"),
                "--method geometric and interpolate need a start on the scan: --template ridges, adaptive, simplify or FILE",
            ),
            (
                interpolate && (asks_error || self.iterations.is_some()),
                "--max-error, --mean-error and --iterations are for --method vsdm and geometric: interpolation has one step",
            ),
            (
                !interpolate && self.refinements.is_some(),
                "--refinements needs --method interpolate",
            ),
            (
                !vsdm
                    && (self.smoothness.is_some()
                        || self.anisotropy.is_some()
                        || self.polish.is_some()
                        || self.limit.is_some()),
                "--smoothness, --anisotropy, --polish and --limit are for --method vsdm",
            ),
            (
                !vsdm && self.outliers > 0.0,
                "--outliers is for --method vsdm",
            ),
            (
                !vsdm && (self.checkpoint.is_some() || self.resume.is_some()),
                "--checkpoint and --resume are for --method vsdm",
            ),
            (
                self.max_control_points.is_some() && !asks_error,
                "--max-control-points needs --max-error or --mean-error, for which control points are added",
            ),
        ];
        if let Some((_, message)) = conflicts.into_iter().find(|(wrong, _)| *wrong) {
            bad_usage(message);
        }
    }

    fn holes(&self) -> Holes {
        let is_poses = |path: &&PathBuf| {
            path.extension()
                .is_some_and(|e| e.eq_ignore_ascii_case("conf"))
        };
        let scans = self.target.len() - self.target.iter().filter(is_poses).count();
        match scans {
            _ if self.open => Holes::Follow,
            1 => Holes::Bridge,
            _ => Holes::Leave,
        }
    }

    fn template_name(&self) -> &str {
        let default = match self.method {
            MethodName::Vsdm => "auto",
            MethodName::Geometric => "simplify",
            MethodName::Interpolate => "ridges",
        };
        self.template.as_deref().unwrap_or(default)
    }

    fn scheme(&self) -> Scheme {
        let is_network = matches!(self.template_name(), "ridges" | "adaptive");
        match self.scheme {
            Some(SchemeName::CatmullClark) => Scheme::CatmullClark,
            Some(SchemeName::Loop) => Scheme::Loop,
            Some(SchemeName::Polygon) => Scheme::Polygon,
            None if self.method == MethodName::Vsdm && !is_network => Scheme::CatmullClark,
            None => Scheme::Loop,
        }
    }

    fn template_file(&self) -> Option<&Path> {
        let name = self.template_name();
        (!TEMPLATES.contains(&name)).then(|| Path::new(name))
    }

    fn inputs(&self) -> Vec<&Path> {
        let targets = self.target.iter().map(PathBuf::as_path);
        targets.chain(self.template_file()).collect()
    }

    fn checkpoints(&self) -> Result<Checkpoints> {
        let file = self.checkpoint.clone().or_else(|| self.resume.clone());
        if let Some(path) = &file {
            check_place(path)?;
        }
        let resume = self.resume.as_deref().map(Checkpoint::read);
        Ok(Checkpoints {
            resume: resume.transpose()?,
            file,
        })
    }

    /// Control points to ask of a grid or of simplification; none of a template that has its own.
    fn control_points(&self) -> Option<usize> {
        let asked = self.control_points.map_or(CONTROL_POINTS, |n| n as usize);
        self.template_file().is_none().then_some(asked)
    }

    /// The method, and what the report says of it.
    fn method(&self) -> Result<(Method, Settings)> {
        let name = self.template_name().to_owned();
        if self.method == MethodName::Vsdm {
            let options = self.options();
            let settings = Settings::new(name, self.control_points(), self.holes(), &options);
            let template = self.template()?;
            return Ok((Method::Voronoi { template, options }, settings));
        }
        if self.method == MethodName::Interpolate {
            let options = Interpolation {
                refinements: self.refinements.map_or(0, usize::from),
                levels: self.levels(),
            };
            let count = self.control_points();
            let settings = Settings::of_interpolation(name, count, options, self.seed);
            let start = self.start(count)?;
            return Ok((Method::Interpolate { start, options }, settings));
        }
        let asked = self.control_points.map(|n| n as usize);
        let samples = self.samples.map(|n| n as usize);
        let options = self.geometric_options();
        let settings = Settings::of_geometric(name, asked, &options, samples, self.seed);
        let start = self.start(asked)?;
        let method = Method::Geometric {
            start,
            samples,
            seed: self.seed,
            options,
        };
        Ok((method, settings))
    }

    fn flips(&self) -> bool {
        self.flips == Some(Switch::On)
    }

    /// The start of a method that needs one on the scan.
    fn start(&self, control_points: Option<usize>) -> Result<geometric::Start> {
        Ok(match self.template_name() {
            "simplify" => geometric::Start::Simplified(control_points),
            "ridges" => geometric::Start::Ridges {
                control_points,
                flips: self.flips(),
            },
            "adaptive" => geometric::Start::Adaptive {
                control_points,
                seed: self.seed,
            },
            path => {
                let (control, align) = self.template_mesh(path.as_ref())?;
                geometric::Start::Mesh { control, align }
            }
        })
    }

    fn template(&self) -> Result<Template> {
        let control_points = self.control_points().unwrap_or_default();
        Ok(match self.template_name() {
            "auto" => Template::Automatic {
                control_points,
                genus: match self.genus {
                    Some(GenusName::Keep) => Genus::Keep,
                    Some(GenusName::Simplify) | None => Genus::Simplify,
                },
            },
            "bbox" => Template::BoundingBox { control_points },
            "simplify" => Template::Simplified { control_points },
            "ridges" => Template::Ridges {
                control_points,
                flips: self.flips(),
            },
            "adaptive" => Template::Adaptive {
                control_points,
                seed: self.seed,
            },
            "torus" => Template::Torus {
                axis: self.axis.unwrap_or(Axis::Inertia),
                control_points,
            },
            path => {
                let (control, align) = self.template_mesh(path.as_ref())?;
                Template::Mesh { control, align }
            }
        })
    }

    fn template_mesh(&self, path: &Path) -> Result<(ControlMesh, Align)> {
        let control = read_control(path).map_err(hint_at_names)?;
        let align = self.align.map_or(Align::None, Align::from);
        Ok((control, align))
    }

    /// Subdivisions from control mesh to dense surface.
    fn levels(&self) -> usize {
        let default = match self.scheme() {
            Scheme::Polygon => 0,
            _ => Options::default().levels,
        };
        self.levels.map_or(default, usize::from)
    }

    fn options(&self) -> Options {
        let scheme = self.scheme();
        Options {
            scheme,
            levels: self.levels(),
            limit: self.limit != Some(Switch::Off) && scheme != Scheme::Polygon,
            smoothness: self.smoothness.unwrap_or(Options::default().smoothness),
            anisotropy: self.anisotropy,
            polish: self.polish != Some(Switch::Off),
            max_error: share(self.max_error),
            mean_error: share(self.mean_error),
            iterations: self.iterations.map(|n| n as usize),
            outliers: self.outliers / 100.0,
            seed: self.seed,
        }
    }

    fn geometric_options(&self) -> geometric::Options {
        geometric::Options {
            step: match self.step {
                Some(StepName::Displacement) => geometric::Step::Displacement,
                Some(StepName::LeastSquares) | None => geometric::Step::LeastSquares,
            },
            max_error: share(self.max_error),
            mean_error: share(self.mean_error),
            max_control_points: self.max_control_points.map(|n| n as usize),
            iterations: self.iterations.map(|n| n as usize),
            levels: self.levels(),
        }
    }
}

/// The share that a percentage is.
fn share(percent: Option<f64>) -> Option<f64> {
    percent.map(|percent| percent / 100.0)
}

/// A mistyped name of a template reads like a file that is not there.
fn hint_at_names(error: Error) -> Error {
    match error {
        Error::Io { path, source } if source.kind() == std::io::ErrorKind::NotFound => Error::file(
            &path,
            "template",
            "there is no such file",
            "give auto, bbox, torus, simplify, ridges, adaptive or a mesh",
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

fn parse_outliers(text: &str) -> Result<f64, String> {
    parse_number(text, |x| (0.0..=50.0).contains(&x), "from 0 to 50")
}

fn parse_from_0(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x >= 0.0, "from 0 up")
}

fn parse_from_1(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x >= 1.0, "from 1 up")
}
