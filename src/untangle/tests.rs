use super::barrier::{Corners, Density};
use super::*;
use crate::mesh::{CellShape, shapes};
use crate::progress::Silent;
use crate::template::volume::{ball, grid};

/// Numbers in [−½, ½) from a fixed sequence.
fn noise() -> impl FnMut() -> DVec3 {
    let mut state = 7u64;
    let mut next = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    move || DVec3::new(next(), next(), next())
}

/// A box of n³ cubes, every cube left whole, cut into two prisms, or those into three tetrahedra each.
fn block(n: u32, shape: CellShape) -> VolumeMesh {
    const PRISMS: [[usize; 6]; 2] = [[0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7]];
    let cubes = grid(DVec3::ZERO, DVec3::splat(f64::from(n)), [n; 3]);
    let mut mesh = VolumeMesh::new(cubes.positions.clone());
    for (_, cube) in cubes.cells() {
        match shape {
            CellShape::Hexahedron => mesh.push_cell(shape, cube),
            CellShape::Prism => PRISMS
                .iter()
                .for_each(|p| mesh.push_cell(shape, &p.map(|k| cube[k]))),
            CellShape::Tetrahedron => {
                // Around the diagonal from corner 0 to corner 6: the same on faces that meet.
                for [a, b] in [[1, 2], [2, 3], [3, 7], [7, 4], [4, 5], [5, 1]] {
                    mesh.push_cell(shape, &[0, a, b, 6].map(|k| cube[k]));
                }
            }
        }
    }
    mesh
}

fn is_inside(p: DVec3, n: f64) -> bool {
    p.min_element() > 0.01 && p.max_element() < n - 0.01
}

/// The same with vertices inside moved at random, so that cells are inverted.
fn tangled(n: u32, shape: CellShape, size: f64) -> VolumeMesh {
    let mut mesh = block(n, shape);
    let mut noise = noise();
    for p in mesh
        .positions
        .iter_mut()
        .filter(|p| is_inside(**p, f64::from(n)))
    {
        *p += size * noise();
    }
    mesh
}

const SHAPES: [CellShape; 3] = CellShape::ALL;

#[test]
fn ideal_cells_have_no_energy_and_turning_changes_none() {
    for shape in SHAPES {
        let mesh = block(2, shape);
        let own = |c: usize| {
            mesh.cell(c)
                .iter()
                .map(|&v| mesh.positions[v as usize])
                .collect()
        };
        let corners = Corners::new(&mesh, &Ideals::new(&mesh, own));
        assert!((corners.least_determinant(&mesh.positions) - 1.0).abs() < 1e-14);
        let turn = glam::DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 1.0);
        let turned: Vec<DVec3> = mesh
            .positions
            .iter()
            .map(|p| turn * *p + DVec3::X)
            .collect();
        for (epsilon, power) in [(0.0, 1), (0.0, 6), (0.0, 24)] {
            let (value, gradient) = corners.evaluate(&turned, Density { epsilon, power });
            assert!(value.abs() < 1e-12, "{shape:?}: {value}");
            assert!(gradient.iter().all(|g| g.length() < 1e-11));
        }
    }
}

#[test]
fn gradients_are_derivatives_also_where_cells_are_inverted() {
    for (size, epsilon, power) in [(0.3, 0.0, 1), (0.3, 0.0, 6), (3.0, 0.3, 1), (3.0, 0.05, 1)] {
        for shape in SHAPES {
            let mesh = tangled(3, shape, size);
            let corners = Corners::new(&mesh, &Ideals::local(&mesh));
            let density = Density { epsilon, power };
            let x = &mesh.positions;
            assert_eq!(size > 1.0, corners.least_determinant(x) < 0.0);
            let (value, gradient) = corners.evaluate(x, density);
            let mut noise = noise();
            let direction: Vec<DVec3> = x.iter().map(|_| noise()).collect();
            let slope: f64 = gradient
                .iter()
                .zip(&direction)
                .map(|(g, d)| g.dot(*d))
                .sum();
            let rest = |step: f64| {
                let at: Vec<DVec3> = x
                    .iter()
                    .zip(&direction)
                    .map(|(p, d)| *p + step * *d)
                    .collect();
                (corners.evaluate(&at, density).0 - value - step * slope).abs()
            };
            let order = (rest(2e-4) / rest(1e-4)).log2();
            assert!(
                (order - 2.0).abs() < 0.1,
                "{shape:?} ε {epsilon}, power {power}: {order}"
            );
        }
    }
}

#[test]
fn without_epsilon_inverted_cells_are_outside_the_domain() {
    let mesh = tangled(3, CellShape::Hexahedron, 3.0);
    let corners = Corners::new(&mesh, &Ideals::local(&mesh));
    let (value, _) = corners.evaluate(
        &mesh.positions,
        Density {
            epsilon: 0.0,
            power: 1,
        },
    );
    assert_eq!(value, f64::INFINITY);
}

