//! Which template pays with which method: errors in percent of the diagonal, and seconds, for some numbers of control points.
//!
//! `cargo bench --bench templates [-- SCAN…]`, tables as Markdown, for the scans whose names contain one of the words. Errors are two-sided, of the dense surface by area samples; the time is that of template and fit, without reading. All
//! surfaces are Loop's, but that of the automatic template fitted by Voronoi squared distances, which is Catmull–Clark's as by default. The distance of
//! ridges is that between the strongest lines of scan and surface, of the same length together, in the mean both ways. Then the figures of surfaces through
//! networks, vertices to faces both ways, medians of five seeds (which ridges do not depend on).

use glam::DVec3;
use std::path::{Path, PathBuf};
use std::time::Instant;
use vorofit::Result;
use vorofit::device::Device;
use vorofit::features::{Features, Scale};
use vorofit::files::read_surface;
use vorofit::fit::geometric::{self, Data};
use vorofit::fit::{Fit, Interpolation, Options, Start, Target, Template, fit, interpolate};
use vorofit::geometry::Bvh;
use vorofit::measure::surface_error;
use vorofit::mesh::{ControlMesh, Frame, Scheme, TriangleMesh};
use vorofit::progress::Silent;
use vorofit::template::{Genus, automatic};

/// Area samples a side.
const SAMPLES: usize = 200_000;

/// The length of the ridges that are compared, in diagonals.
const RIDGES: f64 = 8.0;

/// Subdivisions to the surface that is judged.
const LEVELS: usize = 3;

/// A scan, with the number of points that a network is judged by.
const SCANS: [(&str, usize); 4] = [
    ("stanford-bunny.obj", 381),
    ("rocker-arm.obj", 239),
    ("igea.ply", 383),
    ("fertility.obj", 354),
];
const COUNTS: [usize; 3] = [250, 381, 1000];
const TEMPLATES: [&str; 4] = ["simplify", "ridges", "adaptive", "auto"];
const METHODS: [&str; 3] = ["interpolate", "geometric", "vsdm"];

/// Seeds that a median is taken over.
const SEEDS: u64 = 5;

