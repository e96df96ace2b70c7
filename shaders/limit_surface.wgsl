// The closest point of a Loop limit surface to each of many points, tracked from a point of the surface.
//
// One thread serves one query. It evaluates the surface exactly (Stam 1998): a quarter of a control face is a quartic box spline over twelve points, or, with an
// irregular corner, becomes one by a matrix tabulated for each level of refinement towards the corner. Newton's method runs over the edges of the faces. Coordinates
// are those of the surface's frame, where it is centred and about 1 in size; control points are taken relative to the query.
// The answer is a parameter; the host makes the point of it in f64, and redoes what is left open.
//
// Twins: src/model/limit_surface/newton.rs, and irregular.rs for the evaluation.

const NONE: u32 = 0xffffffffu;
const STEPS: u32 = 50u;
const HALVINGS: u32 = 8u;
const CROSSINGS: u32 = 8u;
// The longest step by either parameter.
const LONGEST: f32 = 0.7;
// A step that moves the point by less ends the iteration: some roundings of a coordinate.
const SETTLED: f32 = 1e-6;
// How near to an edge, by the parameter, is on it.
const ON_EDGE: f32 = 1e-6;
// Covers the rounding of a squared distance, relatively and where it is near 0.
const ROUNDING: f32 = 1.000002;
const LEAST: f32 = 1e-14;
const TINY: f32 = 1e-30;

const OPEN: u32 = 0u;
const CONVERGED: u32 = 1u;
const LEFT_SURFACE: u32 = 2u;

@group(0) @binding(0) var<uniform> params: LimitParams;
@group(0) @binding(1) var<storage, read> quarters: array<vec4u>;             // [4 faces]: first index, points, pickings
@group(0) @binding(2) var<storage, read> indices: array<u32>;
@group(0) @binding(3) var<storage, read> points: array<vec4f>;
@group(0) @binding(4) var<storage, read> pickings: array<f32>;               // [levels, 3, points, 12] by kind of corner
@group(0) @binding(5) var<storage, read> neighbours: array<u32>;             // [3 faces]: 3 face + edge across
@group(0) @binding(6) var<storage, read> queries: array<DeviceQuery>;        // [queries]
@group(0) @binding(7) var<storage, read_write> answers: array<vec4u>;        // [queries]: face, u and v as bits, status

// A map of parameters: a linear part by columns, and an offset.
struct Affine {
    linear: mat2x2f,
    offset: vec2f,
}

// A parameter on a control face, with a step from there.
struct Walk {
    face: u32,
    at: vec2f,
    step: vec2f,
}

struct Step {
    step: vec2f,
    is_held: bool,
}

// Whether the last evaluation was nearer to an irregular corner than the tables reach.
var<private> is_too_deep: bool;

@compute @workgroup_size(WORKGROUP_SIZE)
fn limit_surface(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let query = linear_index(id, groups);
    if query >= params.queries {
        return;
    }
    let q = queries[query];
    var face = q.face;
    var at = vec2f(q.u, q.v);
    if q.is_settled != 0u {
        answers[query] = vec4u(face, bitcast<vec2u>(at), CONVERGED);
        return;
    }
    var jet = evaluate(face, at, q.point);
    var squared = dot(jet.position, jet.position);
    var status = OPEN;
    for (var i = 0u; i < STEPS && !is_too_deep; i++) {
        let held = constrained_step(face, at, jet);
        var step = held.step;
        if length(step.x * jet.du + step.y * jet.dv) <= SETTLED {
            status = select(CONVERGED, LEFT_SURFACE, held.is_held);
            break;
        }
        var is_nearer = false;
        for (var j = 0u; j < HALVINGS && !is_nearer; j++) {
            let next = walk(Walk(face, at, step));
            let next_jet = evaluate(next.face, next.at, q.point);
            let next_squared = dot(next_jet.position, next_jet.position);
            if next_squared <= squared * ROUNDING + LEAST {
                is_nearer = true;
                face = next.face;
                at = next.at;
                jet = next_jet;
                squared = next_squared;
            }
            step *= 0.5;
        }
        if !is_nearer {
            break;
        }
    }
    answers[query] = vec4u(face, bitcast<vec2u>(at), status);
}

