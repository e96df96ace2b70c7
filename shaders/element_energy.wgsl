// The distortion of curved elements: energy, smallest det J and gradient on the coefficients of each.
//
// THREADS threads serve one element, ELEMENTS elements share a workgroup. An element goes slab by slab: from its coefficients to the
// derivatives by u, v, w at the points of a slab, which lie in workgroup memory; the density at each point; and back. How that goes forward
// and back depends on the shape: shared/element_*.wgsl have one `forward` and one `back` each. Coefficients are local: the centre of the
// element subtracted and its size divided out before they were f32.
//
// Twin: src/kernel/element_energy/cpu.rs. Source: [PPL13], equations 7 and 8 with J = ∇h A⁻¹.

// Threads of an element.
const THREADS: u32 = WORKGROUP_SIZE / ELEMENTS;
// More than any determinant.
const NONE: f32 = 1e30;

@group(0) @binding(0) var<uniform> params: ElementParams;
@group(0) @binding(1) var<storage, read> coefficients: array<f32>;       // [elements, 3, MODES]
@group(0) @binding(2) var<storage, read> inverses: array<f32>;           // [elements, 9], A⁻¹ column by column
@group(0) @binding(3) var<storage, read> tables: array<f32>;             // as the shape's file says
@group(0) @binding(4) var<storage, read> weights: array<f32>;            // [POINTS]
@group(0) @binding(5) var<storage, read_write> gradient: array<f32>;     // [elements, 3, MODES], added to
@group(0) @binding(6) var<storage, read_write> results: array<vec2f>;    // [elements], energy and smallest det J

// SHARE numbers an element. First `[3 coordinates, 3 derivatives, SLAB_POINTS]`, then what the shape needs in between.
var<workgroup> pool: array<f32, POOL>;
// Of this thread: its place among the threads of its element, its element's part of the pool, and where its coefficients begin.
var<private> lane: u32;
var<private> base: u32;
var<private> first_mode: u32;
var<private> is_real: bool;

@compute @workgroup_size(WORKGROUP_SIZE)
fn element_energy(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) thread: u32,
) {
    let slot = thread / THREADS;
    let place = (group.y * groups.x + group.x) * ELEMENTS + slot;
    // Threads without an element go along with the last one, for the barriers, and write nothing.
    is_real = place < params.elements;
    let element = min(place, params.elements - 1u);
    lane = thread % THREADS;
    base = slot * SHARE;
    first_mode = 3u * MODES * element;
    let inverse = mat3x3f(column(element, 0u), column(element, 1u), column(element, 2u));
    var result = vec2f(0.0, NONE);
    for (var slab = params.first_slab; slab < params.end_slab; slab++) {
        forward(slab);
        workgroupBarrier();
        for (var point = lane; point < SLAB_POINTS; point += THREADS) {
            if slab * SLAB_POINTS + point < POINTS {
                result = visit(slab * SLAB_POINTS + point, base + point, inverse, result);
            } else {
                store(base + point, mat3x3f());
            }
        }
        workgroupBarrier();
        if GRADIENT == 1u {
            back(slab);
        }
        workgroupBarrier();
    }
    pool[base + 2u * lane] = result.x;
    pool[base + 2u * lane + 1u] = result.y;
    workgroupBarrier();
    if lane == 0u && is_real {
        var total = vec2f(0.0, NONE);
        for (var other = 0u; other < THREADS; other++) {
            let part = base + 2u * other;
            total = vec2f(total.x + pool[part], min(total.y, pool[part + 1u]));
        }
        if params.first_slab > 0u {
            let before = results[element];
            total = vec2f(before.x + total.x, min(before.y, total.y));
        }
        results[element] = total;
    }
}

fn column(element: u32, k: u32) -> vec3f {
    let at = 9u * element + 3u * k;
    return vec3f(inverses[at], inverses[at + 1u], inverses[at + 2u]);
}

// A point: the derivatives of h at `at` become those of the energy. Returns the energy so far and the smallest determinant.
fn visit(point: u32, at: u32, inverse: mat3x3f, result: vec2f) -> vec2f {
    let j = load(at) * inverse;
    let det = dot(cross(j[0], j[1]), j[2]);
    var energy = result.x;
    if GRADIENT == 1u {
        let here = density(j, det);
        let weight = weights[point];
        energy += weight * here.value;
        store(at, (weight * here.gradient) * transpose(inverse));
    }
    return vec2f(energy, min(result.y, det));
}

// The derivatives at a point, those by u, v and w in columns.
fn load(at: u32) -> mat3x3f {
    return mat3x3f(
        entry(at, 0u, 0u), entry(at, 1u, 0u), entry(at, 2u, 0u),
        entry(at, 0u, 1u), entry(at, 1u, 1u), entry(at, 2u, 1u),
        entry(at, 0u, 2u), entry(at, 1u, 2u), entry(at, 2u, 2u),
    );
}

fn entry(at: u32, coordinate: u32, derivative: u32) -> f32 {
    return pool[at + (3u * coordinate + derivative) * SLAB_POINTS];
}

fn store(at: u32, m: mat3x3f) {
    store_column(at, m[0]);
    store_column(at + SLAB_POINTS, m[1]);
    store_column(at + 2u * SLAB_POINTS, m[2]);
}

fn store_column(at: u32, derivative: vec3f) {
    pool[at] = derivative.x;
    pool[at + 3u * SLAB_POINTS] = derivative.y;
    pool[at + 6u * SLAB_POINTS] = derivative.z;
}

// Adds to the gradient of a mode of this thread's element. Each is always added to by the same thread.
fn add(coordinate: u32, mode: u32, value: f32) {
    if is_real {
        gradient[first_mode + coordinate * MODES + mode] += value;
    }
}
