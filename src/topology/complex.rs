//! A triangle complex that edges can be contracted in without changing its topology.
//!
//! **Theory.** Contracting the edge uv keeps the complex's homeomorphism type if Lk(u) ∩ Lk(v) = Lk(uv) [T. K. Dey, H. Edelsbrunner, S. Guha,
//! D. V. Nekhayev, *Topology preserving edge contraction*, 1999, theorem 2], where the complex is first coned: an edge with a number of faces other than
//! two (the rim: boundaries, edges where several sheets meet) sees an extra vertex, and so does a vertex that is neither inside a sheet nor
//! inside a line of the rim (a fixed vertex). For triangles this comes to the five conditions of [`Complex::contractible`]. Nothing is assumed of the
//! input, so there is no such thing as a non-manifold mesh here: sheets, rims and their junctions each stay what they are.
//!
//! **Practice.** Triangles know their edges, and each corner links to the next corner at the same vertex, so a vertex costs one word, merging two
//! vertices relinks their corners, and nothing is allocated after the start.

use glam::DVec3;
use rayon::prelude::*;

/// The end of a list of corners, and the first vertex of a triangle that is gone.
const NONE: u32 = u32::MAX;

/// Corner `k` of triangle `t` is `4 t + k`.
pub(super) type Corner = u32;

/// The triangle of a corner, and its place there.
pub(super) fn split(corner: Corner) -> (usize, usize) {
    ((corner >> 2) as usize, (corner & 3) as usize)
}

/// What a small neighbourhood of a vertex looks like; the order is that of constraint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Place {
    /// A disc.
    Sheet,
    /// Pages that meet along a line: one for a boundary, three and more for a non-manifold edge.
    Rim,
    /// Anything else: the end of a rim, two cones that touch in their tip.
    Fixed,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Triangle {
    pub vertices: [u32; 3],
    /// Opposite the vertex of the same place.
    pub edges: [u32; 3],
    /// The next corner at the vertex of the same place, or `NONE`.
    next: [Corner; 3],
}

impl Triangle {
    /// The positions of its vertices, beginning at place `k`.
    pub fn from(&self, k: usize, positions: &[DVec3]) -> [DVec3; 3] {
        let at = |k: usize| positions[self.vertices[k % 3] as usize];
        [at(k), at(k + 1), at(k + 2)]
    }

    fn alive(&self) -> bool {
        self.vertices[0] != NONE
    }
}

#[derive(Debug, Clone, Copy)]
struct Edge {
    /// Of a contracted edge, the first is the edge that it has become.
    ends: [u32; 2],
    /// 0 of a contracted edge.
    faces: u32,
}

#[derive(Debug, Clone, Copy)]
struct Vertex {
    head: Corner,
    place: Place,
    /// Scratch for [`Complex::contractible`].
    mark: u32,
}

/// Triangles, edges and vertices by number; numbers stay valid through contractions, until the element is gone.
pub(super) struct Complex {
    triangles: Vec<Triangle>,
    edges: Vec<Edge>,
    vertices: Vec<Vertex>,
    stars: [Vec<Corner>; 2],
    stamp: u32,
}

impl Complex {
    /// The complex of fewer than 2³⁰ triangles with three different vertices each, none of them twice; every vertex under `vertex_count` is used.
    pub fn new(triangles: &[[u32; 3]], vertex_count: usize) -> Self {
        let mut complex = Self {
            triangles: triangles
                .iter()
                .map(|&vertices| Triangle {
                    vertices,
                    edges: [NONE; 3],
                    next: [NONE; 3],
                })
                .collect(),
            edges: Vec::with_capacity(triangles.len() * 3 / 2),
            vertices: vec![
                Vertex {
                    head: NONE,
                    place: Place::Sheet,
                    mark: 0
                };
                vertex_count
            ],
            stars: [Vec::new(), Vec::new()],
            stamp: 0,
        };
        complex.link_corners();
        complex.number_edges();
        complex.find_places();
        complex
    }

    /// The edges ever numbered, contracted ones included.
    pub fn edge_count(&self) -> usize {
        self.edges.len()
    }

    /// The end vertices of an edge.
    pub fn ends(&self, edge: u32) -> [u32; 2] {
        self.edges[edge as usize].ends
    }

    /// The number of faces at an edge; 0 where it is contracted.
    pub fn faces(&self, edge: u32) -> u32 {
        self.edges[edge as usize].faces
    }

    /// What the neighbourhood of a vertex looks like.
    pub fn place(&self, vertex: u32) -> Place {
        self.vertices[vertex as usize].place
    }

    /// A triangle that is not gone.
    pub fn triangle(&self, t: usize) -> &Triangle {
        &self.triangles[t]
    }

    /// The vertices of the triangles that are left, in order.
    pub fn remaining(&self) -> impl Iterator<Item = [u32; 3]> {
        self.triangles
            .iter()
            .filter(|t| t.alive())
            .map(|t| t.vertices)
    }

