//! What else a volume fit does: orders by need, subdivision volumes, clouds of points; in the library and as commands.

mod common;
#[path = "common/program.rs"]
mod program;

use glam::DVec3;
use program::{folder, json, path_text, run, succeed, text, write};
use vorofit::device::Device;
use vorofit::fit::{
    Adaptive, PointTarget, StopReason, Target, VolumeFit, VolumeOptions, VolumeStart,
    VolumeTemplate, fit_subdivision, fit_volume,
};
use vorofit::measure::validity::{Validity, validities};
use vorofit::measure::{point_error, surface_error};
use vorofit::mesh::{PointCloud, TriangleMesh, shapes};
use vorofit::model::volume::ControlVolume;
use vorofit::progress::Silent;

/// A ball with a steep bump towards +x.
fn bumpy() -> TriangleMesh {
    let mut mesh = shapes::sphere(1.0, 5);
    for p in &mut mesh.positions {
        *p *= 1.0 + 0.25 * (12.0 * (p.x - 1.0)).exp();
    }
    mesh
}

/// From a ball of 7 n³ hexahedra.
fn fitted(device: &Device, mesh: &TriangleMesh, n: u32, options: &VolumeOptions) -> VolumeFit {
    let target = Target::new(device, mesh).unwrap();
    let start = VolumeStart::new(&target, &VolumeTemplate::Ball(n)).unwrap();
    fit_volume(device, &target, start, options, &Silent).unwrap()
}

fn options(order: usize, adaptive: Option<Adaptive>) -> VolumeOptions {
    VolumeOptions {
        order,
        adaptive,
        ..VolumeOptions::default()
    }
}

/// The largest and the rms distance either way, in percent.
fn errors(mesh: &TriangleMesh, fit: &VolumeFit) -> [f64; 2] {
    assert!(
        validities(&fit.volume)
            .iter()
            .all(|v| *v == Validity::Valid)
    );
    let frame = Target::new(&Device::Cpu, mesh).unwrap().frame;
    let mut unit = mesh.clone();
    for p in &mut unit.positions {
        *p = frame.to_unit(*p);
    }
    let error = surface_error(&unit, &fit.dense_surface(), 20_000).unwrap();
    let [a, b] = [error.target_to_surface, error.surface_to_target];
    [100.0 * a.max.max(b.max), 100.0 * a.rms.max(b.rms)]
}

#[test]
fn orders_go_where_the_surface_needs_them() {
    let mesh = bumpy();
    let full = fitted(&Device::Cpu, &mesh, 2, &options(5, None));
    let all = errors(&mesh, &full);
    let allowed = Adaptive {
        max_error: Some(2.0 * all[0] / 100.0),
    };
    let by_need = fitted(&Device::Cpu, &mesh, 2, &options(5, Some(allowed)));
    let some = errors(&mesh, &by_need);
    let kept = by_need.volume.coefficients.len() as f64 / full.volume.coefficients.len() as f64;
    assert_eq!(full.volume.coefficients.len(), by_need.volume.full_count(5));
    assert_eq!(by_need.stop_reason, StopReason::Tolerance);
    assert!(some[0] <= 2.0 * all[0], "{all:?} {some:?}");
    // The bump is at +x: every face there was raised, and less than half of the others, neighbours of those among them.
    let (mut there, mut elsewhere) = (Vec::new(), Vec::new());
    let faces = by_need.volume.boundary().into_iter();
    for ((cell, _), order) in faces.zip(by_need.volume.boundary_orders()) {
        let corners = by_need.volume.vertices(cell as usize);
        let sum: DVec3 = corners
            .iter()
            .map(|&v| by_need.volume.coefficients[v as usize])
            .sum();
        let side = match sum.x > sum.y.abs().max(sum.z.abs()) {
            true => &mut there,
            false => &mut elsewhere,
        };
        side.push(order);
    }
    assert_eq!(there.len(), 4);
    assert!(there.iter().all(|&order| order > 2), "{there:?}");
    let raised = elsewhere.iter().filter(|&&order| order > 2).count();
    assert!(2 * raised < elsewhere.len(), "{elsewhere:?}");
    assert!(kept < 0.5, "{kept}");
}

#[test]
fn an_error_that_is_met_ends_the_raises() {
    let mesh = shapes::lobed_ball(4);
    let loose = Adaptive {
        max_error: Some(0.005),
    };
    let fit = fitted(&Device::Cpu, &mesh, 2, &options(8, Some(loose)));
    assert_eq!(fit.stop_reason, StopReason::Tolerance);
    assert!(fit.volume.highest_order() < 8);
    let [max, _] = errors(&mesh, &fit);
    assert!(max < 0.6, "{max}");
}

#[test]
fn a_gpu_raises_the_same_orders() {
    let mesh = shapes::lobed_ball(3);
    let gpu = Device::Gpu(common::gpu().clone());
    let fits = [Device::Cpu, gpu].map(|device| {
        // Above the order of the inside, so that there are elements of several.
        let options = options(6, Some(Adaptive::default()));
        fitted(&device, &mesh, 1, &options)
    });
    let [cpu, gpu] = fits.each_ref().map(|fit| errors(&mesh, fit));
    println!("{cpu:?} {gpu:?}");
    assert!(
        gpu[0] < 1.3 * cpu[0] && gpu[1] < 1.1 * cpu[1],
        "{cpu:?} {gpu:?}"
    );
    let groups = fits[1].volume.groups();
    assert!(groups.len() > 1, "{groups:?}");
}

