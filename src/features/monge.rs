//! From a polynomial over a guessed frame to the Monge form, without a second fit.
//!
//! The polynomial z = f(x, y) fixes the normal n = (−f_x, −f_y, 1)/s, s = √(1 + f_x² + f_y²). In a frame along n the same surface is z' = g(x', y') without
//! constant and linear terms, and F(x', y', g) = f(x, y) − z = 0 with (x, y, z) = R (x', y', g). As ∂F/∂g = −s at the origin, g += F/s gains a
//! degree each time. A turn about the normal removes x'y' from the second degree; the coefficients are then those of the Monge form.

use super::Monge;
use crate::kernel::jet::{Jet, TERMS};
use glam::{DMat3, DVec3};

/// Steps from degree 1, where g = 0 is right, to degree 4.
const STEPS: usize = 3;
const DEGREE: usize = 4;

/// A polynomial of degree 4 in two variables; its terms as in [`Jet::coefficients`].
type Polynomial = [f64; TERMS];

/// Where the coordinates of a jet lie in space.
#[derive(Debug, Clone, Copy)]
pub(super) struct JetFrame {
    /// The directions of x, y and height; orthonormal.
    pub axes: DMat3,
    /// The length of its unit.
    pub radius: f64,
}

/// The Monge form of the surface that a jet stands for, above its origin.
pub(super) fn monge(jet: &Jet, frame: &JetFrame) -> Monge {
    let mut f = jet.coefficients;
    f[0] = 0.0;
    let normal = DVec3::new(-f[1], -f[2], 1.0).normalize();
    let (u, v) = normal.any_orthonormal_pair();
    let g = over_tangents(&f, DMat3::from_cols(u, v, normal));
    // The greater eigenvalue of the second derivatives lies along this angle.
    let angle = 0.5 * (2.0 * g[4]).atan2(2.0 * g[3] - 2.0 * g[5]);
    let (sine, cosine) = angle.sin_cos();
    let h = compose(&g, &linear(cosine, -sine), &linear(sine, cosine));
    let first = (frame.axes * (cosine * u + sine * v)).normalize();
    let normal = (frame.axes * normal).normalize();
    let unit = frame.radius;
    let scaled = |value: f64, power: i32| value / unit.powi(power);
    Monge {
        normal,
        directions: [first, normal.cross(first)],
        curvatures: [scaled(2.0 * h[3], 1), scaled(2.0 * h[5], 1)],
        third: [6.0 * h[6], 2.0 * h[7], 2.0 * h[8], 6.0 * h[9]].map(|b| scaled(b, 2)),
        fourth: [
            24.0 * h[10],
            6.0 * h[11],
            4.0 * h[12],
            6.0 * h[13],
            24.0 * h[14],
        ]
        .map(|c| scaled(c, 3)),
    }
}

/// The graph of f as a graph over its tangent plane at the origin; the columns of `turn` are two tangents and the normal.
fn over_tangents(f: &Polynomial, turn: DMat3) -> Polynomial {
    let per_slope = turn.z_axis.z;
    let mut g = [0.0; TERMS];
    for _ in 0..STEPS {
        let coordinate = |row: DVec3| -> Polynomial {
            let mut p = g.map(|c| row.z * c);
            p[1] += row.x;
            p[2] += row.y;
            p
        };
        let [x, y, z] = [turn.row(0), turn.row(1), turn.row(2)].map(coordinate);
        let height = compose(f, &x, &y);
        // Below degree 2 nothing is left but rounding.
        for ((g, height), z) in g.iter_mut().zip(height).zip(z).skip(3) {
            *g += (height - z) * per_slope;
        }
    }
    g
}

/// a x + b y.
fn linear(a: f64, b: f64) -> Polynomial {
    let mut p = [0.0; TERMS];
    (p[1], p[2]) = (a, b);
    p
}

/// f(x, y) up to degree 4 for polynomials x and y without constant terms.
fn compose(f: &Polynomial, x: &Polynomial, y: &Polynomial) -> Polynomial {
    let mut sum = [0.0; TERMS];
    let mut one = [0.0; TERMS];
    one[0] = 1.0;
    // Powers of x; with each, powers of y.
    let mut power = one;
    for i in 0..=DEGREE {
        let mut product = power;
        for j in 0..=DEGREE - i {
            let factor = f[first(i + j) + j];
            for (s, p) in sum.iter_mut().zip(product) {
                *s += factor * p;
            }
            if i + j < DEGREE {
                product = multiply(&product, y, i + j);
            }
        }
        if i < DEGREE {
            power = multiply(&power, x, i);
        }
    }
    sum
}

