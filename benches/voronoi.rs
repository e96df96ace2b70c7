//! The Voronoi terms on the CPU: milliseconds (best of many) of F_T→S and its gradient on the bunny, candidates and clip anew each
//! time, beside 0.7 of geogram's on one thread; the same of both terms for surfaces fitted to it; and how the cost and memory of a
//! whole evaluation grow with the size of target and model.
//!
//! `RAYON_NUM_THREADS=1 cargo bench --bench voronoi`

use glam::DVec3;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::time::Instant;
use vorofit::device::Device;
use vorofit::error::Result;
use vorofit::files::read_surface;
use vorofit::fit::{Options, Start, Target, Template, fit};
use vorofit::geometry::triangle_tree::{TriangleTree, spatial_order};
use vorofit::kernel::candidates::Candidates;
use vorofit::kernel::differentiated_voronoi;
use vorofit::kernel::restricted_voronoi::{self, Metric};
use vorofit::kernel::sparse::Csr;
use vorofit::kernel::vsdm::{FixedSide, MovingSide, Vsdm};
use vorofit::mesh::sample::sample_by_area;
use vorofit::mesh::{TriangleMesh, shapes};
use vorofit::model::Model;
use vorofit::progress::Silent;

/// Seeds, and 0.7 of what geogram takes for them on one thread, in milliseconds.
const ROWS: [(usize, f64); 3] = [(1_000, 15.8), (5_000, 30.4), (20_000, 75.0)];

/// Control points of the fit whose surface has about as many vertices on levels 1 to 3.
const CONTROL_POINTS: usize = 314;

/// Steps that even seeds out.
const LLOYD_STEPS: usize = 4;