#[test]
fn every_level_of_a_subdivision_volume_is_nearer() {
    let mesh = shapes::lobed_ball(4);
    let target = Target::new(&Device::Cpu, &mesh).unwrap();
    let start = VolumeStart::new(&target, &VolumeTemplate::Ball(1)).unwrap();
    let control = ControlVolume::from(start.mesh);
    let options = VolumeOptions::default();
    let fit = fit_subdivision(&Device::Cpu, &target, control, false, 2, &options, &Silent).unwrap();
    println!("{:?}", fit.levels);
    assert_eq!(fit.levels.len(), 2);
    assert_eq!(fit.levels[1].elements, 7 * 8 * 8);
    for pair in fit.levels.windows(2) {
        assert!(
            pair[1].rms_percent < 0.5 * pair[0].rms_percent,
            "{:?}",
            fit.levels
        );
    }
    let [max, rms] = errors(&mesh, &fit.refined);
    assert!(max < 2.0 && rms < 0.5, "{max} {rms}");
    // The refined mesh is that of the control mesh.
    let again = fit.control.subdivided().unwrap().control.mesh.positions;
    let pairs = again.iter().zip(&fit.refined.volume.coefficients);
    assert!(pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max) < 1e-14);
}

#[test]
fn sharp_edges_of_the_control_mesh_stay_on_a_box() {
    let (lo, hi) = (DVec3::ZERO, DVec3::new(3.0, 2.0, 1.0));
    let mesh = shapes::box_grid(lo, hi, [12, 8, 4]).triangulate();
    let target = Target::new(&Device::Cpu, &mesh).unwrap();
    let start = VolumeStart::new(&target, &VolumeTemplate::Grid([3, 2, 1])).unwrap();
    let options = VolumeOptions::default();
    let reached = [
        ControlVolume::with_sharp_edges(start.mesh.clone(), 0.5).unwrap(),
        start.mesh.into(),
    ]
    .map(|control| {
        let fit = fit_subdivision(&Device::Cpu, &target, control, false, 1, &options, &Silent);
        fit.unwrap().levels[0].max_percent
    });
    println!("{reached:?}");
    assert!(
        reached[0] < 0.1 && reached[1] > 10.0 * reached[0],
        "{reached:?}"
    );
}

#[test]
fn points_without_faces_or_normals_are_followed() {
    let mesh = shapes::lobed_ball(4);
    let cloud = PointCloud {
        positions: mesh.positions.clone(),
        ..PointCloud::default()
    };
    let target = PointTarget::new(&cloud).unwrap();
    let start = VolumeStart::new(&target, &VolumeTemplate::Ball(2)).unwrap();
    let fit = fit_volume(&Device::Cpu, &target, start, &options(3, None), &Silent).unwrap();
    let figures = point_error(target.positions(), &fit.dense_surface()).unwrap();
    let [max, rms] = errors(&mesh, &fit);
    println!("{figures:?} {max} {rms}");
    assert!(figures.max < 2e-3 && figures.rms < 3e-4, "{figures:?}");
    assert!(max < 0.3, "the surface between the points is {max} % away");
}

#[test]
fn commands_write_and_report_what_they_made() {
    let folder = folder("volume_applications");
    let [scan, volume, control, report] = ["scan.ply", "a.vtu", "control.vtu", "report.json"]
        .map(|name| path_text(&folder.join(name)).to_string());
    write(scan.as_ref(), &shapes::lobed_ball(3));
    let base = ["volume", &scan, "-o", &volume, "--json", &report];
    fn joined<'a>(base: &[&'a str], more: &[&'a str]) -> Vec<&'a str> {
        [base, more].concat()
    }
    succeed(&joined(
        &base,
        &["--template", "ball:1", "--order", "5", "--adaptive"],
    ));
    let result = json(report.as_ref());
    assert!(
        result["result"]["adaptive"]["of_full_percent"]
            .as_f64()
            .unwrap()
            < 100.0
    );
    assert_eq!(result["settings"]["adaptive"], true);
    succeed(&joined(
        &base,
        &[
            "--template",
            "ball:1",
            "--subdivision",
            "mlca",
            "--levels",
            "2",
            "--control",
            &control,
        ],
    ));
    let result = json(report.as_ref());
    assert_eq!(result["result"]["subdivision"].as_array().unwrap().len(), 2);
    assert_eq!(result["result"]["elements"], 7 * 64);
    let made = vorofit::files::read_volume(control.as_ref(), Default::default()).unwrap();
    assert_eq!(made.mesh.cell_count(), 7 * 8);
    succeed(&joined(&base, &["--template", "ball:1", "--point-cloud"]));
    let result = json(report.as_ref());
    assert!(result["error"].get("surface_to_target").is_none());
    assert!(result["error"]["max_percent"].as_f64().unwrap() < 5.0);
    for refused in [
        &["--template", "ball:1", "--max-error", "1"][..],
        &[
            "--template",
            "ball:1",
            "--subdivision",
            "mlca",
            "--order",
            "2",
        ],
        &["--template", "ball:1", "--levels", "2"],
    ] {
        let output = run(&joined(&base, refused));
        assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    }
}
