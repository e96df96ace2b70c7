use super::strain::curvatures;
use super::*;
use crate::geometry::random::Random;
use glam::{DQuat, DVec3};

fn rotation(random: &mut Random) -> DMat3 {
    let mut n = || random.normal();
    DMat3::from_quat(DQuat::from_xyzw(n(), n(), n(), n()).normalize())
}

/// A matrix of positive determinant, singular values within e^±spread.
fn random_matrix(random: &mut Random, spread: f64) -> DMat3 {
    let s = DVec3::from([0; 3].map(|_| random.between(-spread, spread).exp()));
    rotation(random) * DMat3::from_diagonal(s) * rotation(random)
}

fn product(a: DMat3, b: DMat3) -> f64 {
    let (a, b) = (a.to_cols_array(), b.to_cols_array());
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[test]
fn rotations_cost_nothing() {
    let random = &mut Random::new(1);
    for density in Distortion::ALL {
        for jacobian in [DMat3::IDENTITY, rotation(random), rotation(random)] {
            let at = density.evaluate(jacobian);
            assert!(at.value.abs() < 1e-15, "{density:?} {at:?}");
            assert!(product(at.gradient, at.gradient).sqrt() < 1e-14);
            assert!((at.determinant - 1.0).abs() < 1e-14);
        }
    }
}

#[test]
fn conformal_densities_do_not_see_the_scale() {
    let j = random_matrix(&mut Random::new(2), 0.5);
    for density in Distortion::ALL {
        let change = density.evaluate(3.0 * j).value - density.evaluate(j).value;
        let is_rigid = matches!(density, Distortion::Strain | Distortion::SymmetricDirichlet);
        assert_eq!(change.abs() > 1e-12, is_rigid, "{density:?} {change}");
    }
}

#[test]
fn the_strain_of_known_stretches() {
    let random = &mut Random::new(3);
    for s in [
        DVec3::new(1.0, 2.0, 0.5),
        DVec3::new(1e-6, 1.0, 1e6),
        DVec3::new(1e-3, 1e-3, 1e-3),
        DVec3::new(1.0 + 1e-9, 1.0, 1.0 - 1e-9),
        DVec3::new(2.0, 2.0, 2.0 + 1e-12),
    ] {
        let (u, v) = (rotation(random), rotation(random));
        let l = DVec3::from(s.to_array().map(f64::ln));
        let at = Distortion::Strain.evaluate(u * DMat3::from_diagonal(s) * v.transpose());
        // What rounding of J to one part in 1e16 does to the smallest stretch.
        let rounding = 1e-15 * s.max_element() / s.min_element();
        let value = 0.5 * l.length_squared();
        assert!((at.value - value).abs() <= 30.0 * rounding * l.length() + 1e-16);
        let expected = u * DMat3::from_diagonal(l / s) * v.transpose();
        let error = at.gradient - expected;
        let size = product(expected, expected).sqrt() + 1.0 / s.min_element();
        assert!(
            product(error, error).sqrt() <= 30.0 * rounding * size,
            "{s}"
        );
    }
}

/// The slope of ε(J + hD) − ε(J) − h ⟨∂ε, D⟩ in a doubly logarithmic plot.
#[test]
fn gradients_pass_the_taylor_test() {
    let random = &mut Random::new(4);
    for density in Distortion::ALL {
        for _ in 0..20 {
            let (j, d) = (random_matrix(random, 1.0), random_matrix(random, 0.5));
            let at = density.evaluate(j);
            let remainder = |h: f64| {
                let value = density.evaluate(j + h * d).value;
                (value - at.value - h * product(at.gradient, d)).abs()
            };
            let [coarse, fine] = [1e-3, 1e-4].map(|h| remainder(h * j.determinant().cbrt()));
            assert!(
                (coarse / fine).log10() > 1.9,
                "{density:?}: {coarse} {fine}"
            );
        }
    }
}

#[test]
fn rigid_densities_agree_to_second_order() {
    let d = random_matrix(&mut Random::new(5), 1.0);
    let j = DMat3::IDENTITY + 1e-4 * d;
    let [strain, dirichlet] = [Distortion::Strain, Distortion::SymmetricDirichlet]
        .map(|density| density.evaluate(j).value);
    assert!((strain / dirichlet - 1.0).abs() < 2e-3);
}

#[test]
fn curvatures_are_those_of_the_gradient() {
    let random = &mut Random::new(6);
    let doubled = {
        let (u, v) = (rotation(random), rotation(random));
        u * DMat3::from_diagonal(DVec3::new(0.8, 0.8, 1.1)) * v
    };
    for j in [
        DMat3::IDENTITY,
        doubled,
        random_matrix(random, 0.4),
        random_matrix(random, 0.9),
    ] {
        for pair in curvatures(j) {
            let d = pair.direction;
            assert!((product(d, d) - 1.0).abs() < 1e-12);
            let h = 1e-5;
            let gradient = |h: f64| Distortion::Strain.evaluate(j + h * d).gradient;
            let bent = (gradient(h) - gradient(-h)) * (0.5 / h);
            let along = product(bent, d);
            assert!((along.max(0.0) - pair.curvature).abs() < 1e-7 * (1.0 + along.abs()));
            let rest = bent - along * d;
            assert!(
                product(rest, rest).sqrt() < 1e-7 * (1.0 + along.abs()),
                "no eigenmatrix"
            );
        }
    }
}

#[test]
fn blocks_are_many_matrices() {
    let random = &mut Random::new(7);
    let matrices: Vec<_> = (0..16).map(|_| random_matrix(random, 0.7)).collect();
    for density in Distortion::ALL {
        let mut block = Block::<16>::default();
        for (k, m) in matrices.iter().enumerate() {
            let entries = m.to_cols_array();
            (0..9).for_each(|e| block.jacobian[e][k] = entries[e]);
        }
        density.evaluate_block(&mut block);
        for (k, m) in matrices.iter().enumerate() {
            let at = density.evaluate(*m);
            let gradient = DMat3::from_cols_array(&block.gradient.map(|g| g[k]));
            let error = product(gradient - at.gradient, gradient - at.gradient).sqrt();
            assert!((block.value[k] - at.value).abs() < 1e-14 * (1.0 + at.value));
            assert!(error < 1e-12, "{density:?}: {error}");
            assert!((block.determinant[k] - m.determinant()).abs() < 1e-13);
        }
    }
}

#[test]
fn inverted_and_flat_matrices_are_told_by_the_determinant() {
    let flat = DMat3::from_cols(DVec3::X, DVec3::X, DVec3::Z);
    for density in Distortion::ALL {
        assert!(density.evaluate(-DMat3::IDENTITY).determinant < 0.0);
        assert!(density.evaluate(flat).determinant <= 0.0);
        assert!(density.evaluate(DMat3::ZERO).determinant <= 0.0);
        assert!(
            density
                .evaluate(DMat3::IDENTITY * f64::NAN)
                .determinant
                .is_nan()
        );
    }
}
