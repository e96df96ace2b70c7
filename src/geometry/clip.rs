//! The restricted Voronoi cells of one triangle: barycentric clipping by bisectors.
//!
//! A point of the triangle is p₀ + u (p₁ − p₀) + v (p₂ − p₀). The difference of the squared distances to two seeds is
//! affine in (u, v), so the cell of a seed is the triangle cut by one half-plane a competitor, and only the squared
//! distances at the three corners matter. Clipping in (u, v) partitions the triangle exactly, slivers included;
//! clipping in 3D does not.
//!
//! f_ij = q_j − q_i with q the squared distances at a corner is antisymmetric to the bit, and ties go to the lower
//! seed: triangles equidistant from two seeds are neither lost nor doubled.

use glam::DVec3;

/// The side of a triangle that no bisector made.
pub const SIDE: u32 = u32::MAX;

/// The largest number less than zero: what is greater is at least zero.
const BELOW_ZERO: f64 = -f64::from_bits(1);

/// ∫ over a polygon in the (u, v) plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    /// ∫ 1; half for the whole triangle.
    pub one: f64,
    /// ∫ u.
    pub u: f64,
    /// ∫ v.
    pub v: f64,
    /// ∫ u².
    pub uu: f64,
    /// ∫ u v.
    pub uv: f64,
    /// ∫ v².
    pub vv: f64,
}

impl Moments {
    /// Those of the whole triangle.
    pub const WHOLE: Self = Self {
        one: 1.0 / 2.0,
        u: 1.0 / 6.0,
        v: 1.0 / 6.0,
        uu: 1.0 / 12.0,
        uv: 1.0 / 24.0,
        vv: 1.0 / 12.0,
    };
}

/// A vertex of a clipped polygon, with the edge that leaves it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Vertex {
    u: f64,
    v: f64,
    /// The candidate whose bisector made the edge from this vertex to the next, or [`SIDE`].
    label: u32,
}

/// An edge of a cell that lies on a bisector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BisectorEdge {
    /// The seed on the other side.
    pub other: u32,
    /// Its ends in (u, v), counter-clockwise about the cell.
    pub ends: [[f64; 2]; 2],
}

/// Clips triangles; keeps its buffers between calls.
#[derive(Debug, Default)]
pub struct Clipper {
    /// Squared distances of the candidates to the three corners.
    distances: Vec<[f64; 3]>,
    polygon: Polygon,
    edges: Vec<BisectorEdge>,
}

impl Clipper {
    /// Calls `emit(seed, moments, edges)` for each candidate whose cell meets the triangle, in the order of `candidates`.
    ///
    /// `candidates` must hold every seed that is nearest somewhere on the triangle; more do no harm. The edges are those
    /// on bisectors, in order around the cell; they are only collected where `want_edges`.
    pub fn cells(
        &mut self,
        corners: &[DVec3; 3],
        seeds: &[DVec3],
        candidates: &[u32],
        want_edges: bool,
        mut emit: impl FnMut(u32, &Moments, &[BisectorEdge]),
    ) {
        if let [only] = *candidates {
            emit(only, &Moments::WHOLE, &[]);
            return;
        }
        self.distances.clear();
        self.distances.extend(candidates.iter().map(|&s| {
            let x = seeds[s as usize];
            corners.map(|p| (p - x).length_squared())
        }));
        for (i, &seed) in candidates.iter().enumerate() {
            match self.clip(i, candidates) {
                Cell::Empty => {}
                Cell::Whole => emit(seed, &Moments::WHOLE, &[]),
                Cell::Cut => {
                    let moments = moments(&self.polygon.vertices);
                    self.edges.clear();
                    if want_edges {
                        self.collect_edges();
                    }
                    emit(seed, &moments, &self.edges);
                }
            }
        }
    }

    /// Leaves the cell of candidate `i` in `self.polygon` where it is [`Cell::Cut`].
    fn clip(&mut self, i: usize, candidates: &[u32]) -> Cell {
        let qi = self.distances[i];
        let mut cell = Cell::Whole;
        for (j, qj) in self.distances.iter().enumerate() {
            if i == j {
                continue;
            }
            let f = [qj[0] - qi[0], qj[1] - qi[1], qj[2] - qi[2]];
            let tie_is_ours = candidates[i] < candidates[j];
            let beyond = if tie_is_ours { BELOW_ZERO } else { 0.0 };
            let inside = f.map(|f| f > beyond);
            if inside == [true; 3] {
                continue;
            }
            if inside == [false; 3] {
                return Cell::Empty;
            }
            if cell == Cell::Whole {
                cell = Cell::Cut;
                self.polygon.make_whole();
            }
            self.polygon.cut(f, candidates[j], beyond);
            if self.polygon.vertices.is_empty() {
                return Cell::Empty;
            }
        }
        cell
    }

