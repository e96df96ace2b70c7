//! `vorofit template`: where a fit may start, made step by step.

use super::Outcome;
use super::job::{in_file, warn_of_flaws};
use super::outputs::refuse_clashes;
use super::session::Session;
use super::text::{Summary, count, parse_number, significant};
use super::volume_file::Reading;
use clap::Subcommand;
use glam::DVec3;
use std::path::{Path, PathBuf};
use vorofit::files::{
    SurfaceToWrite, VolumeToWrite, check_volume_writable, check_writable, read_surface,
    write_surface, write_volume,
};
use vorofit::measure::scaled_jacobian::qualities;
use vorofit::mesh::{
    ControlMesh, NodalVolume, PolygonMesh, Scheme, TriangleMesh, VolumeMesh, shapes,
};
use vorofit::model::element::Basis;
use vorofit::model::volume::CurvedVolume;
use vorofit::report::{QualityReport, Report, ResultReport, Stopwatch};
use vorofit::template::volume::{self, Course};
use vorofit::template::{self, Axis};
use vorofit::topology;
use vorofit::{Error, Result};

const EXAMPLES: &str = "\
Examples:
  vorofit template grid scan.ply --cells 12x8x8 -o grid.vtu
  vorofit template carve grid.vtu --target scan.ply -o carved.vtu
  vorofit template pillow carved.vtu -o pillowed.vtu
  vorofit template collapse carved.vtu --face 0,1,14,13 -o rounded.vtu
  vorofit template extrude quads.obj --along 0,0,2 --layers 3 -o slab.vtu
  vorofit template auto scan.ply --elements 400 -o template.vtu
  vorofit template torus ring.stl --control-points 512 -o cage.obj";

/// The largest grid.
const MOST_CELLS: u64 = 10_000_000;

/// Make the mesh that a fit starts from: grids, edits that lead from one to the next, and whole templates
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(subcommand)]
    operation: Operation,
}

#[derive(Debug, Subcommand)]
enum Operation {
    /// A box of hexahedra: a target's, or the one between two points
    Grid {
        /// The scan whose bounding box is filled
        #[arg(required_unless_present = "between")]
        target: Option<PathBuf>,
        /// Two opposite corners of the box
        #[arg(long, conflicts_with = "target", allow_hyphen_values = true, value_name = "X,Y,Z,X,Y,Z", value_parser = parse_numbers::<6>)]
        between: Option<[f64; 6]>,
        /// Hexahedra along x, y and z
        #[arg(long, value_name = "AxBxC", value_parser = parse_cells)]
        cells: [u32; 3],
        #[command(flatten)]
        output: VolumeOutput,
    },
    /// Drop the cells outside of a target; what stays is one piece, without cavities, with a manifold for its boundary
    Carve {
        #[command(flatten)]
        input: VolumeInput,
        /// The scan
        #[arg(long, value_name = "FILE")]
        target: PathBuf,
        /// The share of a cell that must be inside, in percent
        #[arg(long, default_value = "50", value_name = "%", value_parser = parse_percent)]
        inside: f64,
        #[command(flatten)]
        output: VolumeOutput,
    },
    /// Put a layer of cells under the boundary, so that no cell has two faces there
    Pillow {
        #[command(flatten)]
        input: VolumeInput,
        /// How thick the layer is, in edges of the boundary
        #[arg(long, default_value = "0.35", value_name = "SHARE", value_parser = parse_share)]
        depth: f64,
        #[command(flatten)]
        output: VolumeOutput,
    },
    /// Make one vertex of both ends of edges; hexahedra that lose two edges are prisms then
    Collapse {
        #[command(flatten)]
        input: VolumeInput,
        /// An edge by its vertices, counted from 0; may be repeated
        #[arg(long, value_name = "A,B", value_parser = parse_indices::<2>, required_unless_present = "face")]
        edge: Vec<[u32; 2]>,
        /// A quad by its corners in turn: its edge from the first to the second goes, and those like it in the strip of quads to both sides; may be repeated
        #[arg(long, value_name = "A,B,C,D", value_parser = parse_indices::<4>)]
        face: Vec<[u32; 4]>,
        #[command(flatten)]
        output: VolumeOutput,
    },
    /// Make layers of cells over a surface of quads and triangles
    Extrude {
        /// The surface: .obj, .ply, .stl, .off or .usda
        surface: PathBuf,
        /// How far over its faces; below 0 inwards
        #[arg(long, allow_hyphen_values = true, value_name = "D", value_parser = parse_distance, required_unless_present = "along")]
        distance: Option<f64>,
        /// By this vector instead
        #[arg(long, allow_hyphen_values = true, value_name = "X,Y,Z", value_parser = parse_numbers::<3>, conflicts_with = "distance")]
        along: Option<[f64; 3]>,
        /// The number of layers
        #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
        layers: u32,
        #[command(flatten)]
        output: VolumeOutput,
    },
    /// Hexahedra in a target with its handles: what `volume` starts from
    Auto {
        /// The scan
        target: PathBuf,
        /// About how many hexahedra
        #[arg(long, default_value_t = volume::ELEMENTS, value_name = "N", value_parser = parse_elements)]
        elements: usize,
        #[command(flatten)]
        output: VolumeOutput,
    },
    /// A target's bounding box of quads
    Bbox(Cage),
    /// A torus of quads around a target's widest hole
    Torus(Cage),
}

