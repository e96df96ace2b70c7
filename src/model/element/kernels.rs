//! The kernels in one dimension: φ_j, κ_j = φ_j(x) / (x(1 − x)), and Jacobi polynomials.

use super::Basis;
use super::dual::Dual;
use std::f64::consts::{PI, SQRT_2};

/// Value and derivative at `x` in \[0, 1\] of the modes 0 to `order` along an axis: 1 − x, x, φ_1, φ_2 …
pub fn axis(basis: Basis, order: usize, x: f64) -> Vec<[f64; 2]> {
    let mut modes = vec![[1.0 - x, -1.0], [x, 1.0]];
    modes.extend(match basis {
        Basis::Legendre => legendre(order - 1, x),
        Basis::Fourier => fourier(order - 1, x),
    });
    modes
}

/// φ_j = (P_{j−1} − P_{j+1})(2x − 1) / (2√(2j+1)), φ_j' = −√(2j+1) P_j(2x − 1), for j = 1 to `count`.
fn legendre(count: usize, x: f64) -> Vec<[f64; 2]> {
    let p = jacobi::<0>(0, 0, count + 2, Dual::constant(2.0 * x - 1.0), Dual::ONE);
    (1..=count)
        .map(|j| {
            let root = (2.0 * j as f64 + 1.0).sqrt();
            let value = (p[j - 1].value - p[j + 1].value) / (2.0 * root);
            [value, -root * p[j].value]
        })
        .collect()
}

/// φ_j = √2 sin(jπx)/(jπ), φ_j' = √2 cos(jπx), for j = 1 to `count`; folded at ½, so that φ_j(1) is exactly 0.
fn fourier(count: usize, x: f64) -> Vec<[f64; 2]> {
    (1..=count)
        .map(|j| {
            let sign = if x > 0.5 { parity(j) } else { 1.0 };
            let (sin, cos) = (j as f64 * PI * x.min(1.0 - x)).sin_cos();
            let cos = if x > 0.5 { -sign * cos } else { cos };
            [sign * SQRT_2 * sin / (j as f64 * PI), SQRT_2 * cos]
        })
        .collect()
}

/// (−1)^(j+1): what reversing the axis multiplies φ_j by.
pub fn parity(j: usize) -> f64 {
    if j % 2 == 1 { 1.0 } else { -1.0 }
}

/// κ_j(t) for j = 1 to `count`: φ_j(x) = x (1 − x) κ_j(2x − 1), without the division.
pub fn kappa<const N: usize>(basis: Basis, count: usize, t: Dual<N>) -> Vec<Dual<N>> {
    match basis {
        Basis::Legendre => jacobi(1, 1, count, t, Dual::ONE)
            .into_iter()
            .zip(1..)
            .map(|(p, j)| p * ((2.0 * f64::from(j) + 1.0).sqrt() / f64::from(j)))
            .collect(),
        // By 1/(x(1 − x)) = 1/x + 1/(1 − x).
        Basis::Fourier => {
            let (x, rest) = ((Dual::ONE + t) * 0.5, (Dual::ONE - t) * 0.5);
            (1..=count)
                .map(|j| sinc(x * j as f64) + sinc(rest * j as f64) * parity(j))
                .map(|sum| sum * SQRT_2)
                .collect()
        }
    }
}

/// sin(πz)/(πz).
pub fn sinc<const N: usize>(z: Dual<N>) -> Dual<N> {
    let x = z.value;
    let q = (PI * x) * (PI * x);
    if x.abs() < 1e-2 {
        // The next terms are 1e-18 and 1e-14 of the leading ones.
        let value = 1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0));
        let slope = -(PI * PI * x / 3.0) * (1.0 - q / 10.0 * (1.0 - q / 28.0));
        return z.chain(value, slope);
    }
    let (sin, cos) = (PI * x).sin_cos();
    let value = sin / (PI * x);
    z.chain(value, (cos - value) / x)
}

/// sⁿ P_n^(α, β)(x/s) for n = 0 to `count` − 1, by the recurrence made homogeneous in (x, s), which does not divide by s.
pub fn jacobi<const N: usize>(
    alpha: usize,
    beta: usize,
    count: usize,
    x: Dual<N>,
    s: Dual<N>,
) -> Vec<Dual<N>> {
    let (a, b) = (alpha as f64, beta as f64);
    let first = s * (0.5 * (a - b)) + x * (0.5 * (a + b + 2.0));
    let mut p = vec![Dual::ONE, first];
    let s2 = s * s;
    for n in 2..count {
        let n_ = n as f64;
        let c = 2.0 * n_ + a + b;
        let by_x = (c - 1.0) * c * (c - 2.0);
        let by_s = (c - 1.0) * (a * a - b * b);
        let back = 2.0 * (n_ + a - 1.0) * (n_ + b - 1.0) * c;
        let sum = (x * by_x + s * by_s) * p[n - 1] - s2 * p[n - 2] * back;
        // Dividing last keeps the values at x = ±s exact, so that φ_j is exactly 0 at both ends.
        let divisor = 2.0 * n_ * (n_ + a + b) * (c - 2.0);
        p.push(sum.chain(sum.value / divisor, 1.0 / divisor));
    }
    p.truncate(count);
    p
}

/// ∫ (1 − x)^α x^β P_n^(α, β)(2x − 1)² dx over \[0, 1\].
pub fn jacobi_norm_squared(alpha: usize, beta: usize, n: usize) -> f64 {
    let ratio: f64 = (1..=alpha)
        .map(|k| (n + k) as f64 / (n + beta + k) as f64)
        .product();
    ratio / (2 * n + alpha + beta + 1) as f64
}
