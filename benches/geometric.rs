//! The geometric algorithm on the rows that its paper and peers are measured on: control points, errors in percent of the diagonal, seconds.
//!
//! `cargo bench --bench geometric`. E is measured at the vertices of the scan, by a full search; the two-sided figures are those of the dense surface. The time
//! is that of cleaning, simplification, fit and full search, without reading.

use std::path::{Path, PathBuf};
use std::time::Instant;
use vorofit::Result;
use vorofit::device::Device;
use vorofit::files::read_surface;
use vorofit::fit::geometric::{self, Data, Options, Start, Step};
use vorofit::measure::surface_error;
use vorofit::progress::Silent;

/// Area samples a side for the two-sided figures.
const SAMPLES: usize = 200_000;

/// A scan, control points to start from, and the largest and mean error to reach, in percent.
type Row = (&'static str, usize, Option<f64>, Option<f64>);

const ROWS: [Row; 4] = [
    ("stanford-bunny.obj", 390, None, None),
    ("stanford-bunny.obj", 627, None, None),
    ("stanford-bunny.obj", 612, Some(0.049), Some(0.0085)),
    ("igea.ply", 336, Some(0.238), Some(0.029)),
];

fn main() -> Result<()> {
    let data = std::env::var_os("VOROFIT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    println!(
        "{:18} {:>13} {:>6} {:>6} {:>7} {:>7} {:>7} {:>8} {:>8} {:>6} {:>6}  end",
        "scan", "step", "from", "to", "E_max", "E_rms", "E_ave", "2-sided", "rms", "its", "s"
    );
    for row in ROWS {
        let path = data.join("surfaces").join(row.0);
        if !path.exists() {
            println!("skipped: there is no {}", path.display());
            continue;
        }
        for step in [Step::LeastSquares, Step::Displacement] {
            report(&path, row, step)?;
        }
    }
    Ok(())
}

fn report(path: &Path, (name, start, max, mean): Row, step: Step) -> Result<()> {
    let scan = read_surface(path)?.mesh.triangulate();
    let options = Options {
        step,
        max_error: max.map(|percent| percent / 100.0),
        mean_error: mean.map(|percent| percent / 100.0),
        levels: 3,
        ..Options::default()
    };
    let begun = Instant::now();
    let data = Data::of_mesh(&scan, None, 0)?;
    let control = data.control_mesh(&Device::Cpu, &Start::Simplified(Some(start)), &Silent)?;
    let fit = geometric::fit(&Device::Cpu, &data, control, &options, &Silent)?;
    let seconds = begun.elapsed().as_secs_f64();
    let mut target = scan;
    for p in &mut target.positions {
        *p = data.frame.to_unit(*p);
    }
    let both = surface_error(&target, &fit.surface.triangulate(), SAMPLES)?;
    let error = fit.data_error.unwrap_or_default();
    let rms = both.target_to_surface.rms.max(both.surface_to_target.rms);
    println!(
        "{name:18} {:>13} {start:>6} {:>6} {:>7.4} {:>7.4} {:>7.4} {:>8.4} {:>8.4} {:>6} {seconds:>6.2}  {:?}",
        format!("{step:?}"),
        fit.control.mesh.positions.len(),
        100.0 * error.max,
        100.0 * error.rms,
        100.0 * error.mean,
        100.0 * both.max(),
        100.0 * rms,
        fit.iterations.len(),
        fit.stop_reason,
    );
    Ok(())
}
