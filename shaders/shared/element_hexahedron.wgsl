// Hexahedra: products of LINE_MODES functions of x, y and z, at LINE_POINTS points an axis. A slab has one z.
//
// Tables: values [LINE_POINTS, LINE_MODES], then derivatives. One coordinate at a time, so that all orders fit: the z stage lies where the
// derivatives of the third coordinate will be, the x stage behind them all.

const HEX_TABLE: u32 = LINE_POINTS * LINE_MODES;
const HEX_PLANE: u32 = LINE_MODES * LINE_MODES;

fn forward(slab: u32) {
    let z = base + 6u * SLAB_POINTS;
    let x = base + BEHIND;
    for (var c = 0u; c < 3u; c++) {
        // Value and slope along z, [y, x] each.
        let start = first_mode + c * MODES;
        for (var k = lane; k < HEX_PLANE; k += THREADS) {
            var sums = vec2f(0.0);
            for (var m = 0u; m < LINE_MODES; m++) {
                let t = slab * LINE_MODES + m;
                sums += coefficients[start + m * HEX_PLANE + k] * vec2f(tables[t], tables[HEX_TABLE + t]);
            }
            pool[z + k] = sums.x;
            pool[z + HEX_PLANE + k] = sums.y;
        }
        workgroupBarrier();
        // Along x: slope of the value, value of the value, value of the slope, [y, point] each.
        for (var k = lane; k < HEX_TABLE; k += THREADS) {
            let row = z + k / LINE_POINTS * LINE_MODES;
            var sums = vec3f(0.0);
            for (var m = 0u; m < LINE_MODES; m++) {
                let t = k % LINE_POINTS * LINE_MODES + m;
                let value = pool[row + m];
                sums += vec3f(tables[HEX_TABLE + t] * value, tables[t] * vec2f(value, pool[row + HEX_PLANE + m]));
            }
            pool[x + k] = sums.x;
            pool[x + HEX_TABLE + k] = sums.y;
            pool[x + 2u * HEX_TABLE + k] = sums.z;
        }
        workgroupBarrier();
        for (var point = lane; point < SLAB_POINTS; point += THREADS) {
            var sums = vec3f(0.0);
            for (var m = 0u; m < LINE_MODES; m++) {
                let t = point / LINE_POINTS * LINE_MODES + m;
                let at = x + m * LINE_POINTS + point % LINE_POINTS;
                let value = tables[t];
                let slope = tables[HEX_TABLE + t];
                sums += vec3f(value, slope, value) * vec3f(pool[at], pool[at + HEX_TABLE], pool[at + 2u * HEX_TABLE]);
            }
            let to = base + 3u * c * SLAB_POINTS + point;
            pool[to] = sums.x;
            pool[to + SLAB_POINTS] = sums.y;
            pool[to + 2u * SLAB_POINTS] = sums.z;
        }
    }
}

fn back(slab: u32) {
    let x = base + BEHIND;
    for (var c = 0u; c < 3u; c++) {
        for (var k = lane; k < HEX_TABLE; k += THREADS) {
            let start = base + 3u * c * SLAB_POINTS + k % LINE_POINTS;
            var sums = vec3f(0.0);
            for (var q = 0u; q < LINE_POINTS; q++) {
                let t = q * LINE_MODES + k / LINE_POINTS;
                let at = start + q * LINE_POINTS;
                let value = tables[t];
                sums += vec3f(value, tables[HEX_TABLE + t], value)
                    * vec3f(pool[at], pool[at + SLAB_POINTS], pool[at + 2u * SLAB_POINTS]);
            }
            pool[x + k] = sums.x;
            pool[x + HEX_TABLE + k] = sums.y;
            pool[x + 2u * HEX_TABLE + k] = sums.z;
        }
        workgroupBarrier();
        for (var k = lane; k < HEX_PLANE; k += THREADS) {
            let row = x + k / LINE_MODES * LINE_POINTS;
            var sums = vec2f(0.0);
            for (var q = 0u; q < LINE_POINTS; q++) {
                let t = q * LINE_MODES + k % LINE_MODES;
                let value = tables[t];
                let slope = tables[HEX_TABLE + t];
                let at = row + q;
                sums += vec2f(slope * pool[at] + value * pool[at + HEX_TABLE], value * pool[at + 2u * HEX_TABLE]);
            }
            for (var m = 0u; m < LINE_MODES; m++) {
                let t = slab * LINE_MODES + m;
                add(c, m * HEX_PLANE + k, dot(sums, vec2f(tables[t], tables[HEX_TABLE + t])));
            }
        }
        workgroupBarrier();
    }
}
