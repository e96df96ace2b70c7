//! The logarithmic strain, ½ ‖½ ln JᵀJ‖² = ½ Σ l_i², l_i = ln s_i of the singular values \[PPL13, section 3.1 and appendix A\].
//!
//! J = U Σ Vᵀ by one-sided Jacobi: the columns of W = J V are made orthogonal by rotations, so that W = U Σ. Not by eigenvalues of JᵀJ,
//! whose small ones lose twice the digits. The gradient U Σ⁻¹ ln Σ Vᵀ (= J⁻ᵀH) is W diag(l_i/s_i²) Vᵀ.
//!
//! The deviatoric part takes the mean from the l_i; value and gradient are otherwise the same, as the deviator is a projection.

use super::{Arithmetic, Block, Matrix, dot, matrix, set_matrix};
use crate::geometry::vector::{Separate, ln};
use glam::{DMat3, DVec3};

/// Convergence is quadratic; strained elements take three or four sweeps, and any matrix fewer than this.
const MAX_SWEEPS: usize = 12;
/// Columns at a cosine of 1e-11 are orthogonal to the last bit after one more rotation.
const ORTHOGONAL: f64 = 1e-22;
/// Keeps 0/0 out of the rotation of two columns that are orthogonal and of equal length, or zero.
const TINY: f64 = 1e-300;

/// What of the logarithm counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// All of it.
    Whole,
    /// Without its mean.
    Deviatoric,
}

#[inline(always)]
pub(super) fn evaluate<A: Arithmetic, const N: usize>(block: &mut Block<N>, part: Part) {
    let (w, v) = orthogonalize::<A, N>(&block.jacobian);
    let mean = match part {
        Part::Whole => 0.0,
        Part::Deviatoric => 1.0 / 3.0,
    };
    for k in 0..N {
        let (w, v) = (matrix(&w, k), matrix(&v, k));
        let (mut squares, mut l) = ([0.0; 3], [0.0; 3]);
        for i in 0..3 {
            // Where det J is not positive the result is of no use, but it must be a number.
            squares[i] = dot::<A>(w[i], w[i]).max(f64::MIN_POSITIVE);
            l[i] = 0.5 * ln::<A>(squares[i]);
        }
        let subtracted = mean * (l[0] + l[1] + l[2]);
        let mut gradient = [[0.0; 3]; 3];
        for i in 0..3 {
            l[i] -= subtracted;
            let factor = l[i] / squares[i];
            for c in 0..3 {
                let x = factor * v[i][c];
                for r in 0..3 {
                    gradient[c][r] = A::mul_add(x, w[i][r], gradient[c][r]);
                }
            }
        }
        block.value[k] = 0.5 * dot::<A>(l, l);
        set_matrix(&mut block.gradient, k, gradient);
    }
}

/// W and V with W = J V, V a rotation and the columns of W orthogonal.
#[inline(always)]
fn orthogonalize<A: Arithmetic, const N: usize>(
    jacobian: &[[f64; N]; 9],
) -> ([[f64; N]; 9], [[f64; N]; 9]) {
    let mut w = *jacobian;
    let mut v = [[0.0; N]; 9];
    for diagonal in [0, 4, 8] {
        v[diagonal] = [1.0; N];
    }
    // Positive where a matrix is not done. One that is stays as it is, so that it does not depend on the others of its block.
    let mut open = [1.0; N];
    for _ in 0..MAX_SWEEPS {
        let mut left = [0.0; N];
        rotate::<A, N, 0, 1>(&mut w, &mut v, &open, &mut left);
        rotate::<A, N, 0, 2>(&mut w, &mut v, &open, &mut left);
        rotate::<A, N, 1, 2>(&mut w, &mut v, &open, &mut left);
        open = left;
        if open.iter().all(|&o| o <= 0.0) {
            break;
        }
    }
    (w, v)
}

