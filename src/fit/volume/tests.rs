use super::barrier::{Guard, Watch};
use super::body::Body;
use super::correspondence::{Correspondences, Goal};
use super::interior::Interior;
use super::precondition::Inverse;
use super::stiffness::Stiffness;
use super::surface::Surface;
use super::*;
use crate::fit::Target;
use crate::geometry::random::Random;
use crate::kernel::sparse::Csr;
use crate::measure::validity::{Validity, validities};
use crate::mesh::{CellShape, VolumeMesh, shapes};
use crate::model::element::{Quadrature, Tables};
use crate::progress::Silent;
use crate::template::volume::grid;
use glam::{DMat3, DVec3};

/// A hexahedron, a prism on one of its sides and a tetrahedron on the prism.
fn mixed() -> VolumeMesh {
    let mut mesh = grid(DVec3::ZERO, DVec3::ONE, [1; 3]);
    // Vertices of the cube are numbered x + 2 y + 4 z; the prism's ridge is beyond x = 1.
    mesh.positions.extend([
        DVec3::new(1.8, 0.4, 0.1),
        DVec3::new(1.9, 0.5, 1.1),
        DVec3::new(1.4, 0.3, 2.0),
    ]);
    mesh.push_cell(CellShape::Prism, &[1, 8, 3, 5, 9, 7]);
    mesh.push_cell(CellShape::Tetrahedron, &[5, 9, 7, 10]);
    mesh
}

/// Some order with its coefficients shaken, its corners by a tenth, higher modes by less.
fn shaken(mesh: &VolumeMesh, order: usize) -> CurvedVolume {
    let volume = CurvedVolume::new(mesh, Basis::Legendre).unwrap();
    let mut volume = volume.raised(&vec![order; mesh.cell_count()]).unwrap();
    let mut random = Random::new(5);
    let vertices = volume.vertex_count();
    for (k, c) in volume.coefficients.iter_mut().enumerate() {
        let size = if k < vertices { 0.05 } else { 0.01 };
        *c += DVec3::from([0; 3].map(|_| random.between(-size, size)));
    }
    volume
}

