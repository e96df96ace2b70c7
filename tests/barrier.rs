//! The barrier on Bernstein coefficients: a bound on det J, a smooth term with a gradient, infinite where it must be.

mod common;

use common::Noise;
use common::elements::{BASES, SHAPES, affine};
use glam::{DMat3, DVec3};
use vorofit::energy::{BernsteinBarrier, THRESHOLD};
use vorofit::mesh::CellShape;
use vorofit::model::element::{Basis, Grid, Tables, mode_count, reference_matrix};

fn barrier(shape: CellShape, basis: Basis, order: usize, count: usize) -> BernsteinBarrier {
    let inverses = vec![reference_matrix(shape).inverse(); count];
    BernsteinBarrier::new(shape, basis, order, inverses, count).unwrap()
}

/// Elements disturbed so far that their bounds are under the threshold, but positive.
fn near_the_limit(
    noise: &mut Noise,
    shape: CellShape,
    basis: Basis,
    order: usize,
    count: usize,
) -> (BernsteinBarrier, Vec<DVec3>) {
    let barrier = barrier(shape, basis, order, count);
    let modes = mode_count(shape, order);
    let ideal = affine(shape, order, |x| x).repeat(count);
    let mut disturbances: Vec<_> = ideal.iter().map(|_| 2.0 * noise.vector()).collect();
    let disturbed = |disturbances: &[DVec3]| -> Vec<DVec3> {
        ideal
            .iter()
            .zip(disturbances)
            .map(|(c, d)| *c + *d)
            .collect()
    };
    for _ in 0..200 {
        let bounds = barrier.bounds(&disturbed(&disturbances));
        if bounds.iter().all(|&b| b > 0.1 * THRESHOLD) {
            break;
        }
        for (element, bound) in disturbances.chunks_mut(modes).zip(bounds) {
            if bound <= 0.1 * THRESHOLD {
                element.iter_mut().for_each(|d| *d *= 0.96);
            }
        }
    }
    let coefficients = disturbed(&disturbances);
    (barrier, coefficients)
}

#[test]
fn gradients_pass_the_taylor_test() {
    let noise = &mut Noise(1);
    for shape in SHAPES {
        for basis in BASES {
            for order in [1, 2, 3, 5, 6] {
                let (barrier, coefficients) = near_the_limit(noise, shape, basis, order, 5);
                let (value, gradient) = barrier.evaluate(&coefficients);
                let bounds = barrier.bounds(&coefficients);
                assert!(value > 0.0 && value.is_finite());
                let direction: Vec<_> = coefficients.iter().map(|_| noise.vector()).collect();
                let slope: f64 = gradient
                    .iter()
                    .zip(&direction)
                    .map(|(g, d)| g.dot(*d))
                    .sum();
                let least = bounds.into_iter().fold(1.0, f64::min);
                let remainder = |h: f64| {
                    let moved = coefficients.iter().zip(&direction);
                    let moved: Vec<_> = moved.map(|(c, d)| *c + h * *d).collect();
                    let (energy, _) = barrier.evaluate(&moved);
                    (energy - value - h * slope).abs()
                };
                // Not smaller: at order 5 the coefficients carry rounding of 1e-8.
                let step = 0.1 * least / order as f64;
                let rate = (remainder(step) / remainder(0.1 * step)).log10();
                assert!(rate >= 1.9, "{shape:?} {basis:?} {order}: {rate}");
            }
        }
    }
}

#[test]
fn bounds_are_below_every_sample() {
    let noise = &mut Noise(2);
    for shape in SHAPES {
        for order in 1..=5 {
            let (barrier, coefficients) = near_the_limit(noise, shape, Basis::Legendre, order, 6);
            let tables = Tables::new(Basis::Legendre, order, &Grid::lattice(shape, 9));
            let scale = reference_matrix(shape).determinant().recip();
            let modes = mode_count(shape, order);
            for (element, bound) in coefficients
                .chunks(modes)
                .zip(barrier.bounds(&coefficients))
            {
                for j in tables.gradients(element) {
                    assert!(
                        scale * j.determinant() >= bound - 1e-10,
                        "{shape:?} {order}"
                    );
                }
            }
        }
    }
}

/// The Bernstein coefficients of an affine map are its determinant, whatever the order.
#[test]
fn affine_elements_have_the_bound_of_their_matrix() {
    let map = DMat3::from_cols_array(&[1.2, 0.1, 0.0, -0.3, 0.8, 0.2, 0.05, 0.1, 1.5]);
    for shape in SHAPES {
        for basis in BASES {
            for order in [1, 4, 7] {
                let barrier = barrier(shape, basis, order, 1);
                let coefficients = affine(shape, order, |x| map * x);
                let [bound] = barrier.bounds(&coefficients)[..] else {
                    panic!("one element")
                };
                assert!(
                    (bound - map.determinant()).abs() < 1e-7,
                    "{shape:?} {order}: {bound}"
                );
                let (value, gradient) = barrier.evaluate(&coefficients);
                assert_eq!(value, 0.0);
                assert!(gradient.iter().all(|g| *g == DVec3::ZERO));
            }
        }
    }
}

#[test]
fn inverted_and_unsampled_elements_cost_infinitely_much() {
    for shape in SHAPES {
        let barrier = barrier(shape, Basis::Legendre, 2, 2);
        let ideal = affine(shape, 2, |x| x);
        let mirrored = affine(shape, 2, |x| DVec3::new(-x.x, x.y, x.z));
        let mut broken = ideal.clone();
        broken[0].x = f64::NAN;
        for bad in [mirrored, vec![DVec3::ZERO; ideal.len()], broken] {
            let coefficients = [ideal.clone(), bad].concat();
            assert_eq!(barrier.evaluate(&coefficients).0, f64::INFINITY);
            let bounds = barrier.bounds(&coefficients);
            assert!(bounds[0] > 0.9 && bounds[1] <= 1e-12);
        }
    }
}

#[test]
fn raising_the_order_keeps_the_bound() {
    let shape = CellShape::Hexahedron;
    for order in 1..=4 {
        let (low, coefficients) = near_the_limit(&mut Noise(3), shape, Basis::Legendre, order, 3);
        let (n, m) = (order + 1, order + 2);
        let mut raised = vec![DVec3::ZERO; 3 * m * m * m];
        for (k, &c) in coefficients.iter().enumerate() {
            let (element, mode) = (k / (n * n * n), k % (n * n * n));
            let place = mode % n + m * (mode / n % n) + m * m * (mode / (n * n));
            raised[element * m * m * m + place] = c;
        }
        let high = barrier(shape, Basis::Legendre, order + 1, 3);
        for (a, b) in low.bounds(&coefficients).iter().zip(high.bounds(&raised)) {
            assert!(b >= a - 1e-9, "{order}: {a} {b}");
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let (barrier, coefficients) =
        near_the_limit(&mut Noise(4), CellShape::Prism, Basis::Legendre, 2, 19);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| barrier.evaluate(&coefficients))
    };
    assert_eq!(run(1), run(3));
}
