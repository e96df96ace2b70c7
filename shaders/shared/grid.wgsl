// The number of a thread in a grid that may have several rows of workgroups.
//
// One dimension of a dispatch holds 65,535 workgroups; larger ones are folded into rows by `grid` in src/device/batch.rs.

fn linear_index(id: vec3u, groups: vec3u) -> u32 {
    return id.y * groups.x * WORKGROUP_SIZE + id.x;
}
