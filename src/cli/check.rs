//! `vorofit check`: how good the elements of a volume mesh are, and whether each is valid everywhere.

use super::Outcome;
use super::session::Session;
use super::text::{count, significant};
use super::volume_file::Reading;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use vorofit::files::Volume;
use vorofit::measure::scaled_jacobian::{Quality, qualities};
use vorofit::measure::validity::{Validity, validities};
use vorofit::mesh::CellShape;
use vorofit::model::element::Basis;
use vorofit::model::volume::CurvedVolume;
use vorofit::report::{QualityReport, Report, ResultReport, Stopwatch};
use vorofit::{Error, Result};

/// Elements that are listed, the worst first.
const LISTED: usize = 10;

/// Check a volume mesh: scaled Jacobians, and whether the elements are valid everywhere (exit status 1 if one is not)
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Medit (.mesh, .meshb), MFEM (.mesh), legacy VTK (.vtk), .vtu or Gmsh 4.1 (.msh); curved cells as this program writes them
    volume: PathBuf,
    #[command(flatten)]
    reading: Reading,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        let mut stopwatch = Stopwatch::start();
        let terminal = &session.terminal;
        terminal.stage(&format!("reading {}", self.volume.display()));
        let Volume { mesh, nodes, .. } = self.reading.read(session, &self.volume)?;
        let volume = match &nodes {
            Some(nodes) => CurvedVolume::from_nodes(&mesh, nodes)?,
            None => CurvedVolume::new(&mesh, Basis::Legendre)?,
        };
        stopwatch.lap("read");
        terminal.stage("checking");
        let cells = Cells {
            qualities: qualities(&volume),
            validities: validities(&volume),
            volume,
        };
        stopwatch.lap("check");
        terminal.clear();
        let quality = cells.summary(|_| true);
        let report = Report {
            result: Some(ResultReport {
                elements: Some(mesh.cell_count()),
                order: Some(cells.volume.highest_order()),
                nodes: Some(nodes.map_or(mesh.positions.len(), |nodes| nodes.positions.len())),
                ..Default::default()
            }),
            quality: Some(quality),
            timing: Some(stopwatch.timing()),
            ..Report::new("check")
        };
        session.finish(&report, &cells.table(&self.volume))?;
        cells.verdict(&self.volume)
    }
}

/// What is known of every cell.
struct Cells {
    volume: CurvedVolume,
    qualities: Vec<Quality>,
    validities: Vec<Validity>,
}

impl Cells {
    /// The figures of the cells that satisfy a condition.
    fn summary(&self, of: impl Fn(usize) -> bool) -> QualityReport {
        let chosen: Vec<usize> = (0..self.qualities.len()).filter(|&c| of(c)).collect();
        let least = chosen.iter().map(|&c| self.qualities[c].min);
        let sum: f64 = chosen.iter().map(|&c| self.qualities[c].mean).sum();
        let with = |validity| {
            chosen
                .iter()
                .filter(|&&c| self.validities[c] == validity)
                .count()
        };
        QualityReport {
            scaled_jacobian_mean: sum / chosen.len() as f64,
            scaled_jacobian_min: least.fold(f64::INFINITY, f64::min),
            invalid: with(Validity::Invalid),
            undecided: with(Validity::Undecided),
        }
    }

    fn table(&self, path: &Path) -> String {
        let mut text = String::new();
        let _ = writeln!(
            text,
            "{}: {} elements of order {}\n\n{:14} {:>9} {:>9} {:>9} {:>9} {:>9} {:>10}",
            path.display(),
            count(self.qualities.len()),
            self.volume.highest_order(),
            "",
            "elements",
            "mean",
            "min",
            "valid",
            "invalid",
            "undecided"
        );
        let shapes: Vec<(CellShape, usize)> = CellShape::ALL
            .into_iter()
            .map(|shape| (shape, self.count_of(shape)))
            .filter(|&(_, count)| count > 0)
            .collect();
        for &(shape, number) in &shapes {
            let summary = self.summary(|c| self.volume.shape(c) == shape);
            row(&mut text, shape.name(), number, &summary);
        }
        if shapes.len() > 1 {
            row(
                &mut text,
                "all",
                self.qualities.len(),
                &self.summary(|_| true),
            );
        }
        let _ = writeln!(
            text,
            "\n{:14} {:14} {:>9} {:>9}  ",
            "worst element", "shape", "mean", "min"
        );
        for c in self.worst() {
            let Quality { mean, min } = self.qualities[c];
            let _ = writeln!(
                text,
                "{c:<14} {:14} {:>9} {:>9}  {}",
                self.volume.shape(c).name(),
                significant(mean, 3),
                significant(min, 3),
                name(self.validities[c])
            );
        }
        text += "\nMean and minimum are of the scaled Jacobian at samples; elements are counted from 0, and valid where\n\
                 the Jacobian is certain to be positive everywhere.\n";
        text
    }

    fn count_of(&self, shape: CellShape) -> usize {
        (0..self.qualities.len())
            .filter(|&c| self.volume.shape(c) == shape)
            .count()
    }

    /// Invalid elements first, then the smallest scaled Jacobians.
    fn worst(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.qualities.len()).collect();
        let rank = |c: usize| {
            (
                self.validities[c] != Validity::Invalid,
                self.qualities[c].min,
            )
        };
        order.sort_by(|&a, &b| {
            let ((a_valid, a_min), (b_valid, b_min)) = (rank(a), rank(b));
            a_valid.cmp(&b_valid).then(a_min.total_cmp(&b_min))
        });
        order.truncate(LISTED);
        order
    }

    /// A failure where elements are invalid.
    fn verdict(&self, path: &Path) -> Result<Outcome> {
        let invalid = self
            .validities
            .iter()
            .filter(|&&v| v == Validity::Invalid)
            .count();
        match self.validities.iter().position(|&v| v == Validity::Invalid) {
            None => Ok(Outcome::Done),
            Some(first) => Err(Error::file(
                path,
                format!("element {first} (counted from 0)"),
                format!("it is the first of {invalid} invalid elements"),
                "mesh these places again, or untangle the mesh",
            )),
        }
    }
}

fn row(text: &mut String, word: &str, number: usize, summary: &QualityReport) {
    let valid = number - summary.invalid - summary.undecided;
    let _ = writeln!(
        text,
        "{word:14} {:>9} {:>9} {:>9} {:>9} {:>9} {:>10}",
        count(number),
        significant(summary.scaled_jacobian_mean, 3),
        significant(summary.scaled_jacobian_min, 3),
        count(valid),
        count(summary.invalid),
        count(summary.undecided)
    );
}

const fn name(validity: Validity) -> &'static str {
    match validity {
        Validity::Valid => "valid",
        Validity::Invalid => "invalid",
        Validity::Undecided => "undecided",
    }
}