// The surface relative to the query.
fn evaluate(face: u32, at: vec2f, query: vec3f) -> Jet {
    is_too_deep = false;
    var k = quarter_at(at);
    var map = quarter_map(k);
    let quarter = quarters[4u * face + k];
    var local = map.linear * at + map.offset;
    var linear = map.linear;
    if quarter.z == NONE {
        for (var i = 0u; i < 12u; i++) {
            control[i] = points[indices[quarter.x + i]].xyz - query;
        }
    } else {
        var scale = 1.0;
        var level = 0u;
        while level + 1u < LEVELS && scale * (local.x + local.y) < 0.5 {
            scale *= 2.0;
            level++;
        }
        local *= scale;
        k = quarter_at(local);
        // The last level stands in for all that would follow.
        is_too_deep = k == 0u;
        k = max(k, 1u);
        map = quarter_map(k);
        local = map.linear * local + map.offset;
        linear = scale * map.linear * linear;
        pick(quarter, quarter.z + (3u * level + k - 1u) * quarter.y * 12u, query);
    }
    return by(box_spline(local), linear);
}

// Control points from those around an irregular corner, by a matrix of twelve rows.
fn pick(quarter: vec4u, matrix: u32, query: vec3f) {
    for (var r = 0u; r < 12u; r++) {
        control[r] = vec3f(0.0);
    }
    for (var i = 0u; i < quarter.y; i++) {
        let p = points[indices[quarter.x + i]].xyz - query;
        for (var r = 0u; r < 12u; r++) {
            control[r] += pickings[matrix + 12u * i + r] * p;
        }
    }
}

// A jet by other parameters, of which `linear` makes the jet's.
fn by(jet: Jet, linear: mat2x2f) -> Jet {
    let x = linear[0];
    let y = linear[1];
    return Jet(
        jet.position,
        x.x * jet.du + x.y * jet.dv,
        y.x * jet.du + y.y * jet.dv,
        x.x * x.x * jet.duu + 2.0 * x.x * x.y * jet.duv + x.y * x.y * jet.dvv,
        x.x * y.x * jet.duu + (x.x * y.y + x.y * y.x) * jet.duv + x.y * y.y * jet.dvv,
        y.x * y.x * jet.duu + 2.0 * y.x * y.y * jet.duv + y.y * y.y * jet.dvv,
    );
}

// The quarter of a face at a parameter.
fn quarter_at(at: vec2f) -> u32 {
    if at.x >= 0.5 {
        return 1u;
    }
    if at.y >= 0.5 {
        return 2u;
    }
    return select(0u, 3u, at.x + at.y >= 0.5);
}

fn quarter_map(k: u32) -> Affine {
    if k == 3u {
        return Affine(mat2x2f(2.0, -2.0, 2.0, 0.0), vec2f(-1.0, 1.0));
    }
    let map = to_corner(k);
    return Affine(2.0 * map.linear, 2.0 * map.offset);
}

// The map to the frame of a corner: it becomes (0, 0), the edge that leaves it the first axis.
fn to_corner(k: u32) -> Affine {
    switch k {
        case 1u: {
            return Affine(mat2x2f(0.0, -1.0, 1.0, -1.0), vec2f(0.0, 1.0));
        }
        case 2u: {
            return Affine(mat2x2f(-1.0, 1.0, -1.0, 0.0), vec2f(1.0, 0.0));
        }
        default: {
            return Affine(mat2x2f(1.0, 0.0, 0.0, 1.0), vec2f(0.0));
        }
    }
}

fn from_corner(k: u32) -> Affine {
    return to_corner((3u - k) % 3u);
}

