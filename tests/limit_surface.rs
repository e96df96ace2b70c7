//! Closest points on limit surfaces: the twins against each other, and what is found against what is known.

mod common;

use common::{Noise, agree, disagreement, gpu, repeats, sees};
use glam::DVec3;
use vorofit::benchmark::samples;
use vorofit::device::Device;
use vorofit::kernel::Kernel;
use vorofit::kernel::limit_surface::{
    self, ClosestOnLimit, LimitInput, LimitQuery, LimitSurfaceTwins,
};
use vorofit::mesh::{ControlMesh, PolygonMesh, Scheme, shapes};
use vorofit::model::limit_surface::{LimitSurface, PatchSearch, Patches, Status, SurfaceParameter};

/// Triangles around two poles of valence `n` and one of a ring, between them `rings` rings.
fn spindle(n: usize, rings: usize, noise: &mut Noise) -> ControlMesh {
    let mut positions = vec![DVec3::Z, -DVec3::Z];
    for r in 0..rings {
        for k in 0..n {
            let down = std::f64::consts::PI * (r + 1) as f64 / (rings + 1) as f64;
            let turn = std::f64::consts::TAU * (k as f64 + 0.5 * r as f64) / n as f64;
            let ring = DVec3::new(down.sin() * turn.cos(), down.sin() * turn.sin(), down.cos());
            positions.push(ring + 0.1 / n as f64 * noise.vector());
        }
    }
    let at = |r: usize, k: usize| (2 + r * n + k % n) as u32;
    let mut faces = Vec::new();
    for k in 0..n {
        faces.push(vec![0, at(0, k), at(0, k + 1)]);
        faces.push(vec![1, at(rings - 1, k + 1), at(rings - 1, k)]);
        for r in 1..rings {
            faces.push(vec![at(r - 1, k), at(r, k), at(r - 1, k + 1)]);
            faces.push(vec![at(r - 1, k + 1), at(r, k), at(r, k + 1)]);
        }
    }
    PolygonMesh::from_faces(positions, faces).into()
}

/// A wavy square of n × n cells; open.
fn sheet(n: usize, triangles: bool, noise: &mut Noise) -> ControlMesh {
    let at = |i: usize, j: usize| (i * (n + 1) + j) as u32;
    let mut faces = Vec::new();
    for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        if triangles {
            faces.extend([vec![a, b, c], vec![a, c, d]]);
        } else {
            faces.push(vec![a, b, c, d]);
        }
    }
    let positions = (0..(n + 1) * (n + 1))
        .map(|k| DVec3::new((k / (n + 1)) as f64, (k % (n + 1)) as f64, noise.next()) / n as f64)
        .collect();
    PolygonMesh::from_faces(positions, faces).into()
}

fn anywhere(noise: &mut Noise, faces: usize, triangles: bool) -> SurfaceParameter {
    let (mut u, mut v) = (noise.next() + 0.5, noise.next() + 0.5);
    if triangles && u + v > 1.0 {
        (u, v) = (1.0 - u, 1.0 - v);
    }
    SurfaceParameter {
        face: noise.below(faces) as u32,
        u,
        v,
    }
}

/// Queries off points of the surface, starting from points nearby.
fn near(
    control: ControlMesh,
    scheme: Scheme,
    count: usize,
    off: f64,
    noise: &mut Noise,
) -> LimitInput {
    let surface = LimitSurface::new(&control, scheme).unwrap();
    let patches = surface.patches(&control.mesh.positions);
    let faces = control.mesh.face_count();
    let queries = (0..count)
        .map(|_| {
            let mut start = anywhere(noise, faces, scheme == Scheme::Loop);
            let point = patches.evaluate(start).position + off * noise.vector();
            start.u = 0.9 * start.u + 0.03;
            start.v = 0.9 * start.v + 0.03;
            LimitQuery {
                point,
                start,
                is_settled: false,
            }
        })
        .collect();
    LimitInput {
        control,
        scheme,
        queries,
    }
}

