//! The modes of triangles and tetrahedra in barycentric coordinates.
//!
//! An edge's mode is λ_a λ_b κ_j(λ_b − λ_a), on every simplex that has the edge. A triangle's mode is T = abc F(a, b, c); a tetrahedron
//! extends it as abc F(a + d/3, b + d/3, c + d/3), the rule that κ follows on edges. Plain products abc κ_i κ_j are of no use: at order
//! 16 their mass matrix has condition 10¹⁵. Instead:
//! - Legendre: orthogonal polynomials (Dubiner's construction with the weight (abc)², by a recurrence that does not divide);
//! - Fourier: the triangle's own Dirichlet eigenfunctions, antisymmetric sums of exponentials, as sin is on an edge. Written as a
//!   product of sines and a Schur polynomial (Weyl's denominator and the Jacobi–Trudi determinant) they divide by abc exactly.
//!
//! Modes inside triangles and cells have L² norm 1/degree on the reference simplex, so that their gradients are of order 1 like φ_j'.

use super::dual::{Complex, Dual};
use super::kernels::{jacobi, jacobi_norm_squared, kappa, sinc};
use super::quadrature::{collapse, gauss_jacobi};
use super::{Basis, TETRAHEDRON_EDGES, TETRAHEDRON_FACES, TRIANGLE_EDGES, modes};
use std::f64::consts::PI;

/// All modes of a triangle, in barycentric coordinates that sum to 1.
pub fn triangle<const N: usize>(basis: Basis, order: usize, l: [Dual<N>; 3]) -> Vec<Dual<N>> {
    let mut list = l.to_vec();
    for [a, b] in TRIANGLE_EDGES {
        list.extend(edge(basis, order, l[a], l[b]));
    }
    list.extend(face(basis, order, l, l));
    list
}

/// All modes of a tetrahedron, in barycentric coordinates that sum to 1.
pub fn tetrahedron<const N: usize>(basis: Basis, order: usize, l: [Dual<N>; 4]) -> Vec<Dual<N>> {
    let mut list = l.to_vec();
    for [a, b] in TETRAHEDRON_EDGES {
        list.extend(edge(basis, order, l[a], l[b]));
    }
    for corners in TETRAHEDRON_FACES {
        let abc = corners.map(|k| l[k]);
        let rest = (Dual::ONE - abc[0] - abc[1] - abc[2]) * (1.0 / 3.0);
        list.extend(face(basis, order, abc, abc.map(|x| x + rest)));
    }
    let product = l[0] * l[1] * l[2] * l[3];
    let factors = match basis {
        Basis::Legendre => tetrahedron_legendre(order, l),
        Basis::Fourier => tetrahedron_fourier(order, l),
    };
    list.extend(factors.into_iter().map(|f| product * f));
    list
}

/// λ_a λ_b κ_j(λ_b − λ_a).
fn edge<const N: usize>(
    basis: Basis,
    order: usize,
    a: Dual<N>,
    b: Dual<N>,
) -> impl Iterator<Item = Dual<N>> {
    kappa(basis, order - 1, b - a)
        .into_iter()
        .map(move |k| a * b * k)
}

/// abc F(at), F = T/(abc) over the modes inside a triangle.
fn face<const N: usize>(
    basis: Basis,
    order: usize,
    [a, b, c]: [Dual<N>; 3],
    at: [Dual<N>; 3],
) -> impl Iterator<Item = Dual<N>> {
    let factors = match basis {
        Basis::Legendre => triangle_legendre(order, at),
        Basis::Fourier => triangle_fourier(order, at),
    };
    factors.into_iter().map(move |f| a * b * c * f)
}

/// (a+b)ⁿ P_n^(2,2)((b−a)/(a+b)) P_m^(2n+5,2)(2c − 1), n = i − 1, m = j − 1.
fn triangle_legendre<const N: usize>(order: usize, [a, b, c]: [Dual<N>; 3]) -> Vec<Dual<N>> {
    let count = order.saturating_sub(2);
    let first = jacobi(2, 2, count, b - a, a + b);
    let second: Vec<_> = (0..count)
        .map(|n| jacobi(2 * n + 5, 2, count - n, c * 2.0 - Dual::ONE, Dual::ONE))
        .collect();
    modes::triangle(order)
        .into_iter()
        .map(|[i, j]| {
            let (n, m) = (i - 1, j - 1);
            let norm = jacobi_norm_squared(2, 2, n) * jacobi_norm_squared(2 * n + 5, 2, m);
            first[n] * second[n][m] * (1.0 / (norm.sqrt() * (i + j + 1) as f64))
        })
        .collect()
}

