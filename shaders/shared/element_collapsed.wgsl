// Tetrahedra in a basis that factors over collapsed coordinates, ψ_ijk = A_i(s) B_ij(t) C_(i+j)k(r), i + j + k < COUNT; "modes" are its
// coefficients. A slab has one r; its points are [POINTS_S, POINTS_T].
//
// Tables: A [POINTS_S, COUNT] and A'; B [COUNT, POINTS_T, COUNT] and B'; C [COUNT, POINTS_R, COUNT] and C', where rows are filled up with zeros;
// the points s, t and r. As on hexahedra, one coordinate at a time.

const A_TABLE: u32 = POINTS_S * COUNT;
const B_TABLE: u32 = COUNT * POINTS_T * COUNT;
const C_TABLE: u32 = COUNT * POINTS_R * COUNT;
const FIRST_B: u32 = 2u * A_TABLE;
const FIRST_C: u32 = FIRST_B + 2u * B_TABLE;
const FIRST_AXIS: u32 = FIRST_C + 2u * C_TABLE;
const ROWS: u32 = COUNT * POINTS_T;
const PAIRS: u32 = COUNT * COUNT;

fn forward(slab: u32) {
    let r = base + 6u * SLAB_POINTS;
    let t = base + BEHIND;
    for (var c = 0u; c < 3u; c++) {
        let start = first_mode + c * MODES;
        // Value and slope along r, [i, j] each.
        for (var k = lane; k < PAIRS; k += THREADS) {
            let i = k / COUNT;
            let j = k % COUNT;
            if i + j < COUNT {
                let mode = start + first_of_pair(i, j);
                let at = FIRST_C + ((i + j) * POINTS_R + slab) * COUNT;
                var sums = vec2f(0.0);
                for (var m = 0u; m < COUNT - i - j; m++) {
                    sums += coefficients[mode + m] * vec2f(tables[at + m], tables[at + C_TABLE + m]);
                }
                pool[r + k] = sums.x;
                pool[r + PAIRS + k] = sums.y;
            }
        }
        workgroupBarrier();
        // Along t: value of the value, slope of the value, value of the slope, [i, point] each.
        for (var k = lane; k < ROWS; k += THREADS) {
            let i = k / POINTS_T;
            let at = FIRST_B + k * COUNT;
            var sums = vec3f(0.0);
            for (var m = 0u; m < COUNT - i; m++) {
                let value = pool[r + i * COUNT + m];
                sums += vec3f(tables[at + m] * value, tables[at + B_TABLE + m] * value, tables[at + m] * pool[r + PAIRS + i * COUNT + m]);
            }
            pool[t + k] = sums.x;
            pool[t + ROWS + k] = sums.y;
            pool[t + 2u * ROWS + k] = sums.z;
        }
        workgroupBarrier();
        for (var point = lane; point < SLAB_POINTS; point += THREADS) {
            var sums = vec3f(0.0);
            for (var m = 0u; m < COUNT; m++) {
                let a = point / POINTS_T * COUNT + m;
                let at = t + m * POINTS_T + point % POINTS_T;
                sums += vec3f(tables[A_TABLE + a], tables[a], tables[a]) * vec3f(pool[at], pool[at + ROWS], pool[at + 2u * ROWS]);
            }
            let metric = metric_at(slab, point);
            let to = base + 3u * c * SLAB_POINTS + point;
            pool[to] = metric.x * sums.x;
            pool[to + SLAB_POINTS] = metric.y * sums.x + metric.z * sums.y;
            pool[to + 2u * SLAB_POINTS] = metric.y * sums.x + metric.w * sums.y + sums.z;
        }
    }
}

fn back(slab: u32) {
    let t = base + BEHIND;
    for (var c = 0u; c < 3u; c++) {
        for (var point = lane; point < SLAB_POINTS; point += THREADS) {
            let at = base + 3u * c * SLAB_POINTS + point;
            let d = vec3f(pool[at], pool[at + SLAB_POINTS], pool[at + 2u * SLAB_POINTS]);
            let metric = metric_at(slab, point);
            pool[at] = metric.x * d.x + metric.y * (d.y + d.z);
            pool[at + SLAB_POINTS] = metric.z * d.y + metric.w * d.z;
        }
        workgroupBarrier();
        for (var k = lane; k < ROWS; k += THREADS) {
            let start = base + 3u * c * SLAB_POINTS + k % POINTS_T;
            var sums = vec3f(0.0);
            for (var q = 0u; q < POINTS_S; q++) {
                let a = q * COUNT + k / POINTS_T;
                let at = start + q * POINTS_T;
                sums += vec3f(tables[A_TABLE + a], tables[a], tables[a])
                    * vec3f(pool[at], pool[at + SLAB_POINTS], pool[at + 2u * SLAB_POINTS]);
            }
            pool[t + k] = sums.x;
            pool[t + ROWS + k] = sums.y;
            pool[t + 2u * ROWS + k] = sums.z;
        }
        workgroupBarrier();
        for (var k = lane; k < PAIRS; k += THREADS) {
            let i = k / COUNT;
            let j = k % COUNT;
            if i + j < COUNT {
                var sums = vec2f(0.0);
                for (var q = 0u; q < POINTS_T; q++) {
                    let b = FIRST_B + (i * POINTS_T + q) * COUNT + j;
                    let at = t + i * POINTS_T + q;
                    sums += vec2f(tables[b] * pool[at] + tables[b + B_TABLE] * pool[at + ROWS], tables[b] * pool[at + 2u * ROWS]);
                }
                let mode = first_of_pair(i, j);
                let at = FIRST_C + ((i + j) * POINTS_R + slab) * COUNT;
                for (var m = 0u; m < COUNT - i - j; m++) {
                    add(c, mode + m, dot(sums, vec2f(tables[at + m], tables[at + C_TABLE + m])));
                }
            }
        }
        workgroupBarrier();
    }
}

// The first ψ_ijk of a pair: those of smaller i, then those of smaller j, come before.
fn first_of_pair(i: u32, j: u32) -> u32 {
    let rest = COUNT - i;
    return MODES - rest * (rest + 1u) * (rest + 2u) / 6u + j * rest - j * (max(j, 1u) - 1u) / 2u;
}

// a, s a, b and t b of src/kernel/element_energy/pass.rs.
fn metric_at(slab: u32, point: u32) -> vec4f {
    let s = tables[FIRST_AXIS + point / POINTS_T];
    let t = tables[FIRST_AXIS + POINTS_S + point % POINTS_T];
    let b = 1.0 / (1.0 - tables[FIRST_AXIS + POINTS_S + POINTS_T + slab]);
    let a = b / (1.0 - t);
    return vec4f(a, s * a, b, t * b);
}
