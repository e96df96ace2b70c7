//! The inverse mean ratio, ‖J‖²/(3 det^⅔ J) − 1 \[TRBS98\].
//!
//! Gradient 2/(3 det^⅔) (J − ⅓ ‖J‖² J⁻ᵀ), J⁻ᵀ = C/det with the cofactors C.

use super::{Arithmetic, Matrix, combine, norm_squared};

#[inline(always)]
pub(super) fn evaluate<A: Arithmetic>(j: Matrix, c: Matrix, det: f64) -> (f64, Matrix) {
    let root = det.cbrt();
    let scale = 1.0 / (3.0 * root * root);
    let norm = norm_squared::<A>(j);
    let other = -2.0 * scale * norm / (3.0 * det);
    (norm * scale - 1.0, combine::<A>(2.0 * scale, j, other, c))
}
