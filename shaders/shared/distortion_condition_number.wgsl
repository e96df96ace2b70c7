// The condition number ‖J‖ ‖J⁻¹‖/3 − 1. Twin: src/geometry/distortion/condition_number.rs.

fn condition_number(j: mat3x3f, det: f32) -> Density {
    let inverse = cofactors(j) * (1.0 / det);
    let norm = sqrt(norm_squared(j));
    let inverse_norm = sqrt(norm_squared(inverse));
    let ratio = inverse_norm / norm;
    let gradient = ratio * j - (1.0 / ratio) * (inverse * (transpose(inverse) * inverse));
    return Density(norm * inverse_norm / 3.0 - 1.0, (1.0 / 3.0) * gradient);
}
