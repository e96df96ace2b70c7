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
    polygon: Vec<Vertex>,
    scratch: Vec<Vertex>,
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
                    let moments = moments(&self.polygon);
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
            let ours = |f: f64| f > 0.0 || (f == 0.0 && tie_is_ours);
            let inside = f.map(ours);
            if inside == [true; 3] {
                continue;
            }
            if inside == [false; 3] {
                return Cell::Empty;
            }
            if cell == Cell::Whole {
                cell = Cell::Cut;
                self.polygon.clear();
                self.polygon
                    .extend([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)].map(|(u, v)| Vertex {
                        u,
                        v,
                        label: SIDE,
                    }));
            }
            cut(&self.polygon, &mut self.scratch, f, candidates[j], ours);
            std::mem::swap(&mut self.polygon, &mut self.scratch);
            if self.polygon.len() < 3 {
                return Cell::Empty;
            }
        }
        cell
    }

    fn collect_edges(&mut self) {
        for (k, a) in self.polygon.iter().enumerate() {
            if a.label != SIDE {
                let b = self.polygon[(k + 1) % self.polygon.len()];
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

/// Keeps the part of a convex polygon where the affine function with values `f` at the triangle's corners is ours.
fn cut(
    polygon: &[Vertex],
    kept: &mut Vec<Vertex>,
    f: [f64; 3],
    label: u32,
    ours: impl Fn(f64) -> bool,
) {
    kept.clear();
    let value = |p: &Vertex| f[0] + p.u * (f[1] - f[0]) + p.v * (f[2] - f[0]);
    let Some(last) = polygon.last() else { return };
    let (mut a, mut fa) = (last, value(last));
    let mut a_ours = ours(fa);
    for b in polygon {
        let fb = value(b);
        let b_ours = ours(fb);
        if a_ours != b_ours {
            // The same expression from both sides of the bisector, so that neighbouring cells share the cut vertex.
            let (p, q, fp, fq) = if a_ours {
                (a, b, fa, fb)
            } else {
                (b, a, fb, fa)
            };
            let t = fp / (fp - fq);
            kept.push(Vertex {
                u: p.u + t * (q.u - p.u),
                v: p.v + t * (q.v - p.v),
                // Leaving our side, the edge that follows is the bisector; entering it, the rest of the old edge.
                label: if a_ours { label } else { a.label },
            });
        }
        if b_ours {
            kept.push(*b);
        }
        (a, fa, a_ours) = (b, fb, b_ours);
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
