//! How well polynomials stand for the gradients of Fourier elements, and for their determinants.
//!
//! Fourier modes are entire functions. Let f be bounded by M on the Bernstein ellipse of parameter ρ around \[0, 1\] in one coordinate
//! of the cube, the others real. Then interpolation at n Chebyshev nodes is off by at most 4 M ρ^(1−n)/(ρ − 1) (Trefethen, Approximation
//! Theory and Approximation Practice, theorem 8.2), and over three coordinates by the sum of these, times the Lebesgue constants
//! of the axes before. M comes from the coefficients and from a bound on each mode where barycentric coordinates have modulus
//! at most R and imaginary parts that move at most β between them:
//! |sin πjz|, |cos πjz| ≤ cosh(πjβ), |sinc z| ≤ cosh(πβ), and a Schur polynomial of exponentials is bounded by its dimension
//! (Weyl's formula) times the exponential of its highest weight. Derivatives come from Cauchy's estimate.

use crate::mesh::CellShape;
use crate::model::element::{TETRAHEDRON_EDGES, TETRAHEDRON_FACES, TRIANGLE_EDGES, modes};
use glam::DVec3;
use std::f64::consts::{PI, SQRT_2};

/// Ellipses that are tried: ρ = 1.2 … 1.2^20 = 38.
const ELLIPSES: usize = 20;

/// Bounds M of |∂h/∂u_k| for complex values of one coordinate of the cube, by axis and ellipse.
#[derive(Debug)]
pub struct Analytic {
    /// `[axis][ellipse]`, the same for all three derivatives.
    bounds: [Vec<f64>; 3],
}

/// The Lebesgue constant of `n` Chebyshev nodes, or more.
fn lebesgue(n: usize) -> f64 {
    1.0 + 2.0 / PI * (n as f64).ln()
}

fn rho(ellipse: usize) -> f64 {
    1.2f64.powi(ellipse as i32 + 1)
}

/// How far factors of a mode go into the complex plane: modulus of coordinates, and what imaginary parts move.
#[derive(Clone, Copy)]
struct Reach {
    modulus: f64,
    imaginary: f64,
}

/// Bounds of modes per factor, `[reach]`, where reach 0 is real, 1 the ellipse, 2 Cauchy's circle about real points, 3 about the ellipse.
struct Factors {
    bounds: Vec<[Vec<f64>; 4]>,
}

impl Factors {
    fn new(shape: CellShape, order: usize, rho: f64, radius: f64) -> Self {
        let ellipse = Reach {
            modulus: 0.5 + 0.25 * (rho + 1.0 / rho),
            imaginary: 0.25 * (rho - 1.0 / rho),
        };
        let real = Reach {
            modulus: 1.0,
            imaginary: 0.0,
        };
        let wider = |r: Reach| Reach {
            modulus: r.modulus + radius,
            imaginary: r.imaginary + radius,
        };
        let reaches = [real, ellipse, wider(real), wider(ellipse)];
        let factors: &[fn(usize, Reach) -> Vec<f64>] = match shape {
            CellShape::Hexahedron => &[line, line, line],
            CellShape::Prism => &[triangle, line],
            CellShape::Tetrahedron => &[tetrahedron],
        };
        let bounds = factors
            .iter()
            .map(|f| reaches.map(|r| f(order, r)))
            .collect();
        Self { bounds }
    }

    /// Σ |c_m| |m| with factor `complex` on the ellipse and factor `derived` on Cauchy's circle.
    fn sum(&self, sizes: &[f64], complex: usize, derived: usize) -> f64 {
        let chosen = self.bounds.iter().enumerate().map(|(f, reaches)| {
            &reaches[usize::from(f == complex) + 2 * usize::from(f == derived)]
        });
        // The first factor is the fastest.
        let mut products = vec![1.0];
        for factor in chosen {
            products = factor
                .iter()
                .flat_map(|b| products.iter().map(move |p| p * b))
                .collect();
        }
        sizes.iter().zip(products).map(|(s, p)| s * p).sum()
    }
}

/// What is known of the modes of a shape and an order before the coefficients are.
pub struct Envelope {
    /// `[ellipse]`.
    factors: Vec<Factors>,
    /// The factor that has each coordinate.
    owners: [usize; 3],
    /// Of Cauchy's circle.
    radius: f64,
}

impl Envelope {
    /// For the Fourier elements of a shape and an order.
    pub fn new(shape: CellShape, order: usize) -> Self {
        // About where exp(πpr)/r, the growth of the highest mode against Cauchy's divisor, is least.
        let radius = 1.0 / (PI * order as f64);
        let ellipses = 0..ELLIPSES;
        Self {
            factors: ellipses
                .map(|e| Factors::new(shape, order, rho(e), radius))
                .collect(),
            owners: match shape {
                CellShape::Hexahedron => [0, 1, 2],
                CellShape::Prism => [0, 0, 1],
                CellShape::Tetrahedron => [0, 0, 0],
            },
            radius,
        }
    }

