//! Gradients by Taylor tests, areas by partition, and known energies of regular arrangements.

mod common;

use common::Noise;
use glam::DVec3;
use vorofit::device::Device;
use vorofit::geometry::triangle_tree::{TriangleTree, spatial_order};
use vorofit::kernel::candidates::Candidates;
use vorofit::kernel::differentiated_voronoi;
use vorofit::kernel::restricted_voronoi::{self, Metric};
use vorofit::kernel::vsdm::{Evaluation, FixedSide, MovingSide, Vsdm};
use vorofit::mesh::sample::sample_by_area;
use vorofit::mesh::{ControlMesh, Scheme, shapes};
use vorofit::model::Model;

/// A bumpy sheet of `2 n²` triangles over [−½, ½]².
fn sheet(n: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let m = n as u32 + 1;
    let points = (0..m * m)
        .map(|k| {
            let (x, y) = (
                f64::from(k % m) / n as f64 - 0.5,
                f64::from(k / m) / n as f64 - 0.5,
            );
            DVec3::new(x, y, 0.1 * (5.0 * x).sin() * (4.0 * y).cos())
        })
        .collect();
    let mut triangles = Vec::new();
    for k in (0..m * (m - 1)).filter(|k| k % m != m - 1) {
        triangles.push([k, k + 1, k + m]);
        triangles.push([k + 1, k + m + 1, k + m]);
    }
    (points, triangles)
}

fn corners(points: &[DVec3], triangles: &[[u32; 3]]) -> Vec<[DVec3; 3]> {
    triangles
        .iter()
        .map(|t| t.map(|v| points[v as usize]))
        .collect()
}

fn in_order(triangles: &[[DVec3; 3]]) -> Vec<[DVec3; 3]> {
    let centers: Vec<DVec3> = triangles
        .iter()
        .map(|t| (t[0] + t[1] + t[2]) / 3.0)
        .collect();
    spatial_order(&centers)
        .iter()
        .map(|&t| triangles[t as usize])
        .collect()
}

fn area(triangles: &[[DVec3; 3]]) -> f64 {
    triangles
        .iter()
        .map(|t| 0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length())
        .sum()
}

fn cells(triangles: &[[DVec3; 3]], seeds: &[DVec3], metric: Metric) -> restricted_voronoi::Cells {
    let candidates = Candidates::find(&TriangleTree::new(triangles), triangles, seeds, 0.0);
    restricted_voronoi::cpu(triangles, seeds, &candidates, metric)
}

/// The slope of the remainder |f(h) − f(0) − h g| over halved steps: 2 for an exact gradient.
fn taylor_slope(f: impl Fn(f64) -> f64, derivative: f64, step: f64) -> f64 {
    let f0 = f(0.0);
    let remainder = |h: f64| (f(h) - f0 - h * derivative).abs();
    // Over a factor of 16, so that single combinatorial events do not dominate.
    (remainder(step) / remainder(step / 16.0)).log2() / 4.0
}

#[test]
fn cells_partition_the_surface() {
    let (points, triangles) = sheet(40);
    let triangles = in_order(&corners(&points, &triangles));
    let mut noise = Noise(1);
    for count in [1, 2, 7, 100, 3000] {
        let seeds: Vec<DVec3> = (0..count).map(|_| noise.vector()).collect();
        let cells = cells(&triangles, &seeds, Metric::ISOTROPIC);
        let total: f64 = cells.area.iter().sum();
        let expected = area(&triangles);
        assert!(
            ((total - expected) / expected).abs() < 1e-12,
            "{count} seeds: {total} against {expected}"
        );
    }
}

#[test]
fn coincident_and_cocircular_seeds_lose_no_area() {
    let (points, triangles) = sheet(16);
    let flat: Vec<DVec3> = points.iter().map(|p| DVec3::new(p.x, p.y, 0.0)).collect();
    let triangles = in_order(&corners(&flat, &triangles));
    // On the grid's own nodes every bisector runs through vertices and edges; each seed twice.
    let seeds: Vec<DVec3> = flat.iter().flat_map(|&p| [p, p]).collect();
    let cells = cells(&triangles, &seeds, Metric::ISOTROPIC);
    let total: f64 = cells.area.iter().sum();
    assert!((total - 1.0).abs() < 1e-12, "{total}");
    // An inner node owns one grid square; of two coincident seeds the first owns all.
    let inner = 2 * (8 * 17 + 8);
    assert!((cells.area[inner] - 1.0 / 256.0).abs() < 1e-14);
    assert_eq!(cells.area[inner + 1], 0.0);
}

