//! Volume templates: the edits compose through files, every one of them leaves a valid mesh or a refusal, and the automatic template needs no hand: it has the
//! target's handles and the number of elements asked for, and an ordinary fit from it meets the target.

mod common;
#[path = "common/program.rs"]
mod program;

use common::data;
use glam::DVec3;
use program::{ball, folder, json, names, path_text, run, succeed, text, write};
use std::path::Path;
use vorofit::device::Device;
use vorofit::files::{Pyramids, SurfaceToWrite, read_surface, read_volume, write_surface};
use vorofit::fit::{Target, VolumeFit, VolumeOptions, VolumeStart, VolumeTemplate, fit_volume};
use vorofit::measure::scaled_jacobian::qualities;
use vorofit::measure::surface_error;
use vorofit::measure::validity::{Validity, validities};
use vorofit::mesh::{CellShape, Connectivity, PolygonMesh, TriangleMesh, VolumeMesh, shapes};
use vorofit::progress::Silent;
use vorofit::template::volume::{automatic, boundary, checked};
use vorofit::topology;

fn read(path: &Path) -> VolumeMesh {
    let volume = read_volume(path, Pyramids::Refused).unwrap();
    assert!(volume.nodes.is_none() && volume.warnings.is_empty());
    checked(volume.mesh).unwrap()
}

fn count(mesh: &VolumeMesh, shape: CellShape) -> usize {
    mesh.cells().filter(|c| c.0 == shape).count()
}

fn euler(mesh: &VolumeMesh) -> i64 {
    let surface = Connectivity::of(&boundary(mesh)).unwrap();
    assert!(surface.is_connected());
    surface.euler_characteristic()
}

/// A fit of order 2 from the automatic template, and its largest error in percent; all elements must be valid.
fn fitted(target: &TriangleMesh, elements: usize) -> (VolumeFit, f64) {
    let target = Target::new(&Device::Cpu, target).unwrap();
    let start = VolumeStart::new(&target, &VolumeTemplate::Auto(elements)).unwrap();
    let options = VolumeOptions::default();
    let fit = fit_volume(&Device::Cpu, &target, start, &options, &Silent).unwrap();
    let validities = validities(&fit.volume);
    assert!(validities.iter().all(|v| *v == Validity::Valid));
    let error = surface_error(&target.mesh, &fit.dense_surface(), 50_000).unwrap();
    let largest = error.target_to_surface.max.max(error.surface_to_target.max);
    (fit, 100.0 * largest)
}

fn mean_scaled_jacobian(fit: &VolumeFit) -> f64 {
    let qualities = qualities(&fit.volume);
    qualities.iter().map(|q| q.mean).sum::<f64>() / qualities.len() as f64
}

#[test]
fn edits_compose_through_files() {
    let folder = folder("template");
    let at = |name: &str| path_text(&folder.join(name)).to_owned();
    write(&folder.join("scan.ply"), &ball());
    let target = at("scan.ply");
    let template = |words: &[&str]| succeed(&[&["template"], words].concat());
    template(&["grid", &target, "--cells", "8x7x6", "-o", &at("grid.vtu")]);
    let said = template(&[
        "carve",
        &at("grid.vtu"),
        "--target",
        &target,
        "--inside",
        "40",
        "-o",
        &at("carved.msh"),
    ]);
    assert!(said.contains("all valid"), "{said}");
    template(&["pillow", &at("carved.msh"), "-o", &at("pillowed.mesh")]);
    let [grid, carved, pillowed] =
        ["grid.vtu", "carved.msh", "pillowed.mesh"].map(|name| read(&folder.join(name)));
    assert_eq!(grid.cell_count(), 8 * 7 * 6);
    assert!(carved.cell_count() < grid.cell_count() && euler(&carved) == 2);
    let quads = boundary(&carved).face_count();
    assert_eq!(pillowed.cell_count(), carved.cell_count() + quads);

    // A strip of the layer, from one quad of the boundary, and single edges of the grid.
    template(&[
        "grid",
        "--between",
        "0,0,0,3,3,3",
        "--cells",
        "3x3x3",
        "-o",
        &at("cube.vtu"),
    ]);
    template(&[
        "collapse",
        &at("cube.vtu"),
        "--face",
        "16,17,33,32",
        "-o",
        &at("rounded.vtu"),
    ]);
    let (cube, same) = (at("cube.vtu"), at("same.vtu"));
    let edges = [
        "--edge", "0,1", "--edge", "16,17", "--edge", "32,33", "--edge", "48,49",
    ];
    let words = [&["collapse", &cube, "-o", &same], &edges[..]].concat();
    template(&words);
    let [rounded, same] = ["rounded.vtu", "same.vtu"].map(|name| read(&folder.join(name)));
    assert_eq!(rounded, same);
    assert_eq!(count(&rounded, CellShape::Prism), 3);

    let report = at("report.json");
    let words = [
        "volume",
        &target,
        "--template",
        &at("pillowed.mesh"),
        "-o",
        &at("fit.vtu"),
    ];
    succeed(
        &[
            &words[..],
            &["--order", "1", "--json", &report, "--device", "cpu"],
        ]
        .concat(),
    );
    let report = json(Path::new(&report));
    assert_eq!(report["result"]["elements"], pillowed.cell_count());
    assert_eq!(report["quality"]["invalid"], 0);
}

