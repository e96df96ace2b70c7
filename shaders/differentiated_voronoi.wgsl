// Restricted Voronoi, differentiated: the cells of fixed samples on a moving surface, down to gradients on its corners.
//
// One thread clips and integrates one slot, a pair (triangle, candidate sample). Slots of triangles with several candidates
// come first in `order`, so that neighbouring threads do alike work. Coordinates are local to the sample.
//
// Twin: src/kernel/differentiated_voronoi.rs, which has the derivation. Source: [NYL12], section 3.6 and appendix 2.

// Triangles whose largest angle has a smaller sine are given up as uncovered, and the host does them again in f64: the rounding
// of f32 turns their normals, and with them the derivative of their area, by 1e-7 / sine.
const MIN_SINE: f32 = 1e-2;

@group(0) @binding(0) var<uniform> params: DifferentiatedParams;
@group(0) @binding(1) var<storage, read> triangles: array<u32>;              // [triangles, 3], points
@group(0) @binding(2) var<storage, read> points: array<vec4f>;               // [points]
@group(0) @binding(3) var<storage, read> samples: array<vec4f>;              // [samples, 2]: position, unit normal
@group(0) @binding(4) var<storage, read> offsets: array<u32>;                // [triangles + 1], slots of each triangle
@group(0) @binding(5) var<storage, read> candidates: array<u32>;             // [slots], samples, ascending within a triangle
@group(0) @binding(6) var<storage, read> order: array<vec2u>;                // [slots]: slot, triangle
@group(0) @binding(7) var<storage, read_write> records: array<vec4f>;        // [slots, 3]: gradient on a corner; energy, fraction, 0
@group(0) @binding(8) var<storage, read_write> fractions: array<f32>;        // [slots], of the triangle's area

fn seed(slot: u32) -> vec3f {
    return samples[2u * candidates[slot]].xyz;
}