fn directions(count: usize, seed: u64) -> Vec<DVec3> {
    let mut random = Random::new(seed);
    (0..count)
        .map(|_| DVec3::from([0; 3].map(|_| random.between(-1.0, 1.0))))
        .collect()
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

fn moved(x: &[DVec3], direction: &[DVec3], step: f64) -> Vec<DVec3> {
    x.iter()
        .zip(direction)
        .map(|(x, d)| *x + step * *d)
        .collect()
}

/// The correspondences of a volume with a ball around it.
fn with_ball(volume: &CurvedVolume) -> Correspondences {
    let mut ball = shapes::sphere(1.0, 3);
    ball.positions
        .iter_mut()
        .for_each(|p| *p += DVec3::splat(0.5));
    let target = Target::new(&Device::Cpu, &ball).unwrap();
    let mut volume = volume.clone();
    let vertices = volume.vertex_count();
    for (k, c) in volume.coefficients.iter_mut().enumerate() {
        *c = if k < vertices {
            target.frame.to_unit(*c)
        } else {
            *c / target.frame.diagonal
        };
    }
    let body = Body::from(volume);
    let surface = Surface::new(&Device::Cpu, (&target).into(), &body, 3.0, 0);
    surface.correspond(body.unknowns()).unwrap()
}

#[test]
fn the_gradient_of_the_whole_energy_is_right() {
    let volume = shaken(&mixed(), 3);
    let sizes = vec![0.9; volume.cell_count()];
    let interior = Interior::new(
        &Device::Cpu,
        &volume.clone().into(),
        &sizes,
        Rule::Gauss,
        Distortion::Strain,
    )
    .unwrap();
    let surface = with_ball(&volume);
    let energy = |x: &[DVec3]| {
        let inside = interior.evaluate(x).unwrap();
        let (parts, gradient) = surface.evaluate(x);
        let sum = gradient.iter().zip(&inside.gradient);
        let gradient: Vec<DVec3> = sum.map(|(s, d)| *s + 0.3 * *d).collect();
        (parts[0] + parts[1] + 0.3 * inside.value, gradient)
    };
    let x = &volume.coefficients;
    let direction = directions(x.len(), 1);
    let (_, gradient) = energy(x);
    let slope = dot(&gradient, &direction);
    // Central differences: the error falls with the square of the step.
    let errors = [1e-2, 5e-3, 2.5e-3].map(|step: f64| {
        let step = 0.1 * step;
        let ahead = energy(&moved(x, &direction, step)).0;
        let behind = energy(&moved(x, &direction, -step)).0;
        ((ahead - behind) / (2.0 * step) - slope).abs()
    });
    assert!(errors[0] < 1e-2 * slope.abs(), "{errors:?} of {slope}");
    for pair in errors.windows(2) {
        assert!((3.5..4.5).contains(&(pair[0] / pair[1])), "{errors:?}");
    }
}

/// The value of the barrier alone.
fn barrier(watch: &Watch, x: &[DVec3]) -> f64 {
    watch.evaluate(x, 1.0, &mut vec![DVec3::ZERO; x.len()])
}

#[test]
fn the_barrier_bounds_determinants_and_has_the_right_gradient() {
    for order in [1, 2, 3] {
        let mut volume = shaken(&mixed(), order);
        // Flat enough for coefficients under τ.
        volume.coefficients.iter_mut().for_each(|c| c.z *= 0.2);
        let sizes = [1.0; 3];
        let watch = Watch::new(&volume.clone().into(), &sizes, &[0, 1, 2]).unwrap();
        let x = &volume.coefficients;
        let bounds = watch.bounds(x);
        for (c, &bound) in bounds.iter().enumerate() {
            let lattice = crate::model::element::Grid::lattice(volume.shape(c), 7);
            for u in lattice.points() {
                let ideal = crate::model::element::reference_matrix(volume.shape(c));
                let determinant = volume.evaluate(c, u).1.determinant() / ideal.determinant();
                assert!(determinant >= bound - 1e-12, "order {order} cell {c}");
            }
            assert!(bound > 0.0, "order {order}: {bounds:?}");
        }
        let direction = directions(x.len(), 2);
        let mut gradient = vec![DVec3::ZERO; x.len()];
        let value = watch.evaluate(x, 1.0, &mut gradient);
        assert!(value > 0.0);
        let slope = dot(&gradient, &direction);
        let errors = [2e-4, 1e-4].map(|step: f64| {
            let ahead = barrier(&watch, &moved(x, &direction, step));
            let behind = barrier(&watch, &moved(x, &direction, -step));
            ((ahead - behind) / (2.0 * step) - slope).abs()
        });
        assert!(
            errors[1] < 1e-3 * slope.abs(),
            "order {order}: {errors:?} of {slope}"
        );
        // Higher orders of the same shape keep the coefficients positive.
        let raised = volume.raised(&[order + 1; 3]).unwrap();
        let higher = Watch::new(&raised.clone().into(), &sizes, &[0, 1, 2]).unwrap();
        let higher = higher.bounds(&raised.coefficients);
        for (a, b) in bounds.iter().zip(&higher) {
            assert!(b >= &(a - 1e-9), "order {order}: {bounds:?} {higher:?}");
        }
        let mut flipped = x.clone();
        flipped.iter_mut().for_each(|c| c.z = -c.z);
        assert!(barrier(&watch, &flipped).is_infinite());
        // The shares of the elements add up, and who is not watched is not bounded.
        let parts = [0, 1, 2].map(|c| Watch::new(&volume.clone().into(), &sizes, &[c]).unwrap());
        let sum: f64 = parts.iter().map(|part| barrier(part, x)).sum();
        assert!((sum - value).abs() < 1e-12 * value, "order {order}");
        assert_eq!(parts[1].bounds(x)[..2], [f64::INFINITY, bounds[1]]);
    }
}

#[test]
fn the_curvature_of_the_barrier_is_exact_where_coefficients_are_linear() {
    // The thickness of a flat box is a factor of all its determinants.
    let mesh = grid(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.1), [2, 1, 1]);
    let volume = CurvedVolume::new(&mesh, Basis::Legendre).unwrap();
    let x = &volume.coefficients;
    let watch = Watch::new(&volume.clone().into(), &[1.0; 2], &[0, 1]).unwrap();
    let thicker: Vec<DVec3> = x.iter().map(|p| DVec3::Z * p.z).collect();
    let value = |step: f64| barrier(&watch, &moved(x, &thicker, step));
    let step = 1e-3;
    let second = (value(step) - 2.0 * value(0.0) + value(-step)) / (step * step);
    let blocks = watch.blocks(x);
    let known: f64 = blocks
        .iter()
        .map(|&(i, j, block)| {
            let (i, j) = (i as usize, j as usize);
            let times = if i == j { 1.0 } else { 2.0 };
            times * thicker[i].dot(block * thicker[j])
        })
        .sum();
    assert!(
        known > 0.0 && (known - second).abs() < 1e-4 * second,
        "{known} {second}"
    );
    let mut diagonal = vec![DMat3::ZERO; x.len()];
    let alone = blocks.iter().filter(|b| b.0 == b.1);
    alone.for_each(|&(i, _, block)| diagonal[i as usize] += block);
    for (a, b) in diagonal.iter().zip(watch.diagonal(x)) {
        assert!(a.abs_diff_eq(b, 1e-12 * second));
    }
}