fn main() -> Result<()> {
    let data = std::env::var_os("VOROFIT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let path = data.join("surfaces/stanford-bunny.obj");
    if path.exists() {
        let mesh = read_surface(&path)?.mesh.triangulate();
        on_a_scan(&mesh);
        both_terms(&mesh)?;
    } else {
        println!("skipped: there is no {}", path.display());
    }
    growth()
}

/// The least milliseconds of some repetitions.
fn best<T>(repetitions: usize, mut run: impl FnMut() -> T) -> f64 {
    let mut once = || {
        let start = Instant::now();
        std::hint::black_box(run());
        1e3 * start.elapsed().as_secs_f64()
    };
    (0..repetitions).fold(f64::INFINITY, |least, _| least.min(once()))
}

fn in_spatial_order(mesh: &TriangleMesh) -> Vec<[DVec3; 3]> {
    let corners: Vec<_> = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
    let centers: Vec<DVec3> = corners.iter().map(|[a, b, c]| (a + b + c) / 3.0).collect();
    let order = spatial_order(&centers);
    order.iter().map(|&t| corners[t as usize]).collect()
}

/// Energy and gradient of random seeds and of seeds evened out, everything rebuilt but the static target's tree.
fn on_a_scan(mesh: &TriangleMesh) {
    let triangles = in_spatial_order(mesh);
    let tree = TriangleTree::new(&triangles);
    println!(
        "{} triangles, {} threads",
        triangles.len(),
        rayon::current_num_threads()
    );
    println!(
        "{:>6} {:>7} {:>2} {:>10} {:>6} {:>6} {:>7} {:>14}",
        "seeds", "placed", "s", "candidates", "clip", "total", "target", "pairs/triangle"
    );
    for (count, target) in ROWS {
        let random: Vec<DVec3> = sample_by_area(mesh, count, 0)
            .iter()
            .map(|s| s.position(mesh.corners(s.triangle as usize)))
            .collect();
        let even = evened_out(&triangles, &tree, random.clone());
        for (placed, seeds) in [("random", random), ("evenly", even)] {
            let find = || Candidates::find(&tree, &triangles, &seeds, 0.0);
            let candidates = find();
            for s in [1.0, 5.0] {
                let clip = |candidates: &Candidates| {
                    restricted_voronoi::cpu(&triangles, &seeds, candidates, Metric::anisotropic(s))
                };
                println!(
                    "{count:6} {placed:>7} {s:2} {:10.2} {:6.2} {:6.2} {target:7.1} {:14.3}",
                    best(40, find),
                    best(40, || clip(&candidates)),
                    best(40, || clip(&find())),
                    candidates.seeds.len() as f64 / triangles.len() as f64
                );
            }
        }
    }
}

fn evened_out(triangles: &[[DVec3; 3]], tree: &TriangleTree, mut seeds: Vec<DVec3>) -> Vec<DVec3> {
    for _ in 0..LLOYD_STEPS {
        let candidates = Candidates::find(tree, triangles, &seeds, 0.0);
        let cells = restricted_voronoi::cpu(triangles, &seeds, &candidates, Metric::ISOTROPIC);
        for ((x, moment), area) in seeds.iter_mut().zip(&cells.moment).zip(&cells.area) {
            if *area > 0.0 {
                *x += *moment / *area;
            }
        }
    }
    seeds
}

/// Each term alone and both together, for the surface of a fit evaluated on several levels, with as many samples as it has vertices.
fn both_terms(mesh: &TriangleMesh) -> Result<()> {
    let target = Target::new(&Device::Cpu, mesh)?;
    let options = Options::default();
    let template = Template::BoundingBox {
        control_points: CONTROL_POINTS,
    };
    let start = Start::new(&target, &template, options.scheme)?;
    let control = fit(&Device::Cpu, &target, start, &options, &Silent)?.control;
    let triangles = in_spatial_order(&target.mesh);
    let tree = TriangleTree::new(&triangles);
    println!(
        "\n{:>8} {:>9} {:>2} {:>6} {:>6} {:>6} {:>10} {:>14}",
        "vertices", "triangles", "s", "T→S", "S→T", "both", "both / T→S", "pairs/triangle"
    );
    for levels in 1..=3 {
        let model = Model::new(&control, options.scheme, levels, true)?;
        let surface = model.surface(&control.mesh.positions).triangulate();
        let x = &surface.positions;
        let on_surface = in_spatial_order(&surface);
        let mut surface_tree = TriangleTree::new(&on_surface);
        let random = sample_by_area(&target.mesh, x.len(), 0)
            .iter()
            .map(|s| s.position(target.mesh.corners(s.triangle as usize)))
            .collect();
        let closest = target.closest(&evened_out(&triangles, &tree, random))?;
        let y: Vec<DVec3> = closest.iter().map(|c| c.point).collect();
        let normals: Vec<DVec3> = closest.iter().map(|c| c.normal).collect();
        let pairs = Candidates::find(&surface_tree, &on_surface, &y, 0.0)
            .seeds
            .len();
        for s in [1.0, 5.0] {
            let metric = Metric::anisotropic(s);
            let to_surface = || {
                let candidates = Candidates::find(&tree, &triangles, x, 0.0);
                restricted_voronoi::cpu(&triangles, x, &candidates, metric)
            };
            let mut to_target = || {
                surface_tree.refit(&on_surface);
                let candidates = Candidates::find(&surface_tree, &on_surface, &y, 0.0);
                differentiated_voronoi::cpu(&on_surface, &y, &normals, &candidates, metric)
            };
            let one = best(40, to_surface);
            let other = best(40, &mut to_target);
            let both = best(40, || rayon::join(to_surface, &mut to_target));
            println!(
                "{:8} {:9} {s:2} {one:6.2} {other:6.2} {both:6.2} {:10.2} {:14.3}",
                x.len(),
                on_surface.len(),
                both / one,
                pairs as f64 / on_surface.len() as f64
            );
        }
    }
    Ok(())
}

/// Both terms for spheres of 10³ to 10⁶ triangles. A surface of a quarter as many triangles and its samples grow with the target;
/// the control points are the surface's vertices.
fn growth() -> Result<()> {
    println!(
        "\n{:>9} {:>14} {:>8} {:>8} {:>19}",
        "triangles", "control points", "ms", "exponent", "peak bytes/triangle"
    );
    let mut before: Option<(f64, f64)> = None;
    for level in 3..=8 {
        let resting = resident_bytes("VmRSS:");
        let target = shapes::sphere(1.0, level);
        let surface = shapes::sphere(1.0, level - 1);
        let count = target.triangles.len();
        let samples = shapes::sphere(1.0, level - 1).positions;
        let fixed = {
            let corners: Vec<_> = (0..count).map(|t| target.corners(t)).collect();
            FixedSide::new(&corners, samples.clone(), samples)
        };
        let points = surface.positions;
        let moving = MovingSide::new(Csr::identity(points.len()), surface.triangles);
        let mut terms = Vsdm::new(&Device::Cpu, fixed, moving, Metric::ISOTROPIC);
        // Every evaluation moves by half a cell, further than any slack, so each searches candidates anew.
        let step = 0.5 * (2.0 * TAU / points.len() as f64).sqrt();
        let mut scale = 1.0;
        let milliseconds = best((2_000_000 / count).clamp(2, 40), || {
            scale = 2.0 + step - scale;
            let moved: Vec<DVec3> = points.iter().map(|p| scale * p).collect();
            terms.evaluate(&moved)
        });
        let exponent = before.map_or(f64::NAN, |(c, t)| {
            (milliseconds / t).ln() / (count as f64 / c).ln()
        });
        println!(
            "{count:9} {:14} {milliseconds:8.2} {exponent:8.2} {:19.0}",
            points.len(),
            (resident_bytes("VmHWM:") - resting) / count as f64
        );
        before = Some((count as f64, milliseconds));
    }
    Ok(())
}

/// A line of /proc/self/status in bytes; not a number where there is none.
fn resident_bytes(name: &str) -> f64 {
    std::fs::read_to_string("/proc/self/status")
        .ok()
        .and_then(|status| {
            let line = status.lines().find(|line| line.starts_with(name))?;
            line.split_whitespace().nth(1)?.parse::<f64>().ok()
        })
        .map_or(f64::NAN, |kilobytes| 1024.0 * kilobytes)
}
