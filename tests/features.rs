//! Monge forms converge to the exact ones; ridges, umbilics and sharp edges are where they are known to be, on noise too.

mod common;

use common::{Noise, data};
use glam::DVec3;
use std::f64::consts::{PI, TAU};
use vorofit::device::Device;
use vorofit::features::{Features, Kind, Line, Monge, Origin, Scale, monge_forms};
use vorofit::mesh::{Frame, TriangleMesh, shapes};
use vorofit::topology;

fn find(mesh: &TriangleMesh) -> Features {
    Features::find(&Device::Cpu, mesh, Scale::Automatic).unwrap()
}

fn ellipsoid(axes: DVec3, levels: usize) -> TriangleMesh {
    let mut mesh = shapes::sphere(1.0, levels);
    mesh.positions.iter_mut().for_each(|p| *p *= axes);
    mesh
}

const AXES: DVec3 = DVec3::new(1.0, 0.8, 0.6);

/// Vertices moved along their normals, by a share of the diagonal (rms).
fn noisy(mesh: &TriangleMesh, share: f64) -> TriangleMesh {
    let size = 12f64.sqrt() * share * Frame::of(mesh).unwrap().diagonal;
    let noise = &mut Noise(17);
    let mut moved = mesh.clone();
    for (p, normal) in moved.positions.iter_mut().zip(mesh.vertex_normals()) {
        *p += size * noise.next() * normal;
    }
    moved
}

/// The share of some lines' points that are near a line of the same colour.
fn found_again(lines: &[&Line], others: &[Line], reach: f64) -> f64 {
    let near = |p: DVec3, kind: Kind| {
        let same = others
            .iter()
            .filter(|line| line.kind == kind)
            .flat_map(|line| &line.points);
        same.into_iter().any(|q| q.position.distance(p) < reach)
    };
    let points: Vec<_> = lines
        .iter()
        .flat_map(|l| l.points.iter().map(|p| (p.position, l.kind)))
        .collect();
    points.iter().filter(|(p, kind)| near(*p, *kind)).count() as f64 / points.len() as f64
}

#[test]
fn what_has_no_features_gives_none() {
    let triangle = TriangleMesh {
        positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        triangles: vec![[0, 1, 2]],
    };
    let mut doubled = triangle.clone();
    doubled
        .triangles
        .extend([[0, 1, 2], [2, 1, 0], [0, 0, 1], [1, 1, 1]]);
    let square = shapes::box_grid(DVec3::ZERO, DVec3::ONE, [12, 12, 1]).triangulate();
    let top = |t: &[u32; 3]| t.iter().all(|&v| square.positions[v as usize].z == 1.0);
    let flat = TriangleMesh {
        triangles: square.triangles.iter().copied().filter(top).collect(),
        positions: square.positions.clone(),
    };
    let torus = shapes::torus(2.0, 0.7, 180, 60).triangulate();
    for mesh in [triangle, doubled, flat, shapes::sphere(1.0, 4), torus] {
        let features = find(&mesh);
        assert!(features.lines.is_empty(), "{} lines", features.lines.len());
        assert!(features.umbilics.is_empty() && features.crossings.is_empty());
        let finite = |form: &Monge| {
            form.curvatures
                .iter()
                .chain(&form.third)
                .chain(&form.fourth)
                .all(|x| x.is_finite())
        };
        assert!(features.forms.iter().all(finite));
        assert_eq!(features.forms.len(), mesh.positions.len());
        let sites = features.filtered(&mesh, 30).sites;
        assert!(sites.len() <= 30 && !sites.is_empty());
    }
    assert!(Features::find(&Device::Cpu, &TriangleMesh::default(), Scale::Automatic).is_err());
    for share in [0.0, -1.0, 0.5, f64::NAN] {
        let refused = monge_forms(
            &Device::Cpu,
            &shapes::sphere(1.0, 1),
            Scale::Fraction(share),
        );
        assert!(refused.unwrap_err().to_string().contains("out of range"));
    }
}