#[test]
fn tangled_boxes_come_out_valid_in_their_boxes() {
    for shape in SHAPES {
        let mesh = tangled(4, shape, 3.0);
        let before = inverted(&mesh).into_iter().filter(|x| *x).count();
        assert!(before > mesh.cell_count() / 5, "{shape:?}: {before}");
        let tolerance = 1e-3;
        let found = untangle(
            &mesh,
            &Ideals::local(&mesh),
            Boundary::Own { tolerance },
            &Silent,
        )
        .unwrap();
        assert_eq!((found.inverted, found.interrupted), (0, false), "{shape:?}");
        let at_home = block(4, shape);
        for (home, p) in at_home.positions.iter().zip(&found.mesh.positions) {
            for k in 0..3 {
                // What was on a side is there still, and so what was on an edge or a corner.
                if home[k] == 0.0 || home[k] == 4.0 {
                    assert!((home[k] - p[k]).abs() < tolerance, "{shape:?}: {home} {p}");
                }
            }
        }
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let mesh = tangled(6, CellShape::Hexahedron, 2.0);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let own = Boundary::Own { tolerance: 0.01 };
        pool.install(|| untangle(&mesh, &Ideals::local(&mesh), own, &Silent).unwrap())
    };
    let one = on(1);
    assert_eq!(one.inverted, 0);
    assert_eq!(one, on(3));
}

#[test]
fn a_grid_is_drawn_to_a_sphere() {
    let sphere = shapes::sphere(1.0, 3);
    let mesh = ball(DVec3::splat(-0.7), DVec3::splat(0.7), 3);
    let volume = 4.0 / 3.0 * std::f64::consts::PI;
    let found = untangle(
        &mesh,
        &Ideals::uniform(&mesh, volume),
        Boundary::Drawn(&sphere),
        &Silent,
    )
    .unwrap();
    assert_eq!(found.inverted, 0);
    for v in features::boundary_polygons(&mesh).into_iter().flatten() {
        let radius = found.mesh.positions[v as usize].length();
        assert!((radius - 1.0).abs() < 0.04, "{radius}");
    }
}

#[test]
fn pins_hold_and_collapsed_cells_are_spread() {
    let mut mesh = block(3, CellShape::Hexahedron);
    let pinned: Vec<bool> = mesh.positions.iter().map(|p| !is_inside(*p, 3.0)).collect();
    for p in mesh.positions.iter_mut().filter(|p| is_inside(**p, 3.0)) {
        *p = DVec3::ONE;
    }
    let found = untangle(
        &mesh,
        &Ideals::local(&mesh),
        Boundary::Pinned(&pinned),
        &Silent,
    )
    .unwrap();
    assert_eq!(found.inverted, 0);
    for (v, home) in block(3, CellShape::Hexahedron).positions.iter().enumerate() {
        let distance = found.mesh.positions[v].distance(*home);
        assert!(
            if pinned[v] {
                distance == 0.0
            } else {
                distance < 0.05
            },
            "{v}: {distance}"
        );
    }
}

#[test]
fn what_cannot_be_untangled_is_told() {
    // Inside out, and held so.
    let mut mesh = VolumeMesh::new(vec![DVec3::ZERO, DVec3::Y, DVec3::X, DVec3::Z]);
    mesh.push_cell(CellShape::Tetrahedron, &[0, 1, 2, 3]);
    let ideals = Ideals::local(&mesh);
    let found = untangle(&mesh, &ideals, Boundary::Pinned(&[true; 4]), &Silent).unwrap();
    assert_eq!(found.inverted, 1);
    assert!(untangle(&mesh, &ideals, Boundary::Pinned(&[true; 3]), &Silent).is_err());
    let other = block(1, CellShape::Hexahedron);
    assert!(untangle(&other, &ideals, Boundary::Pinned(&[true; 8]), &Silent).is_err());
    let nothing = crate::mesh::TriangleMesh::default();
    assert!(untangle(&mesh, &ideals, Boundary::Drawn(&nothing), &Silent).is_err());
}

#[test]
fn a_box_has_six_patches_twelve_curves_and_eight_corners() {
    use features::{Features, Freedom, boundary_polygons};
    let mesh = block(3, CellShape::Hexahedron);
    let features = Features::of(&mesh.positions, &boundary_polygons(&mesh));
    assert_eq!((features.patch_count, features.curve_count), (6, 12));
    let corners = features
        .vertices
        .values()
        .filter(|f| **f == Freedom::Corner)
        .count();
    assert_eq!((corners, features.edges.len()), (8, 36));
}
