//! Both twins of the jet agree and find polynomials again; and what f32 loses of each derivative.

mod common;

use common::{Noise, agree, gpu, repeats, sees};
use glam::DVec3;
use vorofit::kernel::Kernel;
use vorofit::kernel::jet::{self, JetInput, JetTwins, TERMS, monomials};

/// A group for every list of points.
fn groups(lists: Vec<Vec<DVec3>>) -> JetInput {
    let mut input = JetInput {
        offsets: vec![0],
        points: Vec::new(),
    };
    for list in lists {
        input.points.extend(list);
        input.offsets.push(input.points.len() as u32);
    }
    input
}

/// Points of the disc with heights of their own.
fn disc(noise: &mut Noise, count: usize, height: impl Fn(f64, f64) -> f64) -> Vec<DVec3> {
    let mut points = Vec::new();
    while points.len() < count {
        let (x, y) = (2.0 * noise.next(), 2.0 * noise.next());
        if x * x + y * y < 0.9 {
            points.push(DVec3::new(x, y, height(x, y)));
        }
    }
    points
}

fn smooth(noise: &mut Noise, count: usize) -> JetInput {
    let lists = (0..count).map(|_| {
        let (a, b) = (noise.next(), noise.next());
        disc(noise, 60, |x, y| {
            0.1 * (x + 6.0 * a).sin() * (1.3 * y + 6.0 * b).cos()
        })
    });
    groups(lists.collect())
}

#[test]
fn jets() {
    let noise = &mut Noise(11);
    let rough = (0..200).map(|k| {
        let mut points = disc(noise, 16 + k, |x, y| 0.3 * x * y);
        points.iter_mut().for_each(|p| p.z += 0.1 * noise.next());
        points
    });
    let rough = groups(rough.collect());
    let thin = |noise: &mut Noise, width: f64| -> JetInput {
        groups(
            (0..100)
                .map(|_| {
                    disc(noise, 40, |x, _| 0.1 * x * x)
                        .iter()
                        .map(|p| *p * DVec3::new(1.0, width, 1.0))
                        .collect()
                })
                .collect(),
        )
    };
    let steps = |noise: &mut Noise| disc(noise, 60, |x, _| if x > 0.1 { 0.3 } else { 0.0 });
    let ordinary = smooth(noise, 500);
    agree::<JetTwins>(&[
        ("no groups", JetInput::default()),
        (
            "groups of no, one and five points",
            groups(vec![
                vec![],
                vec![DVec3::ZERO],
                disc(noise, 5, |x, y| x * y),
            ]),
        ),
        (
            "one place many times",
            groups(vec![vec![DVec3::new(0.3, 0.2, 0.1); 40]; 3]),
        ),
        ("flat", groups(vec![disc(noise, 60, |_, _| 0.0); 3])),
        ("a line", thin(noise, 0.0)),
        ("nearly a line", thin(noise, 1e-4)),
        ("needles", thin(noise, 0.05)),
        ("a step", groups(vec![steps(noise), steps(noise)])),
        ("noise", rough.clone()),
        (
            "as many points as there may be",
            groups(vec![
                disc(noise, jet::MAX_POINTS, |x, y| x * x - 0.5 * y);
                5
            ]),
        ),
        ("smooth", ordinary.clone()),
    ]);
    sees::<JetTwins>(
        &jet::SHADER,
        &ordinary,
        &[
            (
                "cosine * lower - sine * upper",
                "cosine * lower + sine * upper",
            ),
            ("offsets[group + 1u]", "offsets[group + 1u] - 1u"),
            ("(terms > vec4u(k))", "(terms >= vec4u(k + 2u))"),
            (
                "second.yz, p.x * second.x, second.x * p.y",
                "second.yz, p.x * second.x, second.y * p.y",
            ),
        ],
    );
    repeats::<JetTwins>(&rough);
}

#[test]
fn a_polynomial_is_found_again() {
    let noise = &mut Noise(5);
    let coefficients: [f64; TERMS] = std::array::from_fn(|_| noise.next());
    let height = |x, y| {
        monomials(x, y)
            .iter()
            .zip(coefficients)
            .map(|(t, c)| t * c)
            .sum()
    };
    let input = groups((16..80).map(|n| disc(noise, 2 * n, height)).collect());
    for jet in JetTwins::cpu(&input) {
        for (found, exact) in jet.coefficients.iter().zip(coefficients) {
            assert!((found - exact).abs() < 1e-9, "{found} {exact}");
        }
        assert!(jet.residual < 1e-7 && jet.pivot > 1e-3, "{jet:?}");
    }
}

#[test]
fn single_precision_loses_millionths_of_every_degree() {
    let input = smooth(&mut Noise(3), 500);
    let cpu = JetTwins::cpu(&input);
    let gpu = JetTwins::gpu(gpu(), &mut input.clone()).unwrap();
    let mut worst = [0f64; 5];
    for (a, b) in cpu.iter().zip(&gpu) {
        for (degree, worst) in worst.iter_mut().enumerate() {
            let first = degree * (degree + 1) / 2;
            for k in first..=first + degree {
                *worst = worst.max((a.coefficients[k] - b.coefficients[k]).abs() / 0.1);
            }
        }
    }
    println!("lost of the largest height, by degree: {worst:?}");
    for (degree, lost) in worst.into_iter().enumerate() {
        assert!(lost < 2e-5, "degree {degree}: {lost}");
    }
}

#[test]
fn points_that_leave_terms_open_are_known_by_their_pivot() {
    let noise = &mut Noise(9);
    let two_lines = (0..40).map(|k| {
        DVec3::new(
            f64::from(k) / 41.0 - 0.5,
            if k % 2 == 0 { 0.0 } else { 0.4 },
            0.1 * noise.next(),
        )
    });
    let input = groups(vec![two_lines.collect(), disc(noise, 60, |x, _| x)]);
    for jets in [
        JetTwins::cpu(&input),
        JetTwins::gpu(gpu(), &mut input.clone()).unwrap(),
    ] {
        assert!(jets[0].pivot < 1e-5 && jets[1].pivot > 5e-3, "{jets:?}");
    }
}
