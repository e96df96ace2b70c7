//! `vorofit features`: ridges, umbilics and crossings of a scan, as lines and points.

use super::Outcome;
use super::outputs::refuse_clashes;
use super::render::AxisName;
use super::session::Session;
use super::text::{Summary, count, parse_number, significant};
use std::path::{Path, PathBuf};
use vorofit::features::{Features, Filtered, Kind, Line, Origin, Scale, UmbilicKind};
use vorofit::files::curves::{Curve, check_curves, write_curves};
use vorofit::files::read_surface;
use vorofit::mesh::{Frame, TriangleMesh};
use vorofit::picture::{Paint, Picture, Rgb, Scene, Shape, View, color};
use vorofit::report::feature_layers::{
    CROSSING_COLOR, UMBILIC_COLOR, point_layers, points, ridge_color, ridge_layers,
};
use vorofit::report::{
    DeviceReport, FeatureReport, LineReport, Report, SiteReport, Stopwatch, TargetReport,
};
use vorofit::{Error, Result, topology};

/// The columns of the files. `kind`: red 8, blue 4, yellow 2, green 1, added up for sites; elliptic umbilics 16, hyperbolic ones 32, crossings 64, turning points 128.
const COLUMNS: [&str; 6] = ["kind", "line", "strength", "curvature", "crest", "sharp"];
const KINDS: [Kind; 4] = [Kind::Red, Kind::Blue, Kind::Yellow, Kind::Green];
const ELLIPTIC: u8 = 16;
const HYPERBOLIC: u8 = 32;
const CROSSING: u8 = 64;
const TURNING: u8 = 128;
/// Sites are told from features by this in the column `line`, which numbers lines from 0.
const SITE: f64 = -2.0;
const NO_LINE: f64 = -1.0;

const SITE_COLOR: Rgb = [20, 20, 20];
const SIZE: [u32; 2] = [1600, 1200];

const EXAMPLES: &str = "\
Examples:
  vorofit features scan.ply -o lines.vtp --picture lines.png
  vorofit features scan.ply -o lines.ply --control-points 400
  vorofit features part.stl -o edges.obj --scale 0.03 --json -";

