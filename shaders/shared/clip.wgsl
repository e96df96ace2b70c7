// The restricted Voronoi cell of one seed on one triangle: barycentric clipping by bisectors.
//
// A point of the triangle is origin + u e1 + v e2. The difference of the squared distances to two seeds is affine in (u, v),
// so the cell is the triangle cut by one half-plane a competitor. f_ij is computed so that f_ij = −f_ji to the bit and ties go
// to the lower seed: what is equidistant from two seeds is neither lost nor doubled.
//
// The cell stays in `polygon`. A cell with too many vertices is given up as empty; the check of the triangle then finds that
// its cells do not add up (cell_check.wgsl), and the host does the triangle again.
//
// The kernel that includes this declares `fn seed(slot: u32) -> vec3f`: the seed of a slot, whose triangle's other
// candidates are its neighbours in the list, ascending by index.
//
// Twin: src/geometry/clip.rs.

const MAX_VERTICES: u32 = 16u; // the worst seen is 13
const SIDE: f32 = -1.0;

const EMPTY: u32 = 0u;
const WHOLE: u32 = 1u;
const CUT: u32 = 2u;

// [vertices]: u, v, and for the edge that leaves the vertex the competitor whose bisector made it, counted from the
// triangle's first slot, or SIDE.
var<private> polygon: array<vec3f, MAX_VERTICES>;
var<private> vertices: u32;

// Integrals over a cell in the (u, v) plane, with a = u − origin.x and b = v − origin.y: local, so that small cells keep their
// digits.
struct Moments {
    origin: vec2f,
    one: f32,
    a: f32,
    b: f32,
    aa: f32,
    ab: f32,
    bb: f32,
}

// Clips the triangle to the cell of slot `own`; its triangle's slots are first..end.
fn clip_cell(origin: vec3f, e1: vec3f, e2: vec3f, own: u32, first: u32, end: u32) -> u32 {
    let x = seed(own);
    var state = WHOLE;
    for (var k = first; k < end; k++) {
        if k == own {
            continue;
        }
        let other = seed(k);
        let apart = x - other;
        let f = vec3f(
            dot(apart, (origin - x) + (origin - other)),
            2.0 * dot(apart, e1),
            2.0 * dot(apart, e2),
        );
        let wins_ties = own < k;
        let inside = vec3<bool>(
            is_ours(f.x, wins_ties),
            is_ours(f.x + f.y, wins_ties),
            is_ours(f.x + f.z, wins_ties),
        );
        if all(inside) {
            continue;
        }
        if !any(inside) {
            return EMPTY;
        }
        if state == WHOLE {
            state = CUT;
            polygon[0] = vec3f(0.0, 0.0, SIDE);
            polygon[1] = vec3f(1.0, 0.0, SIDE);
            polygon[2] = vec3f(0.0, 1.0, SIDE);
            vertices = 3u;
        }
        cut(f, wins_ties, f32(k - first));
        if vertices < 3u || vertices > MAX_VERTICES {
            return EMPTY;
        }
    }
    return state;
}

fn is_ours(f: f32, wins_ties: bool) -> bool {
    return f > 0.0 || (f == 0.0 && wins_ties);
}

// Keeps the part of the polygon where f.x + u f.y + v f.z is ours. In place: a convex polygon gains at most one vertex, and
// the next vertex is read before its place is written.
fn cut(f: vec3f, wins_ties: bool, label: f32) {
    let first = polygon[0];
    var a = first;
    var fa = f.x + a.x * f.y + a.y * f.z;
    var a_ours = is_ours(fa, wins_ties);
    var kept = 0u;
    for (var k = 1u; k <= vertices; k++) {
        var b = first;
        if k < vertices {
            b = polygon[k];
        }
        let fb = f.x + b.x * f.y + b.y * f.z;
        let b_ours = is_ours(fb, wins_ties);
        if a_ours {
            polygon[min(kept, MAX_VERTICES - 1u)] = a;
            kept++;
        }
        if a_ours != b_ours {
            let t = fa / (fa - fb);
            // Leaving our side, the edge that follows is the bisector; entering it, the rest of the old edge.
            let edge = select(a.z, label, a_ours);
            polygon[min(kept, MAX_VERTICES - 1u)] = vec3f(a.xy + t * (b.xy - a.xy), edge);
            kept++;
        }
        a = b;
        fa = fb;
        a_ours = b_ours;
    }
    vertices = kept;
}

// The moments of a cell that is not empty.
fn cell_moments(state: u32) -> Moments {
    if state == WHOLE {
        return Moments(vec2f(0.0), 1.0 / 2.0, 1.0 / 6.0, 1.0 / 6.0, 1.0 / 12.0, 1.0 / 24.0, 1.0 / 12.0);
    }
    let o = polygon[0].xy;
    var m = Moments(o, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    var p = polygon[1].xy - o;
    for (var k = 2u; k < vertices; k++) {
        let q = polygon[k].xy - o;
        let d = p.x * q.y - q.x * p.y;
        m.one += d;
        m.a += d * (p.x + q.x);
        m.b += d * (p.y + q.y);
        m.aa += d * (p.x * p.x + p.x * q.x + q.x * q.x);
        m.ab += d * (2.0 * (p.x * p.y + q.x * q.y) + p.x * q.y + q.x * p.y);
        m.bb += d * (p.y * p.y + p.y * q.y + q.y * q.y);
        p = q;
    }
    m.one /= 2.0;
    m.a /= 6.0;
    m.b /= 6.0;
    m.aa /= 12.0;
    m.ab /= 24.0;
    m.bb /= 12.0;
    return m;
}
