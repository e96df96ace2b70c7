//! `vorofit volume`: curved elements of high order from a closed scan.

mod choices;
mod scan;
mod summary;

use super::choices::Alignment;
use super::job::in_file;
use super::outputs::refuse_clashes;
use super::session::Session;
use super::template::parse_elements;
use super::text::significant;
use super::volume_file::Reading;
use super::{Outcome, bad_usage, terminal};
use choices::{
    BasisName, RuleName, SchemeName, TemplateName, parse_angle, parse_distortion, parse_percent,
    parse_smoothness,
};
use scan::{Prepared, Scan};
use std::path::PathBuf;
use vorofit::files::{
    SurfaceToWrite, VolumeToWrite, check_volume_writable, check_writable, write_surface,
    write_volume,
};
use vorofit::fit::{
    Adaptive, StopReason, SubdivisionLevel, VolumeFit, VolumeOptions, VolumeStart, VolumeTemplate,
    fit_subdivision, fit_volume,
};
use vorofit::geometry::distortion::Distortion;
use vorofit::measure::scaled_jacobian::qualities;
use vorofit::measure::validity::{Validity, validities};
use vorofit::mesh::{NodalVolume, PolygonMesh, VolumeMesh, shapes};
use vorofit::model::element::{Basis, Rule};
use vorofit::model::volume::{ControlVolume, CurvedVolume};
use vorofit::report::{
    AdaptiveReport, DeviceReport, QualityReport, Report, ResultReport, Stopwatch, VolumeSettings,
};
use vorofit::template::Align;
use vorofit::template::volume::ELEMENTS;
use vorofit::{Error, Result};

const EXAMPLES: &str = "\
Examples:
  vorofit volume scan.ply -o part.vtu --order 3
  vorofit volume scan.ply -o fine.vtu --elements 2000
  vorofit volume scan.ply -o ball.vtu --template ball:2 --order 4
  vorofit volume scan.ply -o ball.vtu --template ball:2 --order 12 --adaptive
  vorofit volume scan.ply -o fine.vtu --template ball --subdivision mlca --levels 3 --control control.vtu
  vorofit volume cloud.xyz -o ball.vtu --template ball:3 --order 3 --point-cloud
  vorofit volume part.stl -o part.msh --template grid:4x2x2 --order 3
  vorofit volume bone.obj -o bone.vtu --template bone.vtk --align similarity --order 2";

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
    /// What to start from: hexahedra made in the target with its handles, a grid over its box, a ball of 7 N³ hexahedra [N: 2], or a volume mesh
    #[arg(
        long,
        default_value = "auto",
        value_name = "auto|grid:AxBxC|ball[:N]|FILE"
    )]
    template: String,
    /// About how many hexahedra --template auto makes [default: 450]
    #[arg(long, value_name = "N", value_parser = parse_elements)]
    elements: Option<usize>,
    /// The order of the elements, 1 to 16; with --adaptive the highest
    #[arg(long, default_value_t = 2, value_name = "p", value_parser = clap::value_parser!(u8).range(1..=16))]
    order: u8,
    /// Take the target as points: a cloud (.ply, .xyz), or the vertices of a surface
    #[arg(long)]
    point_cloud: bool,
    /// Raise the order only where the boundary gains by it; files hold all elements elevated to the highest order that there is
    #[arg(long)]
    adaptive: bool,
    /// Raise no more once no distance is larger, in percent of the diagonal; needs --adaptive
    #[arg(long, value_name = "PERCENT", requires = "adaptive", value_parser = parse_percent)]
    max_error: Option<f64>,
    /// Fit the control points of a subdivision volume by multi-linear cell averaging; its hexahedra have straight edges
    #[arg(
        long,
        value_enum,
        hide_possible_values = true,
        value_name = "mlca",
        conflicts_with_all = ["order", "adaptive", "basis"]
    )]
    subdivision: Option<SchemeName>,
    /// So many times, each from what the one before has made [default: 2]
    #[arg(long, value_name = "N", requires = "subdivision", value_parser = clap::value_parser!(u8).range(1..=8))]
    levels: Option<u8>,
    /// Keep edges of the template sharp where it turns by more than so many degrees [default: none]
    #[arg(long, value_name = "DEGREES", requires = "subdivision", value_parser = parse_angle)]
    sharp: Option<f64>,
    /// Write the control mesh as well (.vtu, .mesh or .msh); may be repeated
    #[arg(long, value_name = "FILE", requires = "subdivision")]
    control: Vec<PathBuf>,
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