#[test]
fn square_lattice_has_the_known_energy() {
    // Seeds at the centres of an n × n division of the unit square: energy = 1/(6 n²).
    let (points, triangles) = sheet(12);
    let flat: Vec<DVec3> = points.iter().map(|p| DVec3::new(p.x, p.y, 0.0)).collect();
    let triangles = in_order(&corners(&flat, &triangles));
    let n = 5;
    let seeds: Vec<DVec3> = (0..n * n)
        .map(|k| {
            DVec3::new(
                ((k % n) as f64 + 0.5) / n as f64 - 0.5,
                ((k / n) as f64 + 0.5) / n as f64 - 0.5,
                0.0,
            )
        })
        .collect();
    let cells = cells(&triangles, &seeds, Metric::ISOTROPIC);
    assert!(
        (cells.energy - 1.0 / 150.0).abs() < 1e-15,
        "{}",
        cells.energy
    );
    assert!(cells.gradient.iter().all(|g| g.length() < 1e-15));
}

#[test]
fn hexagonal_lattice_has_the_known_energy() {
    // A regular hexagon of area A about its seed: 5 A² / (18 √3). A parallelogram of 6 × 4 lattice steps holds 24 of them
    // by periodicity, wherever it lies, once the lattice goes on around it.
    let (along, across) = (DVec3::X, DVec3::new(0.5, 0.5 * 3f64.sqrt(), 0.0));
    let (points, triangles) = sheet(11);
    let sheared: Vec<DVec3> = points
        .iter()
        .map(|p| 6.0 * p.x * along + 4.0 * p.y * across + DVec3::new(0.21, 0.13, 0.0))
        .collect();
    let triangles = in_order(&corners(&sheared, &triangles));
    let seeds: Vec<DVec3> = (-6..=6)
        .flat_map(|i| (-5..=5).map(move |j| (f64::from(i), f64::from(j))))
        .map(|(i, j)| i * along + j * across)
        .collect();
    let cells = cells(&triangles, &seeds, Metric::ISOTROPIC);
    let hexagon = 0.5 * 3f64.sqrt();
    let expected = 24.0 * 5.0 / (18.0 * 3f64.sqrt()) * hexagon * hexagon;
    assert!(
        (cells.energy / expected - 1.0).abs() < 1e-13,
        "{} against {expected}",
        cells.energy
    );
    let middle = seeds.iter().position(|x| x.length() < 1e-12).unwrap();
    assert!((cells.area[middle] / hexagon - 1.0).abs() < 1e-13);
    assert!(cells.gradient[middle].length() < 1e-14);
}

#[test]
fn gradient_of_seeds_passes_the_taylor_test() {
    let (points, triangles) = sheet(6);
    let triangles = in_order(&corners(&points, &triangles));
    for s in [0.5, 1.0, 5.0, 50.0] {
        let mut noise = Noise(3);
        let seeds: Vec<DVec3> = (0..25)
            .map(|_| noise.vector() * DVec3::new(1.0, 1.0, 0.3))
            .collect();
        let direction: Vec<DVec3> = (0..25).map(|_| noise.vector()).collect();
        let metric = Metric::anisotropic(s);
        let g = cells(&triangles, &seeds, metric).gradient;
        let derivative = g.iter().zip(&direction).map(|(g, d)| g.dot(*d)).sum();
        let energy = |h: f64| {
            let moved: Vec<DVec3> = seeds
                .iter()
                .zip(&direction)
                .map(|(x, d)| x + h * d)
                .collect();
            cells(&triangles, &moved, metric).energy
        };
        let slope = taylor_slope(energy, derivative, 1e-3);
        assert!(slope > 1.9, "s = {s}: slope {slope}");
    }
}