/// Find the ridges of a surface by colour, its umbilics, and where ridges cross; choose as many as a control mesh shall have points
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The surface: .obj, .ply, .stl or .off
    target: PathBuf,
    /// The lines and points (.vtp, .ply, .obj); can be given several times
    #[arg(short, long, value_name = "FILE", required = true)]
    output: Vec<PathBuf>,
    /// The radius of what is looked at around a vertex, as a share of the diagonal [default: what the noise allows]
    #[arg(long, value_name = "SHARE", value_parser = parse_scale)]
    scale: Option<f64>,
    /// Choose as many features for control points, and write them too
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(4..=1_000_000))]
    control_points: Option<u32>,
    /// Draw the features on the surface (.png)
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// The axis that is upwards in the picture
    #[arg(
        long,
        value_enum,
        default_value_t,
        hide_possible_values = true,
        value_name = "x|y|z"
    )]
    up: AxisName,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        self.check_outputs()?;
        let mut stopwatch = Stopwatch::start();
        let terminal = &session.terminal;
        terminal.stage(&format!("reading {}", self.target.display()));
        let surface = read_surface(&self.target)?;
        let input = surface.mesh.triangulate();
        let frame = Frame::of(&input)?;
        let mesh = topology::oriented(&topology::cleaned(&input));
        stopwatch.lap("read");
        terminal.stage("finding features");
        let device = session.device()?;
        let scale = self.scale.map_or(Scale::Automatic, Scale::Fraction);
        let features = Features::find(device, &mesh, scale)?;
        stopwatch.lap("features");
        let chosen = self
            .control_points
            .map(|n| features.filtered(&mesh, n as usize));
        stopwatch.lap("choose");
        terminal.stage("writing");
        let curves = curves(&features, chosen.as_ref());
        for path in &self.output {
            write_curves(path, &COLUMNS, &curves)?;
        }
        if let Some(path) = &self.picture {
            self.draw(&mesh, &features, chosen.as_ref()).write(path)?;
        }
        stopwatch.lap("write");
        terminal.clear();
        let found = report(&features, chosen.as_ref(), &frame);
        let summary = self.summary(&found);
        let report = Report {
            device: Some(DeviceReport::of(device)),
            target: Some(TargetReport {
                vertices: surface.census.vertices,
                faces: surface.census.faces,
                bbox_diagonal: frame.diagonal,
            }),
            features: Some(found),
            timing: Some(stopwatch.timing()),
            ..Report::new("features")
        };
        session.finish(&report, &summary)?;
        Ok(Outcome::Done)
    }

    fn check_outputs(&self) -> Result<()> {
        self.output.iter().try_for_each(|path| check_curves(path))?;
        if let Some(path) = &self.picture {
            let extension = path.extension();
            if !extension.is_some_and(|e| e.eq_ignore_ascii_case("png")) {
                return Err(Error::file(
                    path,
                    "extension",
                    "pictures are written as PNG",
                    "use .png",
                ));
            }
        }
        let inputs: [&Path; 1] = [&self.target];
        refuse_clashes(self.output.iter().chain(&self.picture), &inputs)
    }

    fn summary(&self, found: &FeatureReport) -> String {
        let mut summary = Summary::default();
        let names = ["red", "blue", "yellow", "green"]
            .into_iter()
            .zip(&found.ridges);
        for (name, lines) in names.chain([("sharp", &found.sharp_edges)]) {
            if lines.count > 0 {
                let (number, length, strength) = (
                    count(lines.count),
                    significant(lines.length, 3),
                    significant(lines.strength, 3),
                );
                let text = format!("{name:7} {number} lines, length {length}, strength {strength}");
                summary.line("ridges", text);
            }
        }
        let umbilics = (
            count(found.elliptic_umbilics),
            count(found.hyperbolic_umbilics),
        );
        summary.line(
            "points",
            format!(
                "{} elliptic and {} hyperbolic umbilics",
                umbilics.0, umbilics.1
            ),
        );
        summary.line(
            "points",
            format!(
                "{} crossings, {} turning points",
                count(found.crossings),
                count(found.turning_points)
            ),
        );
        if let Some(sites) = &found.sites {
            summary.line(
                "chosen",
                format!(
                    "{}: {} umbilics, {} crossings, {} on lines, {} between",
                    count(sites.count),
                    count(sites.umbilics),
                    count(sites.crossings),
                    count(sites.on_lines),
                    count(sites.fill)
                ),
            );
        }
        summary.line(
            "scale",
            format!("{} % of the diagonal", significant(found.scale_percent, 3)),
        );
        for path in self.output.iter().chain(&self.picture) {
            summary.line("wrote", path.display().to_string());
        }
        summary.text()
    }

    /// The chosen sites take the place of umbilics and crossings.
    fn draw(&self, mesh: &TriangleMesh, features: &Features, chosen: Option<&Filtered>) -> Picture {
        let shape = Shape::smooth(mesh);
        let mut layers = Vec::from(ridge_layers(features));
        match chosen {
            Some(chosen) => {
                let sites = chosen.sites.iter().map(|site| site.position);
                layers.push(points("sites", SITE_COLOR, sites));
            }
            None => layers.extend(point_layers(features)),
        }
        let scene = Scene {
            surfaces: vec![(&shape, Paint::Plain(color::TARGET))],
            strokes: layers.into_iter().flat_map(|layer| layer.strokes).collect(),
            legend: None,
        };
        Picture::draw(&scene, &View::with_up(self.up.into()), SIZE)
    }
}

