//! `vorofit render`: a picture of a surface.

use super::Outcome;
use super::choices::Switch;
use super::outputs::refuse_clashes;
use super::session::Session;
use super::text::{Summary, count, parse_number};
use clap::ValueEnum;
use glam::DVec3;
use std::path::{Path, PathBuf};
use vorofit::features::{self, Features};
use vorofit::files::{read_error, read_surface};
use vorofit::measure;
use vorofit::mesh::{Frame, PolygonMesh};
use vorofit::picture::{
    Axis, LARGEST_SIDE, Legend, Paint, Picture, Scale, Scene, Shape, Strokes, View, color,
};
use vorofit::report::feature_layers::{point_layers, ridge_layers};
use vorofit::report::{Report, ResultReport, Stopwatch, TargetReport};
use vorofit::{Error, Result, topology};

/// Meshes of more faces than this are drawn without their edges, which would be all that is seen.
const DISTINCT_FACES: usize = 8000;
/// The width of an edge against the picture's shorter side.
const EDGE_WIDTH: f64 = 0.0018;

const EXAMPLES: &str = "\
Examples:
  vorofit render control.obj -o cage.png
  vorofit render surface.ply --target scan.ply -o error.png --size 2400x1800
  vorofit render scan.ply --features -o ridges.png
  vorofit render part.stl -o part.png --up z --from 1,-2,0.5";

/// Make a picture of a surface (PNG), with its distance to a target as colours
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The surface: .obj, .ply, .stl, .off or .usda. One with few faces is shown with its edges; a .ply with an error per vertex is coloured by it
    mesh: PathBuf,
    /// The picture (.png)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Colour the surface by its distance to this one
    #[arg(long, value_name = "FILE")]
    target: Option<PathBuf>,
    /// Draw its ridges (by colour), sharp edges, umbilics and crossings, as `vorofit features` finds them
    #[arg(long)]
    features: bool,
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", default_value = "1200x900", value_parser = parse_size)]
    size: [u32; 2],
    /// The axis that is upwards
    #[arg(
        long,
        value_enum,
        default_value_t,
        hide_possible_values = true,
        value_name = "x|y|z"
    )]
    up: AxisName,
    /// The direction towards the eye [default: from the front, a little to the right and above]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_direction)]
    from: Option<DVec3>,
    /// Whether the edges of the faces are drawn [default: on up to 8000 faces, off with --features]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "on|off")]
    edges: Option<Switch>,
    /// The distance of the last colour, in percent of the diagonal [default: what 99 % of the vertices are under]
    #[arg(long, value_name = "%", value_parser = parse_scale)]
    scale: Option<f64>,
}

/// [`Axis`] on the command line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum AxisName {
    X,
    #[default]
    Y,
    Z,
}

impl From<AxisName> for Axis {
    fn from(name: AxisName) -> Self {
        match name {
            AxisName::X => Self::X,
            AxisName::Y => Self::Y,
            AxisName::Z => Self::Z,
        }
    }
}