fn sample_normal(slot: u32) -> vec3f {
    return samples[2u * candidates[slot] + 1u].xyz;
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn differentiated_voronoi(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let thread = linear_index(id, groups);
    if thread >= params.slots {
        return;
    }
    let slot = order[thread].x;
    let triangle = order[thread].y;
    let p0 = points[triangles[3u * triangle]].xyz;
    let p1 = points[triangles[3u * triangle + 1u]].xyz;
    let p2 = points[triangles[3u * triangle + 2u]].xyz;
    let e1 = p1 - p0;
    let e2 = p2 - p0;
    let area_vector = accurate_cross(e1, e2, p2 - p1);
    let double_area = length(area_vector.xyz);
    let is_sliver = double_area <= MIN_SINE * area_vector.w;
    let first = offsets[triangle];
    var state = EMPTY;
    if !is_sliver {
        state = clip_cell(p0, e1, e2, slot, first, offsets[triangle + 1u]);
    }
    if state == EMPTY {
        records[3u * slot] = vec4f(0.0);
        records[3u * slot + 1u] = vec4f(0.0);
        records[3u * slot + 2u] = vec4f(0.0);
        fractions[slot] = 0.0;
        return;
    }
    let m = cell_moments(state);
    let normal = area_vector.xyz / double_area;

    // At the moments' origin: the offset w from the sample, and the heights over the sample's tangent plane.
    let w = (p0 - seed(slot)) + e1 * m.origin.x + e2 * m.origin.y;
    let n = sample_normal(slot);
    let h = vec3f(dot(n, w), dot(n, e1), dot(n, e2));
    // ∫ W (x − y) weighted by 1, u and v.
    let by_one = weighted(w, e1, e2, n, h, m.one, m.a, m.b);
    let by_u = m.origin.x * by_one + weighted(w, e1, e2, n, h, m.a, m.aa, m.ab);
    let by_v = m.origin.y * by_one + weighted(w, e1, e2, n, h, m.b, m.ab, m.bb);
    let scale = 2.0 * double_area;
    var gradient = array(scale * (by_one - by_u - by_v), scale * by_u, scale * by_v);

    let squared = quadratic(m, dot(w, w), dot(w, e1), dot(w, e2), dot(e1, e1), dot(e1, e2), dot(e2, e2));
    let along = quadratic(m, h.x * h.x, h.x * h.y, h.x * h.z, h.y * h.y, h.y * h.z, h.z * h.z);
    let mean = params.tangential * squared + params.excess * along;
    // This cell's share of the area's derivative, (F_t / A_t) ∂A_t/∂p.
    let scaled = normal * mean;
    gradient[0] += cross(scaled, e2 - e1);
    gradient[1] -= cross(scaled, e2);
    gradient[2] += cross(scaled, e1);
    if state == CUT && params.excess != 0.0 {
        for (var k = 0u; k < vertices; k++) {
            if polygon[k].z != SIDE {
                let b = polygon[select(k + 1u, 0u, k + 1u == vertices)];
                let part = bisector(slot, first, p0, e1, e2, normal, polygon[k], b.xy);
                gradient[0] += part[0];
                gradient[1] += part[1];
                gradient[2] += part[2];
            }
        }
    }
    records[3u * slot] = vec4f(gradient[0], 0.0);
    records[3u * slot + 1u] = vec4f(gradient[1], double_area * mean);
    records[3u * slot + 2u] = vec4f(gradient[2], 0.0);
    fractions[slot] = 2.0 * m.one;
}

// e1 × e2 for e3 = e2 − e1, from the two shorter of them, between which is the largest angle; and the product of their lengths.
fn accurate_cross(e1: vec3f, e2: vec3f, e3: vec3f) -> vec4f {
    let l1 = length(e1);
    let l2 = length(e2);
    let l3 = length(e3);
    if l3 >= max(l1, l2) {
        return vec4f(cross(e1, e2), l1 * l2);
    }
    if l2 >= l1 {
        return vec4f(cross(e1, e3), l1 * l3);
    }
    return vec4f(cross(e2, e3), l2 * l3);
}

// ∫ W (x − y) over the cell, per unit of twice the triangle's area, from moments of a weight: its own, and those with a and b.
fn weighted(w: vec3f, e1: vec3f, e2: vec3f, n: vec3f, h: vec3f, one: f32, a: f32, b: f32) -> vec3f {
    return params.tangential * (w * one + e1 * a + e2 * b)
        + n * (params.excess * (h.x * one + h.y * a + h.z * b));
}

// ∫ of the quadratic form with these coefficients of (1, a, b).
fn quadratic(m: Moments, q00: f32, q01: f32, q02: f32, q11: f32, q12: f32, q22: f32) -> f32 {
    return q00 * m.one + 2.0 * (q01 * m.a + q02 * m.b + q12 * m.ab) + q11 * m.aa + q22 * m.bb;
}

// Half of what the sliding of the bisector from a to b adds to the gradients on the corners.
fn bisector(
    slot: u32, first: u32, p0: vec3f, e1: vec3f, e2: vec3f, normal: vec3f, a: vec3f, b: vec2f,
) -> array<vec3f, 3> {
    let other = first + u32(a.z);
    let towards = seed(slot) - seed(other);
    let speed = length(towards - normal * dot(normal, towards));
    if speed == 0.0 {
        return array(vec3f(0.0), vec3f(0.0), vec3f(0.0));
    }
    let edge = e1 * (b.x - a.x) + e2 * (b.y - a.y);
    let middle = 0.5 * (a.xy + b);
    let integral = simpson_term(slot, other, p0, e1, e2, a.xy)
        + 4.0 * simpson_term(slot, other, p0, e1, e2, middle)
        + simpson_term(slot, other, p0, e1, e2, b);
    let t = towards * (0.5 * params.excess * length(edge) / (6.0 * speed));
    return array(t * integral.x, t * integral.y, t * integral.z);
}

// The jump of the integrand over a bisector at (u, v), per unit of excess, times the barycentric coordinates.
fn simpson_term(slot: u32, other: u32, p0: vec3f, e1: vec3f, e2: vec3f, at: vec2f) -> vec3f {
    let along = e1 * at.x + e2 * at.y;
    let own_height = dot(sample_normal(slot), (p0 - seed(slot)) + along);
    let other_height = dot(sample_normal(other), (p0 - seed(other)) + along);
    let jump = own_height * own_height - other_height * other_height;
    return jump * vec3f(1.0 - at.x - at.y, at.x, at.y);
}
