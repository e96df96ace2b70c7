//! Raw scans: several files and their poses as one target, range images, single views as points, points that are trusted less, outliers.

mod common;

use glam::{DQuat, DVec3};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use vorofit::device::Device;
use vorofit::files::{Scan, SurfaceToWrite, read_scans, write_surface};
use vorofit::fit::{Options, Start, Target, Template, fit};
use vorofit::geometry::random::Random;
use vorofit::measure;
use vorofit::mesh::{PointCloud, TriangleMesh, shapes};
use vorofit::progress::Silent;
use vorofit::reconstruction;

const BALL: f64 = 2.0;

/// A turn about an axis by an angle, then a motion.
fn pose() -> (DQuat, DVec3) {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.8);
    (turn, DVec3::new(3.0, -1.0, 0.5))
}

/// The triangles of a mesh whose centres are on one side of z = 0.
fn half(mesh: &TriangleMesh, upper: bool) -> TriangleMesh {
    let height = |t: usize| mesh.corners(t).iter().map(|p| p.z).sum::<f64>();
    let chosen = (0..mesh.triangles.len()).filter(|&t| (height(t) > 0.0) == upper);
    TriangleMesh {
        positions: mesh.positions.clone(),
        triangles: chosen.map(|t| mesh.triangles[t]).collect(),
    }
}

fn write(path: &Path, mesh: TriangleMesh) {
    write_surface(path, &SurfaceToWrite::dense(&mesh.into(), None)).expect("a place to write");
}

/// Two halves of a ball, the lower one moved away by the inverse of the pose that the returned .conf has for it.
fn posed_halves(folder: &Path) -> PathBuf {
    let ball = shapes::sphere(BALL, 3);
    let (turn, shift) = pose();
    write(&folder.join("upper.ply"), half(&ball, true));
    let mut lower = half(&ball, false);
    for p in &mut lower.positions {
        *p = turn.inverse() * (*p - shift);
    }
    write(&folder.join("lower.ply"), lower);
    let q = turn.conjugate();
    let conf = folder.join("ball.conf");
    let text = format!(
        "camera 0 0 0\nbmesh upper.ply 0 0 0 0 0 0 1\nbmesh lower.ply {} {} {} {} {} {} {}\nbmesh missing.ply 0 0 0 0 0 0 1\n",
        shift.x, shift.y, shift.z, q.x, q.y, q.z, q.w
    );
    std::fs::write(&conf, text).expect("a place to write");
    conf
}

#[test]
fn poses_bring_scans_together_and_a_file_without_one_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let conf = posed_halves(folder.path());
    let upper = folder.path().join("upper.ply");
    let lower = folder.path().join("lower.ply");
    let surface = |paths: &[PathBuf]| match read_scans(paths).expect("scans") {
        Scan::Surface(surface) => surface.mesh,
        Scan::Points(_) => panic!("faces were written"),
    };
    // The .conf alone stands for what it names and is there.
    let whole = surface(std::slice::from_ref(&conf));
    assert_eq!(whole.face_count(), shapes::sphere(BALL, 3).triangles.len());
    assert!(
        whole
            .positions
            .iter()
            .all(|p| (p.length() - BALL).abs() < 1e-12)
    );
    assert_eq!(
        surface(&[upper.clone(), lower.clone(), conf.clone()]),
        whole
    );
    let above = half(&shapes::sphere(BALL, 3), true).triangles.len();
    assert_eq!(surface(&[conf.clone(), upper.clone()]).face_count(), above);
    // Without poses files are taken as they lie.
    let apart = surface(&[upper.clone(), lower]);
    assert!(apart.positions.iter().any(|p| p.length() > BALL + 1.0));
    let stranger = folder.path().join("stranger.ply");
    std::fs::copy(upper, &stranger).expect("a copy");
    let error = read_scans(&[conf.clone(), stranger])
        .expect_err("no pose")
        .to_string();
    assert!(error.contains("no pose"), "{error}");
    std::fs::remove_file(folder.path().join("upper.ply")).expect("written above");
    std::fs::remove_file(folder.path().join("lower.ply")).expect("written above");
    assert!(
        read_scans(&[conf])
            .expect_err("nothing there")
            .to_string()
            .contains("none of them")
    );
    assert!(read_scans(&[]).is_err());
}

