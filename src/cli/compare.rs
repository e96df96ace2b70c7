//! `vorofit compare`: how far two surfaces are apart.

use super::Outcome;
use super::job::warn_of_flaws;
use super::session::Session;
use super::text::{count, parse_number, significant};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use vorofit::files::{Surface, read_surface};
use vorofit::measure::{self, Comparison};
use vorofit::report::{ErrorReport, Report, ResultReport, Stopwatch, TargetReport};
use vorofit::{Error, Result};

/// Measure how far two surfaces are apart: Hausdorff distance within certain bounds, mean and rms, both ways
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The reference: percentages are of its bounding box's diagonal
    a: PathBuf,
    /// The other surface
    b: PathBuf,
    /// Width of the Hausdorff distance's bounds, relative to it
    #[arg(long, value_name = "SHARE", default_value_t = measure::Options::default().tolerance, value_parser = parse_tolerance)]
    tolerance: f64,
    /// Samples a surface for mean and rms, at least
    #[arg(long, value_name = "N", default_value_t = measure::Options::default().samples as u32, value_parser = clap::value_parser!(u32).range(1..=1_000_000_000))]
    samples: u32,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        let mut stopwatch = Stopwatch::start();
        let (a, b) = (read(session, &self.a)?, read(session, &self.b)?);
        stopwatch.lap("read");
        session.terminal.stage("comparing");
        let options = measure::Options {
            samples: self.samples as usize,
            tolerance: self.tolerance,
            ..Default::default()
        };
        let comparison = measure::compare(&a.mesh.triangulate(), &b.mesh.triangulate(), options)?;
        stopwatch.lap("compare");
        session.terminal.clear();
        let report = Report {
            target: Some(TargetReport {
                vertices: a.census.vertices,
                faces: a.census.faces,
                bbox_diagonal: comparison.diagonal,
            }),
            result: Some(ResultReport {
                surface_vertices: b.census.vertices,
                surface_faces: b.census.faces,
                ..Default::default()
            }),
            error: Some(ErrorReport::of_comparison(&comparison)),
            timing: Some(stopwatch.timing()),
            ..Report::new("compare")
        };
        session.finish(&report, &self.table([&a, &b], &comparison))?;
        Ok(Outcome::Done)
    }

    fn table(&self, surfaces: [&Surface; 2], comparison: &Comparison) -> String {
        let mut text = String::new();
        for ((letter, path), surface) in [("A", &self.a), ("B", &self.b)].into_iter().zip(surfaces)
        {
            let census = &surface.census;
            let (vertices, faces) = (count(census.vertices), count(census.faces));
            let name = path.display();
            let _ = writeln!(text, "{letter}  {name}: {vertices} vertices, {faces} faces");
        }
        let (forth, back) = (comparison.a_to_b, comparison.b_to_a);
        let rows = [
            (
                "Hausdorff, at least",
                forth.hausdorff.lower,
                back.hausdorff.lower,
            ),
            (
                "Hausdorff, at most",
                forth.hausdorff.upper,
                back.hausdorff.upper,
            ),
            ("rms", forth.figures.rms, back.figures.rms),
            ("mean", forth.figures.mean, back.figures.mean),
        ];
        let _ = writeln!(
            text,
            "\n{:20} {:>12} {:>12} {:>12} {:>14}",
            "", "A to B", "B to A", "larger", "% of diagonal"
        );
        for (name, forth, back) in rows {
            let larger = forth.max(back);
            let percent = comparison.percent(larger);
            let [forth, back, larger, percent] = [forth, back, larger, percent].map(digits);
            let _ = writeln!(
                text,
                "{name:20} {forth:>12} {back:>12} {larger:>12} {percent:>14}"
            );
        }
        let diagonal = digits(comparison.diagonal);
        let _ = writeln!(
            text,
            "\nLengths in the files' units; the diagonal of A's bounding box is {diagonal}."
        );
        text
    }
}

/// Six digits: what two programs may be expected to agree on.
fn digits(x: f64) -> String {
    significant(x, 6)
}

fn read(session: &Session, path: &Path) -> Result<Surface> {
    session
        .terminal
        .stage(&format!("reading {}", path.display()));
    let surface = read_surface(path)?;
    warn_of_flaws(session, path, &surface.census);
    if surface.census.degenerate_faces == surface.census.faces {
        return Err(Error::file(
            path,
            "faces",
            "none has an area",
            "give a surface",
        ));
    }
    Ok(surface)
}

fn parse_tolerance(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x > 0.0 && x <= 1.0, "above 0, up to 1")
}