/// Rotates columns P and Q of every open matrix to orthogonality; `left` becomes positive where they were not nearly orthogonal before.
///
/// A loop for each pair, not one for all three: a rotation is a long chain of roots and quotients, and the processor overlaps what
/// is short.
#[inline(always)]
fn rotate<A: Arithmetic, const N: usize, const P: usize, const Q: usize>(
    w: &mut [[f64; N]; 9],
    v: &mut [[f64; N]; 9],
    open: &[f64; N],
    left: &mut [f64; N],
) {
    for k in 0..N {
        let (mut wk, mut vk) = (matrix(w, k), matrix(v, k));
        let (a, b) = (dot::<A>(wk[P], wk[P]), dot::<A>(wk[Q], wk[Q]));
        let c = dot::<A>(wk[P], wk[Q]);
        // tan = sgn(z)/(|z| + √(1 + z²)), z = (b − a)/2c, as the direction (x, y) that needs no division by c.
        let half = 0.5 * (b - a);
        let radius = A::mul_add(half, half, A::mul_add(c, c, TINY)).sqrt();
        let (x, y) = (half.abs() + radius, if half < 0.0 { -c } else { c });
        let scale = 1.0 / A::mul_add(x, x, y * y).sqrt();
        let is_open = open[k] > 0.0;
        let cosine = if is_open { x * scale } else { 1.0 };
        let sine = if is_open { y * scale } else { 0.0 };
        turn::<A, P, Q>(&mut wk, cosine, sine);
        turn::<A, P, Q>(&mut vk, cosine, sine);
        set_matrix(w, k, wk);
        set_matrix(v, k, vk);
        let rest = A::mul_add(c, c, -(ORTHOGONAL * a * b));
        let rest = if is_open { rest } else { 0.0 };
        left[k] = if rest > left[k] { rest } else { left[k] };
    }
}

#[inline(always)]
fn turn<A: Arithmetic, const P: usize, const Q: usize>(m: &mut Matrix, cosine: f64, sine: f64) {
    let (p, q) = (m[P], m[Q]);
    for r in 0..3 {
        m[P][r] = A::mul_add(cosine, p[r], -(sine * q[r]));
        m[Q][r] = A::mul_add(sine, p[r], cosine * q[r]);
    }
}

/// A principal direction of the Hessian of the strain: moving J along `direction`, of norm 1, bends the energy by `curvature`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curvature {
    /// The eigenvalue; negative ones are given as 0, so that the sum of `curvature · direction directionᵀ` is positive semidefinite.
    pub curvature: f64,
    /// The eigenmatrix.
    pub direction: DMat3,
}

/// The eigenpairs of ∂²ε/∂J² of the strain, for preconditioners; det J must be positive.
///
/// u_i v_iᵀ: (1 − l_i)/s_i². (u_i v_jᵀ ∓ u_j v_iᵀ)/√2: (ψ_i ± ψ_j)/(s_i ± s_j), ψ = l/s.
pub fn curvatures(jacobian: DMat3) -> [Curvature; 9] {
    let entries = jacobian.to_cols_array().map(|x| [x]);
    let (w, v) = orthogonalize::<Separate, 1>(&entries);
    let (w, v) = (matrix(&w, 0), matrix(&v, 0));
    let v = v.map(DVec3::from_array);
    let s = w.map(|w| DVec3::from_array(w).length().max(f64::MIN_POSITIVE.sqrt()));
    let u: [DVec3; 3] = std::array::from_fn(|i| DVec3::from_array(w[i]) / s[i]);
    let l = s.map(f64::ln);
    let psi: [f64; 3] = std::array::from_fn(|i| l[i] / s[i]);
    let outer = |i: usize, j: usize| DMat3::from_cols(u[i] * v[j].x, u[i] * v[j].y, u[i] * v[j].z);
    let stretch = |i: usize| (1.0 - l[i]) / (s[i] * s[i]);
    let pair = |curvature: f64, direction: DMat3| Curvature {
        curvature: curvature.max(0.0),
        direction,
    };
    let root = std::f64::consts::FRAC_1_SQRT_2;
    let [a, b, c] = [(0, 1), (0, 2), (1, 2)].map(|(i, j)| {
        let (ij, ji) = (outer(i, j), outer(j, i));
        let difference = s[i] - s[j];
        let quotient = if difference.abs() < 1e-7 * (s[i] + s[j]) {
            0.5 * (stretch(i) + stretch(j))
        } else {
            (psi[i] - psi[j]) / difference
        };
        [
            pair((psi[i] + psi[j]) / (s[i] + s[j]), root * (ij - ji)),
            pair(quotient, root * (ij + ji)),
        ]
    });
    let [x, y, z] = [0, 1, 2].map(|i| pair(stretch(i), outer(i, i)));
    [x, y, z, a[0], a[1], b[0], b[1], c[0], c[1]]
}