#[test]
fn elements_that_are_lost_go_back_alone_and_are_watched() {
    let mesh = grid(DVec3::ZERO, DVec3::new(6.0, 1.0, 1.0), [6, 1, 1]);
    let mut body = Body::from(CurvedVolume::new(&mesh, Basis::Legendre).unwrap());
    let sizes = [1.0; 6];
    let interior =
        Interior::new(&Device::Cpu, &body, &sizes, Rule::Gauss, Distortion::Strain).unwrap();
    let mut guard = Guard::new(&body, &sizes, &[4]).unwrap();
    let before = body.unknowns().to_vec();
    // All are moved, and the first is turned inside out.
    let mut unknowns = before.clone();
    for x in &mut unknowns {
        if x.x == 0.0 {
            x.x = 2.0;
        }
        x.y += 0.1;
    }
    body.set_unknowns(unknowns);
    assert!(guard.settle(&mut body, &before, &interior).unwrap());
    assert_eq!(guard.watched(), [0, 4]);
    for (after, before) in body.unknowns().iter().zip(&before) {
        let moved = if before.x < 1.5 { 0.0 } else { 0.1 };
        assert_eq!(*after, *before + DVec3::Y * moved);
    }
    let before = body.unknowns().to_vec();
    assert!(!guard.settle(&mut body, &before, &interior).unwrap());
}

#[test]
fn stiffness_knows_constants_and_coordinates() {
    for order in [1, 2, 4] {
        let volume = shaken(&mixed(), order);
        let sizes = vec![1.0; 3];
        let interior = Interior::new(
            &Device::Cpu,
            &volume.clone().into(),
            &sizes,
            Rule::Gauss,
            Distortion::Strain,
        )
        .unwrap();
        let x = &volume.coefficients;
        let entries = interior.stiffness_entries(x);
        let quadratic = |u: &dyn Fn(usize) -> f64| -> f64 {
            let term = |&(i, j, k): &(u32, u32, f64)| {
                let times = if i == j { 1.0 } else { 2.0 };
                times * k * u(i as usize) * u(j as usize)
            };
            entries.iter().map(term).sum()
        };
        // The vertices alone make the constant function; the gradient of x has length 1 everywhere, weighted by 1 altogether.
        let constant = |i: usize| f64::from(i < volume.vertex_count());
        assert!(quadratic(&constant).abs() < 1e-12);
        assert!((quadratic(&|i| x[i].x) - 1.0).abs() < 1e-12);
        // On the tops of prisms the diagonal is an approximation.
        let mut diagonal = vec![0.0; x.len()];
        entries
            .iter()
            .filter(|e| e.0 == e.1)
            .for_each(|e| diagonal[e.0 as usize] += e.2);
        for (a, b) in diagonal.iter().zip(interior.stiffness_diagonal(x)) {
            let tolerance = if order < 4 { 1e-12 } else { 0.5 };
            assert!((a - b).abs() <= tolerance * a, "order {order}: {a} {b}");
        }
    }
}

#[test]
fn factored_sums_give_the_diagonal_of_the_matrix() {
    for (cells, shape) in [
        (0, CellShape::Hexahedron),
        (1, CellShape::Prism),
        (2, CellShape::Tetrahedron),
    ] {
        let volume = shaken(&mixed(), 4);
        let quadrature = Quadrature::new(Rule::Gauss, shape, 4);
        let tables = Tables::new(Basis::Legendre, 4, &quadrature.grid);
        let stiffness = Stiffness::new(tables, &quadrature);
        let local = volume.gather(&[cells]).apply(&volume.coefficients);
        let matrix = stiffness.matrix(&local, &(0..local.len()).collect::<Vec<_>>());
        for (k, d) in stiffness.diagonal(&local).into_iter().enumerate() {
            assert!((matrix[(k, k)] - d).abs() < 1e-12 * d, "{shape:?} mode {k}");
        }
    }
}

