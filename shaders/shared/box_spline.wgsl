// The quartic box spline over a triangle, from how its control points deviate from the plane of the corners.
//
// Control points 0 to 2 are the triangle's corners; the order of the others is that of src/model/limit_surface/basis.rs, with the basis
// functions. The spline reproduces linear functions, so it is the linear interpolation of the corners plus, for each of the other nine points, its basis
// function times what the point deviates from the corners' plane continued to its place. Small numbers stay small that way.

// A point of a surface and its derivatives by (u, v).
struct Jet {
    position: vec3f,
    du: vec3f,
    dv: vec3f,
    duu: vec3f,
    duv: vec3f,
    dvv: vec3f,
}

// How the weights of the three corners change with (u, v).
const W0: vec2f = vec2f(-1.0, -1.0);
const W1: vec2f = vec2f(1.0, 0.0);
const W2: vec2f = vec2f(0.0, 1.0);

var<private> control: array<vec3f, 12>;
var<private> patch_jet: Jet;

fn box_spline(at: vec2f) -> Jet {
    let x = control[1] - control[0];
    let y = control[2] - control[0];
    let position = control[0] + at.x * x + at.y * y;
    patch_jet = Jet(position, x, y, vec3f(0.0), vec3f(0.0), vec3f(0.0));
    let a = 1.0 - at.x - at.y;
    let b = at.x;
    let c = at.y;
    let o = control[0];
    add_across(control[3] - o - x - y, b, c, a, W1, W2, W0);
    add_across(control[4] - o + x - y, c, a, b, W2, W0, W1);
    add_across(control[5] - o - x + y, a, b, c, W0, W1, W2);
    add_beyond(control[6] - o + x, a, c, W0, W2);
    add_beyond(control[7] - o + y, a, b, W0, W1);
    add_beyond(control[8] - o - 2.0 * x + y, b, a, W1, W0);
    add_beyond(control[9] - o - 2.0 * x, b, c, W1, W2);
    add_beyond(control[10] - o - 2.0 * y, c, b, W2, W1);
    add_beyond(control[11] - o + x - 2.0 * y, c, a, W2, W0);
    return patch_jet;
}

// x³ (x + 2 y) / 12 times a deviation.
fn add_beyond(deviation: vec3f, x: f32, y: f32, dx: vec2f, dy: vec2f) {
    let xx = x * x;
    let f = xx * x * (x + 2.0 * y);
    let d = xx * (4.0 * x + 6.0 * y) * dx + 2.0 * xx * x * dy;
    let by_xx = 12.0 * x * (x + y);
    let by_xy = 6.0 * xx;
    add(deviation, f, d, second(by_xx, dx, dx) + second(by_xy, dx, dy) + second(by_xy, dy, dx));
}

// (s⁴ + 2 t (s² + t) + 2 z s³) / 12 with s = x + y and t = x y, times a deviation.
fn add_across(deviation: vec3f, x: f32, y: f32, z: f32, dx: vec2f, dy: vec2f, dz: vec2f) {
    let s = x + y;
    let t = x * y;
    let ss = s * s;
    let f = ss * ss + 2.0 * t * (ss + t) + 2.0 * z * ss * s;
    let both = 4.0 * ss * s + 4.0 * s * t + 6.0 * z * ss;
    let d = (both + 2.0 * y * (ss + 2.0 * t)) * dx + (both + 2.0 * x * (ss + 2.0 * t)) * dy + 2.0 * ss * s * dz;
    let bend = 12.0 * ss + 4.0 * t + 12.0 * z * s;
    let ds = dx + dy;
    let by_xy = bend + 6.0 * ss + 8.0 * t;
    add(
        deviation,
        f,
        d,
        second(bend + 4.0 * y * (2.0 * s + y), dx, dx) + second(bend + 4.0 * x * (2.0 * s + x), dy, dy)
            + second(by_xy, dx, dy) + second(by_xy, dy, dx) + second(6.0 * ss, ds, dz) + second(6.0 * ss, dz, ds),
    );
}

// What a second derivative by two weights adds to those by uu, uv and vv.
fn second(value: f32, p: vec2f, q: vec2f) -> vec3f {
    return value * vec3f(p.x * q.x, p.x * q.y, p.y * q.y);
}

fn add(deviation: vec3f, f: f32, d: vec2f, dd: vec3f) {
    let share = deviation / 12.0;
    patch_jet.position += f * share;
    patch_jet.du += d.x * share;
    patch_jet.dv += d.y * share;
    patch_jet.duu += dd.x * share;
    patch_jet.duv += dd.y * share;
    patch_jet.dvv += dd.z * share;
}
