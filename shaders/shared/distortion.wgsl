// Densities of distortion: what a density returns, which one is meant, and what several need.
//
// Twin: src/geometry/distortion/mod.rs. Each density is a file of its own, shared/distortion_*.wgsl; DISTORTION is its place in
// Distortion::ALL. Where det J is not positive the result is a number of no use.

struct Density {
    value: f32,
    // ∂ε/∂J
    gradient: mat3x3f,
}

fn density(j: mat3x3f, det: f32) -> Density {
    let safe = max(det, 1e-20);
    if DISTORTION == 0u {
        return strain(j, 0.0);
    }
    if DISTORTION == 1u {
        return strain(j, 1.0 / 3.0);
    }
    if DISTORTION == 2u {
        return symmetric_dirichlet(j, safe);
    }
    if DISTORTION == 3u {
        return condition_number(j, safe);
    }
    return mean_ratio(j, safe);
}

// ∂det J/∂J = det J · J⁻ᵀ
fn cofactors(j: mat3x3f) -> mat3x3f {
    return mat3x3f(cross(j[1], j[2]), cross(j[2], j[0]), cross(j[0], j[1]));
}

fn norm_squared(m: mat3x3f) -> f32 {
    return dot(m[0], m[0]) + dot(m[1], m[1]) + dot(m[2], m[2]);
}

// The natural logarithm of a positive normal number to rounding, also near 1, where WGSL's own may be off by 2⁻²¹:
// x = 2^e m with m in [√½, √2), ln m = 2 artanh f, f = (m − 1)/(m + 1).
fn logarithm(x: f32) -> f32 {
    let bits = bitcast<u32>(x);
    let e = bitcast<i32>(bits - 0x3f3504f3u) >> 23u;
    let m = bitcast<f32>(bits - (bitcast<u32>(e) << 23u));
    let f = (m - 1.0) / (m + 1.0);
    let s = f * f;
    let series = s * (1.0 / 3.0 + s * (0.2 + s * (1.0 / 7.0 + s * (1.0 / 9.0))));
    return f32(e) * 0.69314718 + 2.0 * (f + f * series);
}