fn differential(
    triangles: &[[DVec3; 3]],
    seeds: &[DVec3],
    normals: &[DVec3],
    metric: Metric,
) -> differentiated_voronoi::Differential {
    let candidates = Candidates::find(&TriangleTree::new(triangles), triangles, seeds, 0.0);
    differentiated_voronoi::cpu(triangles, seeds, normals, &candidates, metric)
}

#[test]
fn gradient_of_the_surface_passes_the_taylor_test() {
    let (points, triangles) = sheet(5);
    for s in [0.5, 1.0, 5.0, 50.0] {
        let mut noise = Noise(7);
        let points: Vec<DVec3> = points.iter().map(|p| p + 0.05 * noise.vector()).collect();
        let seeds: Vec<DVec3> = (0..30)
            .map(|_| noise.vector() * DVec3::new(1.0, 1.0, 0.3))
            .collect();
        let normals: Vec<DVec3> = (0..30).map(|_| noise.vector().normalize()).collect();
        let direction: Vec<DVec3> = points.iter().map(|_| noise.vector()).collect();
        let metric = Metric::anisotropic(s);
        let at = |h: f64| {
            let moved: Vec<DVec3> = points
                .iter()
                .zip(&direction)
                .map(|(x, d)| x + h * d)
                .collect();
            differential(&corners(&moved, &triangles), &seeds, &normals, metric)
        };
        let g = at(0.0).gradient;
        let derivative = triangles
            .iter()
            .zip(&g)
            .map(|(t, g)| {
                (0..3)
                    .map(|k| g[k].dot(direction[t[k] as usize]))
                    .sum::<f64>()
            })
            .sum();
        let slope = taylor_slope(|h| at(h).energy, derivative, 1e-3);
        assert!(slope > 1.9, "s = {s}: slope {slope}");
    }
}

#[test]
fn moving_everything_together_changes_nothing() {
    // Energy of (T, X) under a common translation is constant, so for S → T the gradients of S add up to the
    // derivative of translating the samples the other way: checked by differences.
    let (points, triangles) = sheet(8);
    let triangles = in_order(&corners(&points, &triangles));
    let mut noise = Noise(11);
    let seeds: Vec<DVec3> = (0..40).map(|_| noise.vector()).collect();
    let normals: Vec<DVec3> = (0..40).map(|_| noise.vector().normalize()).collect();
    let metric = Metric::anisotropic(5.0);
    let total: DVec3 = differential(&triangles, &seeds, &normals, metric)
        .gradient
        .iter()
        .flatten()
        .sum();
    let axis = DVec3::new(0.3, -0.5, 0.8);
    let shifted = |h: f64| {
        let moved: Vec<DVec3> = seeds.iter().map(|y| y - h * axis).collect();
        differential(&triangles, &moved, &normals, metric).energy
    };
    let difference = (shifted(1e-6) - shifted(-1e-6)) / 2e-6;
    assert!(
        (difference - total.dot(axis)).abs() < 1e-6 * difference.abs().max(1.0),
        "{difference} {}",
        total.dot(axis)
    );
}

/// A fit of a Catmull–Clark surface to an ellipsoid that is shifted by `shift`, and control points to evaluate it at.
fn fit_problem(metric: Metric, shift: DVec3) -> (Vsdm, Vec<DVec3>) {
    let mut target = shapes::sphere(0.5, 3);
    for p in &mut target.positions {
        *p = *p * DVec3::new(1.0, 0.7, 0.5) + shift;
    }
    let samples = sample_by_area(&target, 400, 1);
    let positions = samples
        .iter()
        .map(|s| s.position(target.corners(s.triangle as usize)))
        .collect();
    let normals = samples
        .iter()
        .map(|s| target.area_vector(s.triangle as usize).normalize())
        .collect();
    let triangles = corners(&target.positions, &target.triangles);
    let fixed = FixedSide::new(&triangles, positions, normals);
    let noise = &mut Noise(13);
    let (lo, hi) = (DVec3::new(-0.5, -0.4, -0.3), DVec3::new(0.5, 0.4, 0.3));
    let mut control = ControlMesh::from(shapes::box_grid(lo, hi, [2; 3]));
    for p in &mut control.mesh.positions {
        *p += 0.05 * noise.vector();
    }
    let model = Model::new(&control, Scheme::CatmullClark, 2, true).unwrap();
    let moving = MovingSide::new(model.matrix, model.triangles);
    let vsdm = Vsdm::new(&Device::Cpu, fixed, moving, metric);
    (vsdm, control.mesh.positions)
}