    /// The corners at a vertex.
    pub fn star(&self, vertex: u32) -> impl Iterator<Item = Corner> {
        let mut corner = self.vertices[vertex as usize].head;
        std::iter::from_fn(move || {
            while corner != NONE {
                let (t, k) = split(corner);
                let here = std::mem::replace(&mut corner, self.triangles[t].next[k]);
                if self.triangles[t].alive() {
                    return Some(here);
                }
            }
            None
        })
    }

    /// The corners at the two ends of the edge last asked about in [`Self::contractible`]; after [`Self::contract`], in the
    /// first, those at the vertex that is left.
    pub fn stars(&self) -> &[Vec<Corner>; 2] {
        &self.stars
    }

    /// Whether contracting an edge leaves the topology as it is.
    pub fn contractible(&mut self, edge: u32) -> bool {
        let Edge { ends, faces } = self.edges[edge as usize];
        let places = ends.map(|v| self.place(v));
        // 1. A line of the rim must not be pinched by contracting an edge across a sheet, nor (2.) lose one of its two fixed ends.
        let pinched = if faces == 2 { Place::Rim } else { Place::Fixed };
        if places[0] >= pinched && places[1] >= pinched {
            return false;
        }
        self.gather(0, ends[0]);
        self.gather(1, ends[1]);
        // 3. The vertices that both ends see are those opposite the edge.
        self.mark_links() == faces
            // 4. No triangle would be there twice.
            && !(self.caps(0) && self.caps(1))
            // 5. No two edges of the rim would become one.
            && !self.rims_meet(edge)
    }

    /// Contracts a contractible edge, right after [`Self::contractible`] said so: its faces and second end go, and the first end, which is returned,
    /// inherits the second's faces.
    pub fn contract(&mut self, edge: u32) -> u32 {
        let [kept, gone] = self.ends(edge);
        let [mut star, other] = std::mem::take(&mut self.stars);
        for &corner in &other {
            self.remove_if_at(corner, edge);
        }
        for &corner in &other {
            self.hand_over(corner, gone, kept);
        }
        self.edges[edge as usize].faces = 0;
        star.extend_from_slice(&other);
        star.retain(|&c| self.triangles[split(c).0].alive());
        let place = self.place(kept).max(self.place(gone));
        self.vertices[kept as usize].place = place;
        self.link(kept, &star);
        self.stars = [star, other];
        kept
    }

    /// Removes the triangle of a corner if it lies at `edge`; its other edge at that corner becomes the one across.
    fn remove_if_at(&mut self, corner: Corner, edge: u32) {
        let (t, k) = split(corner);
        let edges = self.triangles[t].edges;
        let Some(apex) = edges.iter().position(|&e| e == edge) else {
            return;
        };
        let (merged, into) = (edges[3 - k - apex], edges[k]);
        // Two sheets' worth of faces become one.
        self.edges[into as usize].faces += self.faces(merged);
        self.edges[into as usize].faces -= 2;
        self.edges[merged as usize] = Edge {
            ends: [into, NONE],
            faces: 0,
        };
        self.triangles[t].vertices = [NONE; 3];
    }

    /// Replaces a vertex by another in the triangle of a corner, if it is alive, and in its edges.
    fn hand_over(&mut self, corner: Corner, gone: u32, kept: u32) {
        let (t, k) = split(corner);
        let triangle = &mut self.triangles[t];
        if !triangle.alive() {
            return;
        }
        triangle.vertices[k] = kept;
        for place in [(k + 1) % 3, (k + 2) % 3] {
            let edge = &mut self.edges[triangle.edges[place] as usize];
            if edge.faces == 0 {
                triangle.edges[place] = edge.ends[0];
            } else {
                edge.ends = edge.ends.map(|v| if v == gone { kept } else { v });
            }
        }
    }

    /// Puts the corners at a vertex into a scratch list, and forgets those of triangles that are gone.
    fn gather(&mut self, side: usize, vertex: u32) {
        let mut star = std::mem::take(&mut self.stars[side]);
        star.clear();
        let mut corner = self.vertices[vertex as usize].head;
        let mut forgotten = false;
        while corner != NONE {
            let (t, k) = split(corner);
            if self.triangles[t].alive() {
                star.push(corner);
            } else {
                forgotten = true;
            }
            corner = self.triangles[t].next[k];
        }
        if forgotten {
            self.link(vertex, &star);
        }
        self.stars[side] = star;
    }

    /// Makes `star` the corners at a vertex.
    fn link(&mut self, vertex: u32, star: &[Corner]) {
        let mut next = NONE;
        for &corner in star.iter().rev() {
            let (t, k) = split(corner);
            self.triangles[t].next[k] = next;
            next = corner;
        }
        self.vertices[vertex as usize].head = next;
    }

