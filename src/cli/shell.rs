//! `vorofit shell`: layers of cells over one or both sides of a surface.

use super::job::{in_file, warn_of_flaws};
use super::outputs::refuse_clashes;
use super::session::Session;
use super::text::{Summary, count, parse_number, significant};
use super::volume::judge;
use super::{Outcome, terminal};
use glam::DVec3;
use std::path::PathBuf;
use vorofit::files::{VolumeToWrite, check_volume_writable, read_surface, write_volume};
use vorofit::mesh::{Frame, NodalVolume};
use vorofit::model::element::Basis;
use vorofit::model::volume::CurvedVolume;
use vorofit::report::{QualityReport, Report, ResultReport, ShellReport, Stopwatch, TargetReport};
use vorofit::template::shell::{Shell, Side, shell};
use vorofit::template::volume::grid;
use vorofit::{Error, Result};

const EXAMPLES: &str = "\
Examples:
  vorofit shell part.obj -o shell.vtu --layers 2 --distance 2 --outside
  vorofit shell sheet.ply -o sheet.msh --layers 1 --distance 0.5 --both";

/// Make a shell mesh of a surface, closed or open: layers of prisms over its triangles and of hexahedra over its quads
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(group = clap::ArgGroup::new("side").required(true))]
pub struct Args {
    /// The surface: .obj, .ply, .stl or .off, an oriented manifold
    surface: PathBuf,
    /// Write the shell (.vtu, MFEM's .mesh or Gmsh's .msh); may be repeated
    #[arg(short, long, required = true, value_name = "FILE")]
    output: Vec<PathBuf>,
    /// Layers on each side
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    layers: u32,
    /// The thickness of all layers of a side together, in percent of the diagonal of the surface
    #[arg(long, value_name = "%", value_parser = parse_distance)]
    distance: f64,
    /// Layers where the normals of the surface point
    #[arg(long, group = "side")]
    outside: bool,
    /// Layers on the other side
    #[arg(long, group = "side")]
    inside: bool,
    /// Layers on either side
    #[arg(long, group = "side")]
    both: bool,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        refuse_clashes(self.output.iter(), &[&self.surface])?;
        let cube = NodalVolume::from(&grid(DVec3::ZERO, DVec3::ONE, [1; 3]));
        for path in &self.output {
            check_volume_writable(path, &VolumeToWrite::new(&cube))?;
        }
        terminal::catch_interrupts()?;
        let mut stopwatch = Stopwatch::start();
        let terminal = &session.terminal;
        terminal.stage(&format!("reading {}", self.surface.display()));
        let surface = read_surface(&self.surface)?;
        warn_of_flaws(session, &self.surface, &surface.census);
        let diagonal = Frame::of(&surface.mesh.triangulate())
            .map_err(|e| in_file(e, &self.surface, "faces"))?
            .diagonal;
        stopwatch.lap("read");
        let distance = 0.01 * self.distance * diagonal;
        let made = shell(&surface.mesh, self.layers, distance, self.side(), terminal)
            .map_err(|e| in_file(e, &self.surface, "faces"))?;
        stopwatch.lap("shell");
        terminal.stage("judging the elements");
        let (quality, least_jacobians) = judge(&CurvedVolume::new(&made.mesh, Basis::Legendre)?);
        stopwatch.lap("measure");
        terminal.stage("writing");
        let nodes = NodalVolume::from(&made.mesh);
        let file = VolumeToWrite {
            cell_data: &[("scaled_jacobian_min", &least_jacobians)],
            ..VolumeToWrite::new(&nodes)
        };
        for path in &self.output {
            write_volume(path, &file)?;
        }
        stopwatch.lap("write");
        terminal.clear();
        let report = Report {
            target: Some(TargetReport {
                vertices: surface.mesh.positions.len(),
                faces: surface.mesh.face_count(),
                bbox_diagonal: diagonal,
            }),
            result: Some(ResultReport {
                elements: Some(made.mesh.cell_count()),
                order: Some(1),
                nodes: Some(made.mesh.positions.len()),
                ..ResultReport::default()
            }),
            quality: Some(quality.clone()),
            shell: Some(ShellReport::of(&made, distance)),
            timing: Some(stopwatch.timing()),
            ..Report::new("shell")
        };
        session.finish(&report, &self.summary(&made, &quality, &report))?;
        self.verdict(&made, &quality)
    }

    fn side(&self) -> Side {
        match (self.outside, self.inside) {
            (true, _) => Side::Outside,
            (_, true) => Side::Inside,
            _ => Side::Both,
        }
    }

    fn summary(&self, made: &Shell, quality: &QualityReport, report: &Report) -> String {
        let mut summary = Summary::default();
        for path in &self.output {
            let (elements, vertices) = (
                count(made.mesh.cell_count()),
                count(made.mesh.positions.len()),
            );
            summary.line(
                "wrote",
                format!(
                    "{}   {elements} elements, {vertices} vertices",
                    path.display()
                ),
            );
        }
        let thickness = &made.thickness;
        let [min, mean, max] =
            [thickness.min, thickness.mean, thickness.max].map(|x| significant(100.0 * x, 3));
        summary.line(
            "thick",
            format!(
                "{min} to {max} % of the distance, mean {mean} %; no room for all of it over {} % of the vertices",
                significant(100.0 * made.shortened, 3)
            ),
        );
        summary.quality("quality", made.mesh.cell_count(), quality);
        if made.crossing > 0 || made.surface_crossing > 0 {
            summary.line(
                "crosses",
                format!(
                    "{} elements cross others, {} triangles of the surface itself do",
                    count(made.crossing),
                    count(made.surface_crossing)
                ),
            );
        }
        summary.time(report.timing.as_ref(), made.interrupted);
        summary.text()
    }

    /// A failure where elements are invalid: the files are written all the same, to see where.
    fn verdict(&self, made: &Shell, quality: &QualityReport) -> Result<Outcome> {
        if made.interrupted {
            return Ok(Outcome::Interrupted);
        }
        if quality.invalid > 0 || made.crossing > 0 {
            return Err(Error::file(
                &self.output[0],
                "elements",
                format!(
                    "{} of them are invalid, {} cross others",
                    quality.invalid, made.crossing
                ),
                match made.surface_crossing {
                    0 => {
                        "use a smaller distance or smooth the surface; vorofit check names the invalid ones"
                    }
                    _ => "mend the surface, which crosses itself",
                },
            ));
        }
        Ok(Outcome::Done)
    }
}

fn parse_distance(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x > 0.0 && x <= 100.0, "above 0, up to 100")
}
