// The symmetric Dirichlet energy (‖J‖² + ‖J⁻¹‖² − 6)/8. Twin: src/geometry/distortion/dirichlet.rs.

fn symmetric_dirichlet(j: mat3x3f, det: f32) -> Density {
    let inverse = cofactors(j) * (1.0 / det);
    let value = 0.125 * (norm_squared(j) + norm_squared(inverse) - 6.0);
    return Density(value, 0.25 * (j - inverse * (transpose(inverse) * inverse)));
}
