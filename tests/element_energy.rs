//! The energy of curved elements: its gradient, its nulls, its accuracy, its order of summation, and what it says of inverted elements.

mod common;

use common::Noise;
use common::elements::{BASES, SHAPES, affine, batch, cell_volume, random};
use glam::{DMat3, DVec3};
use vorofit::energy::element_tables;
use vorofit::geometry::distortion::Distortion;
use vorofit::kernel::element_energy::{
    self, ElementInput, ElementOutput, ElementTables, Factors, Samples,
};
use vorofit::mesh::CellShape;
use vorofit::model::element::{Basis, Quadrature, Rule, Table, Tables, mode_count};

fn evaluate(input: &ElementInput, coefficients: &[DVec3]) -> ElementOutput {
    element_energy::cpu(&input.batches, coefficients, input.distortion)
}

/// The error of the linear model at two step sizes falls with the square of the step.
fn taylor(noise: &mut Noise, shape: CellShape, basis: Basis, order: usize, distortion: Distortion) {
    let input = random(noise, shape, basis, order, 3, distortion);
    let at = evaluate(&input, &input.coefficients);
    let direction: Vec<_> = at
        .gradient
        .iter()
        .map(|_| noise.vector() / order as f64)
        .collect();
    let slope: f64 = at
        .gradient
        .iter()
        .zip(&direction)
        .map(|(g, d)| g.dot(*d))
        .sum();
    let remainders = [1e-2, 3e-3, 1e-3, 3e-4].map(|h| {
        let h = h * at.smallest_determinant().min(1.0) / order as f64;
        let moved: Vec<_> = input
            .coefficients
            .iter()
            .zip(&direction)
            .map(|(c, d)| *c + h * *d)
            .collect();
        let energy = evaluate(&input, &moved).energy();
        (h, (energy - at.energy() - h * slope).abs())
    });
    let [first, .., last] = remainders;
    let order_of_error = (first.1 / last.1).ln() / (first.0 / last.0).ln();
    assert!(
        order_of_error >= 1.9,
        "{shape:?} {basis:?} {order} {distortion:?}: {order_of_error} {remainders:?}"
    );
}

#[test]
fn gradients_pass_the_taylor_test() {
    let noise = &mut Noise(1);
    for shape in SHAPES {
        for basis in BASES {
            for order in 1..=8 {
                taylor(noise, shape, basis, order, Distortion::Strain);
            }
        }
        taylor(noise, shape, Basis::Legendre, 12, Distortion::Strain);
        for distortion in Distortion::ALL {
            taylor(noise, shape, Basis::Legendre, 3, distortion);
        }
    }
    taylor(
        noise,
        CellShape::Hexahedron,
        Basis::Legendre,
        16,
        Distortion::Strain,
    );
    taylor(
        noise,
        CellShape::Prism,
        Basis::Fourier,
        16,
        Distortion::Strain,
    );
    taylor(
        noise,
        CellShape::Tetrahedron,
        Basis::Legendre,
        16,
        Distortion::Strain,
    );
}

#[test]
fn rigid_motions_of_the_ideal_shape_cost_nothing() {
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 2.0);
    let offset = DVec3::new(3.0, -4.0, 5.0);
    for shape in SHAPES {
        for basis in BASES {
            for order in [1, 2, 5, 9] {
                let tables = element_tables(shape, basis, order, Rule::Gauss).unwrap();
                let batches = [batch(tables, shape, 2)];
                let ideal = affine(shape, order, |x| x);
                let moved = affine(shape, order, |x| turn * x + offset);
                let output =
                    element_energy::cpu(&batches, &[ideal, moved].concat(), Distortion::Strain);
                assert!(
                    output.energy() < 1e-20,
                    "{shape:?} {order}: {}",
                    output.energy()
                );
                assert!(output.gradient.iter().all(|g| g.length() < 1e-11));
                assert!((output.smallest_determinant() - 1.0).abs() < 1e-11);
            }
        }
    }
}

/// The energy of a uniform stretch is that of one matrix; the weights sum to 1.
#[test]
fn a_stretch_costs_what_it_costs_at_a_point() {
    let map = DMat3::from_cols_array(&[1.2, 0.1, 0.0, -0.3, 0.8, 0.2, 0.05, 0.1, 1.5]);
    for shape in SHAPES {
        for distortion in Distortion::ALL {
            let tables = element_tables(shape, Basis::Legendre, 3, Rule::Gauss).unwrap();
            let output = element_energy::cpu(
                &[batch(tables, shape, 1)],
                &affine(shape, 3, |x| map * x),
                distortion,
            );
            let expected = distortion.evaluate(map).value;
            assert!(
                (output.energy() / expected - 1.0).abs() < 1e-12,
                "{shape:?} {distortion:?}"
            );
            assert!((output.smallest_determinant() / map.determinant() - 1.0).abs() < 1e-12);
        }
    }
}