fn moved(mut input: LimitInput, scale: f64, offset: DVec3) -> LimitInput {
    let points = input.queries.iter_mut().map(|q| &mut q.point);
    for p in input.control.mesh.positions.iter_mut().chain(points) {
        *p = offset + scale * *p;
    }
    input
}

fn with_points(mut input: LimitInput, point: impl Fn(DVec3) -> DVec3) -> LimitInput {
    for q in &mut input.queries {
        q.point = point(q.point);
    }
    input
}

#[test]
fn twins_agree() {
    let noise = &mut Noise(5);
    let ordinary = near(spindle(7, 6, noise), Scheme::Loop, 5000, 0.02, noise);
    let few = near(spindle(3, 1, noise), Scheme::Loop, 0, 0.0, noise);
    let mut settled = ordinary.clone();
    settled.queries.iter_mut().for_each(|q| q.is_settled = true);
    let mut corners = ordinary.clone();
    for (i, q) in corners.queries.iter_mut().enumerate() {
        (q.start.u, q.start.v) = [(0.5, 0.5), (0.0, 0.3), (0.4, 0.0), (0.01, 0.01)][i % 4];
    }
    // Tiny faces beside huge ones.
    let mut uneven = spindle(6, 8, noise);
    for p in &mut uneven.mesh.positions {
        p.z = p.z.powi(5);
    }
    let open = near(sheet(8, true, noise), Scheme::Loop, 2000, 0.05, noise);
    let far_away = DVec3::new(4e6, -5e6, 300.0);
    agree::<LimitSurfaceTwins>(&[
        ("no queries", few),
        ("settled", settled),
        (
            "valence 3",
            near(spindle(3, 2, noise), Scheme::Loop, 2000, 0.05, noise),
        ),
        (
            "valence 50",
            near(spindle(50, 4, noise), Scheme::Loop, 2000, 0.01, noise),
        ),
        (
            "on the surface",
            near(spindle(5, 4, noise), Scheme::Loop, 2000, 0.0, noise),
        ),
        ("from edges and corners", corners),
        (
            "far from the surface",
            with_points(ordinary.clone(), |p| 100.0 * p),
        ),
        ("open", open),
        ("uneven", near(uneven, Scheme::Loop, 2000, 0.001, noise)),
        ("small", moved(ordinary.clone(), 1e-3, DVec3::ZERO)),
        ("large", moved(ordinary.clone(), 1e3, DVec3::ZERO)),
        ("far away", moved(ordinary.clone(), 1.0, far_away)),
        ("of the benchmark", samples::limit(2000)),
        ("ordinary", ordinary.clone()),
    ]);
    repeats::<LimitSurfaceTwins>(&ordinary);
}

#[test]
fn faults_are_seen() {
    let noise = &mut Noise(6);
    let input = near(spindle(7, 6, noise), Scheme::Loop, 3000, 0.02, noise);
    sees::<LimitSurfaceTwins>(
        &limit_surface::SHADER,
        &input,
        &[
            ("4.0 * x + 6.0 * y", "4.0 * x - 6.0 * y"),
            ("2.0 * z * ss * s;", "3.0 * z * ss * s;"),
            (
                "control[8] - o - 2.0 * x + y",
                "control[8] - o - 2.0 * x - y",
            ),
            ("3u * level + k - 1u", "3u * level + k % 3u"),
            ("vec2f(1.0, 0.0) - along", "along"),
            (
                "return -solve(hessian, gradient)",
                "return solve(hessian, gradient)",
            ),
        ],
    );
}

#[test]
fn most_queries_are_settled_by_newton_alone() {
    let noise = &mut Noise(7);
    let input = near(spindle(7, 6, noise), Scheme::Loop, 5000, 0.02, noise);
    for points in [
        LimitSurfaceTwins::cpu(&input),
        LimitSurfaceTwins::gpu(
            gpu(),
            &mut LimitSurfaceTwins::upload(gpu(), &input).unwrap(),
        )
        .unwrap(),
    ] {
        let open = points
            .iter()
            .filter(|p| p.status == Status::NotConverged)
            .count();
        println!("{open} of 5000 left open");
        assert!(open < 50, "{open} of 5000");
    }
    assert!(disagreement::<LimitSurfaceTwins>(gpu(), &input) < 1.0);
}

