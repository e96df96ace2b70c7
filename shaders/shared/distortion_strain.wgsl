// The logarithmic strain ½ Σ l_i², l_i = ln s_i less `mean` times their sum: 0 for the strain itself, ⅓ for its deviatoric part.
//
// Twin: src/geometry/distortion/strain.rs. One-sided Jacobi on J, never on JᵀJ, whose small eigenvalues are lost in f32.

// Sweeps of three rotations: four reach the precision of f32.
const SWEEPS: u32 = 4u;
// Keeps 0/0 out of the rotation of columns that are orthogonal and of equal length.
const STRAIN_TINY: f32 = 1e-30;

fn strain(j: mat3x3f, mean: f32) -> Density {
    var w0 = j[0];
    var w1 = j[1];
    var w2 = j[2];
    var v0 = vec3f(1.0, 0.0, 0.0);
    var v1 = vec3f(0.0, 1.0, 0.0);
    var v2 = vec3f(0.0, 0.0, 1.0);
    for (var sweep = 0u; sweep < SWEEPS; sweep++) {
        var turn = rotation(w0, w1);
        var p = w0;
        w0 = turn.x * p - turn.y * w1;
        w1 = turn.y * p + turn.x * w1;
        p = v0;
        v0 = turn.x * p - turn.y * v1;
        v1 = turn.y * p + turn.x * v1;
        turn = rotation(w0, w2);
        p = w0;
        w0 = turn.x * p - turn.y * w2;
        w2 = turn.y * p + turn.x * w2;
        p = v0;
        v0 = turn.x * p - turn.y * v2;
        v2 = turn.y * p + turn.x * v2;
        turn = rotation(w1, w2);
        p = w1;
        w1 = turn.x * p - turn.y * w2;
        w2 = turn.y * p + turn.x * w2;
        p = v1;
        v1 = turn.x * p - turn.y * v2;
        v2 = turn.y * p + turn.x * v2;
    }
    let squares = max(vec3f(dot(w0, w0), dot(w1, w1), dot(w2, w2)), vec3f(STRAIN_TINY));
    var l = 0.5 * vec3f(logarithm(squares.x), logarithm(squares.y), logarithm(squares.z));
    l -= mean * (l.x + l.y + l.z);
    let factors = l / squares;
    // W diag(l_i/s_i²) Vᵀ
    let scaled = mat3x3f(factors.x * w0, factors.y * w1, factors.z * w2);
    return Density(0.5 * dot(l, l), scaled * transpose(mat3x3f(v0, v1, v2)));
}

// Cosine and sine of the rotation that makes two columns orthogonal.
fn rotation(p: vec3f, q: vec3f) -> vec2f {
    let c = dot(p, q);
    let half = 0.5 * (dot(q, q) - dot(p, p));
    let direction = vec2f(abs(half) + sqrt(half * half + c * c + STRAIN_TINY), select(c, -c, half < 0.0));
    let unit = direction * inverseSqrt(dot(direction, direction));
    // One step of Newton's method: the root may be off by two units, and twelve rotations add up.
    return unit * (1.5 - 0.5 * dot(unit, unit));
}