// The step from a parameter; where it would leave the surface, along the boundary.
fn constrained_step(face: u32, at: vec2f, jet: Jet) -> Step {
    let r = jet.position;
    let gradient = vec2f(dot(r, jet.du), dot(r, jet.dv));
    let metric = vec3f(dot(jet.du, jet.du), dot(jet.du, jet.dv), dot(jet.dv, jet.dv));
    let hessian = metric + vec3f(dot(r, jet.duu), dot(r, jet.duv), dot(r, jet.dvv));
    let step = shortened(free_step(gradient, metric, hessian));
    if !is_held(face, at, step) {
        return Step(step, false);
    }
    for (var edge = 0u; edge < 3u; edge++) {
        if holds(face, at, step, edge) {
            let along = from_corner(edge).linear[0];
            let length = quadratic(metric, along);
            let bend = quadratic(hessian, along);
            let curvature = select(length, bend, bend > 0.1 * length);
            let slide = shortened(along * (-dot(gradient, along) / max(curvature, TINY)));
            if !is_held(face, at, slide) {
                return Step(slide, true);
            }
        }
    }
    return Step(vec2f(0.0), true);
}

// A symmetric matrix, by its entries xx, xy and yy, between a vector and itself.
fn quadratic(m: vec3f, v: vec2f) -> f32 {
    return m.x * v.x * v.x + 2.0 * m.y * v.x * v.y + m.z * v.y * v.y;
}

fn determinant_of(m: vec3f) -> f32 {
    return m.x * m.z - m.y * m.y;
}

fn solve(m: vec3f, v: vec2f) -> vec2f {
    return vec2f(m.z * v.x - m.y * v.y, m.x * v.y - m.y * v.x) / determinant_of(m);
}

// Newton's step where the Hessian is safely positive definite, else Gauss and Newton's, else against the gradient.
fn free_step(gradient: vec2f, metric: vec3f, hessian: vec3f) -> vec2f {
    let area = determinant_of(metric);
    let trace = metric.x + metric.z;
    if determinant_of(hessian) > 0.01 * area && hessian.x + hessian.z > 0.0 && area > 0.0 {
        return -solve(hessian, gradient);
    }
    if area > 1e-5 * trace * trace {
        return -solve(metric, gradient);
    }
    return -gradient / max(trace, TINY);
}

fn shortened(step: vec2f) -> vec2f {
    let longest = max(abs(step.x), abs(step.y));
    return step * select(1.0, LONGEST / longest, longest > LONGEST);
}

fn is_held(face: u32, at: vec2f, step: vec2f) -> bool {
    return holds(face, at, step, 0u) || holds(face, at, step, 1u) || holds(face, at, step, 2u);
}

// Whether an edge at a parameter would be crossed by a step, and is where the surface ends.
fn holds(face: u32, at: vec2f, step: vec2f, edge: u32) -> bool {
    let frame = to_corner(edge);
    let distance = (frame.linear * at + frame.offset).y;
    let rate = (frame.linear * step).y;
    return distance <= ON_EDGE
        && rate < -ON_EDGE * max(abs(step.x), abs(step.y))
        && neighbours[3u * face + edge] == NONE;
}

// Where a step leads, over edges, at most to where the surface ends.
fn walk(start: Walk) -> Walk {
    var w = start;
    for (var i = 0u; i < CROSSINGS; i++) {
        var time = 1.0;
        var reached = NONE;
        for (var edge = 0u; edge < 3u; edge++) {
            let frame = to_corner(edge);
            let distance = max((frame.linear * w.at + frame.offset).y, 0.0);
            let rate = (frame.linear * w.step).y;
            if rate < 0.0 && distance < time * -rate {
                time = distance / -rate;
                reached = edge;
            }
        }
        w.at = clamped(w.at + time * w.step);
        if reached == NONE {
            break;
        }
        let there = neighbours[3u * w.face + reached];
        if there == NONE {
            break;
        }
        // Both faces laid out flat as the halves of a parallelogram.
        let to = to_corner(reached);
        let from_there = from_corner(there % 3u);
        let along = to.linear * w.at + to.offset;
        w.face = there / 3u;
        w.at = clamped(from_there.linear * (vec2f(1.0, 0.0) - along) + from_there.offset);
        w.step = -(1.0 - time) * (from_there.linear * (to.linear * w.step));
    }
    return w;
}

fn clamped(at: vec2f) -> vec2f {
    let p = clamp(at, vec2f(0.0), vec2f(1.0));
    let sum = p.x + p.y;
    if sum > 1.0 {
        let x = p.x / sum;
        return vec2f(x, 1.0 - x);
    }
    return p;
}