#[test]
fn surfaces_are_extruded_and_cages_are_made() {
    let folder = folder("extrude");
    let at = |name: &str| path_text(&folder.join(name)).to_owned();
    let sheet = PolygonMesh::from_faces(
        vec![
            DVec3::ZERO,
            DVec3::X,
            DVec3::X + DVec3::Y,
            DVec3::Y,
            2.0 * DVec3::X,
        ],
        [&[0, 1, 2, 3][..], &[1, 4, 2]],
    );
    write_surface(
        Path::new(&at("sheet.obj")),
        &SurfaceToWrite::dense(&sheet, None),
    )
    .unwrap();
    let words = [
        "template",
        "extrude",
        &at("sheet.obj"),
        "--layers",
        "3",
        "-o",
        &at("slab.vtu"),
    ];
    let said = succeed(&[&words[..], &["--along", "0,0.5,2", "--json", &at("r.json")]].concat());
    assert!(said.contains("6 elements"), "{said}");
    let slab = read(Path::new(&at("slab.vtu")));
    assert_eq!(
        [CellShape::Hexahedron, CellShape::Prism].map(|s| count(&slab, s)),
        [3, 3]
    );
    let report = json(Path::new(&at("r.json")));
    assert_eq!(report["command"], "template");
    assert_eq!(report["result"]["elements"], 6);

    let torus = shapes::torus(1.0, 0.3, 60, 30).triangulate();
    write(Path::new(&at("ring.ply")), &torus);
    for (cage, euler) in [("torus", 0), ("bbox", 2)] {
        let output = at("cage.obj");
        succeed(&[
            "template",
            cage,
            &at("ring.ply"),
            "--control-points",
            "98",
            "-o",
            &output,
        ]);
        let mesh = read_surface(Path::new(&output)).unwrap().mesh;
        let connectivity = Connectivity::of(&mesh).unwrap();
        assert_eq!(connectivity.euler_characteristic(), euler);
    }
}

#[test]
fn what_cannot_be_made_is_refused_in_one_line_and_leaves_no_file() {
    let folder = folder("refused-templates");
    let at = |name: &str| path_text(&folder.join(name)).to_owned();
    write(&folder.join("scan.ply"), &ball());
    let (cube, scan, out) = (at("cube.vtu"), at("scan.ply"), at("out.vtu"));
    let make = [
        "template",
        "grid",
        "--between",
        "5,5,5,6,6,6",
        "--cells",
        "2x2x2",
    ];
    succeed(&[&make[..], &["-o", &cube]].concat());
    let cases: [(&[&str], &str); 7] = [
        (&["carve", &cube, "--target", &scan], "no cell lies inside"),
        (&["collapse", &cube, "--edge", "0,1"], "7 corners"),
        (&["collapse", &cube, "--face", "0,1,2,3"], "no face"),
        (&["extrude", &scan, "--distance", "-5"], "inverted"),
        (
            &["grid", "--between", "0,0,0,1,1,0", "--cells", "2x2x2"],
            "no volume",
        ),
        (&["pillow", &scan], "scan.ply"),
        (&["carve", &cube, "--target", &at("none.ply")], "none.ply"),
    ];
    for (words, reason) in cases {
        let output = run(&[&["template"], words, &["-o", &out]].concat());
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{words:?}: {said}");
        assert!(said.contains(reason), "{words:?}: {said}");
        let errors = said.lines().filter(|line| line.starts_with("error"));
        assert_eq!(errors.count(), 1, "{said}");
        assert!(
            said.lines()
                .last()
                .is_some_and(|line| line.contains(reason)),
            "{said}"
        );
    }
    for words in [
        &["grid", &scan, "--cells", "0x1x1"][..],
        &["carve", &cube],
        &["collapse", &cube],
        &["extrude", &scan],
        &["auto", &scan, "--elements", "0"],
        &["grid", "--cells", "2x2x2"],
    ] {
        let output = run(&[&["template"], words, &["-o", &out]].concat());
        assert_eq!(output.status.code(), Some(2), "{words:?}");
    }
    assert_eq!(names(&folder), ["cube.vtu", "scan.ply"]);
}

