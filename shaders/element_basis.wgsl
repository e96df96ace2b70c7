// Changes the basis of the coefficients of elements: a dense matrix times each element's coefficients.
//
// One thread computes one coordinate of one coefficient. Twin: `matrix` of src/kernel/element_energy/pass.rs.

@group(0) @binding(0) var<uniform> params: BasisParams;
@group(0) @binding(1) var<storage, read> matrix: array<f32>;             // [modes before, modes after]
@group(0) @binding(2) var<storage, read> before: array<f32>;             // [elements, 3, modes]
@group(0) @binding(3) var<storage, read_write> after: array<f32>;        // [elements, 3, modes]

@compute @workgroup_size(WORKGROUP_SIZE)
fn element_basis(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let k = linear_index(id, groups);
    if k >= params.vectors * params.modes {
        return;
    }
    let row = k % params.modes;
    let start = k - row;
    var sum = 0.0;
    for (var m = 0u; m < params.modes; m++) {
        sum += matrix[m * params.modes + row] * before[start + m];
    }
    after[k] = sum;
}