#[test]
fn monge_forms_of_a_torus_converge() {
    // Worst errors of curvatures and of third derivatives; neighbourhoods of the same number of edges.
    let errors = |n: u32| {
        let mesh = shapes::torus(2.0, 0.7, 3 * n, n).triangulate();
        let forms = monge_forms(&Device::Cpu, &mesh, Scale::Fraction(3.0 / f64::from(n))).unwrap();
        let mut worst = [0f64; 2];
        for (v, form) in forms.iter().enumerate() {
            let phi = TAU * f64::from(v as u32 % n) / f64::from(n);
            let exact = [-phi.cos() / (2.0 + 0.7 * phi.cos()), -1.0 / 0.7];
            for (k, exact) in form.curvatures.iter().zip(exact) {
                worst[0] = worst[0].max((k - exact).abs());
            }
            worst[1] = worst[1].max(form.third[0].abs()).max(form.third[3].abs());
        }
        worst
    };
    let (coarse, fine) = (errors(60), errors(120));
    let orders = [0, 1].map(|k| (coarse[k] / fine[k]).log2());
    println!(
        "orders on a torus: curvatures {:.2}, third derivatives {:.2}",
        orders[0], orders[1]
    );
    assert!(orders[0] > 3.0 && orders[1] > 1.6, "{orders:?}");
}

#[test]
fn curvatures_of_an_ellipsoid_converge() {
    let errors = |levels: usize| {
        let mesh = ellipsoid(AXES, levels);
        let share = 0.2 / f64::from(1 << (levels - 3));
        let forms = monge_forms(&Device::Cpu, &mesh, Scale::Fraction(share)).unwrap();
        let squares = AXES * AXES;
        let worst = mesh.positions.iter().zip(&forms).map(|(p, form)| {
            let length = (*p / squares).length();
            let gauss = 1.0 / ((squares.x * squares.y * squares.z) * length.powi(4));
            let mean = (p.length_squared() - squares.element_sum())
                / (2.0 * squares.x * squares.y * squares.z * length.powi(3));
            let [k1, k2] = form.curvatures;
            ((k1 * k2) - gauss)
                .abs()
                .max((0.5 * (k1 + k2) - mean).abs())
        });
        worst.fold(0.0, f64::max)
    };
    let (coarse, fine) = (errors(4), errors(5));
    println!("order on an ellipsoid: {:.2}", (coarse / fine).log2());
    assert!(coarse / fine > 8.0, "{coarse} {fine}");
}

#[test]
fn an_ellipsoid_has_its_four_umbilics_and_its_symmetry_planes_for_ridges() {
    let mesh = ellipsoid(AXES, 5);
    let features = find(&mesh);
    let (a, b, c) = (AXES.x * AXES.x, AXES.y * AXES.y, AXES.z * AXES.z);
    let exact = DVec3::new(
        AXES.x * ((a - b) / (a - c)).sqrt(),
        0.0,
        AXES.z * ((b - c) / (a - c)).sqrt(),
    );
    assert_eq!(features.umbilics.len(), 4);
    for umbilic in &features.umbilics {
        assert!(
            (umbilic.position.abs() - exact).length() < 0.01,
            "{umbilic:?}"
        );
        assert!(umbilic.is_sure && umbilic.index == 0.5);
    }
    for line in &features.lines {
        assert!(
            line.points
                .iter()
                .all(|p| p.position.abs().min_element() < 0.01),
            "{line:?}"
        );
    }
    // Along z = 0 runs the crest, along x = 0 a ridge of the lesser sort, along y = 0 both meet at the umbilics.
    let rings: Vec<_> = features
        .lines
        .iter()
        .filter(|line| line.is_closed)
        .map(|line| (line.kind, line.length()))
        .collect();
    let perimeter = |p: f64, q: f64| {
        let h = ((p - q) / (p + q)).powi(2);
        PI * (p + q) * (1.0 + 3.0 * h / (10.0 + (4.0 - 3.0 * h).sqrt()))
    };
    assert_eq!(rings.len(), 2);
    for ((kind, length), (expected, exact)) in rings.into_iter().zip([
        (Kind::Blue, perimeter(1.0, 0.8)),
        (Kind::Red, perimeter(0.8, 0.6)),
    ]) {
        assert_eq!(kind, expected);
        assert!((length / exact - 1.0).abs() < 2e-3, "{length} {exact}");
    }
    assert_eq!(features.crossings.len(), 6);
    for crossing in &features.crossings {
        let axis = (crossing.position.abs() / AXES).max_element();
        assert!((axis - 1.0).abs() < 0.01, "{crossing:?}");
    }
}