/// (a+b)ⁿ P_n^(2,2) (a+b+c)^m P_m^(2n+5,2)((c−a−b)/(a+b+c)) P_q^(2n+2m+8,2)(2d − 1), n = i − 1, m = j − 1, q = k − 1.
fn tetrahedron_legendre<const N: usize>(order: usize, [a, b, c, d]: [Dual<N>; 4]) -> Vec<Dual<N>> {
    let count = order.saturating_sub(3);
    let (ab, abc) = (a + b, a + b + c);
    let first = jacobi(2, 2, count, b - a, ab);
    let second: Vec<_> = (0..count)
        .map(|n| jacobi(2 * n + 5, 2, count - n, c - ab, abc))
        .collect();
    let third: Vec<_> = (0..count)
        .map(|nm| jacobi(2 * nm + 8, 2, count - nm, d * 2.0 - Dual::ONE, Dual::ONE))
        .collect();
    modes::tetrahedron(order)
        .into_iter()
        .map(|[i, j, k]| {
            let (n, m, q) = (i - 1, j - 1, k - 1);
            let norm = jacobi_norm_squared(2, 2, n)
                * jacobi_norm_squared(2 * n + 5, 2, m)
                * jacobi_norm_squared(2 * (n + m) + 8, 2, q);
            let scale = 1.0 / (norm.sqrt() * (i + j + k + 1) as f64);
            first[n] * second[n][m] * third[n + m][q] * scale
        })
        .collect()
}

/// Im D (i ≤ j) or Re D (i > j) over abc, D = det\[exp(2πi ν_k y_l)\], ν = (m+n, n, 0), (m, n) = (min, max)(i, j).
fn triangle_fourier<const N: usize>(order: usize, [a, b, c]: [Dual<N>; 3]) -> Vec<Dual<N>> {
    let third = 1.0 / 3.0;
    let y = [b * 2.0 + c, c - b, -(b + c * 2.0)].map(|y| y * third);
    let z = y.map(|y| Complex::unit(y * (2.0 * PI)));
    let e1 = z[0] + z[1] + z[2];
    let h = Symmetric::new(&[e1, e1.conjugate(), Complex::ONE], order);
    let sines = sinc(a) * sinc(b) * sinc(c) * (8.0 * PI.powi(3));
    modes::triangle(order)
        .into_iter()
        .map(|[i, j]| {
            let (m, n) = (i.min(j) as i32, i.max(j) as i32);
            let s = h.at(m + n - 2) * h.at(n - 1) - h.at(m + n - 1) * h.at(n - 2);
            // D/abc = −i S times the sines.
            let part = if i <= j { -s.re } else { s.im };
            let norm = if i == j { 3f64 } else { 1.5 };
            sines * part * (1.0 / (norm.sqrt() * (i + j + 1) as f64))
        })
        .collect()
}

/// Re D (i ≤ k) or Im D (i > k) over abcd, D = det\[exp(2πi ν_k y_l)\], ν = (l+m+n, m+n, n, 0), m = j, (l, n) = (min, max)(i, k).
fn tetrahedron_fourier<const N: usize>(order: usize, [a, b, c, d]: [Dual<N>; 4]) -> Vec<Dual<N>> {
    let y3 = (b + c * 2.0 + d * 3.0) * -0.25;
    let y = [y3 + d + c + b, y3 + d + c, y3 + d, y3];
    let z = y.map(|y| Complex::unit(y * (2.0 * PI)));
    let e1 = z[0] + z[1] + z[2] + z[3];
    let pairs = (z[0] + z[1]) * (z[2] + z[3]) + z[0] * z[1] + z[2] * z[3];
    let e2 = Complex::real(pairs.re); // Real, since the product of all z is 1.
    let h = Symmetric::new(&[e1, e2, e1.conjugate(), Complex::ONE], order);
    let sines = sinc(a)
        * sinc(b)
        * sinc(c)
        * sinc(d)
        * (-64.0 * PI.powi(4))
        * ((b + c) * PI).sin()
        * ((c + d) * PI).sin();
    modes::tetrahedron(order)
        .into_iter()
        .map(|[i, j, k]| {
            let (l, m, n) = (i.min(k) as i32, j as i32, i.max(k) as i32);
            let s = h.schur([l + m + n - 3, m + n - 2, n - 1]);
            let part = if i <= k { s.re } else { s.im };
            let norm = if i == k { 4f64 } else { 2.0 };
            sines * part * (1.0 / (norm.sqrt() * (i + j + k + 1) as f64))
        })
        .collect()
}

