// Restricted Voronoi: the cells of moving seeds on a fixed surface, integrated.
//
// One thread clips and integrates one slot, a pair (triangle, candidate seed). Slots of triangles with several candidates come
// first in `order`, so that neighbouring threads do alike work. Coordinates are local to the seed.
//
// Twin: src/kernel/restricted_voronoi.rs, which has the derivation. Source: [NYL12], section 3.6, with the motion of the
// bisectors.

@group(0) @binding(0) var<uniform> params: RestrictedParams;
@group(0) @binding(1) var<storage, read> facets: array<GpuFacet>;               // [triangles]
@group(0) @binding(2) var<storage, read> seeds: array<vec4f>;                // [seeds]
@group(0) @binding(3) var<storage, read> offsets: array<u32>;                // [triangles + 1], slots of each triangle
@group(0) @binding(4) var<storage, read> candidates: array<u32>;             // [slots], seeds, ascending within a triangle
@group(0) @binding(5) var<storage, read> order: array<vec2u>;                // [slots]: slot, triangle
@group(0) @binding(6) var<storage, read_write> records: array<vec4f>;        // [slots, 2]: moment, area; gradient, energy
@group(0) @binding(7) var<storage, read_write> fractions: array<f32>;        // [slots], of the triangle's area

fn seed(slot: u32) -> vec3f {
    return seeds[candidates[slot]].xyz;
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn restricted_voronoi(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let thread = linear_index(id, groups);
    if thread >= params.slots {
        return;
    }
    let slot = order[thread].x;
    let triangle = order[thread].y;
    let facet = facets[triangle];
    let first = offsets[triangle];
    let state = clip_cell(facet.origin, facet.e1, facet.e2, slot, first, offsets[triangle + 1u]);
    if state == EMPTY {
        records[2u * slot] = vec4f(0.0);
        records[2u * slot + 1u] = vec4f(0.0);
        fractions[slot] = 0.0;
        return;
    }
    let m = cell_moments(state);
    let x = seed(slot);
    let d = facet.origin - x;
    let height = dot(facet.normal, d);
    let w = d + facet.e1 * m.origin.x + facet.e2 * m.origin.y;
    let area = facet.double_area * m.one;
    let moment = facet.double_area * (w * m.one + facet.e1 * m.a + facet.e2 * m.b);
    var gradient = -2.0 * (params.tangential * moment + params.excess * height * area * facet.normal);
    if state == CUT && params.excess != 0.0 {
        gradient += bisectors(facet, x, height, first);
    }
    let squared = dot(w, w) * m.one
        + 2.0 * (dot(w, facet.e1) * m.a + dot(w, facet.e2) * m.b + dot(facet.e1, facet.e2) * m.ab)
        + dot(facet.e1, facet.e1) * m.aa
        + dot(facet.e2, facet.e2) * m.bb;
    let energy = params.tangential * facet.double_area * squared + params.excess * height * height * area;
    records[2u * slot] = vec4f(moment, area);
    records[2u * slot + 1u] = vec4f(gradient, energy);
    fractions[slot] = 2.0 * m.one;
}

// What the motion of the cell's bisectors adds to the gradient of its seed x.
fn bisectors(facet: GpuFacet, x: vec3f, height: f32, first: u32) -> vec3f {
    var total = vec3f(0.0);
    for (var k = 0u; k < vertices; k++) {
        let a = polygon[k];
        if a.z == SIDE {
            continue;
        }
        let b = polygon[select(k + 1u, 0u, k + 1u == vertices)];
        let apart = seed(first + u32(a.z)) - x;
        let across = dot(facet.normal, apart);
        let speed = length(apart - facet.normal * across);
        if speed == 0.0 {
            continue;
        }
        let edge = facet.e1 * (b.x - a.x) + facet.e2 * (b.y - a.y);
        let middle = (facet.origin - x) + 0.5 * (facet.e1 * (a.x + b.x) + facet.e2 * (a.y + b.y));
        // e_i − e_j, with the other seed's height = height − across.
        let jump = params.excess * across * (2.0 * height - across);
        total += middle * (jump * length(edge) / speed);
    }
    return total;
}