/// What a fit finds at these control points, with candidates of their own.
fn afresh(metric: Metric, shift: DVec3, control: &[DVec3]) -> Evaluation {
    fit_problem(metric, shift).0.evaluate(control).unwrap()
}

fn value(evaluation: &Evaluation) -> f64 {
    evaluation.target_to_surface + evaluation.surface_to_target
}

fn moved(points: &[DVec3], directions: &[DVec3], step: f64) -> Vec<DVec3> {
    let pairs = points.iter().zip(directions);
    pairs.map(|(p, d)| *p + step * *d).collect()
}

#[test]
fn gradient_of_a_fit_passes_the_taylor_test() {
    for s in [1.0, 5.0, 50.0] {
        let metric = Metric::anisotropic(s);
        let (mut vsdm, control) = fit_problem(metric, DVec3::ZERO);
        let noise = &mut Noise(17);
        let direction: Vec<DVec3> = control.iter().map(|_| noise.vector()).collect();
        let here = vsdm.evaluate(&control).unwrap();
        // Neither term hides the other.
        let ratio = here.target_to_surface / here.surface_to_target;
        assert!((0.2..5.0).contains(&ratio), "s = {s}: {ratio}");
        let pairs = here.gradient.iter().zip(&direction);
        let derivative = pairs.map(|(g, d)| g.dot(*d)).sum();
        let energy = |h: f64| {
            value(&afresh(
                metric,
                DVec3::ZERO,
                &moved(&control, &direction, h),
            ))
        };
        let slope = taylor_slope(energy, derivative, 1e-3);
        assert!(slope > 1.9, "s = {s}: slope {slope}");
    }
}

#[test]
fn moving_all_control_points_is_moving_the_target_the_other_way() {
    let metric = Metric::anisotropic(5.0);
    let (mut vsdm, control) = fit_problem(metric, DVec3::ZERO);
    let total: DVec3 = vsdm.evaluate(&control).unwrap().gradient.iter().sum();
    // Short, for cells of T that a bisector sweeps almost at once.
    let h = 1e-7;
    for axis in DVec3::AXES {
        let shifted = |h: f64| value(&afresh(metric, -h * axis, &control));
        let difference = (shifted(h) - shifted(-h)) / (2.0 * h);
        assert!(
            (difference - total.dot(axis)).abs() < 1e-6 * total.length(),
            "{difference} {}",
            total.dot(axis)
        );
    }
}

#[test]
fn kept_candidates_find_what_new_ones_find() {
    let metric = Metric::anisotropic(5.0);
    let (mut vsdm, mut control) = fit_problem(metric, DVec3::ZERO);
    let noise = &mut Noise(19);
    // The second evaluation knows the step's size and keeps its candidates for the next ones; large steps drop them.
    for step in [0.0, 1e-3, 5e-4, 5e-4, 5e-4, 1e-3, 1e-1, 1e-3, 1e-3] {
        let direction: Vec<DVec3> = control.iter().map(|_| noise.vector()).collect();
        control = moved(&control, &direction, step);
        let kept = vsdm.evaluate(&control).unwrap();
        let new = afresh(metric, DVec3::ZERO, &control);
        assert!((value(&kept) / value(&new) - 1.0).abs() < 1e-12, "{step}");
        let norm = new.gradient.iter().map(|g| g.length()).fold(0.0, f64::max);
        let pairs = kept.gradient.iter().zip(&new.gradient);
        let apart = pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(apart < 1e-11 * norm, "{step}: {apart} of {norm}");
    }
}
