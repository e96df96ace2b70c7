//! `vorofit volume`: curved elements of high order from a closed scan.

use super::choices::Alignment;
use super::job::{in_file, warn_of_flaws};
use super::outputs::refuse_clashes;
use super::session::Session;
use super::text::{Summary, count, parse_number, significant};
use super::volume_file::Reading;
use super::{Outcome, bad_usage, terminal};
use clap::ValueEnum;
use std::path::{Path, PathBuf};
use vorofit::files::{
    SurfaceToWrite, VolumeToWrite, check_volume_writable, check_writable, read_surface,
    write_surface, write_volume,
};
use vorofit::fit::{StopReason, Target, VolumeOptions, VolumeStart, VolumeTemplate, fit_volume};
use vorofit::geometry::distortion::Distortion;
use vorofit::measure;
use vorofit::measure::scaled_jacobian::qualities;
use vorofit::measure::validity::{Validity, validities};
use vorofit::mesh::{NodalVolume, PolygonMesh, TriangleMesh, shapes};
use vorofit::model::element::{Basis, Rule};
use vorofit::model::volume::CurvedVolume;
use vorofit::report::{
    DeviceReport, ErrorReport, QualityReport, Report, ResultReport, Stopwatch, TargetReport,
    VolumeSettings,
};
use vorofit::template::Align;
use vorofit::{Error, Result};

const EXAMPLES: &str = "\
Examples:
  vorofit volume scan.ply -o ball.vtu --template ball:2 --order 4
  vorofit volume part.stl -o part.msh --template grid:4x2x2 --order 3
  vorofit volume bone.obj -o bone.vtu --template bone.vtk --align similarity --order 2";

/// Area samples a side by which the result is judged: the rms is then certain to about a percent.
const SAMPLES: usize = 200_000;

/// The highest order of the nodes that a Fourier volume is interpolated at.
const MAX_NODAL_ORDER: usize = 16;