#[test]
fn the_last_step_may_be_taken_on_trust() {
    let noise = &mut Noise(8);
    let input = near(spindle(7, 6, noise), Scheme::Loop, 3000, 0.02, noise);
    let near = 1e-3;
    let surface = LimitSurface::new(&input.control, input.scheme).unwrap();
    let patches = surface.patches(&input.control.mesh.positions);
    for device in [Device::Cpu, Device::Gpu(gpu().clone())] {
        let closest = ClosestOnLimit::new(&device, &patches).unwrap();
        let exact = closest.descend(&input.queries).unwrap();
        let trusted = closest.approach(&input.queries, near).unwrap();
        let settled = exact.iter().zip(&trusted);
        let apart: Vec<f64> = settled
            .filter(|(exact, _)| exact.status == Status::Converged)
            .map(|(exact, &at)| exact.position.distance(patches.evaluate(at).position))
            .collect();
        let share =
            |most: f64| apart.iter().filter(|&&d| d <= most).count() as f64 / apart.len() as f64;
        println!(
            "{} of 3000, {:.3}, {:.3}",
            apart.len(),
            share(near),
            share(0.1 * near)
        );
        assert!(apart.len() > 2900 && share(near) > 0.99 && share(0.1 * near) > 0.9);
    }
    let mut kept = input.queries[0];
    kept.is_settled = true;
    let closest = ClosestOnLimit::new(&Device::Cpu, &patches).unwrap();
    assert_eq!(closest.approach(&[kept], near).unwrap(), [kept.start]);
}

/// The nearest of many points of the surface.
fn by_sampling(patches: &Patches<'_>, faces: usize, triangles: bool, query: DVec3) -> f64 {
    let n = 10;
    let mut least = f64::INFINITY;
    for face in 0..faces as u32 {
        for i in 0..=n {
            for j in 0..=if triangles { n - i } else { n } {
                let (u, v) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                let at = SurfaceParameter { face, u, v };
                least = least.min((patches.evaluate(at).position - query).length());
            }
        }
    }
    least
}

fn check_search(name: &str, control: &ControlMesh, scheme: Scheme, queries: &[DVec3]) {
    let surface = LimitSurface::new(control, scheme).unwrap();
    let patches = surface.patches(&control.mesh.positions);
    let closest = ClosestOnLimit::new(&Device::Cpu, &patches).unwrap();
    let faces = control.mesh.face_count();
    let found = closest.search(queries, &[], 1e-6).unwrap();
    let guesses = closest.first_guess(&Device::Cpu, queries).unwrap();
    let tracked: Vec<LimitQuery> = (queries.iter().zip(&guesses))
        .map(|(&point, &start)| LimitQuery {
            point,
            start,
            is_settled: false,
        })
        .collect();
    let tracked = closest.track(&tracked).unwrap();
    let known = closest.search(queries, &tracked, 1e-6).unwrap();
    for (i, (&query, answer)) in queries.iter().zip(&found).enumerate() {
        assert!((patches.evaluate(answer.parameter).position - answer.position).length() < 1e-12);
        assert!(((answer.position - query).length() - answer.distance).abs() < 1e-12);
        let sampled = by_sampling(&patches, faces, scheme == Scheme::Loop, query);
        let slack = 1e-5;
        assert!(
            answer.distance <= sampled + slack,
            "{name}, {query}: {} but {sampled}",
            answer.distance
        );
        assert!(
            (known[i].distance - answer.distance).abs() < slack,
            "{name}, {query}"
        );
        assert!(
            answer.distance <= tracked[i].distance + slack,
            "{name}, {query}"
        );
        assert_eq!(tracked[i].status, Status::Converged);
    }
}