#[derive(Debug, clap::Args)]
struct VolumeInput {
    /// The mesh: Medit (.mesh, .meshb), MFEM (.mesh), legacy VTK (.vtk), .vtu or Gmsh 4.1 (.msh)
    mesh: PathBuf,
    #[command(flatten)]
    reading: Reading,
}

#[derive(Debug, clap::Args)]
struct VolumeOutput {
    /// Write the mesh (.vtu, MFEM's .mesh or Gmsh's .msh)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

#[derive(Debug, clap::Args)]
struct Cage {
    /// The scan
    target: PathBuf,
    /// About how many control points
    #[arg(long, default_value_t = 386, value_name = "N", value_parser = parse_points)]
    control_points: usize,
    /// Write the mesh (.obj, .ply, .off or .usda)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// What an operation makes.
enum Made {
    Volume(VolumeMesh),
    Cage(ControlMesh),
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        let mut stopwatch = Stopwatch::start();
        self.operation.check()?;
        let made = self.operation.make(session)?;
        stopwatch.lap("template");
        let output = self.operation.output();
        let report = match made {
            Made::Volume(mesh) => {
                write_volume(output, &VolumeToWrite::new(&NodalVolume::from(&mesh)))?;
                of_volume(&mesh)?
            }
            Made::Cage(control) => {
                let surface = SurfaceToWrite::control(&control, Scheme::CatmullClark);
                write_surface(output, &surface)?;
                of_cage(&control)
            }
        };
        stopwatch.lap("write");
        session.terminal.clear();
        let report = Report {
            timing: Some(stopwatch.timing()),
            ..report
        };
        session.finish(&report, &summary(output, &report))?;
        Ok(Outcome::Done)
    }
}

impl Operation {
    /// Refuses, before any work, what could not be written after it.
    fn check(&self) -> Result<()> {
        let (input, output) = (self.input(), self.output());
        match self {
            Self::Bbox(_) | Self::Torus(_) => {
                let triangle = ControlMesh::from(PolygonMesh::from(shapes::sphere(1.0, 0)));
                let surface = SurfaceToWrite::control(&triangle, Scheme::CatmullClark);
                check_writable(output, &surface)?;
            }
            _ => {
                let cube = volume::grid(DVec3::ZERO, DVec3::ONE, [1; 3]);
                let nodes = NodalVolume::from(&cube);
                check_volume_writable(output, &VolumeToWrite::new(&nodes))?;
            }
        }
        let inputs: Vec<&Path> = input.into_iter().collect();
        refuse_clashes(std::iter::once(output), &inputs)
    }

    fn input(&self) -> Option<&Path> {
        match self {
            Self::Grid { target, .. } => target.as_deref(),
            Self::Carve { input, .. }
            | Self::Pillow { input, .. }
            | Self::Collapse { input, .. } => Some(&input.mesh),
            Self::Extrude { surface, .. } => Some(surface),
            Self::Auto { target, .. } => Some(target),
            Self::Bbox(cage) | Self::Torus(cage) => Some(&cage.target),
        }
    }