    /// For the local modes of an element, its corners relative to a point nearby.
    pub fn of(&self, coefficients: &[DVec3]) -> Analytic {
        let sizes: Vec<f64> = coefficients.iter().map(|c| c.length()).collect();
        let bound = |factors: &Factors, complex: usize| {
            let derived = self.owners.map(|d| factors.sum(&sizes, complex, d));
            derived.into_iter().fold(0.0, f64::max) / self.radius
        };
        Analytic {
            bounds: self
                .owners
                .map(|owner| self.factors.iter().map(|f| bound(f, owner)).collect()),
        }
    }
}

impl Analytic {
    /// The error of interpolating det ∇h with `n` nodes an axis: by Hadamard, a product of three derivatives.
    pub fn determinant_error(&self, n: usize) -> f64 {
        self.error(n, 3)
    }

    /// The further error of an interpolant with `to` nodes an axis, where the determinants come from derivatives that have been
    /// interpolated with `from` nodes.
    pub fn sampling_error(&self, from: usize, to: usize) -> f64 {
        let error = self.error(from, 1);
        let column = self.bounds[0][0] + error;
        lebesgue(to).powi(3) * 3.0 * error * column * column
    }

    fn error(&self, n: usize, power: i32) -> f64 {
        let lebesgue = lebesgue(n);
        let along = |bounds: &Vec<f64>| {
            let each = bounds
                .iter()
                .enumerate()
                .map(|(e, m)| 4.0 * m.powi(power) * rho(e).powf(1.0 - n as f64) / (rho(e) - 1.0));
            each.fold(f64::INFINITY, f64::min)
        };
        let [x, y, z] = self.bounds.each_ref().map(along);
        x + lebesgue * (y + lebesgue * z)
    }
}

/// 1 − x, x, φ_1, φ_2 …
fn line(order: usize, r: Reach) -> Vec<f64> {
    let mut bounds = vec![r.modulus; 2];
    bounds.extend((1..order).map(|j| {
        let z = PI * j as f64;
        SQRT_2 / z * (z * r.imaginary).cosh()
    }));
    bounds
}

fn triangle(order: usize, r: Reach) -> Vec<f64> {
    let mut bounds = vec![r.modulus; 3];
    for _ in TRIANGLE_EDGES {
        bounds.extend(edge(order, r));
    }
    bounds.extend(face(order, r));
    bounds
}

fn tetrahedron(order: usize, r: Reach) -> Vec<f64> {
    let mut bounds = vec![r.modulus; 4];
    for _ in TETRAHEDRON_EDGES {
        bounds.extend(edge(order, r));
    }
    for _ in TETRAHEDRON_FACES {
        bounds.extend(face(order, r));
    }
    bounds.extend(modes::tetrahedron(order).into_iter().map(|[i, j, k]| {
        let [l, m, n] = [i, j, k].map(|x| x as f64);
        let dimension = l * m * n * (l + m) * (m + n) * (l + m + n) / 12.0;
        let weight = 0.75 * (l - 1.0) + (m - 1.0) + 0.75 * (n - 1.0);
        let sines = 64.0 * PI.powi(4) * (PI * r.imaginary).cosh().powi(6);
        let norm = if i == k { 2.0 } else { SQRT_2 };
        let degree = (i + j + k + 1) as f64;
        r.modulus.powi(4) * sines * dimension * (2.0 * PI * weight * r.imaginary).exp()
            / (norm * degree)
    }));
    bounds
}

/// λ_a λ_b κ_j, |κ_j| ≤ 2√2 cosh(πjβ).
fn edge(order: usize, r: Reach) -> impl Iterator<Item = f64> {
    (1..order).map(move |j| r.modulus.powi(2) * 2.0 * SQRT_2 * (PI * j as f64 * r.imaginary).cosh())
}

/// abc 8π³ sinc³ S, S of the highest weight (m − 1, n − 1), whose fundamental weights turn by ⅔ β.
fn face(order: usize, r: Reach) -> impl Iterator<Item = f64> {
    modes::triangle(order).into_iter().map(move |[i, j]| {
        let (m, n) = (i as f64, j as f64);
        let dimension = m * n * (m + n) / 2.0;
        let weight = 2.0 / 3.0 * (m + n - 2.0);
        let sines = 8.0 * PI.powi(3) * (PI * r.imaginary).cosh().powi(3);
        let norm = if i == j { 3f64 } else { 1.5 }.sqrt();
        let degree = (i + j + 1) as f64;
        r.modulus.powi(3) * sines * dimension * (2.0 * PI * weight * r.imaginary).exp()
            / (norm * degree)
    })
}