    /// Marks the vertices that both ends see with the stamp + 1, and counts them.
    fn mark_links(&mut self) -> u32 {
        self.stamp += 2;
        let (seen, common) = (self.stamp, self.stamp + 1);
        let mut count = 0;
        for (side, star) in self.stars.iter().enumerate() {
            for &corner in star {
                let (t, k) = split(corner);
                let vertices = self.triangles[t].vertices;
                for v in [vertices[(k + 1) % 3], vertices[(k + 2) % 3]] {
                    let mark = &mut self.vertices[v as usize].mark;
                    if side == 0 {
                        *mark = seen;
                    } else if *mark == seen {
                        *mark = common;
                        count += 1;
                    }
                }
            }
        }
        count
    }

    /// Whether a triangle at one end has its other vertices seen by both ends.
    fn caps(&self, side: usize) -> bool {
        self.stars[side].iter().any(|&corner| {
            let (t, k) = split(corner);
            let vertices = self.triangles[t].vertices;
            [vertices[(k + 1) % 3], vertices[(k + 2) % 3]]
                .iter()
                .all(|&v| self.vertices[v as usize].mark == self.stamp + 1)
        })
    }

    /// Whether a face at the edge has both other edges on the rim.
    fn rims_meet(&self, edge: u32) -> bool {
        self.stars[0].iter().any(|&corner| {
            let edges = self.triangles[split(corner).0].edges;
            edges.contains(&edge) && edges.iter().all(|&e| e == edge || self.faces(e) != 2)
        })
    }

    fn link_corners(&mut self) {
        for t in (0..self.triangles.len()).rev() {
            for k in 0..3 {
                let v = self.triangles[t].vertices[k] as usize;
                self.triangles[t].next[k] = self.vertices[v].head;
                self.vertices[v].head = (4 * t + k) as Corner;
            }
        }
    }

    /// Numbers the edges by their lower vertex.
    fn number_edges(&mut self) {
        // For each vertex the last edge that ends there.
        let mut last = vec![NONE; self.vertices.len()];
        for v in 0..self.vertices.len() as u32 {
            let mut corner = self.vertices[v as usize].head;
            while corner != NONE {
                let (t, k) = split(corner);
                let triangle = &mut self.triangles[t];
                for (end, place) in [((k + 1) % 3, (k + 2) % 3), ((k + 2) % 3, (k + 1) % 3)] {
                    let w = triangle.vertices[end];
                    if w < v {
                        continue;
                    }
                    let known = last[w as usize];
                    if known == NONE || self.edges[known as usize].ends[0] != v {
                        last[w as usize] = self.edges.len() as u32;
                        self.edges.push(Edge {
                            ends: [v, w],
                            faces: 0,
                        });
                    }
                    triangle.edges[place] = last[w as usize];
                    self.edges[last[w as usize] as usize].faces += 1;
                }
                corner = triangle.next[k];
            }
        }
    }

    fn find_places(&mut self) {
        let places: Vec<Place> = (0..self.vertices.len() as u32)
            .into_par_iter()
            .with_min_len(1024)
            .map_init(Vec::new, |spokes, v| {
                spokes.clear();
                spokes.extend(self.star(v).map(|c| self.spokes(c)));
                self.place_of(spokes)
            })
            .collect();
        for (vertex, place) in self.vertices.iter_mut().zip(places) {
            vertex.place = place;
        }
    }

    /// What a neighbourhood looks like, from the spokes of its corners.
    fn place_of(&self, star: &[[u32; 2]]) -> Place {
        let mut rims = star
            .iter()
            .flatten()
            .copied()
            .filter(|&e| self.faces(e) != 2);
        let Some(from) = rims.next() else {
            let (length, _) = self.page(star, 0, star[0][0]);
            return if length == star.len() {
                Place::Sheet
            } else {
                Place::Fixed
            };
        };
        let Some(to) = rims.find(|&e| e != from) else {
            return Place::Fixed;
        };
        // Every page that begins at one line must end at the other, and there must be no corner besides.
        let mut corners = 0;
        for first in (0..star.len()).filter(|&i| star[i].contains(&from)) {
            let (length, last) = self.page(star, first, from);
            if last != to {
                return Place::Fixed;
            }
            corners += length;
        }
        if corners == star.len() {
            Place::Rim
        } else {
            Place::Fixed
        }
    }

    /// The number of corners from corner `i`, entered through `entry`, to the rim or back to the entry, and the edge it ends at.
    fn page(&self, star: &[[u32; 2]], mut i: usize, entry: u32) -> (usize, u32) {
        let mut spoke = entry;
        for length in 1..=star.len() {
            let [a, b] = star[i];
            spoke = if a == spoke { b } else { a };
            if spoke == entry || self.faces(spoke) != 2 {
                return (length, spoke);
            }
            i = (0..star.len())
                .find(|&j| j != i && star[j].contains(&spoke))
                .unwrap_or(i);
        }
        (star.len(), spoke)
    }

    /// The two edges of a corner's triangle that meet in it.
    pub fn spokes(&self, corner: Corner) -> [u32; 2] {
        let (t, k) = split(corner);
        let edges = self.triangles[t].edges;
        [edges[(k + 1) % 3], edges[(k + 2) % 3]]
    }
}