/// The complete homogeneous symmetric polynomials h_0, h_1 … of a few variables.
struct Symmetric<const N: usize>(Vec<Complex<N>>);

impl<const N: usize> Symmetric<N> {
    /// From the elementary ones e_1, e_2 …: h_k = e_1 h_{k−1} − e_2 h_{k−2} + e_3 h_{k−3} …
    fn new(elementary: &[Complex<N>], count: usize) -> Self {
        let mut h = vec![Complex::ONE];
        for k in 1..count {
            let mut sum = Complex::ZERO;
            for (r, &e) in (1..=k).zip(elementary) {
                let term = e * h[k - r];
                sum = if r % 2 == 1 { sum + term } else { sum - term };
            }
            h.push(sum);
        }
        Self(h)
    }

    /// h_k; zero below 0.
    fn at(&self, k: i32) -> Complex<N> {
        usize::try_from(k).map_or(Complex::ZERO, |k| self.0[k])
    }

    /// The Schur polynomial of a partition into three, det\[h_{μ_r − r + c}\].
    fn schur(&self, mu: [i32; 3]) -> Complex<N> {
        let at = |r: usize, c: i32| self.at(mu[r] - r as i32 + c);
        at(0, 0) * (at(1, 1) * at(2, 2) - at(1, 2) * at(2, 1))
            - at(0, 1) * (at(1, 0) * at(2, 2) - at(1, 2) * at(2, 0))
            + at(0, 2) * (at(1, 0) * at(2, 1) - at(1, 1) * at(2, 0))
    }
}

/// The modes inside a triangle after a permutation of its corners: T_k(λ ∘ order) = Σ_l R_kl T_l(λ), `[k, l]`, where
/// corner k of the permuted triangle is corner `order[k]` of the other. R is orthogonal, and zero between modes of different degree.
pub fn triangle_permutation(basis: Basis, order: usize, permutation: [usize; 3]) -> Vec<f64> {
    let count = modes::triangle_count(order);
    let n = match basis {
        Basis::Legendre => order + 1,
        // The product of two modes turns by up to 4π(p − 1) over an edge; the rest is for accuracy.
        Basis::Fourier => 4 * order + 14,
    };
    let (lines, weights) = (gauss_jacobi(n, 0), gauss_jacobi(n, 1));
    let degrees = Vec::from_iter(modes::triangle(order).iter().map(|[i, j]| i + j + 1));
    let pairs = (0..count).flat_map(|k| (0..count).map(move |l| (k, l)));
    let pairs = Vec::from_iter(pairs.filter(|&(k, l)| degrees[k] == degrees[l]));
    let mut product = vec![0.0; count * count];
    for &(t, b) in &weights {
        for &(s, a) in &lines {
            let [u, v, _] = collapse(s, t, 0.0);
            let l = [1.0 - u - v, u, v].map(Dual::<0>::constant);
            let at = |l| Vec::from_iter(face(basis, order, l, l).map(|t| t.value));
            let (modes, permuted) = (at(l), at(permutation.map(|k| l[k])));
            for &(k, l) in &pairs {
                // The norm of a mode is 1/degree.
                let scale = a * b * (degrees[l] * degrees[l]) as f64;
                product[k * count + l] += scale * permuted[k] * modes[l];
            }
        }
    }
    // What the quadrature leaves of entries that are zero.
    for entry in &mut product {
        if entry.abs() < 1e-12 {
            *entry = 0.0;
        }
    }
    product
}
