//! The condition number in the Frobenius norm, ‖J‖ ‖J⁻¹‖/3 − 1 \[FK99\].
//!
//! With ‖J⁻¹‖ = ‖C‖/det, C the cofactors, and k = ‖J⁻¹‖/‖J‖: gradient ⅓ (k J − J⁻ᵀJ⁻¹J⁻ᵀ/k) = ⅓ (k J − C CᵀC/(k det³)).

use super::{Arithmetic, Matrix, combine, cube, norm_squared};

#[inline(always)]
pub(super) fn evaluate<A: Arithmetic>(j: Matrix, c: Matrix, det: f64) -> (f64, Matrix) {
    let inverse = 1.0 / det;
    let norm = norm_squared::<A>(j).sqrt();
    let inverse_norm = norm_squared::<A>(c).sqrt() * inverse;
    let (third, ratio) = (1.0 / 3.0, inverse_norm / norm);
    let other = -third * inverse * inverse * inverse / ratio;
    (
        third * norm * inverse_norm - 1.0,
        combine::<A>(third * ratio, j, other, cube::<A>(c)),
    )
}