/// z = 0.1 (cos x + 0.7 cos y) over [−4, 4]²: the planes x = mπ and y = nπ are planes of symmetry, and so hold ridges.
#[test]
fn a_bumpy_sheet_has_ridges_along_its_crests_and_valleys() {
    let square = shapes::box_grid(-DVec3::ONE, DVec3::ONE, [161, 161, 1]).triangulate();
    let top = |t: &[u32; 3]| t.iter().all(|&v| square.positions[v as usize].z == 1.0);
    let height = |p: &DVec3| {
        DVec3::new(
            4.0 * p.x,
            4.0 * p.y,
            0.1 * ((4.0 * p.x).cos() + 0.7 * (4.0 * p.y).cos()),
        )
    };
    let mesh = TriangleMesh {
        triangles: square.triangles.iter().copied().filter(top).collect(),
        positions: square.positions.iter().map(height).collect(),
    };
    let features = find(&mesh);
    for along in 0..2 {
        for (m, kind) in [(0.0, Kind::Blue), (PI, Kind::Red), (-PI, Kind::Red)] {
            let on_line = |p: DVec3| (p[along] - m).abs() < 0.02;
            let lines = features
                .lines
                .iter()
                .filter(|line| line.points.iter().filter(|p| on_line(p.position)).count() > 10);
            let lines: Vec<_> = lines.collect();
            let length: f64 = lines.iter().map(|line| line.length()).sum();
            assert!(length > 5.5, "{along} {m}: {length}");
            let outstanding = lines
                .iter()
                .filter(|line| line.kind == kind)
                .map(|line| line.length())
                .sum::<f64>();
            assert!(
                outstanding > 0.3 * length,
                "{along} {m}: {outstanding} of {length}"
            );
        }
    }
    // The summits, pits and passes within the sheet.
    let is_summit = |p: DVec3| {
        let q = p.truncate() / PI;
        (q - q.round()).abs().max_element() < 0.01
    };
    let summits = features.crossings.iter().filter(|c| is_summit(c.position));
    assert!(summits.count() >= 4);
}

#[test]
fn a_box_has_its_edges_and_corners_and_nothing_else() {
    let mesh = shapes::box_grid(DVec3::ZERO, DVec3::new(3.0, 2.0, 1.0), [30, 20, 10]).triangulate();
    let features = find(&mesh);
    assert_eq!((features.lines.len(), features.crossings.len()), (12, 8));
    assert!(
        features
            .lines
            .iter()
            .all(|line| line.is_sharp && line.kind == Kind::Blue)
    );
    let length: f64 = features.lines.iter().map(Line::length).sum();
    assert!((length - 24.0).abs() < 1e-9);
    assert!(features.umbilics.is_empty());
    // Beside the edges planes are planes.
    for (p, form) in mesh.positions.iter().zip(&features.forms) {
        let sides = p.min(DVec3::new(3.0, 2.0, 1.0) - *p);
        if sides.to_array().iter().filter(|s| **s < 1e-9).count() == 1 {
            assert!(
                form.curvatures.iter().all(|k| k.abs() < 1e-9),
                "{p} {form:?}"
            );
        }
    }
}

#[test]
fn parts_give_their_edges_and_little_else() {
    for (name, least) in [("surfaces/gear.obj", 0.9), ("surfaces/fandisk.obj", 0.8)] {
        let Some(path) = data(name) else { continue };
        let mesh = vorofit::files::read_surface(&path)
            .unwrap()
            .mesh
            .triangulate();
        let features = find(&topology::oriented(&topology::cleaned(&mesh)));
        let strength = |of: &dyn Fn(&Line) -> bool| {
            features
                .lines
                .iter()
                .filter(|l| of(l))
                .map(|l| l.strength)
                .sum::<f64>()
        };
        let share = strength(&|line| line.is_sharp) / strength(&|_| true);
        println!(
            "{name}: {} lines, {:.1} % of the strength on sharp edges",
            features.lines.len(),
            100.0 * share
        );
        assert!(share > least, "{name}: {share}");
    }
}

