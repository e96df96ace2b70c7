// The polynomial of degree 4 whose graph is nearest to points, for each of many groups of points.
//
// One thread serves one group. It takes its points one by one, each as a row of 15 monomials and a height, and turns them into an upper triangle by
// Givens rotations: nothing is stored but the triangle, and unlike the normal equations nothing is squared. Points are local: within 1 of the origin.
//
// Twin: src/kernel/jet.rs (Householder reflections). Source: F. Cazals and M. Pouget, Estimating differential quantities using polynomial fitting
// of osculating jets, CAGD 22 (2005), section 3; W. M. Gentleman, Least squares computations by Givens transformations, 1973.

const TERMS: u32 = 15u;
// Vectors in a row of 15 coefficients and a height.
const ROW: u32 = 4u;
const ANSWER: u32 = TERMS + 2u;
// Where the triangle starts, so that points which leave terms open, such as points of a line, give the smallest of these: above the rounding of a
// row of the triangle, 1e-6, and too small to be seen in the rest.
const DAMPING: f32 = 1e-5;

@group(0) @binding(0) var<uniform> params: JetParams;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;            // [groups + 1]
@group(0) @binding(2) var<storage, read> points: array<vec4f>;           // [points]: x, y, height; weight
// [groups, 17]: 15 coefficients; rms of what is left; the least pivot.
@group(0) @binding(3) var<storage, read_write> jets: array<f32>;

var<private> triangle: array<vec4f, TERMS * ROW>;
var<private> row: array<vec4f, ROW>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn jet(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let group = linear_index(id, groups);
    if group >= params.groups {
        return;
    }
    for (var k = 0u; k < TERMS; k++) {
        for (var j = 0u; j < ROW; j++) {
            triangle[k * ROW + j] = vec4f(0.0);
        }
        triangle[k * ROW + k / 4u][k % 4u] = DAMPING;
    }
    let begin = offsets[group];
    let end = offsets[group + 1u];
    var left = 0.0;
    for (var p = begin; p < end; p++) {
        set_row(points[p]);
        for (var k = 0u; k < TERMS; k++) {
            rotate(k);
        }
        left += row[3].w * row[3].w;
    }
    solve();
    let count = max(f32(end - begin), 1.0);
    var pivot = 1e30;
    for (var k = 0u; k < TERMS; k++) {
        jets[group * ANSWER + k] = row[k / 4u][k % 4u];
        pivot = min(pivot, abs(triangle[k * ROW + k / 4u][k % 4u]));
    }
    jets[group * ANSWER + TERMS] = sqrt(left / count);
    jets[group * ANSWER + TERMS + 1u] = pivot / sqrt(count);
}

// The monomials by degree, powers of x falling, and the height last; all times the weight.
fn set_row(p: vec4f) {
    let second = vec3f(p.x * p.x, p.x * p.y, p.y * p.y);
    row[0] = p.w * vec4f(1.0, p.x, p.y, second.x);
    row[1] = p.w * vec4f(second.yz, p.x * second.x, second.x * p.y);
    row[2] = p.w * vec4f(p.x * second.z, p.y * second.z, second.x * second.x, second.x * second.y);
    row[3] = p.w * vec4f(second.x * second.z, second.y * second.z, second.z * second.z, p.z);
}

// Turns row k of the triangle and the new row against each other until the new row has no term k.
fn rotate(k: u32) {
    let first = k / 4u;
    let a = triangle[k * ROW + first][k % 4u];
    let b = row[first][k % 4u];
    let length = sqrt(a * a + b * b);
    let cosine = a / length;
    let sine = b / length;
    for (var j = first; j < ROW; j++) {
        let upper = triangle[k * ROW + j];
        let lower = row[j];
        triangle[k * ROW + j] = cosine * upper + sine * lower;
        row[j] = cosine * lower - sine * upper;
    }
}

// The coefficients, from the last to the first, into the row.
fn solve() {
    row[3].w = 0.0;
    for (var i = 0u; i < TERMS; i++) {
        let k = TERMS - 1u - i;
        let first = k / 4u;
        var rest = triangle[k * ROW + 3u].w;
        row[first][k % 4u] = 0.0;
        for (var j = first; j < ROW; j++) {
            rest -= dot(triangle[k * ROW + j] * tail(k, j), row[j]);
        }
        row[first][k % 4u] = rest / triangle[k * ROW + first][k % 4u];
    }
}

// 1 for the terms of a vector of a row that come after term k, else 0: rotations leave rounding before it, and rows still hold other numbers there.
fn tail(k: u32, j: u32) -> vec4f {
    let terms = vec4u(4u * j) + vec4u(0u, 1u, 2u, 3u);
    return select(vec4f(0.0), vec4f(1.0), (terms > vec4u(k)) & (terms < vec4u(TERMS)));
}
