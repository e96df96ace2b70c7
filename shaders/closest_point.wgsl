// The closest point of a surface to each of many points.
//
// One thread serves one query: it descends a tree of bounding boxes with four children a node, the nearest first, and leaves
// out what is further than the best triangle so far. Coordinates are those of the tree, where the mesh is centred and about 1 in
// size. The answer is a triangle and weights of its corners; the host makes the point and its distance of them in f64.
//
// Twin: src/kernel/closest_point.rs, on the tree of src/geometry/bvh.rs.

// Covers the rounding of a squared distance in f32 and of a corner that is not quite in its box.
const ROUNDING: f32 = 1.00001;
// Each level leaves at most three children behind.
const STACK_SIZE: u32 = 96u;
const LEAF: u32 = 0x80000000u;
const COUNT_BITS: u32 = 3u;
// Nodes and leaves that a thread visits at most, up to five iterations each: see MAX_ITERATIONS in src/device. What is left
// open then, such as the middle of a sphere, the host finds.
const BUDGET: u32 = 12000u;
// Further than anything, but nearer than the boxes of absent children.
const FAR: f32 = 1e30;
// Below this sine squared of the angle at the first corner a projection on the plane is not trusted alone.
const SLIVER: f32 = 1e-6;

@group(0) @binding(0) var<uniform> params: ClosestParams;
@group(0) @binding(1) var<storage, read> nodes: array<TreeNode>;             // the root first
@group(0) @binding(2) var<storage, read> leaves: array<TreeLeaf>;            // [triangles]
@group(0) @binding(3) var<storage, read> queries: array<vec4f>;              // [queries]
// [queries]: leaf; weights of the second and third corner, as bits; 1 if left open.
@group(0) @binding(4) var<storage, read_write> answers: array<vec4u>;

// Squared distances, as bits (they sort like the numbers), and references of children yet to visit.
var<private> stack: array<vec2u, STACK_SIZE>;

// A point of a triangle: its weights of the second and third corner, its squared distance.
struct Candidate {
    weights: vec2f,
    squared: f32,
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn closest_point(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let query = linear_index(id, groups);
    if query >= params.queries {
        return;
    }
    let p = queries[query].xyz;
    var best = Candidate(vec2f(0.0), FAR);
    var best_leaf = 0u;
    stack[0] = vec2u(0u, 0u);
    var height = 1u;
    var visits = 0u;
    while height > 0u && visits < BUDGET {
        visits++;
        height--;
        let entry = stack[height];
        if bitcast<f32>(entry.x) > best.squared * ROUNDING {
            continue;
        }
        if (entry.y & LEAF) != 0u {
            let first = (entry.y & ~LEAF) >> COUNT_BITS;
            let end = first + (entry.y & ((1u << COUNT_BITS) - 1u));
            for (var leaf = first; leaf < end; leaf++) {
                let candidate = nearest(leaves[leaf], p);
                if candidate.squared < best.squared {
                    best = candidate;
                    best_leaf = leaf;
                }
            }
        } else {
            height = push_children(entry.y, p, best.squared * ROUNDING, height);
        }
    }
    answers[query] = vec4u(best_leaf, bitcast<vec2u>(best.weights), u32(height > 0u));
}

// Puts the children of a node that are within the limit on the stack, the nearest on top.
fn push_children(node: u32, p: vec3f, limit: f32, bottom: u32) -> u32 {
    let n = nodes[node];
    let x = max(max(n.lo_x - p.x, p.x - n.hi_x), vec4f(0.0));
    let y = max(max(n.lo_y - p.y, p.y - n.hi_y), vec4f(0.0));
    let z = max(max(n.lo_z - p.z, p.z - n.hi_z), vec4f(0.0));
    let squared = bitcast<vec4u>(x * x + y * y + z * z);
    var a = vec2u(squared.x, n.children.x);
    var b = vec2u(squared.y, n.children.y);
    var c = vec2u(squared.z, n.children.z);
    var d = vec2u(squared.w, n.children.w);
    sort(&a, &b);
    sort(&c, &d);
    sort(&a, &c);
    sort(&b, &d);
    sort(&b, &c);
    var height = push(a, limit, bottom);
    height = push(b, limit, height);
    height = push(c, limit, height);
    return push(d, limit, height);
}

// Puts the further of two entries first.
fn sort(a: ptr<function, vec2u>, b: ptr<function, vec2u>) {
    let swap = (*a).x < (*b).x;
    let further = select(*a, *b, swap);
    *b = select(*b, *a, swap);
    *a = further;
}

fn push(entry: vec2u, limit: f32, height: u32) -> u32 {
    // Written whether it counts or not; the next one overwrites it.
    stack[min(height, STACK_SIZE - 1u)] = entry;
    return select(height, min(height + 1u, STACK_SIZE), bitcast<f32>(entry.x) <= limit);
}

// The point of a triangle nearest to p: the projection on its plane where that is inside, else the nearest point of an edge.
fn nearest(leaf: TreeLeaf, p: vec3f) -> Candidate {
    let ap = p - leaf.a;
    let normal = cross(leaf.ab, leaf.ac);
    let area = dot(normal, normal);
    let v = dot(cross(ap, leaf.ac), normal);
    let w = dot(cross(leaf.ab, ap), normal);
    let is_inside = v >= 0.0 && w >= 0.0 && v + w <= area && area > 0.0;
    var best = Candidate(vec2f(0.0), FAR);
    if is_inside {
        let weights = vec2f(v, w) / area;
        best = Candidate(weights, squared_length(ap - weights.x * leaf.ab - weights.y * leaf.ac));
    }
    let is_sliver = area <= SLIVER * dot(leaf.ab, leaf.ab) * dot(leaf.ac, leaf.ac);
    if !is_inside || is_sliver {
        let ab = on_segment(ap, leaf.ab);
        best = nearer(best, Candidate(vec2f(ab.x, 0.0), ab.y));
        let ac = on_segment(ap, leaf.ac);
        best = nearer(best, Candidate(vec2f(0.0, ac.x), ac.y));
        let bc = on_segment(ap - leaf.ab, leaf.ac - leaf.ab);
        best = nearer(best, Candidate(vec2f(1.0 - bc.x, bc.x), bc.y));
    }
    return best;
}

fn nearer(a: Candidate, b: Candidate) -> Candidate {
    if b.squared < a.squared {
        return b;
    }
    return a;
}

// The parameter of the point nearest to p on the segment from the origin to the edge's end, and its squared distance.
fn on_segment(p: vec3f, edge: vec3f) -> vec2f {
    let length = dot(edge, edge);
    let along = dot(p, edge);
    var t = 0.0;
    if along > 0.0 && length > 0.0 {
        t = min(along / length, 1.0);
    }
    return vec2f(t, squared_length(p - t * edge));
}

fn squared_length(v: vec3f) -> f32 {
    return dot(v, v);
}
