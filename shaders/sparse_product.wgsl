// The product of a sparse matrix with an array of points: X = M P, and with the transpose's rows G = Mᵀ F.
//
// One thread computes one row, in the order of its columns.
//
// Twin: src/kernel/sparse.rs.

@group(0) @binding(0) var<uniform> params: SparseParams;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;            // [rows + 1]
@group(0) @binding(2) var<storage, read> columns: array<u32>;            // [entries]
@group(0) @binding(3) var<storage, read> values: array<f32>;             // [entries]
@group(0) @binding(4) var<storage, read> points: array<vec4f>;           // [columns of the matrix]
@group(0) @binding(5) var<storage, read_write> products: array<vec4f>;   // [rows]

@compute @workgroup_size(WORKGROUP_SIZE)
fn sparse_product(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let row = linear_index(id, groups);
    if row >= params.rows {
        return;
    }
    let end = offsets[row + 1u];
    var total = vec4f(0.0);
    for (var k = offsets[row]; k < end; k++) {
        total += values[k] * points[columns[k]];
    }
    products[row] = total;
}