/// Fit a volume mesh of curved hexahedra, prisms and tetrahedra to a closed scan
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The scan: .obj, .ply, .stl or .off, closed but for small holes
    target: PathBuf,
    /// Write the volume (.vtu, MFEM's .mesh or Gmsh's .msh); may be repeated
    #[arg(short, long, required = true, value_name = "FILE")]
    output: Vec<PathBuf>,
    /// Write its boundary with the distance to the scan (.ply, .glb, .obj, .stl, .off or .usda); may be repeated
    #[arg(long, value_name = "FILE")]
    surface: Vec<PathBuf>,
    /// What to start from: a grid over the target's box, a ball of 7 N³ hexahedra [N: 2], or a volume mesh
    #[arg(long, required = true, value_name = "grid:AxBxC|ball[:N]|FILE")]
    template: String,
    /// The order of the elements, 1 to 16
    #[arg(long, default_value_t = 2, value_name = "p", value_parser = clap::value_parser!(u8).range(1..=16))]
    order: u8,
    /// Bring a template FILE onto the target: `box` stretches its bounding box onto the target's, `rigid` turns and moves
    /// it, `similarity` scales it as well [default: none]
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "none|box|rigid|similarity"
    )]
    align: Option<Alignment>,
    #[command(flatten)]
    reading: Reading,
    /// The functions that elements are made of
    #[arg(
        long,
        value_enum,
        default_value_t,
        hide_possible_values = true,
        value_name = "legendre|fourier"
    )]
    basis: BasisName,
    /// How distortion is measured: strain, conformal, symmetric-dirichlet, condition-number or mean-ratio
    #[arg(long, default_value = "strain", value_name = "NAME", value_parser = parse_distortion)]
    distortion: Distortion,
    /// Where distortion is sampled; `trapezoid` is the paper's rule
    #[arg(
        long,
        value_enum,
        default_value_t,
        hide_possible_values = true,
        value_name = "gauss|trapezoid"
    )]
    quadrature: RuleName,
    /// The weight of distortion from afar and at the end [default: 50,0.002]
    #[arg(long, value_name = "FAR,CLOSE", value_parser = parse_smoothness)]
    smoothness: Option<[f64; 2]>,
    /// Stop after so many iterations of all phases
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    iterations: Option<u32>,
    /// The seed of all sampling
    #[arg(long, default_value_t, value_name = "N")]
    seed: u64,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum BasisName {
    #[default]
    Legendre,
    Fourier,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum RuleName {
    #[default]
    Gauss,
    Trapezoid,
}

/// What `--template` says.
enum TemplateName<'a> {
    Grid([u32; 3]),
    Ball(u32),
    File(&'a Path),
}

/// A fit that has run, in input coordinates.
struct Finished {
    nodes: NodalVolume,
    surface: PolygonMesh,
    /// `[surface vertices]`: from the target.
    distances: Vec<f64>,
    /// `[cells]`.
    least_jacobians: Vec<f64>,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        let name = self.template_name();
        if self.align.is_some() && !matches!(name, TemplateName::File(_)) {
            bad_usage("--align needs --template FILE");
        }
        if self.reading.drops_pyramids() && !matches!(name, TemplateName::File(_)) {
            bad_usage("--drop-pyramids needs --template FILE");
        }
        self.check_surfaces(&name)?;
        session.device()?;
        terminal::catch_interrupts()?;

        let mut stopwatch = Stopwatch::start();
        let terminal = &session.terminal;
        terminal.stage(&format!("reading {}", self.target.display()));
        let template = self.template(session, &name)?;
        self.check_volumes(&template)?;
        let target = read_surface(&self.target)?;
        warn_of_flaws(session, &self.target, &target.census);
        stopwatch.lap("read");
        let (report, finished) = self.fit(session, &target.mesh, &template, &mut stopwatch)?;
        terminal.stage("writing");
        self.write(&finished)?;
        stopwatch.lap("write");
        terminal.clear();
        let report = Report {
            timing: Some(stopwatch.timing()),
            ..report
        };
        session.finish(&report, &self.summary(&report))?;
        self.verdict(&report)
    }

    fn template_name(&self) -> TemplateName<'_> {
        let text = self.template.as_str();
        if let Some(cells) = text.strip_prefix("grid:") {
            let counts: Option<Vec<u32>> = cells.split('x').map(parse_count).collect();
            return match counts.as_deref() {
                Some(&[a, b, c]) => TemplateName::Grid([a, b, c]),
                _ => bad_usage("--template grid: give three counts from 1 to 1000, as grid:4x2x2"),
            };
        }
        match text.strip_prefix("ball") {
            Some("") => TemplateName::Ball(2),
            Some(n) if n.starts_with(':') => match parse_count(&n[1..]) {
                Some(n) => TemplateName::Ball(n),
                None => bad_usage("--template ball: give a count from 1 to 1000, as ball:2"),
            },
            _ => TemplateName::File(Path::new(text)),
        }
    }

    fn template(&self, session: &Session, name: &TemplateName) -> Result<VolumeTemplate> {
        let path = match *name {
            TemplateName::Grid(cells) => return Ok(VolumeTemplate::Grid(cells)),
            TemplateName::Ball(n) => return Ok(VolumeTemplate::Ball(n)),
            TemplateName::File(path) => path,
        };
        let volume = self.reading.read(session, path)?;
        if volume.nodes.is_some() {
            session.terminal.warn(&format!(
                "{}: only the corners of its curved cells are used",
                path.display()
            ));
        }
        Ok(VolumeTemplate::Mesh {
            mesh: volume.mesh,
            align: self.align.map_or(Align::None, Align::from),
        })
    }

    fn options(&self) -> VolumeOptions {
        let defaults = VolumeOptions::default();
        let [far, close] = self.smoothness.unwrap_or([defaults.far, defaults.close]);
        VolumeOptions {
            order: self.order.into(),
            basis: match self.basis {
                BasisName::Legendre => Basis::Legendre,
                BasisName::Fourier => Basis::Fourier,
            },
            distortion: self.distortion,
            rule: match self.quadrature {
                RuleName::Gauss => Rule::Gauss,
                RuleName::Trapezoid => Rule::Trapezoid,
            },
            far,
            close,
            iterations: self.iterations.map(|n| n as usize),
            seed: self.seed,
        }
    }

    /// Refuses, before any work, surfaces that could not be written after it, and what would replace an input.
    fn check_surfaces(&self, name: &TemplateName) -> Result<()> {
        let triangle: PolygonMesh = shapes::sphere(1.0, 0).into();
        for path in &self.surface {
            check_writable(path, &SurfaceToWrite::dense(&triangle, None))?;
        }
        let mut inputs = vec![self.target.as_path()];
        if let TemplateName::File(path) = *name {
            inputs.push(path);
        }
        refuse_clashes(self.output.iter().chain(&self.surface), &inputs)
    }

    /// The same for volumes of the template's shapes.
    fn check_volumes(&self, template: &VolumeTemplate) -> Result<()> {
        let sample = template.sample()?;
        let volume = CurvedVolume::new(&sample, Basis::Legendre)?;
        let nodes = volume.nodes(self.nodal_order());
        for path in &self.output {
            check_volume_writable(path, &VolumeToWrite::new(&nodes))?;
        }
        Ok(())
    }

    /// Nodes of the order itself hold polynomials exactly; of Fourier modes more nodes lose less.
    fn nodal_order(&self) -> usize {
        let order = usize::from(self.order);
        match self.basis {
            BasisName::Legendre => order,
            BasisName::Fourier => (2 * order).min(MAX_NODAL_ORDER),
        }
    }

    fn fit(
        &self,
        session: &Session,
        mesh: &PolygonMesh,
        template: &VolumeTemplate,
        stopwatch: &mut Stopwatch,
    ) -> Result<(Report, Finished)> {
        let (device, terminal) = (session.device()?, &session.terminal);
        terminal.stage("preparing the target");
        let mut input = mesh.triangulate();
        let target = Target::new(device, &input).map_err(|e| in_file(e, &self.target, "faces"))?;
        stopwatch.lap("prepare");
        let start = VolumeStart::new(&target, template).map_err(|e| self.in_template(e))?;
        stopwatch.lap("template");
        let options = self.options();
        let fit = fit_volume(device, &target, start, &options, terminal)
            .map_err(|e| self.in_template(e))?;
        stopwatch.laps(fit.stages.clone());

        terminal.stage("certifying the elements");
        let (quality, least_jacobians) = judge(&fit.volume);
        stopwatch.lap("certify");
        terminal.stage("measuring the error");
        for p in &mut input.positions {
            *p = target.frame.to_unit(*p);
        }
        let surface = fit.dense_surface();
        let error = measure::surface_error(&input, &surface, SAMPLES)
            .map_err(|e| in_file(e, &self.target, "faces"))?;
        let diagonal = target.frame.diagonal;
        let distances = self.distances(&input, &surface, diagonal)?;
        let iterations = fit.iterations.clone();
        let stop_reason = fit.stop_reason;
        let volume = fit.in_input_frame(&target.frame);
        let nodes = volume.nodes(self.nodal_order());
        self.warn_of_interpolation(session, &volume, &nodes, diagonal)?;
        let mut surface: PolygonMesh = surface.into();
        for p in &mut surface.positions {
            *p = target.frame.to_input(*p);
        }
        stopwatch.lap("measure");
        let report = Report {
            device: Some(DeviceReport::of(device)),
            volume_settings: Some(VolumeSettings::new(self.template.clone(), &options)),
            target: Some(TargetReport {
                vertices: mesh.positions.len(),
                faces: mesh.face_count(),
                bbox_diagonal: diagonal,
            }),
            result: Some(ResultReport {
                elements: Some(volume.cell_count()),
                order: Some(options.order),
                nodes: Some(nodes.positions.len()),
                ..ResultReport::default()
            }),
            iterations: Some(iterations),
            converged: Some(stop_reason == StopReason::Schedule),
            stop_reason: Some(stop_reason),
            error: Some(ErrorReport::of_fit(&error, diagonal)),
            quality: Some(quality),
            ..Report::new("volume")
        };
        let finished = Finished {
            nodes,
            surface,
            distances,
            least_jacobians,
        };
        Ok((report, finished))
    }

    fn distances(
        &self,
        input: &TriangleMesh,
        surface: &TriangleMesh,
        diagonal: f64,
    ) -> Result<Vec<f64>> {
        if self.surface.is_empty() {
            return Ok(Vec::new());
        }
        let distances = measure::distances(input, &surface.positions)?;
        Ok(distances.iter().map(|d| diagonal * d).collect())
    }

    fn warn_of_interpolation(
        &self,
        session: &Session,
        volume: &CurvedVolume,
        nodes: &NodalVolume,
        diagonal: f64,
    ) -> Result<()> {
        if self.basis == BasisName::Fourier {
            let error = 100.0 * volume.interpolation_error(nodes)? / diagonal;
            session.terminal.warn(&format!(
                "files hold the Fourier elements as polynomials of order {}, at most {} % of the diagonal away",
                nodes.order(),
                significant(error, 3)
            ));
        }
        Ok(())
    }

    fn write(&self, finished: &Finished) -> Result<()> {
        let volume = VolumeToWrite {
            cell_data: &[("scaled_jacobian_min", &finished.least_jacobians)],
            ..VolumeToWrite::new(&finished.nodes)
        };
        for path in &self.output {
            write_volume(path, &volume)?;
        }
        let surface = SurfaceToWrite::dense(&finished.surface, Some(&finished.distances));
        for path in &self.surface {
            write_surface(path, &surface)?;
        }
        Ok(())
    }

    /// The file to name where the template is at fault: grids come from the target.
    fn in_template(&self, error: Error) -> Error {
        match self.template_name() {
            TemplateName::File(path) => in_file(error, path, "template"),
            _ => in_file(error, &self.target, "template"),
        }
    }

    /// The report in words.
    fn summary(&self, report: &Report) -> String {
        let mut summary = Summary::default();
        if let Some(result) = &report.result {
            let of = |n: Option<usize>| count(n.unwrap_or_default());
            for path in &self.output {
                summary.line(
                    "wrote",
                    format!(
                        "{}   {} elements of order {}, {} nodes",
                        path.display(),
                        of(result.elements),
                        of(result.order),
                        of(result.nodes)
                    ),
                );
            }
        }
        for path in &self.surface {
            summary.line(
                "wrote",
                format!("{}   the boundary with its error", path.display()),
            );
        }
        if let Some(error) = &report.error {
            let [max, rms, mean] = [error.max_percent, error.rms_percent, error.mean_percent]
                .map(|x| significant(x, 3));
            let of = "of the bounding box's diagonal";
            summary.line(
                "error",
                format!("largest {max} %, rms {rms} %, mean {mean} % {of}"),
            );
        }
        if let Some(quality) = &report.quality {
            let elements = report
                .result
                .as_ref()
                .and_then(|r| r.elements)
                .unwrap_or_default();
            let valid = elements - quality.invalid - quality.undecided;
            summary.line(
                "quality",
                format!(
                    "{} valid everywhere, {} invalid, {} undecided; scaled Jacobian at least {}, mean {}",
                    count(valid),
                    count(quality.invalid),
                    count(quality.undecided),
                    significant(quality.scaled_jacobian_min, 3),
                    significant(quality.scaled_jacobian_mean, 3)
                ),
            );
        }
        let why = match report.stop_reason {
            Some(StopReason::Interrupted) => "interrupted: this is the best so far",
            Some(StopReason::Iterations) => "stopped at the iterations allowed",
            _ => "ran to the end",
        };
        let seconds = report.timing.as_ref().map_or(0.0, |timing| timing.total_s);
        let iterations = report.iterations.as_ref().map_or(0, Vec::len);
        summary.line(
            "time",
            format!("{seconds:.1} s, {} iterations; {why}", count(iterations)),
        );
        summary.text()
    }

    /// A failure where elements are invalid: the files are written all the same, to see where.
    fn verdict(&self, report: &Report) -> Result<Outcome> {
        let (invalid, undecided) = report
            .quality
            .as_ref()
            .map_or((0, 0), |quality| (quality.invalid, quality.undecided));
        if invalid > 0 {
            return Err(Error::file(
                &self.output[0],
                "elements",
                format!("{invalid} of them are invalid, {undecided} more undecided"),
                "use more smoothness, a lower order or a better template; vorofit check names them",
            ));
        }
        if undecided > 0 {
            terminal::complain(
                "warning",
                &format!("{undecided} elements could not be shown to be valid everywhere"),
            );
        }
        Ok(match report.stop_reason {
            Some(StopReason::Interrupted) => Outcome::Interrupted,
            _ => Outcome::Done,
        })
    }
}

