//! `vorofit optimize`: a volume mesh made valid and better over its own boundary.

use super::job::in_file;
use super::outputs::refuse_clashes;
use super::session::Session;
use super::text::{Summary, count, parse_number, significant};
use super::volume::judge;
use super::volume_file::Reading;
use super::{Outcome, terminal};
use std::path::PathBuf;
use vorofit::files::{VolumeToWrite, check_volume_writable, write_volume};
use vorofit::fit::{Target, VolumeOptions, VolumeStart, VolumeTemplate, fit_volume};
use vorofit::measure;
use vorofit::mesh::{Frame, NodalVolume, TriangleMesh, VolumeMesh};
use vorofit::model::element::Basis;
use vorofit::model::volume::CurvedVolume;
use vorofit::report::{ErrorReport, QualityReport, Report, ResultReport, Stopwatch, TargetReport};
use vorofit::template::Align;
use vorofit::untangle::{Boundary, Ideals, untangle};
use vorofit::{Error, Result};

const EXAMPLES: &str = "\
Examples:
  vorofit optimize part.mesh -o part.vtu
  vorofit optimize part.vtk -o part.msh --tolerance 0.01 --json -
  vorofit optimize part.vtk -o part.vtu --order 2";

/// Intervals along the edges of a boundary face by which displacements are measured: faces of four corners are curved.
const INTERVALS: usize = 4;

/// Repair and improve a volume mesh over its own boundary: no inverted elements, sharp edges kept
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Medit (.mesh, .meshb), MFEM (.mesh), legacy VTK (.vtk), .vtu or Gmsh 4.1 (.msh); of curved cells the corners
    mesh: PathBuf,
    /// Write the result (.vtu, MFEM's .mesh or Gmsh's .msh); may be repeated
    #[arg(short, long, required = true, value_name = "FILE")]
    output: Vec<PathBuf>,
    /// The largest distance between the old and the new boundary, in percent of the diagonal
    #[arg(long, default_value_t = 0.05, value_name = "%", value_parser = parse_tolerance)]
    tolerance: f64,
    /// Curve the elements to this order over the boundary, 1 to 16
    #[arg(long, default_value_t = 1, value_name = "p", value_parser = clap::value_parser!(u8).range(1..=16))]
    order: u8,
    #[command(flatten)]
    reading: Reading,
}