/// A fit that has run, in input coordinates.
struct Finished {
    nodes: NodalVolume,
    surface: PolygonMesh,
    /// `[surface vertices]`: from the target.
    distances: Option<Vec<f64>>,
    /// `[cells]`.
    least_jacobians: Vec<f64>,
    /// `[cells]`: the highest of their edges, faces and insides.
    orders: Vec<f64>,
    /// The control mesh of a subdivision volume.
    control: Option<VolumeMesh>,
}

/// What a fit has made, in the unit frame.
struct Fitted {
    volume: VolumeFit,
    subdivision: Option<(ControlVolume, Vec<SubdivisionLevel>)>,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        let name = TemplateName::of(&self.template);
        if self.align.is_some() && !matches!(name, TemplateName::File(_)) {
            bad_usage("--align needs --template FILE");
        }
        if self.elements.is_some() && !matches!(name, TemplateName::Auto) {
            bad_usage("--elements needs --template auto");
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
        let scan = Scan::read(session, &self.target, self.point_cloud)?;
        stopwatch.lap("read");
        let (report, finished) = self.make(session, &scan, &template, &mut stopwatch)?;
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

    fn template(&self, session: &Session, name: &TemplateName) -> Result<VolumeTemplate> {
        let path = match *name {
            TemplateName::Auto => {
                let elements = self.elements.unwrap_or(ELEMENTS);
                return Ok(VolumeTemplate::Auto(elements));
            }
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
            order: self.highest_order(),
            adaptive: self.adaptive.then(|| Adaptive {
                max_error: self.max_error.map(|percent| percent / 100.0),
            }),
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
        let outputs = self.output.iter().chain(&self.surface).chain(&self.control);
        refuse_clashes(outputs, &inputs)
    }

    /// The same for volumes of the template's shapes.
    fn check_volumes(&self, template: &VolumeTemplate) -> Result<()> {
        let sample = template.sample()?;
        let volume = CurvedVolume::new(&sample, Basis::Legendre)?;
        let nodes = volume.nodes(self.nodal_order(self.highest_order()));
        for path in &self.output {
            check_volume_writable(path, &VolumeToWrite::new(&nodes))?;
        }
        for path in &self.control {
            check_volume_writable(path, &VolumeToWrite::new(&volume.nodes(1)))?;
        }
        Ok(())
    }

    fn highest_order(&self) -> usize {
        match self.subdivision {
            Some(_) => 1,
            None => self.order.into(),
        }
    }

    /// Nodes of the order itself hold polynomials exactly; of Fourier modes more nodes lose less.
    fn nodal_order(&self, order: usize) -> usize {
        match self.basis {
            BasisName::Legendre => order,
            BasisName::Fourier => (2 * order).min(MAX_NODAL_ORDER),
        }
    }

    /// Fits, and judges what came of it.
    fn make(
        &self,
        session: &Session,
        scan: &Scan,
        template: &VolumeTemplate,
        stopwatch: &mut Stopwatch,
    ) -> Result<(Report, Finished)> {
        let terminal = &session.terminal;
        terminal.stage("preparing the target");
        let prepared = scan.prepare(session, &self.target)?;
        stopwatch.lap("prepare");
        let options = self.options();
        let fitted = self
            .fit(session, &prepared, template, &options, stopwatch)
            .map_err(|e| self.in_template(e))?;
        stopwatch.laps(fitted.volume.stages.clone());

        terminal.stage("certifying the elements");
        let (quality, least_jacobians) = judge(&fitted.volume.volume);
        stopwatch.lap("certify");
        terminal.stage("measuring the error");
        let dense = fitted.volume.dense_surface();
        let error = prepared
            .error(&dense)
            .map_err(|e| in_file(e, &self.target, "faces"))?;
        let distances = match self.surface.is_empty() {
            true => None,
            false => prepared.distances(&dense)?,
        };
        let frame = prepared.frame();
        let mut surface: PolygonMesh = dense.into();
        for p in &mut surface.positions {
            *p = frame.to_input(*p);
        }
        let (control, levels) = fitted.subdivision.unzip();
        let (iterations, stop_reason) =
            (fitted.volume.iterations.clone(), fitted.volume.stop_reason);
        let volume = fitted.volume.in_input_frame(&frame);
        // Files have one order for all: cells of lower ones are elevated, which does not change them.
        let nodes = volume.nodes(self.nodal_order(volume.highest_order()));
        self.warn_of_interpolation(session, &volume, &nodes, frame.diagonal)?;
        stopwatch.lap("measure");
        let report = Report {
            device: Some(DeviceReport::of(session.device()?)),
            volume_settings: Some(self.settings(&options)),
            target: Some(scan.report(frame.diagonal)),
            result: Some(ResultReport {
                control_points: control.as_ref().map(|c| c.mesh.positions.len()),
                subdivision: levels,
                ..self.result(&volume, &nodes)
            }),
            iterations: Some(iterations),
            converged: Some(matches!(
                stop_reason,
                StopReason::Schedule | StopReason::Tolerance
            )),
            stop_reason: Some(stop_reason),
            error: Some(error),
            quality: Some(quality),
            ..Report::new("volume")
        };
        let orders = (0..volume.cell_count()).map(|c| volume.kernel_order(c) as f64);
        let finished = Finished {
            orders: orders.collect(),
            nodes,
            surface,
            distances,
            least_jacobians,
            control: control.map(|c| c.mesh),
        };
        Ok((report, finished))
    }

    fn fit(
        &self,
        session: &Session,
        prepared: &Prepared,
        template: &VolumeTemplate,
        options: &VolumeOptions,
        stopwatch: &mut Stopwatch,
    ) -> Result<Fitted> {
        let (device, terminal) = (session.device()?, &session.terminal);
        let target = prepared.target();
        terminal.stage("preparing the template");
        let start = VolumeStart::new(target, template)?;
        stopwatch.lap("template");
        if self.subdivision.is_none() {
            return Ok(Fitted {
                volume: fit_volume(device, target, start, options, terminal)?,
                subdivision: None,
            });
        }
        let control = match self.sharp {
            None => start.mesh.into(),
            Some(degrees) => ControlVolume::with_sharp_edges(start.mesh, degrees.to_radians())?,
        };
        let levels = self.levels().into();
        let fit = fit_subdivision(
            device,
            target,
            control,
            start.nearby,
            levels,
            options,
            terminal,
        )?;
        Ok(Fitted {
            subdivision: Some((fit.control_in_input_frame(&prepared.frame()), fit.levels)),
            volume: fit.refined,
        })
    }

    fn levels(&self) -> u8 {
        self.levels.unwrap_or(2)
    }

    fn settings(&self, options: &VolumeOptions) -> VolumeSettings {
        VolumeSettings {
            point_cloud: self.point_cloud,
            subdivision: self.subdivision.map(|_| "mlca"),
            levels: self.subdivision.map(|_| self.levels()),
            sharp_degrees: self.sharp,
            ..VolumeSettings::new(self.template.clone(), options)
        }
    }

    /// What the report says of a volume and of its nodes in files.
    fn result(&self, volume: &CurvedVolume, nodes: &NodalVolume) -> ResultReport {
        let kept = volume.coefficients.len();
        let full = volume.full_count(self.highest_order());
        ResultReport {
            elements: Some(volume.cell_count()),
            order: Some(volume.highest_order()),
            nodes: Some(nodes.positions.len()),
            adaptive: self.adaptive.then(|| AdaptiveReport {
                nodes: kept,
                of_full_percent: 100.0 * kept as f64 / full as f64,
            }),
            ..ResultReport::default()
        }
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
            cell_data: &[
                ("scaled_jacobian_min", &finished.least_jacobians),
                ("order", &finished.orders),
            ],
            ..VolumeToWrite::new(&finished.nodes)
        };
        for path in &self.output {
            write_volume(path, &volume)?;
        }
        for path in &self.control {
            if let Some(control) = &finished.control {
                write_volume(path, &VolumeToWrite::new(&control.into()))?;
            }
        }
        let surface = SurfaceToWrite::dense(&finished.surface, finished.distances.as_deref());
        for path in &self.surface {
            write_surface(path, &surface)?;
        }
        Ok(())
    }

    /// The file to name where the template is at fault: grids come from the target.
    fn in_template(&self, error: Error) -> Error {
        match TemplateName::of(&self.template) {
            TemplateName::File(path) => in_file(error, path, "template"),
            _ => in_file(error, &self.target, "template"),
        }
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
pub(super) fn judge(volume: &CurvedVolume) -> (QualityReport, Vec<f64>) {
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
