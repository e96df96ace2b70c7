//! The distortion of curved elements, value and gradient, on the CPU and on the GPU if there is one (a software adapter counts):
//! `cargo bench --bench elements`.
//!
//! Millions of degrees of freedom (three a coefficient) a second, and the share of the arithmetic bound of the CPU: the operations that sum
//! factorization takes, with 890 for the strain at a point, over what a loop of fused multiply-adds reaches on the same threads. Operations at
//! check points are not counted.

use rayon::prelude::*;
use std::hint::black_box;
use std::time::Instant;
use vorofit::benchmark::samples;
use vorofit::device::{Adapter, Gpu};
use vorofit::geometry::vector::{Arithmetic, Work, fastest};
use vorofit::kernel::Kernel;
use vorofit::kernel::element_energy::ElementEnergyTwins;
use vorofit::mesh::CellShape;
use vorofit::model::element::{mode_count, triangle_mode_count};

/// Operations for value and gradient of the strain at a point.
const POINTWISE: usize = 890;
/// Elements of the largest model of the paper, of order 12.
const LARGEST: usize = 2492;

fn main() {
    let peak = peak();
    let gpu = Adapter::select(None)
        .and_then(|adapter| Gpu::open(&adapter))
        .ok();
    println!(
        "{} threads, fused multiply-adds {:.1} Gflop/s; GPU: {}",
        rayon::current_num_threads(),
        1e-9 * peak,
        gpu.as_ref().map_or("none", |gpu| &gpu.adapter().name)
    );
    println!(
        "{:12} {:>5} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9}",
        "shape", "order", "elements", "CPU ms", "Mdof/s", "Gflop/s", "of bound", "GPU ms", "Mdof/s"
    );
    for shape in [
        CellShape::Hexahedron,
        CellShape::Prism,
        CellShape::Tetrahedron,
    ] {
        for order in [2, 4, 8, 12, 16] {
            let count = (400_000 / mode_count(shape, order)).clamp(64, 8192);
            row(shape, order, count, peak, gpu.as_ref());
        }
    }
    row(CellShape::Hexahedron, 12, LARGEST, peak, gpu.as_ref());
}

fn row(shape: CellShape, order: usize, count: usize, peak: f64, gpu: Option<&Gpu>) {
    let input = samples::curved(shape, order, count).expect("tables");
    let dof = 3e-6 * input.coefficients.len() as f64;
    let seconds = shortest(|| ElementEnergyTwins::cpu(&input));
    let rate = (count * operations(shape, order)) as f64 / seconds;
    print!(
        "{:12} {order:>5} {count:>9} {:>9.2} {:>9.2} {:>9.2} {:>8.0}%",
        shape.name(),
        1e3 * seconds,
        dof / seconds,
        1e-9 * rate,
        100.0 * rate / peak
    );
    if let Some(gpu) = gpu {
        let mut resident = ElementEnergyTwins::upload(gpu, &input).expect("upload");
        let seconds = shortest(|| ElementEnergyTwins::gpu(gpu, &mut resident).expect("run"));
        print!(" {:>9.2} {:>9.2}", 1e3 * seconds, dof / seconds);
    }
    println!();
}

/// Additions and multiplications for an element, to the derivatives and back.
fn operations(shape: CellShape, order: usize) -> usize {
    let (n, q) = (order + 1, order + 2);
    let triangle = triangle_mode_count(order);
    let one_way = match shape {
        CellShape::Hexahedron => 12 * q * n.pow(3) + 18 * q.pow(2) * n.pow(2) + 18 * q.pow(3) * n,
        CellShape::Prism => 12 * q * n * triangle + 18 * q.pow(3) * triangle,
        CellShape::Tetrahedron => {
            let modes = mode_count(shape, order);
            6 * modes.pow(2) + 12 * q * modes + 18 * q.pow(2) * triangle + 18 * q.pow(3) * n
        }
    };
    2 * one_way + POINTWISE * q.pow(3)
}

/// Operations a second of independent fused multiply-adds on all threads.
fn peak() -> f64 {
    const STEPS: usize = 2_000_000;
    let threads = rayon::current_num_threads();
    let seconds = shortest(|| {
        (0..threads).into_par_iter().for_each(|_| {
            let mut sums = [[1.0; 4]; 12];
            fastest(Sums(&mut sums, STEPS));
            black_box(sums);
        });
    });
    (2 * 48 * STEPS * threads) as f64 / seconds
}

struct Sums<'a>(&'a mut [[f64; 4]; 12], usize);

impl Work for Sums<'_> {
    #[inline(always)]
    fn run<A: Arithmetic>(self) {
        let (a, b) = (black_box([0.999_999; 4]), black_box([1e-6; 4]));
        let mut sums = *self.0;
        for _ in 0..self.1 {
            for sum in &mut sums {
                for l in 0..4 {
                    sum[l] = A::mul_add(sum[l], a[l], b[l]);
                }
            }
        }
        *self.0 = sums;
    }
}

/// Seconds of the fastest of some calls.
fn shortest<T>(mut call: impl FnMut() -> T) -> f64 {
    (0..4)
        .map(|_| {
            let begun = Instant::now();
            black_box(call());
            begun.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}
