// Candidate seeds: which seeds of a leaf's list may be nearest somewhere on a triangle.
//
// One thread prunes the list of one triangle: by the seed that is nearest on the whole, then by each survivor. The difference of
// the squared distances to two seeds is affine, so the three corners decide. The answer is one bit a seed. Coordinates are of
// order 1 about the middle of the surface.
//
// Twin: src/kernel/candidates.rs, which has the derivation of the margins.

// Iterations of the pairwise pruning at most: see MAX_ITERATIONS in src/device. What is not looked at is kept, which does no harm.
const BUDGET: u32 = 20000u;

// Bound on the rounding of squared distances, as in the twin.
const ROUNDING: f32 = 16.0 * 6e-8;

@group(0) @binding(0) var<uniform> params: CandidateParams;
@group(0) @binding(1) var<storage, read> corners: array<vec4f>;              // [triangles, 3]
@group(0) @binding(2) var<storage, read> seeds: array<vec4f>;                // [seeds]
@group(0) @binding(3) var<storage, read> lists: array<vec4u>;                // [triangles]: begin and end in items, first word of bits
@group(0) @binding(4) var<storage, read> items: array<u32>;                  // seeds, leaf after leaf
@group(0) @binding(5) var<storage, read_write> kept: array<u32>;             // bits

@compute @workgroup_size(WORKGROUP_SIZE)
fn candidates(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let triangle = linear_index(id, groups);
    if triangle >= params.triangles {
        return;
    }
    let list = lists[triangle];
    let count = list.y - list.x;
    var nearest = vec3f(1e30);
    var best = 3e30;
    for (var k = 0u; k < count; k++) {
        let squared = distances(triangle, list.x + k);
        let sum = squared.x + squared.y + squared.z;
        if sum < best {
            best = sum;
            nearest = squared;
        }
    }
    let bound = beaten_from(nearest);
    for (var base = 0u; base < count; base += 32u) {
        var bits = 0u;
        for (var k = base; k < min(base + 32u, count); k++) {
            let squared = distances(triangle, list.x + k);
            if !all(squared > bound) {
                bits |= 1u << (k - base);
            }
        }
        kept[list.z + base / 32u] = bits;
    }
    prune_pairwise(triangle, list);
}

// Drops the survivors that another one beats at all corners. Nothing beats itself, and what is beaten by a seed that was dropped
// is also beaten by what dropped that.
fn prune_pairwise(triangle: u32, list: vec4u) {
    let words = (list.y - list.x + 31u) / 32u;
    var budget = BUDGET;
    for (var w = 0u; w < words; w++) {
        for (var open = kept[list.z + w]; open != 0u; open &= open - 1u) {
            let k = 32u * w + firstTrailingBit(open);
            // It may have been dropped meanwhile; it is then no worse for dropping others.
            let bound = beaten_from(distances(triangle, list.x + k));
            for (var v = 0u; v < words && budget > 0u; v++) {
                var bits = kept[list.z + v];
                for (var rest = bits; rest != 0u && budget > 0u; rest &= rest - 1u) {
                    budget--;
                    let j = firstTrailingBit(rest);
                    if all(distances(triangle, list.x + 32u * v + j) > bound) {
                        bits &= ~(1u << j);
                    }
                }
                kept[list.z + v] = bits;
                budget -= min(budget, 1u);
            }
        }
    }
}

// The squared distances of an item to the corners.
fn distances(triangle: u32, item: u32) -> vec3f {
    let x = seeds[items[item]].xyz;
    let a = corners[3u * triangle].xyz - x;
    let b = corners[3u * triangle + 1u].xyz - x;
    let c = corners[3u * triangle + 2u].xyz - x;
    return vec3f(dot(a, a), dot(b, b), dot(c, c));
}

// The squared distances beyond which a seed is nowhere on the triangle nearer than one at these, now and after motions within the
// slack.
fn beaten_from(squared: vec3f) -> vec3f {
    let distance = sqrt(squared);
    let reach = distance + 2.0 * params.slack;
    return squared + 4.0 * params.slack * (distance + params.slack) + ROUNDING * (reach + reach * reach);
}