#[test]
fn nothing_to_fill_and_impossible_counts_are_refused() {
    let refusal = |mesh: &TriangleMesh, count| automatic(mesh, count).unwrap_err().to_string();
    assert!(refusal(&TriangleMesh::default(), 100).contains("triangle"));
    let ball = shapes::sphere(1.0, 3);
    assert!(refusal(&ball, 0).contains("0 elements"));
    assert!(refusal(&ball, usize::MAX).contains("elements"));
    let mut sheet =
        shapes::box_grid(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), [3, 3, 1]).triangulate();
    sheet
        .triangles
        .retain(|t| t.iter().all(|&v| sheet.positions[v as usize].z == 0.0));
    assert!(refusal(&sheet, 100).contains("flat"));
}

#[test]
fn automatic_templates_have_the_number_of_elements_and_the_handles() {
    let torus = shapes::torus(1.0, 0.4, 80, 40).triangulate();
    for (target, elements, wanted) in [(&ball(), 120, 2), (&ball(), 450, 2), (&torus, 300, 0)] {
        let mesh = automatic(target, elements).unwrap();
        let share = mesh.cell_count() as f64 / elements as f64;
        assert!(
            (share - 1.0).abs() < 0.1001,
            "{elements}: {}",
            mesh.cell_count()
        );
        assert_eq!(count(&mesh, CellShape::Hexahedron), mesh.cell_count());
        assert_eq!(euler(&mesh), wanted);
        // Pillowed: no more quads on the surface than cells under it.
        assert!(boundary(&mesh).face_count() < mesh.cell_count());
        checked(mesh).unwrap();
    }
}

#[test]
fn a_ring_with_holes_in_its_surface_is_fitted_without_a_hand() {
    let mut ring = shapes::torus(1.0, 0.4, 80, 40).triangulate();
    ring.triangles.retain(|t| t[0] % 211 != 0);
    let (fit, error) = fitted(&ring, 200);
    println!(
        "largest error {error:.3} %, mean scaled Jacobian {:.3}",
        mean_scaled_jacobian(&fit)
    );
    assert!(error < 0.5, "{error}");
    assert!(mean_scaled_jacobian(&fit) > 0.85);
}

#[test]
fn places_and_sizes_do_not_matter() {
    let there = |scale: f64, far: DVec3| {
        let mut moved = ball();
        moved
            .positions
            .iter_mut()
            .for_each(|p| *p = far + scale * *p);
        automatic(&moved, 100).unwrap()
    };
    for (scale, far) in [
        (1.0, DVec3::ZERO),
        (1e-3, DVec3::ZERO),
        (1e3, DVec3::new(5e5, -1e6, 2e6)),
    ] {
        let mesh = there(scale, far);
        assert!(mesh.cell_count().abs_diff(100) <= 10);
        for p in &mesh.positions {
            assert!(((*p - far) / scale).length() < 1.5);
        }
    }
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let make = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build()
            .unwrap()
            .install(|| automatic(&ball(), 80).unwrap())
    };
    assert!(make(1) == make(3));
}

#[test]
fn a_bone_is_fitted_better_than_by_the_published_linear_mesh() {
    let Some(path) = data("pairs/bone.tri.obj") else {
        return;
    };
    let bone = topology::oriented(&read_surface(&path).unwrap().mesh.triangulate());
    let (fit, error) = fitted(&bone, 450);
    let mean = mean_scaled_jacobian(&fit);
    println!(
        "{} elements: {error:.3} %, scaled Jacobian {mean:.3}",
        fit.volume.cell_count()
    );
    assert!(fit.volume.cell_count() < 500);
    assert!(error < 0.73, "{error}");
    assert!(mean > 0.93, "{mean}");
}
