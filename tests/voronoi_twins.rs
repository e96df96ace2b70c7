//! The Voronoi kernels on the GPU against their f64 twins, on surfaces and seeds from ordinary to hostile, at three sizes and
//! far from the origin.

mod common;

use common::{Noise, agree, disagreement, gpu, repeats, sees};
use glam::DVec3;
use vorofit::geometry::triangle_tree::{TriangleTree, spatial_order};
use vorofit::kernel::candidates::{self, CandidateInput, CandidateSeeds, Candidates};
use vorofit::kernel::differentiated_voronoi::{self, DifferentiatedInput, DifferentiatedVoronoi};
use vorofit::kernel::restricted_voronoi::{self, Metric, RestrictedInput, RestrictedVoronoi};
use vorofit::kernel::slots;

/// A surface and seeds near it.
#[derive(Clone)]
struct Scene {
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    seeds: Vec<DVec3>,
}

impl Scene {
    /// As the device sees it, so that exact ties stay exact.
    fn rounded(mut self) -> Self {
        for p in self.points.iter_mut().chain(&mut self.seeds) {
            *p = p.as_vec3().as_dvec3();
        }
        self
    }

    fn moved(mut self, scale: f64, offset: DVec3) -> Self {
        for p in self.points.iter_mut().chain(&mut self.seeds) {
            *p = offset + scale * *p;
        }
        self
    }

    fn corners(&self) -> Vec<[DVec3; 3]> {
        let corner = |v: u32| self.points[v as usize];
        self.triangles.iter().map(|t| t.map(corner)).collect()
    }

    fn in_order(mut self) -> Self {
        let centers: Vec<DVec3> = self
            .corners()
            .iter()
            .map(|[a, b, c]| (a + b + c) / 3.0)
            .collect();
        self.triangles = spatial_order(&centers)
            .iter()
            .map(|&t| self.triangles[t as usize])
            .collect();
        self
    }