/// The derivatives of every mode at every point of a rule as one matrix, from the model's tables one mode at a time.
fn dense(shape: CellShape, basis: Basis, order: usize) -> ElementTables {
    let rule = Quadrature::new(Rule::Gauss, shape, order);
    let tables = Tables::new(basis, order, &rule.grid);
    let (modes, points) = (mode_count(shape, order), rule.grid.len());
    let mut derivatives = vec![vec![0.0; modes * points]; 3];
    for mode in 0..modes {
        let mut unit = vec![DVec3::ZERO; modes];
        unit[mode] = DVec3::X;
        for (point, gradient) in tables.gradients(&unit).iter().enumerate() {
            for (axis, derivative) in derivatives.iter_mut().enumerate() {
                derivative[point * modes + mode] = gradient.col(axis).x;
            }
        }
    }
    let samples = Samples {
        modes,
        values: vec![0.0; modes * points],
        derivatives,
    };
    ElementTables::new(Factors::Dense(samples), rule.weights, None).unwrap()
}

#[test]
fn factored_sums_are_the_plain_ones() {
    let noise = &mut Noise(2);
    for shape in SHAPES {
        for basis in BASES {
            for order in [1, 2, 3, 4, 6] {
                let input = random(noise, shape, basis, order, 5, Distortion::Strain);
                let factored = evaluate(&input, &input.coefficients);
                let plain = element_energy::cpu(
                    &[batch(dense(shape, basis, order), shape, 5)],
                    &input.coefficients,
                    Distortion::Strain,
                );
                let size = plain
                    .gradient
                    .iter()
                    .map(|g| g.length())
                    .fold(0.0, f64::max);
                for (a, b) in factored.energies.iter().zip(&plain.energies) {
                    assert!(
                        (a / b - 1.0).abs() < 1e-12,
                        "{shape:?} {basis:?} {order}: {a} {b}"
                    );
                }
                for (a, b) in factored.gradient.iter().zip(&plain.gradient) {
                    let error = (*a - *b).length() / size;
                    assert!(error < 1e-12, "{shape:?} {basis:?} {order}: {error}");
                }
            }
        }
    }
}

/// The energy by a rule, of elements of one order.
fn energy_by(rule: &Quadrature, shape: CellShape, order: usize, coefficients: &[DVec3]) -> f64 {
    let samples = |k: usize| {
        let table = Table::new(Basis::Legendre, order, &rule.grid.factors[k]);
        Samples {
            modes: table.modes,
            values: table.values,
            derivatives: table.derivatives,
        }
    };
    let factors = match shape {
        CellShape::Hexahedron => Factors::Hexahedron(samples(0)),
        CellShape::Prism => Factors::Prism(samples(0), samples(1)),
        CellShape::Tetrahedron => Factors::Dense(samples(0)),
    };
    let tables = ElementTables::new(factors, rule.weights.clone(), None).unwrap();
    element_energy::cpu(&[batch(tables, shape, 1)], coefficients, Distortion::Strain).energy()
}

#[test]
fn the_default_rule_is_accurate_and_converges() {
    for shape in SHAPES {
        let order = 2;
        let input = random(
            &mut Noise(3),
            shape,
            Basis::Legendre,
            order,
            1,
            Distortion::Strain,
        );
        let error = |rule: Rule, points: usize| {
            let by = |rule, points| {
                energy_by(
                    &Quadrature::new(rule, shape, points),
                    shape,
                    order,
                    &input.coefficients,
                )
            };
            (by(rule, points) / by(Rule::Gauss, 20) - 1.0).abs()
        };
        let errors = [2, 4, 8, 12].map(|points| error(Rule::Gauss, points));
        assert!(errors[0] < 0.05, "{shape:?}: {errors:?}");
        assert!(errors[0] > errors[1] && errors[1] > errors[2] && errors[2] > errors[3]);
        assert!(errors[3] < 1e-5, "{shape:?}: {errors:?}");
        let trapezoid = error(Rule::Trapezoid, order);
        assert!(trapezoid > errors[0], "{shape:?}: {trapezoid} {errors:?}");
    }
}

