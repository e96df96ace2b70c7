//! QEM simplification: time (best of five) and two-sided distances, in percent of the diagonal, for the rows that peers are measured on.
//!
//! `cargo bench --bench simplify [FILE.obj FACES]…`

use std::path::{Path, PathBuf};
use std::time::Instant;
use vorofit::Result;
use vorofit::files::read_surface;
use vorofit::geometry::Bvh;
use vorofit::mesh::sample::sample_by_area;
use vorofit::mesh::{Frame, TriangleMesh};
use vorofit::topology::{Target, simplify};

const SAMPLES: usize = 200_000;

fn main() -> Result<()> {
    let mut rows: Vec<String> = std::env::args()
        .skip(1)
        .filter(|a| a != "--bench")
        .collect();
    if rows.is_empty() {
        rows = [
            "stanford-bunny.obj",
            "1224",
            "igea.ply",
            "672",
            "igea.ply",
            "15000",
        ]
        .map(String::from)
        .into();
    }
    let data = std::env::var_os("VOROFIT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    println!(
        "{:18} {:>8} {:>7} {:>8} {:>8} {:>7} {:>11}",
        "input", "faces", "to", "ms", "rms %", "max %", "deviation %"
    );
    for row in rows.chunks_exact(2) {
        let path = data.join("surfaces").join(&row[0]);
        if path.exists() {
            let mesh = read_surface(&path)?.mesh.triangulate();
            report(&path, &mesh, row[1].parse().expect("a number of faces"))?;
        } else {
            println!("skipped: there is no {}", path.display());
        }
    }
    Ok(())
}

fn report(path: &Path, mesh: &TriangleMesh, faces: usize) -> Result<()> {
    let mut result = simplify(mesh, Target::Faces(faces));
    let mut best = f64::INFINITY;
    for _ in 0..5 {
        let start = Instant::now();
        result = simplify(mesh, Target::Faces(faces));
        best = best.min(start.elapsed().as_secs_f64());
    }
    let percent = 100.0 / Frame::of(mesh)?.diagonal;
    let (there, back) = (
        distances(mesh, &result.mesh)?,
        distances(&result.mesh, mesh)?,
    );
    println!(
        "{:18} {:8} {:7} {:8.1} {:8.4} {:7.3} {:11.4}",
        path.file_stem().unwrap_or_default().to_string_lossy(),
        mesh.triangles.len(),
        result.mesh.triangles.len(),
        1e3 * best,
        percent * there.0.max(back.0),
        percent * there.1.max(back.1),
        percent * result.deviation,
    );
    Ok(())
}

/// Root mean square and largest distance from area samples of one mesh to another.
fn distances(from: &TriangleMesh, to: &TriangleMesh) -> Result<(f64, f64)> {
    let samples: Vec<_> = sample_by_area(from, SAMPLES, 0)
        .iter()
        .map(|s| s.position(from.corners(s.triangle as usize)))
        .collect();
    let closest = Bvh::new(&to.positions, &to.triangles)?.closest_all(&samples);
    let sum: f64 = closest.iter().map(|c| c.distance_squared).sum();
    let largest = closest
        .iter()
        .map(|c| c.distance_squared)
        .fold(0.0, f64::max);
    Ok(((sum / samples.len() as f64).sqrt(), largest.sqrt()))
}