    fn output(&self) -> &PathBuf {
        match self {
            Self::Grid { output, .. }
            | Self::Carve { output, .. }
            | Self::Pillow { output, .. }
            | Self::Collapse { output, .. }
            | Self::Extrude { output, .. }
            | Self::Auto { output, .. } => &output.output,
            Self::Bbox(cage) | Self::Torus(cage) => &cage.output,
        }
    }

    fn make(&self, session: &Session) -> Result<Made> {
        let volume = match self {
            Self::Bbox(cage) => return cage.bounding_box(session).map(Made::Cage),
            Self::Torus(cage) => return cage.torus(session).map(Made::Cage),
            Self::Grid {
                target,
                between,
                cells,
                ..
            } => grid(session, target.as_deref(), *between, *cells),
            Self::Carve {
                input,
                target,
                inside,
                ..
            } => {
                let mesh = input.read(session)?;
                let target = read_target(session, target)?;
                session.terminal.stage("carving");
                volume::carve(&mesh, &target, 0.01 * inside)
            }
            Self::Pillow { input, depth, .. } => volume::pillow(&input.read(session)?, *depth),
            Self::Collapse {
                input, edge, face, ..
            } => collapse(&input.read(session)?, edge, face),
            Self::Extrude {
                surface,
                distance,
                along,
                layers,
                ..
            } => {
                let course = match (along, distance) {
                    (Some(vector), _) => Course::Along(DVec3::from(*vector)),
                    (None, distance) => Course::Normals(distance.unwrap_or_default()),
                };
                volume::extrude(&read_surface(surface)?.mesh, course, *layers)
            }
            Self::Auto {
                target, elements, ..
            } => {
                let target = read_target(session, target)?;
                session.terminal.stage("carving and relaxing grids");
                volume::automatic(&topology::oriented(&target), *elements)
            }
        };
        let named = |error| match self.input() {
            Some(path) => in_file(error, path, "mesh"),
            None => error,
        };
        Ok(Made::Volume(volume.map_err(named)?))
    }
}

impl Cage {
    fn bounding_box(&self, session: &Session) -> Result<ControlMesh> {
        let target = read_target(session, &self.target)?;
        let (lo, hi) = target.bounding_box().unwrap_or_default();
        Ok(template::bounding_box(lo, hi, self.control_points))
    }

