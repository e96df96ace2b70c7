//! Closest points: this crate's tree against parry3d, on the Stanford bunny where it is at hand, else on a generated torus.
//!
//! Queries are the vertices moved 1 % of the diagonal in a fixed random direction each, three times over. Both sides give the point, the
//! triangle and its barycentrics, in f64. Times are the best of several runs. Run with `cargo bench --bench closest_point`.

use glam::DVec3;
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::TriMesh;
use rayon::prelude::*;
use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;
use vorofit::device::Device;
use vorofit::kernel::closest_point::ClosestPoints;
use vorofit::mesh::{Frame, TriangleMesh};

const ROUNDS: usize = 5;
const OFFSET: f64 = 0.01;

fn main() {
    let (name, mesh) = bunny().unwrap_or_else(torus);
    let queries = queries(&mesh);
    println!(
        "{name}: {} triangles, {} queries at 1 % of the diagonal; best of {ROUNDS}",
        mesh.triangles.len(),
        queries.len()
    );
    for threads in [1, 2] {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a thread pool")
            .install(|| run(threads, &mesh, &queries));
    }
}

fn run(threads: usize, mesh: &TriangleMesh, queries: &[DVec3]) {
    let (ours_build, ours) = best(|| ClosestPoints::new(&Device::Cpu, mesh).expect("triangles"));
    let (ours_query, answers) = best(|| ours.query(queries).expect("a CPU"));
    let (parry_build, parry) = best(|| {
        TriMesh::new(
            mesh.positions.iter().map(|p| p.to_array().into()).collect(),
            mesh.triangles.clone(),
        )
        .expect("triangles")
    });
    let (parry_query, distances) = best(|| -> Vec<f64> {
        queries
            .par_iter()
            .with_min_len(256)
            .map(|q| {
                let q = q.to_array().into();
                let (projection, location) = parry.project_local_point_and_get_location(q, false);
                black_box(location);
                (projection.point - q).length()
            })
            .collect()
    });
    let report = |who, build: f64, query: f64| {
        println!(
            "{threads} thread(s)  {who:<8} build {:7.1} ms   {:6.0} k queries/s",
            1e3 * build,
            1e-3 * queries.len() as f64 / query
        );
    };
    report("vorofit", ours_build, ours_query);
    report("parry3d", parry_build, parry_query);
    let difference = answers
        .iter()
        .zip(&distances)
        .map(|(a, d)| (a.distance_squared.sqrt() - d).abs())
        .fold(0.0, f64::max);
    println!("             largest difference of a distance {difference:.1e}");
}

/// The shortest of several runs in seconds, and the last result.
fn best<T>(mut work: impl FnMut() -> T) -> (f64, T) {
    let mut time = || {
        let start = Instant::now();
        let result = black_box(work());
        (start.elapsed().as_secs_f64(), result)
    };
    (1..ROUNDS).fold(time(), |best, _| {
        let (seconds, result) = time();
        (best.0.min(seconds), result)
    })
}

fn queries(mesh: &TriangleMesh) -> Vec<DVec3> {
    let diagonal = Frame::of(mesh).expect("an extent").diagonal;
    let mut state = 1u64;
    let mut random = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    (0..3)
        .flat_map(|_| &mesh.positions)
        .map(|&p| {
            let direction = DVec3::new(random(), random(), random());
            p + OFFSET * diagonal * direction.normalize_or(DVec3::X)
        })
        .collect()
}

fn bunny() -> Option<(&'static str, TriangleMesh)> {
    let folder = std::env::var_os("VOROFIT_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")),
        PathBuf::from,
    );
    let path = folder.join("surfaces/stanford-bunny.obj");
    let (models, _) = tobj::load_obj(path, &tobj::GPU_LOAD_OPTIONS).ok()?;
    let mesh = &models.first()?.mesh;
    let positions = mesh.positions.chunks(3).map(DVec3::from_slice).collect();
    let triangles = mesh.indices.chunks(3).map(|t| [t[0], t[1], t[2]]).collect();
    Some((
        "bunny",
        TriangleMesh {
            positions,
            triangles,
        },
    ))
}

/// A torus of 70,000 triangles.
fn torus() -> (&'static str, TriangleMesh) {
    let (m, n) = (250u32, 140u32);
    let turn = |i: u32, of: u32| std::f64::consts::TAU * f64::from(i) / f64::from(of);
    let positions = (0..m * n)
        .map(|k| {
            let (u, v) = (turn(k / n, m), turn(k % n, n));
            let r = 1.0 + 0.4 * v.cos();
            DVec3::new(r * u.cos(), r * u.sin(), 0.4 * v.sin())
        })
        .collect();
    let at = |i: u32, j: u32| i % m * n + j % n;
    let triangles = (0..m * n)
        .map(|k| (k / n, k % n))
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    (
        "torus (no bunny found)",
        TriangleMesh {
            positions,
            triangles,
        },
    )
}