/// Distances in percent of a diagonal, and whose that is.
struct Distances {
    percent: Vec<f64>,
    target: Option<TargetReport>,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        self.check_output()?;
        let mut stopwatch = Stopwatch::start();
        let terminal = &session.terminal;
        terminal.stage(&format!("reading {}", self.mesh.display()));
        let mesh = read_surface(&self.mesh)?.mesh;
        stopwatch.lap("read");
        terminal.stage("measuring the distances");
        let distances = self.distances(&mesh)?;
        stopwatch.lap("measure");
        let mut strokes = Vec::new();
        if self.features {
            terminal.stage("finding features");
            strokes = feature_strokes(session, &mesh)?;
            stopwatch.lap("features");
        }
        terminal.stage("drawing");
        self.picture(&mesh, distances.as_ref(), strokes)
            .write(&self.output)?;
        stopwatch.lap("draw");
        terminal.clear();
        let report = Report {
            target: distances.and_then(|d| d.target),
            result: Some(ResultReport {
                surface_vertices: mesh.positions.len(),
                surface_faces: mesh.face_count(),
                ..Default::default()
            }),
            timing: Some(stopwatch.timing()),
            ..Report::new("render")
        };
        let mut summary = Summary::default();
        let [width, height] = self.size;
        let output = self.output.display();
        let (vertices, faces) = (count(mesh.positions.len()), count(mesh.face_count()));
        summary.line(
            "wrote",
            format!("{output}   {width} × {height} pixels: {vertices} vertices, {faces} faces"),
        );
        session.finish(&report, &summary.text())?;
        Ok(Outcome::Done)
    }

    fn check_output(&self) -> Result<()> {
        let extension = self.output.extension();
        if !extension.is_some_and(|e| e.eq_ignore_ascii_case("png")) {
            return Err(Error::file(
                &self.output,
                "extension",
                "pictures are written as PNG",
                "use .png",
            ));
        }
        let inputs = [Some(self.mesh.as_path()), self.target.as_deref()];
        let inputs: Vec<&Path> = inputs.into_iter().flatten().collect();
        refuse_clashes(std::iter::once(&self.output), &inputs)
    }

    /// What to colour the surface by: the distance to the target or, without one, what its file says.
    fn distances(&self, mesh: &PolygonMesh) -> Result<Option<Distances>> {
        let Some(path) = &self.target else {
            let frame = Frame::of(&mesh.triangulate())?;
            let percent = |error: f64| 100.0 * error.abs() / frame.diagonal;
            let errors = read_error(&self.mesh)?;
            return Ok(errors.map(|errors| Distances {
                percent: errors.into_iter().map(percent).collect(),
                target: None,
            }));
        };
        let target = read_surface(path)?;
        let mut triangles = target.mesh.triangulate();
        let frame = Frame::of(&triangles)?;
        for p in &mut triangles.positions {
            *p = frame.to_unit(*p);
        }
        let points: Vec<_> = mesh.positions.iter().map(|&p| frame.to_unit(p)).collect();
        let distances = measure::distances(&triangles, &points)?;
        Ok(Some(Distances {
            percent: distances.into_iter().map(|d| 100.0 * d).collect(),
            target: Some(TargetReport {
                vertices: target.census.vertices,
                faces: target.census.faces,
                bbox_diagonal: frame.diagonal,
            }),
        }))
    }

    fn picture(
        &self,
        mesh: &PolygonMesh,
        distances: Option<&Distances>,
        strokes: Vec<Strokes>,
    ) -> Picture {
        let with_edges = match self.edges {
            Some(switch) => switch == Switch::On,
            None => mesh.face_count() <= DISTINCT_FACES && !self.features,
        };
        let shape = match with_edges {
            true => Shape::faceted(mesh),
            false => Shape::smooth(&mesh.triangulate()),
        };
        let mut scene = Scene {
            strokes,
            ..Scene::default()
        };
        let values: Vec<f64>;
        let mut paint = Paint::Plain(if with_edges {
            color::CAGE
        } else {
            color::TARGET
        });
        if let Some(Distances { percent, .. }) = distances {
            let scale = Scale::up_to(self.scale.unwrap_or_else(|| most(percent)));
            values = percent.iter().map(|x| x / scale.top).collect();
            paint = Paint::Values(&values);
            scene.legend = Some(Legend {
                title: "% of the diagonal".into(),
                exceeded: percent.iter().any(|&x| x > scale.top),
                scale,
            });
        }
        scene.surfaces.push((&shape, paint));
        if with_edges {
            let [width, height] = self.size.map(f64::from);
            let width = (EDGE_WIDTH * width.min(height)).max(1.3);
            scene.strokes.push(Strokes::edges(mesh, width));
        }
        let up: Axis = self.up.into();
        let usual = View::with_up(up);
        let view = View {
            from: self.from.unwrap_or(usual.from),
            ..usual
        };
        Picture::draw(&scene, &view, self.size)
    }
}

/// The features of a surface as lines and points.
fn feature_strokes(session: &Session, mesh: &PolygonMesh) -> Result<Vec<Strokes>> {
    let mesh = topology::oriented(&topology::cleaned(&mesh.triangulate()));
    let features = Features::find(session.device()?, &mesh, features::Scale::Automatic)?;
    let layers = ridge_layers(&features).into_iter();
    let layers = layers.chain(point_layers(&features));
    Ok(layers.flat_map(|layer| layer.strokes).collect())
}

/// What 99 % of the numbers are under.
fn most(numbers: &[f64]) -> f64 {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
        .get(99 * sorted.len() / 100)
        .copied()
        .unwrap_or_default()
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let side = |text: &str| {
        let n = text.trim().parse().ok();
        n.filter(|n| (16..=LARGEST_SIDE).contains(n))
    };
    let sides = text.split_once(['x', '×']);
    match sides.map(|(width, height)| (side(width), side(height))) {
        Some((Some(width), Some(height))) => Ok([width, height]),
        _ => Err(format!(
            "give width x height, each from 16 to {LARGEST_SIDE}"
        )),
    }
}

fn parse_direction(text: &str) -> Result<DVec3, String> {
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|word| word.trim().parse().ok())
        .collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => match DVec3::new(x, y, z).try_normalize() {
            Some(direction) => Ok(direction),
            None => Err("give a direction that is not 0".into()),
        },
        _ => Err("give three numbers".into()),
    }
}

fn parse_scale(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x > 0.0, "above 0")
}