#[test]
fn preconditioners_are_positive_definite_and_the_factor_is_exact() {
    let volume = shaken(&mixed(), 3);
    let x = &volume.coefficients;
    let interior = Interior::new(
        &Device::Cpu,
        &volume.clone().into(),
        &[1.0; 3],
        Rule::Gauss,
        Distortion::Strain,
    )
    .unwrap();
    let surface = with_ball(&volume);
    let entries = interior.stiffness_entries(x);
    let factor = Inverse::factored(
        x.len(),
        entries.iter().copied(),
        surface.blocks().into_iter(),
    );
    let factor = factor.unwrap();
    let blocks = Inverse::of_diagonal(&interior.stiffness_diagonal(x), &surface.diagonal());
    for seed in 0..5 {
        let v = directions(x.len(), seed);
        for inverse in [&factor, &blocks] {
            assert!(dot(&v, &inverse.apply(&v)) > 0.0);
        }
        // The surface's part is quadratic: its product with v is a difference of gradients.
        let (_, there) = surface.evaluate(&v);
        let (_, origin) = surface.evaluate(&vec![DVec3::ZERO; v.len()]);
        let mut product = moved(&there, &origin, -1.0);
        for &(i, j, k) in &entries {
            let (i, j) = (i as usize, j as usize);
            product[i] += k * v[j];
            if i != j {
                product[j] += k * v[i];
            }
        }
        let solved = factor.apply(&product);
        let error = moved(&solved, &v, -1.0);
        assert!(dot(&error, &error) < 1e-16 * dot(&v, &v));
    }
}

#[test]
fn correspondences_measure_distances_along_their_directions() {
    let goal = |x: f64, direction: DVec3| Goal {
        position: DVec3::new(x, 0.0, 0.0),
        direction,
        weight: 2.0,
    };
    // The middle of two nodes, and the second node.
    let rows = Csr::from_rows(&[vec![(0, 0.5), (1, 0.5)], vec![(1, 1.0)]], 2);
    let goals = vec![goal(0.0, DVec3::Z), goal(1.0, DVec3::X)];
    let found = Correspondences::new(rows, goals, 1, 10.0);
    let nodes = [DVec3::new(7.0, 7.0, 1.0), DVec3::new(4.0, 7.0, 3.0)];
    let ([of_target, of_surface], gradient) = found.evaluate(&nodes);
    assert_eq!(
        [of_target, of_surface],
        [10.0 * 2.0 * 9.0, 10.0 * 2.0 * 4.0]
    );
    assert_eq!(gradient[0], DVec3::Z * 10.0 * 2.0 * 2.0 * 2.0 * 0.5);
    assert!((found.rms(&nodes) - 6.5f64.sqrt()).abs() < 1e-14);
    let diagonal = found.diagonal();
    for (i, j, block) in found.blocks() {
        if i == j && i == 0 {
            assert_eq!(block, diagonal[0]);
        }
    }
    assert_eq!(diagonal[1].z_axis.z, 2.0 * 10.0 * 2.0 * 0.25);
    assert_eq!(diagonal[1].x_axis.x, 2.0 * 10.0 * 2.0);
}

#[test]
fn flat_targets_are_refused() {
    let sheet = shapes::box_grid(DVec3::ZERO, DVec3::new(1.0, 1.0, 1e-9), [4, 4, 1]);
    let target = Target::new(&Device::Cpu, &sheet.triangulate()).unwrap();
    assert!(VolumeTarget::from(&target).enclosure().is_err());
}

#[test]
fn an_inverted_start_is_untangled() {
    let target = Target::new(&Device::Cpu, &shapes::sphere(1.0, 3)).unwrap();
    let mut mesh = grid(DVec3::splat(-0.2), DVec3::splat(0.2), [2, 2, 2]);
    let inside = mesh
        .positions
        .iter()
        .position(|p| p.length() < 1e-9)
        .unwrap();
    mesh.positions[inside] = DVec3::new(0.3, 0.1, 0.25);
    assert!(crate::untangle::inverted(&mesh).contains(&true));
    let start = VolumeStart {
        mesh,
        nearby: false,
    };
    let options = VolumeOptions::default();
    let fit = fit_volume(&Device::Cpu, &target, start, &options, &Silent).unwrap();
    let all = validities(&fit.volume);
    assert!(all.iter().all(|v| *v == Validity::Valid));
}