/// The product up to degree 4 of a polynomial with no terms below degree `low`, and one without constant term.
fn multiply(a: &Polynomial, b: &Polynomial, low: usize) -> Polynomial {
    let mut product = [0.0; TERMS];
    for p in low..DEGREE {
        for q in 1..=DEGREE - p {
            for j in 0..=p {
                for k in 0..=q {
                    product[first(p + q) + j + k] += a[first(p) + j] * b[first(q) + k];
                }
            }
        }
    }
    product
}

/// The place of the first term of a degree.
const fn first(degree: usize) -> usize {
    degree * (degree + 1) / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jet(coefficients: Polynomial) -> Jet {
        Jet {
            coefficients,
            ..Jet::default()
        }
    }

    const PLAIN: JetFrame = JetFrame {
        axes: DMat3::IDENTITY,
        radius: 1.0,
    };

    #[test]
    fn a_plane_has_no_curvature_and_a_frame() {
        let mut f = [0.0; TERMS];
        (f[1], f[2]) = (0.75, -0.3);
        let form = monge(&jet(f), &PLAIN);
        assert!(
            form.curvatures
                .iter()
                .chain(&form.third)
                .chain(&form.fourth)
                .all(|k| k.abs() < 1e-14)
        );
        assert!((form.normal - DVec3::new(-0.75, 0.3, 1.0).normalize()).length() < 1e-15);
        let [a, b] = form.directions;
        assert!((a.cross(b) - form.normal).length() < 1e-15);
    }

    #[test]
    fn a_monge_form_is_its_own() {
        let h = [
            0.0, 0.0, 0.0, 0.8, 0.0, -0.3, 0.1, -0.2, 0.3, 0.05, 0.4, -0.1, 0.2, 0.3, -0.7,
        ];
        let frame = JetFrame {
            radius: 0.1,
            ..PLAIN
        };
        let form = monge(&jet(h), &frame);
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-10 * b.abs().max(1.0), "{a} {b}");
        near(form.curvatures[0], 16.0);
        near(form.curvatures[1], -6.0);
        let sign = form.directions[0].x;
        for (b, expected) in form.third.into_iter().zip([60.0, -40.0, 60.0, 30.0]) {
            near(sign * b, expected);
        }
        for (c, expected) in form
            .fourth
            .into_iter()
            .zip([9600.0, -600.0, 800.0, 1800.0, -16800.0])
        {
            near(c, expected);
        }
    }

    /// The graph of a tilted paraboloid, known exactly: z' = ½ (a x'² + b y'²) turned about an axis in the plane, solved for z.
    #[test]
    fn a_tilted_frame_gives_the_same_form() {
        // Jets of z = f over a tilted frame, by Newton on the implicit equation at many points, would be a fit. Instead tilt the
        // graph of a Monge form by polynomial algebra and come back: the inverse turn must undo the turn.
        let h = [
            0.0, 0.0, 0.0, 0.8, 0.0, -0.3, 0.1, -0.2, 0.3, 0.05, 0.4, -0.1, 0.2, 0.3, -0.7,
        ];
        let turn = DMat3::from_rotation_x(0.4) * DMat3::from_rotation_y(-0.3);
        let tilted = graph_in(&h, turn);
        assert!(tilted[1].abs() > 0.2 && tilted[2].abs() > 0.2);
        let form = monge(&jet(tilted), &PLAIN);
        let back = JetFrame {
            axes: turn.transpose(),
            ..PLAIN
        };
        assert!((back.axes * form.normal - DVec3::Z).length() < 1e-12);
        let straight = monge(&jet(h), &PLAIN);
        let sign = (back.axes * form.directions[0]).dot(straight.directions[0]);
        assert!((sign.abs() - 1.0).abs() < 1e-12);
        for (a, b) in form.curvatures.iter().zip(straight.curvatures) {
            assert!((a - b).abs() < 1e-12);
        }
        for (a, b) in form.third.iter().zip(straight.third) {
            assert!((sign * a - b).abs() < 1e-11, "{a} {b}");
        }
        for (a, b) in form.fourth.iter().zip(straight.fourth) {
            assert!((a - b).abs() < 1e-10, "{a} {b}");
        }
    }

    /// The graph of h turned by a rotation, again as a graph over x and y, by the fixed point that the slope allows.
    fn graph_in(h: &Polynomial, turn: DMat3) -> Polynomial {
        let back = turn.transpose();
        let slope = back.row(2);
        let mut z = linear(-slope.x / slope.z, -slope.y / slope.z);
        for _ in 0..20 {
            let coordinate = |row: DVec3| {
                let mut p = z.map(|c| row.z * c);
                p[1] += row.x;
                p[2] += row.y;
                p
            };
            let (x, y, w) = (
                coordinate(back.row(0)),
                coordinate(back.row(1)),
                coordinate(slope),
            );
            let value = compose(h, &x, &y);
            for ((z, value), w) in z.iter_mut().zip(value).zip(w) {
                *z += (value - w) / slope.z;
            }
        }
        z
    }
}
