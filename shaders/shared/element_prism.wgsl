// Prisms: TRIANGLE_MODES functions of (u, v) times LINE_MODES functions of w. A slab has one w and all points of the triangle.
//
// Tables: functions of the triangle, their derivatives by u and by v, [3, TRIANGLE_MODES, SLAB_POINTS]; the same as
// [3, SLAB_POINTS, TRIANGLE_MODES]; values on the line [LINE_POINTS, LINE_MODES], then derivatives.

const PRISM_TABLE: u32 = TRIANGLE_MODES * SLAB_POINTS;
const PRISM_LINE: u32 = 6u * PRISM_TABLE;

fn forward(slab: u32) {
    // Value and slope along w of each coordinate, [2, 3, TRIANGLE_MODES].
    let w = base + 9u * SLAB_POINTS;
    for (var k = lane; k < 3u * TRIANGLE_MODES; k += THREADS) {
        let start = first_mode + k / TRIANGLE_MODES * MODES + k % TRIANGLE_MODES;
        var sums = vec2f(0.0);
        for (var m = 0u; m < LINE_MODES; m++) {
            sums += coefficients[start + m * TRIANGLE_MODES] * line_entry(slab, m);
        }
        pool[w + k] = sums.x;
        pool[w + 3u * TRIANGLE_MODES + k] = sums.y;
    }
    workgroupBarrier();
    for (var point = lane; point < SLAB_POINTS; point += THREADS) {
        var sums = mat3x3f();
        for (var m = 0u; m < TRIANGLE_MODES; m++) {
            let t = m * SLAB_POINTS + point;
            let at = w + m;
            let value = vec3f(pool[at], pool[at + TRIANGLE_MODES], pool[at + 2u * TRIANGLE_MODES]);
            let slope = vec3f(
                pool[at + 3u * TRIANGLE_MODES],
                pool[at + 4u * TRIANGLE_MODES],
                pool[at + 5u * TRIANGLE_MODES],
            );
            sums[0] += tables[PRISM_TABLE + t] * value;
            sums[1] += tables[2u * PRISM_TABLE + t] * value;
            sums[2] += tables[t] * slope;
        }
        store(base + point, sums);
    }
}

fn back(slab: u32) {
    for (var m = lane; m < TRIANGLE_MODES; m += THREADS) {
        var value = vec3f(0.0);
        var slope = vec3f(0.0);
        for (var point = 0u; point < SLAB_POINTS; point++) {
            let t = 3u * PRISM_TABLE + point * TRIANGLE_MODES + m;
            let d = load(base + point);
            value += tables[PRISM_TABLE + t] * d[0] + tables[2u * PRISM_TABLE + t] * d[1];
            slope += tables[t] * d[2];
        }
        for (var k = 0u; k < LINE_MODES; k++) {
            let along = line_entry(slab, k);
            let sum = along.x * value + along.y * slope;
            for (var c = 0u; c < 3u; c++) {
                add(c, k * TRIANGLE_MODES + m, sum[c]);
            }
        }
    }
}

// Value and derivative of a function of w at the point of a slab.
fn line_entry(slab: u32, mode: u32) -> vec2f {
    let t = PRISM_LINE + slab * LINE_MODES + mode;
    return vec2f(tables[t], tables[t + LINE_POINTS * LINE_MODES]);
}
