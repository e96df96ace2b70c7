// Checks that the cells on each triangle add up to it, and sums their energies.
//
// One thread serves one triangle. Where the fractions of its slots do not add up to 1 (a cell with too many vertices, rounding
// gone wrong) the triangle's records are zeroed and its number is listed, and the host does it again in f64. The list
// is filled through a counter, so its order is arbitrary; the host sorts it. Energies are added in fixed order, one sum a
// workgroup; the host adds those in f64.
//
// Host: src/kernel/slots.rs.

const MAX_GAP: f32 = 1e-4;

@group(0) @binding(0) var<uniform> params: CheckParams;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;                // [triangles + 1], slots of each triangle
@group(0) @binding(2) var<storage, read> fractions: array<f32>;              // [slots]
@group(0) @binding(3) var<storage, read_write> records: array<vec4f>;        // [slots, width], the energy in [slot, 1].w
@group(0) @binding(4) var<storage, read_write> energies: array<f32>;         // [workgroups]
@group(0) @binding(5) var<storage, read_write> failures: array<atomic<u32>>; // how many, then which triangles

var<workgroup> parts: array<f32, WORKGROUP_SIZE>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn cell_check(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let triangle = linear_index(id, groups);
    var energy = 0.0;
    if triangle < params.triangles {
        let first = offsets[triangle];
        let end = offsets[triangle + 1u];
        var covered = 0.0;
        for (var slot = first; slot < end; slot++) {
            covered += fractions[slot];
            energy += records[slot * params.width + 1u].w;
        }
        // Written so that what is not a number fails too, where the device keeps it.
        if !(abs(covered - 1.0) <= MAX_GAP) {
            energy = 0.0;
            for (var k = first * params.width; k < end * params.width; k++) {
                records[k] = vec4f(0.0);
            }
            let place = atomicAdd(&failures[0], 1u);
            if place < params.capacity {
                atomicStore(&failures[1u + place], triangle);
            }
        }
    }
    parts[local] = energy;
    for (var half = WORKGROUP_SIZE / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if local < half {
            parts[local] += parts[local + half];
        }
    }
    if local == 0u {
        let workgroup = group.y * groups.x + group.x;
        if workgroup < arrayLength(&energies) {
            energies[workgroup] = parts[0];
        }
    }
}