#[test]
fn clouds_and_surfaces_together_are_points_with_the_normals_that_all_have() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("a place to write");
        path
    };
    let bare = file("bare.xyz", "0 0 5\n1 0 5\n");
    let with_normals = file("normals.xyz", "0 0 7 0 0 1\n1 0 7 0 0 1\n");
    let face = file(
        "face.off",
        "OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n9 9 9\n3 0 1 2\n",
    );
    let trusted = file(
        "trusted.ply",
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nproperty float confidence\nend_header\n\
         0 0 1 0.25\n1 0 1 0.5\n",
    );
    let points = |paths: &[&PathBuf]| -> PointCloud {
        let paths: Vec<PathBuf> = paths.iter().map(|&path| path.clone()).collect();
        match read_scans(&paths).expect("points") {
            Scan::Points(points) => points,
            Scan::Surface(_) => panic!("there are points without faces"),
        }
    };
    let both = points(&[&with_normals, &face]);
    // The vertex of no face is no point.
    assert_eq!((both.positions.len(), both.normals), (5, vec![DVec3::Z; 5]));
    assert!(points(&[&with_normals, &bare]).normals.is_empty());
    assert!(points(&[&bare, &with_normals]).normals.is_empty());
    assert_eq!(points(&[&bare, &trusted]).confidence, [1.0, 1.0, 0.25, 0.5]);
    assert_eq!(points(&[&trusted, &bare]).confidence, [0.25, 0.5, 1.0, 1.0]);
}

/// A range image of the lower side of a ball that hangs in front of a wall, as a text PLY.
fn range_image(columns: usize, rows: usize) -> String {
    let (mut points, mut cells) = (String::new(), String::new());
    let mut count = 0;
    for row in 0..rows {
        for column in 0..columns {
            let x = 3.0 * (column as f64 / (columns - 1) as f64 - 0.5);
            let y = 3.0 * (row as f64 / (rows - 1) as f64 - 0.5);
            let height = 1.0 - x * x - y * y;
            let z = if height > 0.0 { height.sqrt() } else { -4.0 };
            if row == 0 {
                cells.push_str("0\n");
            } else {
                writeln!(points, "{x} {y} {z}").expect("memory");
                writeln!(cells, "1 {count}").expect("memory");
                count += 1;
            }
        }
    }
    format!(
        "ply\nformat ascii 1.0\nobj_info num_cols {columns}\nobj_info num_rows {rows}\nelement vertex {count}\nproperty float x\nproperty float y\n\
         property float z\nelement range_grid {}\nproperty list uchar int vertex_indices\nend_header\n{points}{cells}",
        columns * rows
    )
}

#[test]
fn a_range_image_becomes_a_surface_that_faces_the_scanner_and_stops_at_jumps() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scan.ply");
    std::fs::write(&path, range_image(60, 40)).expect("a place to write");
    let Scan::Surface(surface) = read_scans(&[path]).expect("a scan") else {
        panic!("a range grid has faces");
    };
    // The ball and the wall behind it.
    assert_eq!(
        surface.census.components - surface.census.unreferenced_vertices,
        2
    );
    let mesh = surface.mesh.triangulate();
    for t in 0..mesh.triangles.len() {
        assert!(mesh.area_vector(t).z > 0.0);
        let z = mesh.corners(t).map(|p| p.z);
        assert!(z.iter().all(|&z| z < -3.0) || z.iter().all(|&z| z >= 0.0));
    }
}

#[test]
fn the_eight_scans_of_the_dragon_fit_together() {
    let Some(conf) = common::data("scans/dragonStandRight.conf") else {
        return;
    };
    let Scan::Surface(dragon) = read_scans(std::slice::from_ref(&conf)).expect("eight scans")
    else {
        panic!("their range grids have faces");
    };
    assert!(
        dragon.mesh.face_count() > 400_000,
        "{}",
        dragon.mesh.face_count()
    );
    let one = conf.with_file_name("dragonStandRight_48.ply");
    let Scan::Surface(one) = read_scans(&[one, conf.clone()]).expect("a scan") else {
        panic!("its range grid has faces");
    };
    let others = [0, 96, 144, 192, 240, 288, 336]
        .map(|k| conf.with_file_name(format!("dragonStandRight_{k}.ply")));
    let Scan::Surface(others) = read_scans(&[others.to_vec(), vec![conf]].concat()).expect("scans")
    else {
        panic!("their range grids have faces");
    };
    let mut distances =
        measure::distances(&others.mesh.triangulate(), &one.mesh.positions).expect("faces");
    let middle = distances.len() / 2;
    let median = *distances.select_nth_unstable_by(middle, f64::total_cmp).1;
    // A fraction of the points' spacing of half a millimetre; the wrong way round the quaternions leave several millimetres.
    assert!(median < 0.0002, "{median}");
}

fn cloud(positions: Vec<DVec3>) -> PointCloud {
    PointCloud {
        positions,
        ..PointCloud::default()
    }
}