#[test]
fn a_template_on_the_target_is_nearby_and_keeps_its_sizes() {
    let target = Target::new(&Device::Cpu, &shapes::sphere(2.0, 4)).unwrap();
    let on = crate::template::volume::ball(DVec3::splat(-2.0), DVec3::splat(2.0), 2);
    let placed = |mesh: &VolumeMesh, align| {
        let mesh = mesh.clone();
        VolumeStart::new(&target, &VolumeTemplate::Mesh { mesh, align }).unwrap()
    };
    use crate::template::Align;
    let start = placed(&on, Align::None);
    assert!(start.nearby);
    let sizes = start.ideal_sizes(1.0);
    let volume: f64 = sizes.iter().map(|s| s.powi(3)).sum();
    let ball = 4.0 / 3.0 * std::f64::consts::PI * (2.0 / target.frame.diagonal).powi(3);
    assert!((0.7..1.0).contains(&(volume / ball)), "{}", volume / ball);
    let mut away = on.clone();
    away.positions
        .iter_mut()
        .for_each(|p| *p = 0.3 * *p + DVec3::X);
    assert!(!placed(&away, Align::None).nearby);
    assert!(placed(&away, Align::Similarity).nearby);
    let far = VolumeStart::new(&target, &VolumeTemplate::Grid([2, 2, 2])).unwrap();
    let sizes = far.ideal_sizes(1.0);
    assert!(sizes.iter().all(|s| (s - 0.5).abs() < 1e-15));
}

#[test]
fn gradients_on_control_points_are_transposed_from_those_of_the_elements() {
    let control: crate::model::volume::ControlVolume = mixed().into();
    let step = control.subdivided().unwrap();
    let volume = CurvedVolume::new(&step.control.mesh, Basis::Legendre).unwrap();
    let sizes = vec![0.4; volume.cell_count()];
    let body = Body::subdivided(volume, step.matrix, control.mesh.positions);
    let interior =
        Interior::new(&Device::Cpu, &body, &sizes, Rule::Gauss, Distortion::Strain).unwrap();
    let x = body.unknowns();
    let direction = directions(x.len(), 7);
    let slope = dot(&interior.evaluate(x).unwrap().gradient, &direction);
    let value = |step: f64| {
        interior
            .evaluate(&moved(x, &direction, step))
            .unwrap()
            .value
    };
    let errors = [2e-3, 1e-3].map(|h| ((value(h) - value(-h)) / (2.0 * h) - slope).abs());
    assert!(errors[0] < 1e-3 * slope.abs(), "{errors:?} of {slope}");
    assert!((3.0..5.0).contains(&(errors[0] / errors[1])), "{errors:?}");
}

#[test]
fn absent_modes_are_left_out_of_the_stiffness() {
    let mesh = mixed();
    let flat = CurvedVolume::new(&mesh, Basis::Legendre).unwrap();
    let mut orders = vec![2; flat.boundary().len()];
    orders[0] = 5;
    let body = Body::from(flat.graded(&orders, 2).unwrap());
    let interior = Interior::new(
        &Device::Cpu,
        &body,
        &[1.0; 3],
        Rule::Gauss,
        Distortion::Strain,
    )
    .unwrap();
    let x = body.unknowns();
    let mut diagonal = vec![0.0; x.len()];
    let entries = interior.stiffness_entries(x);
    let alone = entries.iter().filter(|e| e.0 == e.1);
    alone.for_each(|e| diagonal[e.0 as usize] += e.2);
    for (a, b) in diagonal.iter().zip(interior.stiffness_diagonal(x)) {
        assert!(*a > 0.0 && (a - b).abs() <= 1e-12 * a, "{a} {b}");
    }
    let full = Body::from(flat.raised(&[5; 3]).unwrap());
    let full = Interior::new(
        &Device::Cpu,
        &full,
        &[1.0; 3],
        Rule::Gauss,
        Distortion::Strain,
    );
    let operations = full.unwrap().stiffness_operations();
    assert!(interior.stiffness_operations() < 0.2 * operations);
}

#[test]
fn clouds_that_enclose_nothing_are_refused() {
    let cloud = |positions: Vec<DVec3>| crate::mesh::PointCloud {
        positions,
        ..Default::default()
    };
    assert!(PointTarget::new(&cloud(Vec::new())).is_err());
    assert!(PointTarget::new(&cloud(vec![DVec3::ONE; 100])).is_err());
    let sheet = (0..400).map(|k| DVec3::new(f64::from(k % 20), f64::from(k / 20), 0.0));
    let sheet = PointTarget::new(&cloud(sheet.collect())).unwrap();
    assert!(VolumeTarget::from(&sheet).enclosure().is_err());
    let sphere = shapes::sphere(2.0, 4).positions;
    let ball = PointTarget::new(&cloud(sphere)).unwrap();
    let measure = VolumeTarget::from(&ball).enclosure().unwrap();
    let radius = 2.0 / ball.frame.diagonal;
    let [area, volume] = [4.0 * radius.powi(2), 4.0 / 3.0 * radius.powi(3)];
    let pi = std::f64::consts::PI;
    assert!(
        (measure.area / (pi * area) - 1.0).abs() < 0.15,
        "{measure:?}"
    );
    assert!(
        (measure.volume / (pi * volume) - 1.0).abs() < 0.15,
        "{measure:?}"
    );
}