    fn collect_edges(&mut self) {
        let polygon = &self.polygon.vertices;
        for (k, a) in polygon.iter().enumerate() {
            if a.label != SIDE {
                let b = polygon[(k + 1) % polygon.len()];
                self.edges.push(BisectorEdge {
                    other: a.label,
                    ends: [[a.u, a.v], [b.u, b.v]],
                });
            }
        }
    }
}

#[derive(PartialEq)]
enum Cell {
    Empty,
    Whole,
    Cut,
}

/// A convex polygon of the (u, v) plane.
#[derive(Debug, Default)]
struct Polygon {
    /// Counter-clockwise.
    vertices: Vec<Vertex>,
    scratch: Vec<Vertex>,
    /// The function of a bisector at the vertices.
    values: Vec<f64>,
}

impl Polygon {
    /// Becomes the whole triangle.
    fn make_whole(&mut self) {
        self.vertices.clear();
        let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)];
        self.vertices
            .extend(corners.map(|(u, v)| Vertex { u, v, label: SIDE }));
    }

    /// Keeps the part of the polygon where the affine function with values `f` at the triangle's corners is greater than `beyond`;
    /// no vertices where there is none.
    ///
    /// The polygon is convex, so it leaves our side once and comes back once. Both places are found without branches, which
    /// could not be predicted.
    fn cut(&mut self, f: [f64; 3], label: u32, beyond: f64) {
        let [f1, f2] = [f[1] - f[0], f[2] - f[0]];
        let value = |p: &Vertex| f[0] + p.u * f1 + p.v * f2;
        self.values.clear();
        self.values.extend(self.vertices.iter().map(value));
        let count = self.values.len();
        let mut last = count - 1;
        let mut last_ours = self.values[last] > beyond;
        // The vertex before the last turn from one side (first index) to another.
        let mut before_turn = [[0; 2]; 2];
        let mut inside = 0;
        for (k, &value) in self.values.iter().enumerate() {
            let ours = value > beyond;
            inside += usize::from(ours);
            before_turn[usize::from(last_ours)][usize::from(ours)] = last;
            (last, last_ours) = (k, ours);
        }
        let (leaving, entering) = (before_turn[1][0], before_turn[0][1]);
        if inside == count {
            return;
        }
        self.scratch.clear();
        if inside > 0 {
            let next = |k: usize| if k + 1 == count { 0 } else { k + 1 };
            let first = next(entering);
            let kept = 1 + if leaving < first {
                leaving + count
            } else {
                leaving
            } - first;
            let vertices = &self.vertices;
            let mut k = entering;
            self.scratch.extend((0..kept).map(|_| {
                k = next(k);
                vertices[k]
            }));
            self.scratch
                .push(self.crossing(leaving, next(leaving), label));
            self.scratch
                .push(self.crossing(first, entering, self.vertices[entering].label));
        }
        std::mem::swap(&mut self.vertices, &mut self.scratch);
    }

    /// Where the edge from vertex `p`, on our side, to vertex `q` crosses the bisector. The same expression from both sides of the
    /// bisector, so that neighbouring cells share the vertex.
    fn crossing(&self, p: usize, q: usize, label: u32) -> Vertex {
        let (fp, fq) = (self.values[p], self.values[q]);
        let (p, q) = (&self.vertices[p], &self.vertices[q]);
        let t = fp / (fp - fq);
        Vertex {
            u: p.u + t * (q.u - p.u),
            v: p.v + t * (q.v - p.v),
            label,
        }
    }
}

/// The moments of a polygon of the (u, v) plane, as a fan about its first vertex.
fn moments(polygon: &[Vertex]) -> Moments {
    let o = polygon[0];
    let (mut one, mut a, mut b, mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for w in polygon[1..].windows(2) {
        let (a1, b1) = (w[0].u - o.u, w[0].v - o.v);
        let (a2, b2) = (w[1].u - o.u, w[1].v - o.v);
        let d = a1 * b2 - a2 * b1;
        one += d;
        a += d * (a1 + a2);
        b += d * (b1 + b2);
        aa += d * (a1 * a1 + a1 * a2 + a2 * a2);
        ab += d * (2.0 * (a1 * b1 + a2 * b2) + a1 * b2 + a2 * b1);
        bb += d * (b1 * b1 + b1 * b2 + b2 * b2);
    }
    let (one, a, b) = (one / 2.0, a / 6.0, b / 6.0);
    let (aa, ab, bb) = (aa / 12.0, ab / 24.0, bb / 12.0);
    Moments {
        one,
        u: a + o.u * one,
        v: b + o.v * one,
        uu: aa + o.u * (2.0 * a + o.u * one),
        uv: ab + o.u * b + o.v * a + o.u * o.v * one,
        vv: bb + o.v * (2.0 * b + o.v * one),
    }
}
