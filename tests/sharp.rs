//! Creases and corners: kept by the files that hold them, and by a fit from a template that has them.

use glam::DVec3;
use std::collections::HashMap;
use vorofit::device::Device;
use vorofit::files::{SurfaceToWrite, read_control, write_surface};
use vorofit::fit::{Options, Start, Target, Template, fit};
use vorofit::measure::surface_error;
use vorofit::mesh::{ControlMesh, Crease, PolygonMesh, Scheme, shapes};
use vorofit::progress::Silent;
use vorofit::template::Align;

/// A box grid whose edges stay sharp, and its corners.
fn sharp_box(size: DVec3, cells: [u32; 3]) -> ControlMesh {
    let mesh = shapes::box_grid(-size, size, cells);
    let sides = |v: u32| {
        let p = mesh.positions[v as usize].to_array();
        (0..3).filter(|&k| p[k].abs() == size[k]).count()
    };
    let mut met: HashMap<[u32; 2], usize> = HashMap::new();
    for face in mesh.faces() {
        for (k, &a) in face.iter().enumerate() {
            let b = face[(k + 1) % face.len()];
            *met.entry([a.min(b), a.max(b)]).or_default() += 1;
        }
    }
    let along_a_side = |&[a, b]: &[u32; 2]| {
        let [p, q] = [a, b].map(|v| mesh.positions[v as usize].to_array());
        (0..3)
            .filter(|&k| p[k].abs() == size[k] && p[k] == q[k])
            .count()
            == 2
    };
    let mut edges: Vec<_> = met.into_keys().filter(along_a_side).collect();
    edges.sort_unstable();
    let corners = (0..mesh.positions.len() as u32).filter(|&v| sides(v) == 3);
    ControlMesh {
        corners: corners.collect(),
        creases: edges
            .into_iter()
            .map(|edge| Crease {
                edge,
                sharpness: Crease::INFINITE,
            })
            .collect(),
        mesh,
    }
}

/// What is read back from a file of this extension.
fn through_a_file(control: &ControlMesh, extension: &str) -> ControlMesh {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control").with_extension(extension);
    write_surface(
        &path,
        &SurfaceToWrite::control(control, Scheme::CatmullClark),
    )
    .unwrap();
    read_control(&path).unwrap()
}

#[test]
fn what_is_sharp_survives_its_file() {
    let mut control = sharp_box(DVec3::new(1.0, 0.5, 2.0), [2, 1, 4]);
    control.creases[0].sharpness = 2.5;
    for extension in ["obj", "usda"] {
        assert_eq!(through_a_file(&control, extension), control, "{extension}");
    }
    control.creases[0].sharpness = f64::INFINITY;
    let back = through_a_file(&control, "obj");
    assert_eq!(back.creases[0].sharpness, Crease::INFINITE);
    // Far from the origin USD's f32 coordinates are local to a translation in f64.
    for p in &mut control.mesh.positions {
        *p += DVec3::new(5e6, -4e6, 3e5);
    }
    let back = through_a_file(&control, "usda");
    assert_eq!(back.mesh.positions, control.mesh.positions);
}

/// The largest error in percent, and the control mesh, of a fit to a box from a smaller one with or without creases.
fn fitted(creased: bool) -> (f64, ControlMesh) {
    let target = shapes::box_grid(DVec3::NEG_ONE, DVec3::ONE, [24; 3]).triangulate();
    let target = Target::new(&Device::Cpu, &target).unwrap();
    let mut control = sharp_box(DVec3::splat(0.9), [3; 3]);
    if !creased {
        control = PolygonMesh::into(control.mesh);
    }
    let template = Template::Mesh {
        control: through_a_file(&control, "obj"),
        align: Align::None,
    };
    let options = Options::default();
    let start = Start::new(&target, &template, options.scheme).unwrap();
    let fit = fit(&Device::Cpu, &target, start, &options, &Silent).unwrap();
    let error = surface_error(&target.mesh, &fit.surface.triangulate(), 20_000).unwrap();
    let max = f64::max(error.target_to_surface.max, error.surface_to_target.max);
    (100.0 * max, fit.control)
}

#[test]
fn a_template_s_creases_make_sharp_edges() {
    let (smooth, _) = fitted(false);
    let (sharp, control) = fitted(true);
    println!("largest error: {smooth:.3} % without creases, {sharp:.4} % with them");
    assert!(sharp < 0.05 * smooth, "{sharp} against {smooth}");
    let template = sharp_box(DVec3::splat(0.9), [3; 3]);
    assert_eq!(
        (control.creases, control.corners),
        (template.creases, template.corners)
    );
}
