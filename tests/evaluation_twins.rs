//! A whole evaluation, control points in and gradient out, on the GPU against the CPU.

mod common;

use common::{Noise, gpu};
use glam::DVec3;
use vorofit::device::{Device, Gpu};
use vorofit::kernel::restricted_voronoi::{self, Metric};
use vorofit::kernel::sparse::Csr;
use vorofit::kernel::vsdm::{Evaluation, FixedSide, MovingSide, Vsdm};

/// Of the energies, and of the gradient's norm. The noise of the kernels, averaged over the control points. Measured: 5e-7.
const TOLERANCE: f64 = 5e-6;

/// A grid of (n + 1)² points over [−½, ½]² at a height, and its triangles.
fn grid(n: u32, height: impl Fn(f64, f64) -> f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let m = n + 1;
    let at = |k: u32| f64::from(k) / f64::from(n) - 0.5;
    let points = (0..m * m)
        .map(|k| (at(k % m), at(k / m)))
        .map(|(x, y)| DVec3::new(x, y, height(x, y)))
        .collect();
    let corner = (0..m * n).filter(|k| k % m != n);
    let triangles = corner.flat_map(|k| [[k, k + 1, k + m], [k + 1, k + m + 1, k + m]]);
    (points, triangles.collect())
}

/// Linear interpolation from a grid of (n + 1)² control points to one twice as fine.
fn refinement(n: u32) -> Csr {
    let (coarse, fine) = (n + 1, 2 * n + 1);
    let rows: Vec<Vec<(u32, f64)>> = (0..fine * fine)
        .map(|k| {
            let (x, y) = (k % fine, k / fine);
            let ends = |c: u32| [c / 2, c.div_ceil(2)];
            let mut row = Vec::new();
            for i in ends(x) {
                for j in ends(y) {
                    row.push((j * coarse + i, 0.25));
                }
            }
            row
        })
        .collect();
    Csr::from_rows(&rows, (coarse * coarse) as usize)
}

/// A fit of a sheet to a bumpy one, and control points to evaluate it at.
fn problem(device: &Device, metric: Metric) -> (Vsdm, Vec<DVec3>) {
    let bumpy = |x: f64, y: f64| 0.1 * (5.0 * x).sin() * (4.0 * y).cos();
    let (target, faces) = grid(60, bumpy);
    let corners: Vec<[DVec3; 3]> = faces
        .iter()
        .map(|t| t.map(|v| target[v as usize]))
        .collect();
    let noise = &mut Noise(3);
    let samples: Vec<_> = (0..900)
        .map(|_| (noise.next(), noise.next()))
        .map(|(x, y)| DVec3::new(x, y, bumpy(x, y)))
        .collect();
    let normals = samples
        .iter()
        .map(|p| DVec3::new(p.y.sin(), p.x.cos() - 1.0, 2.0).normalize())
        .collect();
    let (mut control, _) = grid(12, |_, _| 0.03);
    for p in &mut control {
        *p += 0.01 * noise.vector();
    }
    let (_, triangles) = grid(24, |_, _| 0.0);
    let fixed = FixedSide::new(&corners, samples, normals);
    let moving = MovingSide::new(refinement(12), triangles);
    (Vsdm::new(device, fixed, moving, metric), control)
}

fn evaluate(device: &Device, metric: Metric) -> [Evaluation; 3] {
    let (mut vsdm, mut control) = problem(device, metric);
    let noise = &mut Noise(4);
    // Small steps keep the candidates, the large one does not.
    [0.0, 1e-4, 1e-2].map(|step| {
        for p in &mut control {
            *p += step * noise.vector();
        }
        vsdm.evaluate(&control).unwrap()
    })
}

fn disagreement(a: &Evaluation, b: &Evaluation) -> f64 {
    let norm =
        |g: &mut dyn Iterator<Item = DVec3>| g.map(|v| v.length_squared()).sum::<f64>().sqrt();
    let difference = norm(&mut a.gradient.iter().zip(&b.gradient).map(|(a, b)| *a - *b));
    [
        (a.target_to_surface / b.target_to_surface - 1.0).abs(),
        (a.surface_to_target / b.surface_to_target - 1.0).abs(),
        difference / norm(&mut b.gradient.iter().copied()),
    ]
    .into_iter()
    .fold(0.0, f64::max)
}

fn worst(gpu: &Gpu, metric: Metric) -> f64 {
    let [device, cpu] = [Device::Gpu(gpu.clone()), Device::Cpu];
    let pairs = evaluate(&device, metric)
        .into_iter()
        .zip(evaluate(&cpu, metric));
    pairs.map(|(a, b)| disagreement(&a, &b)).fold(0.0, f64::max)
}

#[test]
fn evaluations_agree_and_repeat() {
    for s in [1.0, 5.0, 50.0] {
        let metric = Metric::anisotropic(s);
        let worst = worst(gpu(), metric);
        println!("s = {s}: {worst:.2e}");
        assert!(worst <= TOLERANCE, "s = {s}: {worst}");
        let device = Device::Gpu(gpu().clone());
        assert!(evaluate(&device, metric) == evaluate(&device, metric));
    }
}

#[test]
fn a_fault_in_a_shader_is_seen() {
    let shader = &restricted_voronoi::SHADER;
    let faulty = gpu().with_fault(shader, "2.0 * height - across", "2.0 * height + across");
    assert!(worst(&faulty, Metric::anisotropic(5.0)) > TOLERANCE);
}

#[test]
fn what_the_device_gives_up_is_done_on_the_host() {
    let shader = &restricted_voronoi::SHADER;
    // Every cell that is cut is lost: more failures than the list holds, or almost.
    let losing = gpu().with_fault(shader, "if state == EMPTY", "if state != WHOLE");
    let worst = worst(&losing, Metric::anisotropic(5.0));
    assert!(worst <= TOLERANCE, "{worst}");
}