#[test]
fn the_points_of_one_view_make_a_surface_of_one_side() {
    let golden_angle = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    // The upper half of a ball.
    let count = 3_000;
    let point = |k: usize| {
        let z = (k as f64 + 0.5) / count as f64;
        let (sin, cos) = (golden_angle * k as f64).sin_cos();
        DVec3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + z * DVec3::Z
    };
    let view = cloud((0..count).map(point).collect());
    let surface = reconstruction::surface(&view).expect("a surface");
    let outwards = |t: usize| {
        let center = surface.corners(t).iter().sum::<DVec3>();
        0.5 * surface.area_vector(t).dot(center.normalize())
    };
    let outwards: f64 = (0..surface.triangles.len()).map(outwards).sum();
    let area = std::f64::consts::TAU;
    assert!((outwards / area - 1.0).abs() < 0.1, "{outwards} of {area}");
    assert!(surface.area() < 1.12 * area, "{} of {area}", surface.area());
}

#[test]
fn points_that_enclose_nothing_are_refused() {
    let refusal = |points: &PointCloud| {
        let surface = reconstruction::surface(points);
        surface.map(|_| ()).expect_err("no inside").to_string()
    };
    // A wavy sheet.
    let side = 60;
    let at = |k: usize| 2.0 * (k as f64 + 0.5) / side as f64 - 1.0;
    let point = |k: usize| {
        let (x, y) = (at(k % side), at(k / side));
        DVec3::new(x, y, 0.1 * (4.0 * x).sin() * (4.0 * y).sin())
    };
    let refused = refusal(&cloud((0..side * side).map(point).collect()));
    assert!(refused.contains("enclose nothing"), "{refused}");
    // A hippopotamus in six parts, from one side.
    let Some(hippo) = common::data("points/hippo.ply") else {
        return;
    };
    let Scan::Points(hippo) = read_scans(&[hippo]).expect("points") else {
        panic!("it has no faces");
    };
    let refused = refusal(&hippo);
    assert!(refused.contains("enclose nothing"), "{refused}");
}

/// The distances from the centre of a ball that a fit with these options ends with, least and largest.
fn radii(target: &Target, options: &Options) -> (f64, f64) {
    let template = Template::BoundingBox { control_points: 98 };
    let start = Start::new(target, &template, options.scheme).expect("a box");
    let fitted = fit(&Device::Cpu, target, start, options, &Silent).expect("a fit");
    let radius = |p: &DVec3| target.frame.to_input(*p).length();
    let radii = fitted.surface.positions.iter().map(radius);
    radii.fold((f64::INFINITY, 0.0), |(lo, hi), r| (lo.min(r), hi.max(r)))
}

#[test]
fn outliers_that_are_allowed_do_not_pull() {
    let mut ball = shapes::sphere(BALL, 4);
    let mut random = Random::new(7);
    // Small triangles beside the ball: about one percent of the area.
    for _ in 0..60 {
        let spread = DVec3::new(random.normal(), random.normal(), random.normal());
        let direction = (DVec3::X + 0.2 * spread).normalize();
        let center = BALL * random.between(1.05, 1.2) * direction;
        let first = ball.positions.len() as u32;
        ball.positions
            .extend([DVec3::X, DVec3::Y, DVec3::Z].map(|d| center + 0.12 * d));
        ball.triangles.push([first, first + 1, first + 2]);
    }
    let target = Target::new(&Device::Cpu, &ball).expect("a target");
    let pulled = radii(&target, &Options::default());
    assert!(pulled.1 > 1.03 * BALL, "{pulled:?}");
    let options = Options {
        outliers: 0.04,
        ..Options::default()
    };
    let free = radii(&target, &options);
    assert!(free.0 > 0.99 * BALL && free.1 < 1.01 * BALL, "{free:?}");
}

#[test]
fn what_is_trusted_less_pulls_less() {
    let mut both = shapes::sphere(BALL, 4);
    let outer = shapes::sphere(1.05 * BALL, 4);
    let first = both.positions.len() as u32;
    both.triangles
        .extend(outer.triangles.iter().map(|t| t.map(|v| v + first)));
    both.positions.extend(outer.positions);
    let confidence = |outer: f64| -> Vec<f64> {
        (0..both.positions.len())
            .map(|v| if v < first as usize { 1.0 } else { outer })
            .collect()
    };
    let middle = |outer: f64| {
        let target =
            Target::with_confidence(&Device::Cpu, &both, &confidence(outer)).expect("a target");
        let (lo, hi) = radii(&target, &Options::default());
        0.5 * (lo + hi) / BALL
    };
    let (alike, less) = (middle(1.0), middle(0.02));
    assert!(alike > 1.015 && less < 1.01, "{alike} {less}");
    for wrong in [
        vec![1.0],
        vec![0.0; both.positions.len()],
        confidence(-1.0),
        confidence(f64::NAN),
    ] {
        assert!(Target::with_confidence(&Device::Cpu, &both, &wrong).is_err());
    }
}
