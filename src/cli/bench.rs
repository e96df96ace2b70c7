//! `vorofit bench`: every kernel on the CPU and on the GPU, over sizes.

use super::Outcome;
use super::session::Session;
use super::text::{count, significant};
use serde::Deserialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use vorofit::benchmark::{Bench, MEASUREMENTS, Row};
use vorofit::device::{Adapter, Device, DeviceChoice, Gpu};
use vorofit::progress::{Event, Progress};
use vorofit::report::{DeviceReport, Report, SCHEMA, Stopwatch};
use vorofit::{Error, Result};

const SIZES: [usize; 3] = [1_000, 10_000, 100_000];
const QUICK_SIZES: [usize; 2] = [1_000, 10_000];
/// Seconds that each call is repeated for.
const SECONDS: f64 = 0.5;
const QUICK_SECONDS: f64 = 0.05;

/// Time every kernel and the whole evaluation, CPU beside GPU, and check that they agree
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Sizes, about so many triangles [default: 1000,10000,100000]
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(100..=10_000_000))]
    sizes: Vec<u32>,
    /// Small sizes and few repetitions: shows that everything runs
    #[arg(long, conflicts_with = "sizes")]
    quick: bool,
    /// Compare with the report (--json) of another machine or version
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
}

/// What is read from another run's report.
#[derive(Debug, Deserialize)]
struct Other {
    schema: String,
    device: DeviceReport,
    kernels: Vec<Row>,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        let other = self.against.as_deref().map(read).transpose()?;
        let mut stopwatch = Stopwatch::start();
        let gpu = open_gpu(session)?;
        let device = DeviceReport::of(&gpu.clone().map_or(Device::Cpu, Device::Gpu));
        let rows = self.measure(session, gpu)?;
        stopwatch.lap("measure");
        let text = match &other {
            Some(other) => comparison(&rows, &device, other),
            None => table(&rows, &device),
        };
        let report = Report {
            device: Some(device),
            kernels: Some(rows),
            timing: Some(stopwatch.timing()),
            ..Report::new("bench")
        };
        session.finish(&report, &text)?;
        Ok(Outcome::Done)
    }

    fn measure(&self, session: &Session, gpu: Option<Gpu>) -> Result<Vec<Row>> {
        let asked: Vec<usize> = self.sizes.iter().map(|&size| size as usize).collect();
        let (sizes, seconds) = match (self.quick, asked.is_empty()) {
            (true, _) => (QUICK_SIZES.to_vec(), QUICK_SECONDS),
            (false, true) => (SIZES.to_vec(), SECONDS),
            (false, false) => (asked, SECONDS),
        };
        let bench = Bench { gpu, seconds };
        let pairs = MEASUREMENTS
            .iter()
            .flat_map(|m| sizes.iter().map(move |&size| (m, size)));
        session.terminal.event(Event::Stage {
            name: "measuring",
            steps: MEASUREMENTS.len() * sizes.len(),
        });
        let mut rows = Vec::new();
        for (measurement, size) in pairs {
            rows.push(measurement(&bench, size)?);
            session.terminal.event(Event::Step {
                done: rows.len(),
                value: None,
            });
        }
        session.terminal.clear();
        Ok(rows)
    }
}

/// The GPU to measure: any for `auto`, software included, since it is to be compared and not to be waited for.
fn open_gpu(session: &Session) -> Result<Option<Gpu>> {
    match session.choice {
        DeviceChoice::Cpu => Ok(None),
        DeviceChoice::Gpu => open(session).map(Some),
        DeviceChoice::Auto if session.adapter.is_some() => open(session).map(Some),
        DeviceChoice::Auto => Ok(open(session)
            .inspect_err(|e| {
                session
                    .terminal
                    .warn(&format!("only the CPU is measured: {e}"))
            })
            .ok()),
    }
}

fn open(session: &Session) -> Result<Gpu> {
    Gpu::open(&Adapter::select(session.adapter.as_deref())?)
}

fn read(path: &Path) -> Result<Other> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    let refused = |place: String, problem: String| {
        Error::file(
            path,
            place,
            problem,
            "give a file that vorofit bench --json has written",
        )
    };
    let other: Other = serde_json::from_str(&text)
        .map_err(|e| refused(format!("line {}", e.line()), e.to_string()))?;
    match other.schema == SCHEMA {
        true => Ok(other),
        false => Err(refused(
            "schema".into(),
            format!("it is {:?}", other.schema),
        )),
    }
}

/// Millions of items a second.
fn rate(row: &Row, ms: f64) -> String {
    significant(row.items as f64 / ms / 1e3, 3)
}

fn table(rows: &[Row], device: &DeviceReport) -> String {
    let threads = rayon::current_num_threads();
    let mut text = format!("CPU: f64, {threads} threads\n");
    if rows.iter().any(|row| row.gpu_ms.is_some()) {
        let _ = writeln!(text, "GPU: f32, {device}");
    }
    let _ = writeln!(
        text,
        "\n{:24} {:>10} {:>9} {:>9} {:>10} {:>10} {:>8} {:>13}",
        "kernel", "items", "CPU ms", "GPU ms", "CPU Mit/s", "GPU Mit/s", "GPU/CPU", "disagreement"
    );
    for row in rows {
        let absent = || "-".to_owned();
        let gpu = |of: &dyn Fn(f64) -> String| row.gpu_ms.map_or_else(absent, of);
        let _ = writeln!(
            text,
            "{:24} {:>10} {:>9} {:>9} {:>10} {:>10} {:>8} {:>13}",
            row.kernel,
            count(row.items),
            significant(row.cpu_ms, 3),
            gpu(&|ms| significant(ms, 3)),
            rate(row, row.cpu_ms),
            gpu(&|ms| rate(row, ms)),
            gpu(&|ms| format!("{:.2}", ms / row.cpu_ms)),
            row.disagreement.map_or_else(absent, |d| format!("{d:.3}")),
        );
    }
    text += "\nMit/s: millions of items a second. GPU/CPU: ratio of times. Disagreement: in units of the kernel's tolerance, at most 1.\n";
    text
}

fn comparison(rows: &[Row], device: &DeviceReport, other: &Other) -> String {
    let mut text = format!("here:  {device}\nthere: {}\n\n", other.device);
    let _ = writeln!(
        text,
        "{:24} {:>10} {:>11} {:>11} {:>7} {:>11} {:>11} {:>7}",
        "kernel", "items", "CPU here", "CPU there", "ratio", "GPU here", "GPU there", "ratio"
    );
    let columns = |here: Option<f64>, there: Option<f64>| {
        let ms = |ms: Option<f64>| ms.map_or("-".into(), |ms| significant(ms, 3));
        let ratio = here
            .zip(there)
            .map_or("-".into(), |(a, b)| format!("{:.2}", a / b));
        format!("{:>11} {:>11} {ratio:>7}", ms(here), ms(there))
    };
    for row in rows {
        let same = |r: &&Row| r.kernel == row.kernel && r.items == row.items;
        let there = other.kernels.iter().find(same);
        let _ = writeln!(
            text,
            "{:24} {:>10} {} {}",
            row.kernel,
            count(row.items),
            columns(Some(row.cpu_ms), there.map(|r| r.cpu_ms)),
            columns(row.gpu_ms, there.and_then(|r| r.gpu_ms)),
        );
    }
    text += "\nMilliseconds; ratio: here over there.\n";
    text
}
