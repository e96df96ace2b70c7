// Segmented sums of gathered records.
//
// One thread adds one four-vector of one segment: records in the order of the segment's list, in blocks, so that the error
// grows with n / BLOCK and the result is the same from run to run.
//
// Twin: src/kernel/sum.rs.

const BLOCK: u32 = 16u;

@group(0) @binding(0) var<uniform> params: SumParams;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;            // [segments + 1]
@group(0) @binding(2) var<storage, read> items: array<u32>;              // [offsets[segments]]
@group(0) @binding(3) var<storage, read> values: array<vec4f>;           // [records, stride]
@group(0) @binding(4) var<storage, read_write> sums: array<vec4f>;       // [segments, width]

@compute @workgroup_size(WORKGROUP_SIZE)
fn sum(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let k = linear_index(id, groups);
    if k >= params.segments * params.width {
        return;
    }
    let segment = k / params.width;
    let lane = params.first + k % params.width;
    let end = offsets[segment + 1u];
    var total = vec4f(0.0);
    var i = offsets[segment];
    while i < end {
        let stop = min(i + BLOCK, end);
        var block = vec4f(0.0);
        for (; i < stop; i++) {
            var item = i;
            if params.consecutive == 0u {
                item = items[i];
            }
            block += values[item * params.stride + lane];
        }
        total += block;
    }
    if params.accumulate != 0u {
        total += sums[k];
    }
    sums[k] = total;
}