#[test]
fn noise_leaves_the_strong_ridges() {
    let clean = ellipsoid(AXES, 5);
    let mesh = noisy(&clean, 1e-3);
    let features = find(&mesh);
    let crest = features.lines.iter().filter(|line| line.strength > 2.0);
    let crest: Vec<_> = crest.collect();
    let diagonal = Frame::of(&clean).unwrap().diagonal;
    let length: f64 = crest.iter().map(|line| line.length()).sum();
    assert!(length > 0.7 * 5.67 && length < 1.3 * 5.67, "{length}");
    assert!(crest.iter().all(|line| {
        line.kind == Kind::Blue
            && line
                .points
                .iter()
                .all(|p| p.position.z.abs() < 0.06 * diagonal)
    }));

    let Some(path) = data("surfaces/stanford-bunny.obj") else {
        return;
    };
    let mesh = vorofit::files::read_surface(&path)
        .unwrap()
        .mesh
        .triangulate();
    let mesh = topology::oriented(&topology::cleaned(&mesh));
    let (before, after) = (find(&mesh), find(&noisy(&mesh, 1e-3)));
    let strong: Vec<_> = before
        .lines
        .iter()
        .filter(|line| line.kind.is_elliptic())
        .take(30)
        .collect();
    let share = found_again(&strong, &after.lines, before.radius);
    println!(
        "bunny: {} lines, {} with noise; {share:.3} of the 30 strongest are found again",
        before.lines.len(),
        after.lines.len()
    );
    assert!(share > 0.75 && after.lines.len() < before.lines.len());
}

/// At the automatic scale, a radius of 7 % of the diagonal, third derivatives are too uncertain there and all umbilics are dropped.
#[test]
fn a_coarse_scale_finds_the_umbilics_under_noise() {
    let clean = ellipsoid(AXES, 5);
    let features = Features::find(&Device::Cpu, &noisy(&clean, 1e-3), Scale::Fraction(0.16));
    let found = features.unwrap().umbilics;
    assert_eq!(found.len(), 4);
    let [a, b, c] = AXES.to_array().map(|x| x * x);
    let exact = DVec3::new(
        (a * (a - b) / (a - c)).sqrt(),
        0.0,
        (c * (b - c) / (a - c)).sqrt(),
    );
    let diagonal = Frame::of(&clean).unwrap().diagonal;
    for umbilic in found {
        let p = umbilic.position;
        let gap = DVec3::new(p.x.abs(), p.y, p.z.abs()).distance(exact);
        assert!(gap < 0.04 * diagonal, "{gap}");
    }
}

#[test]
fn the_wanted_number_of_sites_is_met() {
    let mesh = shapes::lobed_ball(4);
    let features = find(&mesh);
    for count in [1, 10, 50, 300, 1000] {
        let filtered = features.filtered(&mesh, count);
        assert_eq!(filtered.sites.len(), count);
        for (k, site) in filtered.sites.iter().enumerate() {
            let place = site
                .place
                .position(mesh.corners(site.place.triangle as usize));
            assert!((place - site.position).length() < 1e-6, "{site:?}");
            assert!(
                filtered.sites[..k]
                    .iter()
                    .all(|other| other.position != site.position)
            );
        }
    }
    let all = features.filtered(&mesh, 100_000).sites;
    assert!(all.len() >= mesh.positions.len() && all.len() < 100_000);
    let strong = features.filtered(&mesh, 20);
    assert!(strong.strength.unwrap() > features.crossings.last().unwrap().strength);
    assert!(
        strong
            .sites
            .iter()
            .all(|site| !matches!(site.origin, Origin::Vertex(_)))
    );
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let mesh = noisy(&shapes::lobed_ball(4), 1e-4);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let features = find(&mesh);
            let sites = features.filtered(&mesh, 200);
            (features, sites)
        })
    };
    assert!(with(1) == with(3));
}

#[test]
fn the_gpu_finds_the_same_ridges() {
    let mesh = shapes::lobed_ball(4);
    let cpu = find(&mesh);
    let gpu = Features::find(&Device::Gpu(common::gpu().clone()), &mesh, Scale::Automatic).unwrap();
    let strong: Vec<_> = cpu
        .lines
        .iter()
        .filter(|line| line.strength > 0.5)
        .collect();
    assert!(found_again(&strong, &gpu.lines, 0.1 * cpu.radius) > 0.99);
    assert_eq!(cpu.umbilics.len(), gpu.umbilics.len());
}