/// The quality of all elements together, and the least scaled Jacobian of each.
fn judge(volume: &CurvedVolume) -> (QualityReport, Vec<f64>) {
    let (qualities, validities) = (qualities(volume), validities(volume));
    let with = |validity| validities.iter().filter(|v| **v == validity).count();
    let least: Vec<f64> = qualities.iter().map(|q| q.min).collect();
    let mean = qualities.iter().map(|q| q.mean).sum::<f64>() / qualities.len() as f64;
    let report = QualityReport {
        scaled_jacobian_mean: mean,
        scaled_jacobian_min: least.iter().copied().fold(f64::INFINITY, f64::min),
        invalid: with(Validity::Invalid),
        undecided: with(Validity::Undecided),
    };
    (report, least)
}

/// Counts of cells along an edge.
fn parse_count(text: &str) -> Option<u32> {
    text.parse().ok().filter(|n| (1..=1000).contains(n))
}

fn parse_distortion(text: &str) -> Result<Distortion, String> {
    Distortion::ALL
        .into_iter()
        .find(|distortion| distortion.name() == text)
        .ok_or_else(|| {
            let names = Distortion::ALL.map(Distortion::name);
            format!("give one of {}", names.join(", "))
        })
}

fn parse_smoothness(text: &str) -> Result<[f64; 2], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|word| parse_number(word.trim(), |x| x > 0.0, "above 0"))
        .collect::<Result<_, _>>()?;
    match numbers[..] {
        [far, close] if close <= far => Ok([far, close]),
        _ => Err("give two numbers, the second not above the first".into()),
    }
}
