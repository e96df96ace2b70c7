//! The discrete energy F̃ converges to F as ε² where the samples are refined: [NYL12], section 3.2 and appendix 1.

use glam::DVec3;
use vorofit::geometry::triangle_tree::{TriangleTree, spatial_order};
use vorofit::kernel::candidates::Candidates;
use vorofit::kernel::differentiated_voronoi;
use vorofit::kernel::restricted_voronoi::{self, Metric};
use vorofit::mesh::{TriangleMesh, shapes};

/// F: the integral of the squared distance that `distance` gives, by a rule of degree 5 on every triangle (Radon's, 7 points).
fn exact(triangles: &[[DVec3; 3]], distance: impl Fn(DVec3) -> f64) -> f64 {
    let root = 15f64.sqrt();
    let squared = |[a, b, c]: &[DVec3; 3], near: f64| {
        let far = 0.5 * (1.0 - near);
        [(a, b, c), (b, c, a), (c, a, b)]
            .map(|(p, q, r)| distance(*p * near + (*q + *r) * far).powi(2))
            .iter()
            .sum::<f64>()
    };
    triangles
        .iter()
        .map(|t| {
            let area = 0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length();
            let rule = 9.0 / 40.0 / 3.0 * squared(t, 1.0 / 3.0)
                + (155.0 - root) / 1200.0 * squared(t, (9.0 + 2.0 * root) / 21.0)
                + (155.0 + root) / 1200.0 * squared(t, (9.0 - 2.0 * root) / 21.0);
            area * rule
        })
        .sum()
}

/// F̃ by the cells of the samples: with the samples moving (T → S) and with the triangles moving (S → T) it is the same integral.
fn discrete(triangles: &[[DVec3; 3]], samples: &[DVec3]) -> f64 {
    let candidates = Candidates::find(&TriangleTree::new(triangles), triangles, samples, 0.0);
    let metric = Metric::ISOTROPIC;
    let of_samples = restricted_voronoi::cpu(triangles, samples, &candidates, metric).energy;
    let normals = vec![DVec3::Z; samples.len()];
    let of_surface =
        differentiated_voronoi::cpu(triangles, samples, &normals, &candidates, metric).energy;
    assert!((of_samples / of_surface - 1.0).abs() < 1e-12);
    of_samples
}

fn corners(mesh: &TriangleMesh) -> Vec<[DVec3; 3]> {
    let all: Vec<_> = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
    let centers: Vec<DVec3> = all.iter().map(|t| (t[0] + t[1] + t[2]) / 3.0).collect();
    let order = spatial_order(&centers);
    order.iter().map(|&t| all[t as usize]).collect()
}

/// The least-squares slope of log(F̃ − F) against log ε, where each list of samples has half the ε of the one before.
fn slope(
    name: &str,
    triangles: &[[DVec3; 3]],
    distance: impl Fn(DVec3) -> f64,
    refined: &[Vec<DVec3>],
) -> f64 {
    let expected = exact(triangles, distance);
    let logs: Vec<f64> = refined
        .iter()
        .map(|samples| {
            let above = discrete(triangles, samples) - expected;
            println!(
                "{name}, {} samples: F̃ − F = {above:.4e}, F = {expected:.4e}",
                samples.len()
            );
            assert!(
                above > 0.0,
                "no sample is nearer than the surface it lies on"
            );
            above.log2()
        })
        .collect();
    let middle = 0.5 * (logs.len() - 1) as f64;
    let offsets = || (0..logs.len()).map(|k| k as f64 - middle);
    let slope = -offsets().zip(&logs).map(|(x, y)| x * y).sum::<f64>()
        / offsets().map(|x| x * x).sum::<f64>();
    println!("{name}: slope {slope:.3}");
    slope
}

#[test]
fn energy_to_a_sphere_falls_as_the_square() {
    let triangles = corners(&shapes::sphere(1.0, 4));
    let (center, radius) = (DVec3::new(0.05, -0.03, 0.02), 0.9);
    let refined: Vec<Vec<DVec3>> = (1..5)
        .map(|levels| {
            let sphere = shapes::sphere(radius, levels);
            sphere.positions.iter().map(|p| *p + center).collect()
        })
        .collect();
    let distance = |y: DVec3| (y - center).length() - radius;
    let slope = slope("sphere", &triangles, distance, &refined);
    assert!((1.8..2.2).contains(&slope), "{slope}");
}

#[test]
fn energy_to_a_torus_falls_as_the_square() {
    let triangles = corners(&shapes::torus(1.0, 0.4, 120, 48).triangulate());
    let (major, minor) = (1.05, 0.35);
    let refined: Vec<Vec<DVec3>> = (0..4)
        .map(|k| shapes::torus(major, minor, 18 << k, 6 << k).positions)
        .collect();
    let distance = |y: DVec3| (y.truncate().length() - major).hypot(y.z) - minor;
    let slope = slope("torus", &triangles, distance, &refined);
    assert!((1.8..2.2).contains(&slope), "{slope}");
}

#[test]
fn the_rule_of_the_exact_energy_is_exact() {
    // ∫ (x + 2y)⁴ over the triangle (0,0), (1,0), (0,1): Σ binom(4,k) 2^k k! (4−k)! / 6! = 24 · 31 / 720.
    let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
    let value = exact(&[triangle], |p| (p.x + 2.0 * p.y).powi(2));
    assert!((value - 31.0 / 30.0).abs() < 1e-14, "{value}");
}