#[test]
fn the_search_misses_nothing() {
    let noise = &mut Noise(9);
    let queries: Vec<DVec3> = (0..30).map(|_| 2.0 * noise.vector()).collect();
    let mut creased = spindle(6, 3, noise);
    for k in 0..6 {
        let edge = [2 + k, 2 + (k + 1) % 6];
        creased.creases.push(vorofit::mesh::Crease {
            edge,
            sharpness: f64::INFINITY,
        });
    }
    let quads = shapes::box_grid(DVec3::splat(-0.5), DVec3::splat(0.5), [2, 1, 2]);
    check_search("spindle", &spindle(7, 3, noise), Scheme::Loop, &queries);
    check_search("valence 3", &spindle(3, 2, noise), Scheme::Loop, &queries);
    check_search("creased", &creased, Scheme::Loop, &queries);
    check_search("sheet", &sheet(4, true, noise), Scheme::Loop, &queries);
    check_search("quads", &quads.into(), Scheme::CatmullClark, &queries);
    check_search(
        "quad sheet",
        &sheet(4, false, noise),
        Scheme::CatmullClark,
        &queries,
    );
    check_search(
        "valence 20",
        &spindle(20, 2, noise),
        Scheme::Loop,
        &queries[..5],
    );
}

#[test]
fn corners_edges_and_far_points_are_found() {
    let noise = &mut Noise(11);
    let sheet = sheet(4, true, noise);
    let surface = LimitSurface::new(&sheet, Scheme::Loop).unwrap();
    let patches = surface.patches(&sheet.mesh.positions);
    let closest = ClosestOnLimit::new(&Device::Cpu, &patches).unwrap();
    // The corner of one face stays where its control point is.
    let corner = sheet.mesh.positions[20];
    let beyond = corner + DVec3::new(1.0, -1.0, 0.0);
    let found = closest
        .search(&[beyond, corner, 1e4 * DVec3::Z], &[], 1e-6)
        .unwrap();
    assert!(
        (found[0].position - corner).length() < 1e-9,
        "{:?}",
        found[0]
    );
    assert!(found[1].distance < 1e-6);
    assert!((found[2].distance - 1e4).abs() < 1.0);
    let query = LimitQuery {
        point: beyond,
        start: SurfaceParameter {
            face: 3,
            u: 0.2,
            v: 0.2,
        },
        is_settled: false,
    };
    let tracked = closest
        .track(&[
            query,
            LimitQuery {
                is_settled: true,
                ..query
            },
        ])
        .unwrap();
    assert!((tracked[0].position - corner).length() < 1e-9);
    assert_eq!(tracked[1].parameter, query.start);
}

#[test]
fn the_middle_of_a_sphere_is_as_far_from_everything() {
    let sphere: ControlMesh = PolygonMesh::from(shapes::sphere(1.0, 0)).into();
    let surface = LimitSurface::new(&sphere, Scheme::Loop).unwrap();
    let patches = surface.patches(&sphere.mesh.positions);
    // All pieces must be refined down to where the tolerance tells them apart.
    let tolerance = 1e-4;
    let found = PatchSearch::new(&patches, tolerance)
        .unwrap()
        .nearest(DVec3::ZERO, None);
    let sampled = by_sampling(&patches, sphere.mesh.face_count(), true, DVec3::ZERO);
    assert!(found.distance <= sampled + tolerance && found.distance > 0.9 * sampled);
}

#[test]
fn a_device_tracks_to_the_same_points_as_the_cpu() {
    let noise = &mut Noise(13);
    let input = near(spindle(7, 6, noise), Scheme::Loop, 3000, 0.02, noise);
    let surface = LimitSurface::new(&input.control, input.scheme).unwrap();
    let patches = surface.patches(&input.control.mesh.positions);
    let track = |device: &Device| {
        ClosestOnLimit::new(device, &patches)
            .unwrap()
            .track(&input.queries)
            .unwrap()
    };
    let (cpu, device) = (track(&Device::Cpu), track(&Device::Gpu(gpu().clone())));
    let apart = cpu
        .iter()
        .zip(&device)
        .filter(|(a, b)| (a.position - b.position).length() > 1e-8);
    assert!(apart.count() < 10);
    let threads = |n| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(n)
            .build()
            .unwrap();
        pool.install(|| track(&Device::Cpu))
    };
    assert_eq!(threads(1), threads(3));
}