/// What has been measured of a mesh and its successor.
struct Judged {
    before: QualityReport,
    after: QualityReport,
    least_jacobians: Vec<f64>,
    displacement: measure::Comparison,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        refuse_clashes(self.output.iter(), &[&self.mesh])?;
        terminal::catch_interrupts()?;
        let mut stopwatch = Stopwatch::start();
        let terminal = &session.terminal;
        terminal.stage(&format!("reading {}", self.mesh.display()));
        let volume = self.reading.read(session, &self.mesh)?;
        if volume.nodes.is_some() {
            let path = self.mesh.display();
            terminal.warn(&format!(
                "{path}: only the corners of its curved cells are used"
            ));
        }
        let before = CurvedVolume::new(&volume.mesh, Basis::Legendre)?;
        for path in &self.output {
            check_volume_writable(path, &VolumeToWrite::new(&before.nodes(self.order.into())))?;
        }
        stopwatch.lap("read");
        let (after, is_interrupted) = self.optimized(session, &volume.mesh, &before)?;
        stopwatch.lap("optimize");
        terminal.stage("judging the elements");
        let judged = judge_both(&before, &after)?;
        stopwatch.lap("measure");
        terminal.stage("writing");
        let nodes = after.nodes(self.order.into());
        let file = VolumeToWrite {
            cell_data: &[("scaled_jacobian_min", &judged.least_jacobians)],
            ..VolumeToWrite::new(&nodes)
        };
        for path in &self.output {
            write_volume(path, &file)?;
        }
        stopwatch.lap("write");
        terminal.clear();
        let report = self.report(&before, &nodes, &judged, &stopwatch);
        session.finish(
            &report,
            &self.summary(&nodes, &judged, is_interrupted, &report),
        )?;
        self.verdict(&judged.after, is_interrupted)
    }

    /// The mesh at the order asked for, and whether it was interrupted.
    fn optimized(
        &self,
        session: &Session,
        mesh: &VolumeMesh,
        before: &CurvedVolume,
    ) -> Result<(CurvedVolume, bool)> {
        let own = boundary(before, 1);
        let tolerance = 0.01 * self.tolerance * Frame::of(&own)?.diagonal;
        let hold = Boundary::Own { tolerance };
        let found = untangle(mesh, &Ideals::local(mesh), hold, &session.terminal)?;
        if self.order == 1 || found.inverted > 0 || found.interrupted {
            let volume = CurvedVolume::new(&found.mesh, Basis::Legendre)?;
            return Ok((volume, found.interrupted));
        }
        let device = session.device()?;
        let target = Target::new(device, &boundary(before, INTERVALS))?;
        let template = VolumeTemplate::Mesh {
            mesh: found.mesh,
            align: Align::None,
        };
        let options = VolumeOptions {
            order: self.order.into(),
            ..VolumeOptions::default()
        };
        let fit = VolumeStart::new(&target, &template)
            .and_then(|start| fit_volume(device, &target, start, &options, &session.terminal))
            .map_err(|e| in_file(e, &self.mesh, "boundary"))?;
        let is_interrupted = fit.stop_reason == vorofit::fit::StopReason::Interrupted;
        Ok((fit.in_input_frame(&target.frame), is_interrupted))
    }

    fn report(
        &self,
        before: &CurvedVolume,
        nodes: &NodalVolume,
        judged: &Judged,
        stopwatch: &Stopwatch,
    ) -> Report {
        Report {
            target: Some(TargetReport {
                vertices: before.vertex_count(),
                faces: before.boundary().len(),
                bbox_diagonal: judged.displacement.diagonal,
            }),
            result: Some(ResultReport {
                elements: Some(nodes.cell_count()),
                order: Some(nodes.order()),
                nodes: Some(nodes.positions.len()),
                ..ResultReport::default()
            }),
            error: Some(ErrorReport::of_comparison(&judged.displacement)),
            quality_before: Some(judged.before.clone()),
            quality: Some(judged.after.clone()),
            timing: Some(stopwatch.timing()),
            ..Report::new("optimize")
        }
    }

    fn summary(
        &self,
        nodes: &NodalVolume,
        judged: &Judged,
        is_interrupted: bool,
        report: &Report,
    ) -> String {
        let mut summary = Summary::default();
        for path in &self.output {
            let (elements, nodes, order) = (
                count(nodes.cell_count()),
                count(nodes.positions.len()),
                nodes.order(),
            );
            summary.line(
                "wrote",
                format!(
                    "{}   {elements} elements of order {order}, {nodes} nodes",
                    path.display()
                ),
            );
        }
        summary.quality("before", nodes.cell_count(), &judged.before);
        summary.quality("after", nodes.cell_count(), &judged.after);
        let moved = &judged.displacement;
        let [forth, back] =
            [moved.a_to_b, moved.b_to_a].map(|d| significant(moved.percent(d.hausdorff.upper), 3));
        summary.line(
            "moved",
            format!("the old boundary is at most {forth} % of the diagonal from the new one, the new at most {back} % from the old"),
        );
        summary.time(report.timing.as_ref(), is_interrupted);
        summary.text()
    }

    /// A failure where elements are invalid: the files are written all the same, to see where.
    fn verdict(&self, quality: &QualityReport, is_interrupted: bool) -> Result<Outcome> {
        if is_interrupted {
            return Ok(Outcome::Interrupted);
        }
        if quality.invalid > 0 {
            return Err(Error::file(
                &self.output[0],
                "elements",
                format!(
                    "{} of them are still invalid, {} more undecided",
                    quality.invalid, quality.undecided
                ),
                "let the boundary move further with --tolerance, or mesh these places again; vorofit check names them",
            ));
        }
        Ok(Outcome::Done)
    }
}

fn judge_both(before: &CurvedVolume, after: &CurvedVolume) -> Result<Judged> {
    let (quality_before, _) = judge(before);
    let (quality_after, least_jacobians) = judge(after);
    let intervals = INTERVALS.max(2 * after.highest_order());
    let displacement = measure::compare(
        &boundary(before, intervals),
        &boundary(after, intervals),
        measure::Options::default(),
    )?;
    Ok(Judged {
        before: quality_before,
        after: quality_after,
        least_jacobians,
        displacement,
    })
}

fn boundary(volume: &CurvedVolume, intervals: usize) -> TriangleMesh {
    volume
        .boundary_surface(intervals)
        .mesh(&volume.coefficients)
}

fn parse_tolerance(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x > 0.0 && x <= 100.0, "above 0, up to 100")
}