    /// The largest extent of the surface.
    fn size(&self) -> f64 {
        let first = self.points[0];
        let bounds = self
            .points
            .iter()
            .fold((first, first), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        (bounds.1 - bounds.0).max_element()
    }

    fn candidates(&self, slack: f64) -> Candidates {
        let corners = self.corners();
        Candidates::find(&TriangleTree::new(&corners), &corners, &self.seeds, slack)
    }

    fn restricted(self, metric: Metric) -> RestrictedInput {
        let scene = self.in_order();
        RestrictedInput {
            candidates: scene.candidates(0.0),
            triangles: scene.corners(),
            seeds: scene.seeds,
            metric,
        }
    }

    /// With normals that lean about the z axis, alike where samples coincide.
    fn differentiated(self, metric: Metric) -> DifferentiatedInput {
        let scene = self.in_order();
        let normal = |p: &DVec3| {
            let lean = DVec3::new((40.0 * p.y).sin(), (30.0 * p.x).cos(), 1.5);
            lean.normalize().as_vec3().as_dvec3()
        };
        DifferentiatedInput {
            candidates: scene.candidates(0.0),
            normals: scene.seeds.iter().map(normal).collect(),
            triangles: scene.triangles,
            points: scene.points,
            samples: scene.seeds,
            metric,
        }
    }
}

/// A bumpy sheet of `2 n²` triangles over [−½, ½]², without seeds.
fn sheet(n: u32) -> Scene {
    let m = n + 1;
    let at = |k: u32| f64::from(k) / f64::from(n) - 0.5;
    let points = (0..m * m)
        .map(|k| {
            let (x, y) = (at(k % m), at(k / m));
            DVec3::new(x, y, 0.1 * (5.0 * x).sin() * (4.0 * y).cos())
        })
        .collect();
    let mut triangles = Vec::new();
    for k in (0..m * n).filter(|k| k % m != n) {
        triangles.push([k, k + 1, k + m]);
        triangles.push([k + 1, k + m + 1, k + m]);
    }
    Scene {
        points,
        triangles,
        seeds: Vec::new(),
    }
}

/// Seeds scattered about a sheet.
fn scattered(n: u32, seeds: usize) -> Scene {
    let noise = &mut Noise(5);
    let mut scene = sheet(n);
    scene.seeds = (0..seeds)
        .map(|_| {
            let p = noise.vector();
            DVec3::new(
                p.x,
                p.y,
                0.1 * (5.0 * p.x).sin() * (4.0 * p.y).cos() + 0.02 * p.z,
            )
        })
        .collect();
    scene.rounded()
}

/// A flat grid with two seeds on each of its nodes: every bisector runs through vertices and along edges.
fn lattice(n: u32) -> Scene {
    let mut scene = sheet(n);
    for p in &mut scene.points {
        p.z = 0.0;
    }
    scene.seeds = scene.points.iter().flat_map(|&p| [p, p]).collect();
    scene.rounded()
}

/// Thin triangles over the square, down to an aspect of 1e-7, and two that are degenerate.
fn slivers() -> Scene {
    let noise = &mut Noise(9);
    let mut scene = scattered(4, 60);
    for k in 0..200 {
        let (a, b) = (noise.vector(), noise.vector());
        let middle = 0.5 * (a + b) + 10f64.powf(-1.0 - 6.0 * f64::from(k) / 200.0) * noise.vector();
        let first = scene.points.len() as u32;
        scene.points.extend([a, b, middle]);
        scene.triangles.push([first, first + 1, first + 2]);
    }
    scene.triangles.push([0, 0, 1]);
    scene.triangles.push([3, 3, 3]);
    scene.rounded()
}

/// One triangle and seeds on a ring about one in the middle, whose cell has more corners than the device keeps.
fn ring(seeds: u32) -> Scene {
    let angle = |k: u32| std::f64::consts::TAU * f64::from(k) / f64::from(seeds);
    Scene {
        points: vec![
            DVec3::new(-2.0, -2.0, 0.0),
            DVec3::new(3.0, -2.0, 0.0),
            DVec3::new(-2.0, 3.0, 0.0),
        ],
        triangles: vec![[0, 1, 2]],
        seeds: std::iter::once(DVec3::new(0.0, 0.0, 0.1))
            .chain((0..seeds).map(|k| 0.5 * DVec3::new(angle(k).cos(), angle(k).sin(), 0.0)))
            .collect(),
    }
    .rounded()
}

/// Every scene, ordinary ones first.
fn scenes() -> Vec<(&'static str, Scene)> {
    let far = DVec3::new(4e6, -5e6, 300.0);
    let mut stretched = scattered(24, 200);
    for p in stretched.points.iter_mut().chain(&mut stretched.seeds) {
        p.y *= 1e-4;
    }
    let mut crowded = scattered(8, 100);
    crowded
        .seeds
        .extend((0..20).map(|_| DVec3::new(0.1, 0.1, 0.0)));
    let mut distant = scattered(8, 30);
    distant
        .seeds
        .extend((0..30).map(|k| DVec3::new(0.0, 0.0, 3.0 + f64::from(k))));
    vec![
        ("more seeds than triangles", scattered(12, 3000)),
        ("fewer seeds than triangles", scattered(60, 90)),
        ("as many", scattered(40, 1500)),
        ("small", scattered(24, 300).moved(1e-3, DVec3::ZERO)),
        ("large", scattered(24, 300).moved(1e3, DVec3::ZERO)),
        ("far away", scattered(24, 300).moved(1.0, far)),
        ("large and far away", scattered(24, 300).moved(1e3, far)),
        ("ties", lattice(16)),
        ("slivers", slivers()),
        ("stretched", stretched.rounded()),
        ("coincident seeds", crowded.rounded()),
        ("empty cells", distant.rounded()),
        ("one triangle", ring(5)),
        ("one seed", scattered(3, 1)),
        ("more corners than the device keeps", ring(40)),
        ("more candidates than the device takes", ring(3000)),
    ]
}

#[test]
fn candidate_seeds() {
    for slack in [0.0, 0.01] {
        let input = |scene: Scene| CandidateInput {
            slack: slack * scene.size(),
            triangles: scene.clone().in_order().corners(),
            seeds: scene.seeds,
        };
        let inputs: Vec<_> = scenes()
            .into_iter()
            .map(|(name, scene)| (name, input(scene)))
            .collect();
        println!("slack {slack}");
        agree::<CandidateSeeds>(&inputs);
        let ordinary = input(scattered(12, 3000));
        repeats::<CandidateSeeds>(&ordinary);
        sees::<CandidateSeeds>(
            &candidates::SHADER,
            &ordinary,
            &[
                ("ROUNDING * (reach", "-0.3 * (reach"),
                ("if !all(squared > bound)", "if !any(squared > bound)"),
                ("budget = BUDGET", "budget = 0u"),
            ],
        );
    }
}

const METRICS: [f64; 3] = [1.0, 5.0, 50.0];

#[test]
fn restricted_cells() {
    for s in METRICS {
        let metric = Metric::anisotropic(s);
        println!("s = {s}");
        let inputs: Vec<_> = scenes()
            .into_iter()
            .map(|(name, scene)| (name, scene.restricted(metric)))
            .collect();
        agree::<RestrictedVoronoi>(&inputs);
    }
    let input = scattered(24, 300).restricted(Metric::anisotropic(5.0));
    repeats::<RestrictedVoronoi>(&input);
}

#[test]
fn restricted_cells_with_faults() {
    let input = scattered(24, 300).restricted(Metric::anisotropic(5.0));
    let shader = &restricted_voronoi::SHADER;
    sees::<RestrictedVoronoi>(
        shader,
        &input,
        &[
            ("2.0 * dot(apart, e2)", "1.999 * dot(apart, e2)"),
            ("2.0 * height - across", "2.0 * height"),
            ("length(edge) / speed", "length(edge)"),
            ("m.ab /= 24.0", "m.ab /= 12.0"),
            ("gradient += bisectors(", "gradient -= bisectors("),
        ],
    );
}

#[test]
fn lost_and_doubled_cells_are_mended_on_the_host() {
    let input = lattice(16).restricted(Metric::ISOTROPIC);
    for rule in ["false", "f == 0.0"] {
        let shader = &restricted_voronoi::SHADER;
        let faulty = gpu().with_fault(shader, "(f == 0.0 && wins_ties)", rule);
        let ratio = disagreement::<RestrictedVoronoi>(&faulty, &input);
        assert!(ratio <= 1.0, "ties by '{rule}': {ratio}");
        // Where nothing looks after them, they are seen.
        let gap = faulty.with_fault(&slots::SHADER, "MAX_GAP: f32 = 1e-4", "MAX_GAP: f32 = 1e4");
        assert!(disagreement::<RestrictedVoronoi>(&gap, &input) > 1.0);
    }
}

#[test]
fn differentiated_cells() {
    for s in METRICS {
        let metric = Metric::anisotropic(s);
        println!("s = {s}");
        let inputs: Vec<_> = scenes()
            .into_iter()
            .map(|(name, scene)| (name, scene.differentiated(metric)))
            .collect();
        agree::<DifferentiatedVoronoi>(&inputs);
    }
    let input = scattered(24, 300).differentiated(Metric::anisotropic(5.0));
    repeats::<DifferentiatedVoronoi>(&input);
}

#[test]
fn differentiated_cells_with_faults() {
    let input = scattered(24, 300).differentiated(Metric::anisotropic(5.0));
    sees::<DifferentiatedVoronoi>(
        &differentiated_voronoi::SHADER,
        &input,
        &[
            ("m.origin.x * by_one", "0.0 * by_one"),
            (
                "gradient[1] -= cross(scaled, e2)",
                "gradient[1] += cross(scaled, e2)",
            ),
            ("+ 4.0 * simpson_term", "+ 3.9 * simpson_term"),
            ("other_height * other_height", "own_height * own_height"),
            ("h.y * h.z, h.z * h.z", "h.y * h.y, h.z * h.z"),
        ],
    );
}
