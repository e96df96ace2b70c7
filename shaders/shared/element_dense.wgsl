// Elements whose modes do not factor. A slab has a point for each thread.
//
// Tables: [slabs, MODES, 3 derivatives, SLAB_POINTS], filled up with zeros.

fn forward(slab: u32) {
    var sums = mat3x3f();
    for (var m = 0u; m < MODES; m++) {
        let start = first_mode + m;
        let c = vec3f(coefficients[start], coefficients[start + MODES], coefficients[start + 2u * MODES]);
        let t = (slab * MODES + m) * 3u * SLAB_POINTS + lane;
        sums[0] += tables[t] * c;
        sums[1] += tables[t + SLAB_POINTS] * c;
        sums[2] += tables[t + 2u * SLAB_POINTS] * c;
    }
    store(base + lane, sums);
}

fn back(slab: u32) {
    for (var m = lane; m < MODES; m += THREADS) {
        var sum = vec3f(0.0);
        for (var point = 0u; point < SLAB_POINTS; point++) {
            let t = (slab * MODES + m) * 3u * SLAB_POINTS + point;
            let d = load(base + point);
            sum += tables[t] * d[0] + tables[t + SLAB_POINTS] * d[1] + tables[t + 2u * SLAB_POINTS] * d[2];
        }
        for (var c = 0u; c < 3u; c++) {
            add(c, m, sum[c]);
        }
    }
}