/// Everything as curves of the input's coordinates, lines first.
fn curves(features: &Features, chosen: Option<&Filtered>) -> Vec<Curve> {
    let mut curves: Vec<Curve> = features
        .lines
        .iter()
        .enumerate()
        .map(|(l, line)| line_curve(l, line))
        .collect();
    let point = |name, position, color, values: [f64; 6]| Curve {
        name,
        points: vec![position],
        values: vec![values.to_vec()],
        color,
    };
    curves.extend(features.umbilics.iter().map(|umbilic| {
        let (name, code) = match umbilic.kind {
            UmbilicKind::Elliptic => ("elliptic_umbilic", ELLIPTIC),
            UmbilicKind::Hyperbolic => ("hyperbolic_umbilic", HYPERBOLIC),
        };
        let values = [f64::from(code), NO_LINE, 0.0, umbilic.curvature, 0.0, 0.0];
        point(name, umbilic.position, UMBILIC_COLOR, values)
    }));
    curves.extend(features.crossings.iter().map(|crossing| {
        let values = [
            f64::from(CROSSING),
            NO_LINE,
            crossing.strength,
            0.0,
            0.0,
            0.0,
        ];
        point("crossing", crossing.position, CROSSING_COLOR, values)
    }));
    curves.extend(features.turnings.iter().map(|turning| {
        let values = [
            f64::from(TURNING),
            NO_LINE,
            0.0,
            turning.curvature,
            0.0,
            0.0,
        ];
        point("turning_point", turning.position, SITE_COLOR, values)
    }));
    curves.extend(
        chosen
            .into_iter()
            .flat_map(|chosen| &chosen.sites)
            .map(|site| {
                let values = [f64::from(site.colors), SITE, 0.0, 0.0, 0.0, 0.0];
                point("site", site.position, SITE_COLOR, values)
            }),
    );
    curves
}

fn line_curve(number: usize, line: &Line) -> Curve {
    let name = match (line.is_sharp, line.kind) {
        (true, _) => "sharp_edge",
        (_, Kind::Red) => "red_ridge",
        (_, Kind::Blue) => "blue_ridge",
        (_, Kind::Yellow) => "yellow_ridge",
        (_, Kind::Green) => "green_ridge",
    };
    let flag = |is: bool| f64::from(u8::from(is));
    Curve {
        name,
        points: line.points.iter().map(|point| point.position).collect(),
        values: line
            .points
            .iter()
            .map(|point| {
                let kind = f64::from(line.kind.code());
                vec![
                    kind,
                    number as f64,
                    line.strength,
                    point.curvature,
                    flag(point.is_crest),
                    flag(line.is_sharp),
                ]
            })
            .collect(),
        color: ridge_color(line.kind),
    }
}

fn report(features: &Features, chosen: Option<&Filtered>, frame: &Frame) -> FeatureReport {
    let lines = |is: &dyn Fn(&Line) -> bool| {
        let mut sum = LineReport::default();
        for line in features.lines.iter().filter(|line| is(line)) {
            sum.count += 1;
            sum.length += line.length();
            sum.strength += line.strength;
        }
        sum
    };
    let umbilics = |kind| features.umbilics.iter().filter(|u| u.kind == kind).count();
    let sites = chosen.map(|chosen| {
        let number =
            |is: fn(&Origin) -> bool| chosen.sites.iter().filter(|site| is(&site.origin)).count();
        SiteReport {
            count: chosen.sites.len(),
            umbilics: number(|origin| matches!(origin, Origin::Umbilic(_))),
            crossings: number(|origin| matches!(origin, Origin::Crossing(_))),
            on_lines: number(|origin| matches!(origin, Origin::Line(_))),
            fill: number(|origin| matches!(origin, Origin::Vertex(_))),
            least_strength: chosen.strength,
            least_curvature: chosen.curvature,
        }
    });
    FeatureReport {
        scale_percent: 100.0 * features.radius / frame.diagonal,
        ridges: KINDS.map(|kind| lines(&|line| line.kind == kind && !line.is_sharp)),
        sharp_edges: lines(&|line| line.is_sharp),
        elliptic_umbilics: umbilics(UmbilicKind::Elliptic),
        hyperbolic_umbilics: umbilics(UmbilicKind::Hyperbolic),
        crossings: features.crossings.len(),
        turning_points: features.turnings.len(),
        sites,
    }
}

fn parse_scale(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x > 0.0 && x <= 0.25, "above 0 and up to 0.25")
}
