// The inverse mean ratio ‖J‖²/(3 det^⅔ J) − 1. Twin: src/geometry/distortion/mean_ratio.rs.

fn mean_ratio(j: mat3x3f, det: f32) -> Density {
    let scale = exp(-2.0 / 3.0 * logarithm(det)) / 3.0;
    let norm = norm_squared(j);
    let gradient = j - (norm / (3.0 * det)) * cofactors(j);
    return Density(norm * scale - 1.0, (2.0 * scale) * gradient);
}
