//! The symmetric Dirichlet energy, (‖J‖² + ‖J⁻¹‖² − 6)/8.
//!
//! With J⁻ᵀ = C/det, C the cofactors: gradient ¼ (J − J⁻ᵀJ⁻¹J⁻ᵀ) = ¼ (J − C CᵀC/det³).

use super::{Arithmetic, Matrix, combine, cube, norm_squared};

#[inline(always)]
pub(super) fn evaluate<A: Arithmetic>(j: Matrix, c: Matrix, det: f64) -> (f64, Matrix) {
    let inverse = 1.0 / det;
    let square = inverse * inverse;
    let value = norm_squared::<A>(j) + norm_squared::<A>(c) * square - 6.0;
    let gradient = combine::<A>(0.25, j, -0.25 * inverse * square, cube::<A>(c));
    (0.125 * value, gradient)
}