    fn torus(&self, session: &Session) -> Result<ControlMesh> {
        let target = read_target(session, &self.target)?;
        template::torus(&target, Axis::Inertia, self.control_points)
            .map_err(|e| in_file(e, &self.target, "mesh"))
    }
}

impl VolumeInput {
    fn read(&self, session: &Session) -> Result<VolumeMesh> {
        let path = self.mesh.display();
        session.terminal.stage(&format!("reading {path}"));
        Ok(self.reading.read(session, &self.mesh)?.mesh)
    }
}

fn read_target(session: &Session, path: &Path) -> Result<TriangleMesh> {
    session
        .terminal
        .stage(&format!("reading {}", path.display()));
    let target = read_surface(path)?;
    warn_of_flaws(session, path, &target.census);
    Ok(target.mesh.triangulate())
}

fn grid(
    session: &Session,
    target: Option<&Path>,
    between: Option<[f64; 6]>,
    cells: [u32; 3],
) -> Result<VolumeMesh> {
    let bounds = match (between, target) {
        (Some([a, b, c, d, e, f]), _) => {
            let (one, other) = (DVec3::new(a, b, c), DVec3::new(d, e, f));
            Some((one.min(other), one.max(other)))
        }
        (None, Some(path)) => read_target(session, path)?.bounding_box(),
        (None, None) => None,
    };
    let (lo, hi) = bounds.unwrap_or_default();
    if !(hi - lo).cmpgt(DVec3::ZERO).all() {
        return Err(Error::input(
            "the box has no volume",
            "give two opposite corners of a box",
        ));
    }
    Ok(volume::grid(lo, hi, cells))
}

fn collapse(mesh: &VolumeMesh, edges: &[[u32; 2]], faces: &[[u32; 4]]) -> Result<VolumeMesh> {
    let mut all = edges.to_vec();
    for &face in faces {
        all.extend(volume::strip(mesh, face)?);
    }
    volume::collapse(mesh, &all)
}

fn of_volume(mesh: &VolumeMesh) -> Result<Report> {
    let qualities = qualities(&CurvedVolume::new(mesh, Basis::Legendre)?);
    let mean = qualities.iter().map(|q| q.mean).sum::<f64>() / qualities.len() as f64;
    let least = qualities.iter().map(|q| q.min);
    Ok(Report {
        result: Some(ResultReport {
            elements: Some(mesh.cell_count()),
            order: Some(1),
            nodes: Some(mesh.positions.len()),
            ..ResultReport::default()
        }),
        // Edits that would leave an invalid cell are refused.
        quality: Some(QualityReport {
            scaled_jacobian_mean: mean,
            scaled_jacobian_min: least.fold(f64::INFINITY, f64::min),
            invalid: 0,
            undecided: 0,
        }),
        ..Report::new("template")
    })
}

fn of_cage(control: &ControlMesh) -> Report {
    Report {
        result: Some(ResultReport {
            control_points: Some(control.mesh.positions.len()),
            control_faces: Some(control.mesh.face_count()),
            ..ResultReport::default()
        }),
        ..Report::new("template")
    }
}

fn summary(output: &Path, report: &Report) -> String {
    let mut summary = Summary::default();
    let result = report.result.clone().unwrap_or_default();
    let of = |n: Option<usize>| count(n.unwrap_or_default());
    let content = match result.elements {
        Some(elements) => format!(
            "{} elements, {} vertices",
            count(elements),
            of(result.nodes)
        ),
        None => format!(
            "{} control points, {} faces",
            of(result.control_points),
            of(result.control_faces)
        ),
    };
    summary.line("wrote", format!("{}   {content}", output.display()));
    if let Some(quality) = &report.quality {
        summary.line(
            "quality",
            format!(
                "all valid; scaled Jacobian at least {}, mean {}",
                significant(quality.scaled_jacobian_min, 3),
                significant(quality.scaled_jacobian_mean, 3)
            ),
        );
    }
    summary.text()
}

fn parse_cells(text: &str) -> Result<[u32; 3], String> {
    let counts: Option<Vec<u32>> = text
        .split('x')
        .map(|n| n.parse().ok().filter(|n| (1..=1000).contains(n)))
        .collect();
    let product = |c: &[u32]| c.iter().map(|&n| u64::from(n)).product::<u64>();
    match counts.as_deref() {
        Some(&[a, b, c]) if product(&[a, b, c]) <= MOST_CELLS => Ok([a, b, c]),
        _ => Err("give three counts from 1 to 1000, as 4x2x2, for 10 million cells at most".into()),
    }
}

fn parse_numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let numbers: Result<Vec<f64>, _> = text
        .split(',')
        .map(|word| parse_number(word.trim(), |_| true, ""))
        .collect();
    numbers
        .ok()
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| format!("give {N} numbers with commas between them"))
}

fn parse_indices<const N: usize>(text: &str) -> Result<[u32; N], String> {
    let indices: Result<Vec<u32>, _> = text.split(',').map(|word| word.trim().parse()).collect();
    indices
        .ok()
        .and_then(|indices| indices.try_into().ok())
        .ok_or_else(|| format!("give {N} vertices with commas between them, counted from 0"))
}

fn parse_percent(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x > 0.0 && x <= 100.0, "above 0 and up to 100")
}

fn parse_share(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x > 0.0 && x < 1.0, "between 0 and 1")
}

fn parse_distance(text: &str) -> Result<f64, String> {
    parse_number(text, |x| x != 0.0, "other than 0")
}

fn parse_points(text: &str) -> Result<usize, String> {
    let points = text.parse().ok().filter(|n| (8..=10_000_000).contains(n));
    points.ok_or_else(|| "give a number from 8 to 10000000".into())
}

/// Counts of elements of automatic templates.
pub fn parse_elements(text: &str) -> Result<usize, String> {
    let most = volume::MOST_ELEMENTS;
    let elements = text.parse().ok().filter(|n| (1..=most).contains(n));
    elements.ok_or_else(|| format!("give a number from 1 to {most}"))
}