#[test]
fn inverted_elements_are_reported_and_their_neighbours_are_not() {
    for shape in SHAPES {
        for basis in BASES {
            let mut input = random(&mut Noise(4), shape, basis, 2, 6, Distortion::Strain);
            let modes = mode_count(shape, 2);
            let before = evaluate(&input, &input.coefficients);
            let element = &mut input.coefficients[modes..2 * modes];
            element.iter_mut().for_each(|c| c.x = -c.x);
            input.coefficients[2 * modes..3 * modes].fill(DVec3::ZERO);
            input.coefficients[4 * modes + 1] = DVec3::splat(f64::NAN);
            let output = evaluate(&input, &input.coefficients);
            assert_eq!(output.energy(), f64::INFINITY);
            for k in 0..6 {
                let part = k * modes..(k + 1) * modes;
                if [1, 2, 4].contains(&k) {
                    assert_eq!(output.energies[k], f64::INFINITY, "{shape:?} {k}");
                    assert!(output.gradient[part].iter().all(|g| *g == DVec3::ZERO));
                } else {
                    assert_eq!(output.energies[k], before.energies[k], "{shape:?} {k}");
                    assert_eq!(output.gradient[part.clone()], before.gradient[part]);
                }
            }
            assert!(output.determinants[1] < 0.0 && output.determinants[2] <= 0.0);
        }
    }
}

/// Collapsed rules have no points on the boundary; check points see what goes wrong there.
#[test]
fn a_vertex_that_folds_over_is_seen() {
    for shape in SHAPES {
        let tables = element_tables(shape, Basis::Legendre, 2, Rule::Gauss).unwrap();
        let mut coefficients = affine(shape, 2, |x| x);
        let edge = match shape {
            CellShape::Hexahedron => 2,
            CellShape::Prism => 3,
            CellShape::Tetrahedron => 4,
        };
        // h(x) along the first edge is x + c φ(x): its slope at one end is 1 − √3 |c| up to the scale of φ; past 0, just.
        let mut least = 1.0;
        let mut c = 0.0;
        while least > 0.0 && c < 10.0 {
            c += 0.01;
            coefficients[edge] = DVec3::new(c, 0.0, 0.0);
            let grid = vorofit::model::element::Grid::lattice(shape, 1);
            least = Tables::new(Basis::Legendre, 2, &grid)
                .gradients(&coefficients)
                .iter()
                .map(|j| j.determinant())
                .fold(f64::INFINITY, f64::min);
        }
        let output = element_energy::cpu(
            &[batch(tables, shape, 1)],
            &coefficients,
            Distortion::Strain,
        );
        assert_eq!(output.energy(), f64::INFINITY, "{shape:?} {c}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let noise = &mut Noise(5);
    for shape in SHAPES {
        let input = random(noise, shape, Basis::Legendre, 3, 23, Distortion::Strain);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| evaluate(&input, &input.coefficients))
        };
        assert_eq!(run(1), run(3));
    }
}

#[test]
fn a_mesh_of_several_batches_is_the_sum_of_them() {
    let noise = &mut Noise(6);
    let parts = SHAPES.map(|shape| random(noise, shape, Basis::Legendre, 2, 5, Distortion::Strain));
    let whole = ElementInput {
        batches: parts.iter().flat_map(|p| p.batches.clone()).collect(),
        coefficients: parts.iter().flat_map(|p| p.coefficients.clone()).collect(),
        distortion: Distortion::Strain,
    };
    let output = evaluate(&whole, &whole.coefficients);
    let outputs = parts.each_ref().map(|p| evaluate(p, &p.coefficients));
    assert_eq!(
        output.energies,
        outputs.each_ref().map(|o| o.energies.clone()).concat()
    );
    assert_eq!(
        output.gradient,
        outputs.each_ref().map(|o| o.gradient.clone()).concat()
    );
    assert!(element_energy::cpu(&[], &[], Distortion::Strain).energy() == 0.0);
}

#[test]
fn tables_that_do_not_fit_are_refused() {
    let samples = |derivatives: usize| Samples {
        modes: 2,
        values: vec![0.0; 6],
        derivatives: vec![vec![0.0; 6]; derivatives],
    };
    let tables = |factors, weights: usize| ElementTables::new(factors, vec![1.0; weights], None);
    assert!(tables(Factors::Hexahedron(samples(1)), 27).is_ok());
    assert!(tables(Factors::Hexahedron(samples(1)), 26).is_err());
    assert!(tables(Factors::Hexahedron(samples(2)), 27).is_err());
    assert!(tables(Factors::Prism(samples(2), samples(1)), 9).is_ok());
    assert!(tables(Factors::Prism(samples(1), samples(1)), 9).is_err());
    assert!(tables(Factors::Dense(samples(3)), 3).is_ok());
    assert!((cell_volume(CellShape::Tetrahedron) - 1.0 / 6.0).abs() < 1e-15);
}
