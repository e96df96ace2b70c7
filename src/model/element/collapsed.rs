//! The orthonormal tensor basis in which sums over the modes of a Legendre tetrahedron factor.

use super::Basis;
use super::dual::Dual;
use super::kernels::{jacobi, jacobi_norm_squared};
use super::quadrature::{collapse, gauss_jacobi};
use super::tables::{Factor, Table};

/// Dubiner's basis of the polynomials of degree p on the tetrahedron, ψ_ijk = A_i(s) B_ij(t) C_{i+j,k}(r) in the coordinates of
/// [`collapse`], i + j + k ≤ p, listed with k fastest and i slowest:
/// A_i = P_i^(0,0), B_ij = (1−t)^i P_j^(2i+1,0), C_lk = (1−r)^l P_k^(2l+2,0), all normalized on their axes.
///
/// For a gradient by (u, v, w): ∂_u = ∂_s/((1−r)(1−t)), ∂_v = ∂_t/(1−r) + s ∂_u, ∂_w = ∂_r + t ∂_v + (1−t) s ∂_u, which the points of
/// the default rule, inside the cube, allow.
#[derive(Debug, Clone, PartialEq)]
pub struct CollapsedBasis {
    /// A_i at points s, `[points, p + 1]`.
    pub first: Table,
    /// For each i: B_ij at points t, `[points, p + 1 − i]`.
    pub second: Vec<Table>,
    /// For each l = i + j: C_lk at points r, `[points, p + 1 − l]`.
    pub third: Vec<Table>,
    /// `[ψ, modes]`: coefficients of the ψ from those of the local modes of [`Basis::Legendre`].
    pub matrix: Vec<f64>,
}

impl CollapsedBasis {
    /// For an order, with tables at the given points of the axes s, t, r.
    pub fn new(order: usize, axes: [&[f64]; 3]) -> Self {
        Self {
            first: Self::axis(order, 0, 0, axes[0]),
            second: Self::family(order, 1, axes[1]),
            third: Self::family(order, 2, axes[2]),
            matrix: matrix(order),
        }
    }

    fn family(order: usize, alpha: usize, points: &[f64]) -> Vec<Table> {
        (0..=order)
            .map(|l| Self::axis(order, l, alpha, points))
            .collect()
    }

    /// (1−x)^l P_k^(2l+α, 0)(2x − 1) for k ≤ p − l, normalized for the weight (1−x)^α.
    fn axis(order: usize, l: usize, alpha: usize, points: &[f64]) -> Table {
        let count = order + 1 - l;
        let mut table = Table {
            modes: count,
            values: Vec::with_capacity(points.len() * count),
            derivatives: vec![Vec::with_capacity(points.len() * count)],
        };
        for &x in points {
            let x = Dual::<1>::coordinate(0, x);
            let power = (0..l).fold(Dual::ONE, |power, _| power * (Dual::ONE - x));
            let p = jacobi(2 * l + alpha, 0, count, x * 2.0 - Dual::ONE, Dual::ONE);
            for (k, p) in p.into_iter().enumerate() {
                let f = power * p * (1.0 / jacobi_norm_squared(2 * l + alpha, 0, k).sqrt());
                table.values.push(f.value);
                table.derivatives[0].push(f.gradient[0]);
            }
        }
        table
    }
}

/// ⟨ψ, mode⟩ of every pair, `[ψ, modes]`, by a rule that is exact for it; summed one axis after the other.
fn matrix(order: usize) -> Vec<f64> {
    let n = order + 1;
    let rules = [0, 1, 2].map(|alpha| gauss_jacobi(n, alpha));
    let [s, t, r] = rules
        .each_ref()
        .map(|rule| Vec::from_iter(rule.iter().map(|p| p.0)));
    let first = CollapsedBasis::axis(order, 0, 0, &s);
    let second = CollapsedBasis::family(order, 1, &t);
    let third = CollapsedBasis::family(order, 2, &r);
    let points = r.iter().flat_map(|&r| {
        let s = &s;
        t.iter()
            .flat_map(move |&t| s.iter().map(move |&s| collapse(s, t, r)))
    });
    let modes = Table::new(
        Basis::Legendre,
        order,
        &Factor::Tetrahedron(points.collect()),
    );
    // `[points of the axes yet to sum, modes]`; the sum over the slowest remaining axis would stride, so s, the fastest, goes first.
    let sum = |input: &[f64], table: &Table, k: usize, rule: &[(f64, f64)]| -> Vec<f64> {
        input
            .chunks_exact(n * modes.modes)
            .flat_map(|block| {
                let mut total = vec![0.0; modes.modes];
                for (x, (line, point)) in block.chunks_exact(modes.modes).zip(rule).enumerate() {
                    let weight = point.1 * table.values[x * table.modes + k];
                    total
                        .iter_mut()
                        .zip(line)
                        .for_each(|(t, v)| *t += weight * v);
                }
                total
            })
            .collect()
    };
    let mut matrix = Vec::with_capacity(modes.modes * modes.modes);
    for i in 0..=order {
        let by_i = sum(&modes.values, &first, i, &rules[0]);
        for j in 0..=order - i {
            let by_j = sum(&by_i, &second[i], j, &rules[1]);
            for k in 0..=order - i - j {
                matrix.extend(sum(&by_j, &third[i + j], k, &rules[2]));
            }
        }
    }
    matrix
}