fn main() -> Result<()> {
    let data = std::env::var_os("VOROFIT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let wanted: Vec<String> = std::env::args()
        .skip(1)
        .filter(|a| !a.starts_with('-'))
        .collect();
    println!(
        "| scan | asked | template | method | points | max % | rms % | mean % | ridges % | s |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    for (name, _) in chosen(&wanted) {
        let Some(scan) = unit_scan(&data, name)? else {
            continue;
        };
        let lines = ridge_points(&scan)?;
        for count in COUNTS {
            for template in TEMPLATES {
                for method in METHODS {
                    if let Err(problem) =
                        row(name, (&scan, lines.as_slice()), count, template, method)
                    {
                        println!(
                            "| {name} | {count} | {template} | {method} | {problem} | | | | | |"
                        );
                    }
                }
            }
        }
    }
    println!("\n| surface through | template | points | refined | H % | mean % | s |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    for (name, count) in chosen(&wanted) {
        if let Some(scan) = unit_scan(&data, name)? {
            for template in ["ridges", "adaptive"] {
                for refinements in 0..2 {
                    figures(name, &scan, template, count, refinements)?;
                }
            }
        }
    }
    Ok(())
}

fn chosen(wanted: &[String]) -> impl Iterator<Item = (&'static str, usize)> + '_ {
    let is_wanted = |name: &str| wanted.is_empty() || wanted.iter().any(|w| name.contains(w));
    SCANS.into_iter().filter(move |(name, _)| is_wanted(name))
}

/// A scan in the unit frame, or a word that there is none.
fn unit_scan(data: &Path, name: &str) -> Result<Option<TriangleMesh>> {
    let path = data.join("surfaces").join(name);
    if !path.exists() {
        println!("skipped: there is no {}", path.display());
        return Ok(None);
    }
    let mut scan = read_surface(&path)?.mesh.triangulate();
    let frame = Frame::of(&scan)?;
    for p in &mut scan.positions {
        *p = frame.to_unit(*p);
    }
    Ok(Some(scan))
}

/// Fits one cell of the table and prints it.
fn row(
    name: &str,
    (scan, lines): (&TriangleMesh, &[DVec3]),
    count: usize,
    template: &str,
    method: &str,
) -> Result<()> {
    let begun = Instant::now();
    let fitted = match method {
        "vsdm" => voronoi(scan, count, template)?,
        _ => near(scan, count, template, method)?,
    };
    let seconds = begun.elapsed().as_secs_f64();
    let surface = fitted.surface.triangulate();
    let error = surface_error(scan, &surface, SAMPLES)?;
    let found = ridge_points(&surface)?;
    let apart = 50.0 * (mean_gap(lines, &found) + mean_gap(&found, lines));
    let larger = |figure: fn(&vorofit::measure::Figures) -> f64| {
        100.0 * figure(&error.target_to_surface).max(figure(&error.surface_to_target))
    };
    println!(
        "| {name} | {count} | {template} | {method} | {} | {:.3} | {:.4} | {:.4} | {apart:.3} | {seconds:.1} |",
        fitted.control.mesh.positions.len(),
        larger(|f| f.max),
        larger(|f| f.rms),
        larger(|f| f.mean),
    );
    Ok(())
}

/// The points of the strongest ridges.
fn ridge_points(surface: &TriangleMesh) -> Result<Vec<DVec3>> {
    let features = Features::find(&Device::Cpu, surface, Scale::default())?;
    let mut length = 0.0;
    let strongest = features.lines.iter().take_while(|line| {
        let before = length;
        length += line.length();
        before < RIDGES
    });
    Ok(strongest
        .flat_map(|line| line.points.iter().map(|point| point.position))
        .collect())
}

/// The mean distance of points from the nearest of others.
fn mean_gap(from: &[DVec3], to: &[DVec3]) -> f64 {
    let nearest = |p: &DVec3| {
        to.iter()
            .map(|q| p.distance(*q))
            .fold(f64::INFINITY, f64::min)
    };
    from.iter().map(nearest).sum::<f64>() / from.len() as f64
}

fn voronoi(scan: &TriangleMesh, control_points: usize, template: &str) -> Result<Fit> {
    let target = Target::new(&Device::Cpu, scan)?;
    let (template, scheme) = match template {
        "simplify" => (Template::Simplified { control_points }, Scheme::Loop),
        "ridges" => (
            Template::Ridges {
                control_points,
                flips: false,
            },
            Scheme::Loop,
        ),
        "adaptive" => (
            Template::Adaptive {
                control_points,
                seed: 0,
            },
            Scheme::Loop,
        ),
        _ => (
            Template::Automatic {
                control_points,
                genus: Genus::default(),
            },
            Scheme::CatmullClark,
        ),
    };
    let options = Options {
        scheme,
        levels: LEVELS,
        ..Options::default()
    };
    let start = Start::new(&target, &template, scheme)?;
    fit(&Device::Cpu, &target, start, &options, &Silent)
}

/// By a method that starts on the scan.
fn near(scan: &TriangleMesh, count: usize, template: &str, method: &str) -> Result<Fit> {
    let data = Data::of_mesh(scan, None, 0)?;
    let control = match template {
        "simplify" => {
            let start = geometric::Start::Simplified(Some(count));
            data.control_mesh(&Device::Cpu, &start, &Silent)?
        }
        "ridges" | "adaptive" => network(&data, template, count, 0)?,
        _ => {
            let target = Target::new(&Device::Cpu, scan)?;
            let control = automatic(&target.mesh, count, Genus::default(), target.holes)?.control;
            ControlMesh {
                mesh: control.mesh.triangulate().into(),
                ..control
            }
        }
    };
    if method == "interpolate" {
        let options = Interpolation {
            refinements: 0,
            levels: LEVELS,
        };
        return interpolate(&data, control, &options, &Silent);
    }
    let options = geometric::Options {
        levels: LEVELS,
        ..geometric::Options::default()
    };
    geometric::fit(&Device::Cpu, &data, control, &options, &Silent)
}

fn network(data: &Data, template: &str, count: usize, seed: u64) -> Result<ControlMesh> {
    let control_points = Some(count);
    let start = match template {
        "ridges" => geometric::Start::Ridges {
            control_points,
            flips: false,
        },
        _ => geometric::Start::Adaptive {
            control_points,
            seed,
        },
    };
    data.control_mesh(&Device::Cpu, &start, &Silent)
}

/// Prints the medians for surfaces through networks whose edges are halved so often.
fn figures(
    name: &str,
    scan: &TriangleMesh,
    template: &str,
    count: usize,
    refinements: usize,
) -> Result<()> {
    let data = Data::of_mesh(scan, None, 0)?;
    let mut found = Vec::new();
    let mut points = 0;
    for seed in 0..SEEDS {
        let begun = Instant::now();
        let options = Interpolation {
            refinements,
            levels: LEVELS,
        };
        let control = network(&data, template, count, seed)?;
        let fitted = interpolate(&data, control, &options, &Silent)?;
        let seconds = begun.elapsed().as_secs_f64();
        points = fitted.control.mesh.positions.len();
        let [largest, mean] = vertex_errors(scan, &fitted.surface.triangulate())?;
        found.push([largest, mean, seconds]);
    }
    let median = |k: usize| {
        let mut values: Vec<f64> = found.iter().map(|f| f[k]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    println!(
        "| {name} | {template} | {points} | {refinements} | {:.3} | {:.4} | {:.2} |",
        median(0),
        median(1),
        median(2)
    );
    Ok(())
}

/// The largest distance and the mean one, vertices to faces both ways, in percent.
fn vertex_errors(a: &TriangleMesh, b: &TriangleMesh) -> Result<[f64; 2]> {
    let one_way = |points: &TriangleMesh, faces: &TriangleMesh| -> Result<[f64; 2]> {
        let found = Bvh::new(&faces.positions, &faces.triangles)?.closest_all(&points.positions);
        let far = found.iter().map(|c| 100.0 * c.distance_squared.sqrt());
        let mean = far.clone().sum::<f64>() / found.len() as f64;
        Ok([far.fold(0.0, f64::max), mean])
    };
    let (forth, back) = (one_way(a, b)?, one_way(b, a)?);
    Ok([forth[0].max(back[0]), 0.5 * (forth[1] + back[1])])
}
