//! Which vertices a jet is fitted to: those of a ball around its vertex that are connected to it within the ball, in a frame of its own.

use super::monge::JetFrame;
use crate::kernel::jet::{JetInput, MAX_POINTS};
use crate::mesh::TriangleMesh;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::ops::Range;

/// A ball of fewer points is widened ring by ring: 15 coefficients, and some more to average.
const MIN_POINTS: usize = 24;
/// A ball is walked no further than this many points; of more than [`MAX_POINTS`] an even choice is taken.
const MAX_WALK: usize = 1024;
/// The cosine from which on a normal faces the other way: the far side of a thin sheet is no neighbour.
const FACING: f64 = -0.2;
/// Vertices that a thread takes at a time.
const GRAIN: usize = 64;

/// Who is next to whom, by edges.
#[derive(Debug, Clone, Default)]
pub(super) struct Adjacency {
    offsets: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Adjacency {
    /// Of the vertices of triangles, whatever they make up.
    pub fn of(mesh: &TriangleMesh) -> Self {
        let mut starts = vec![0u32; mesh.positions.len() + 1];
        for &v in mesh.triangles.as_flattened() {
            starts[v as usize + 1] += 2;
        }
        for v in 1..starts.len() {
            starts[v] += starts[v - 1];
        }
        let mut next = starts.clone();
        let mut all = vec![0u32; starts[mesh.positions.len()] as usize];
        for &[a, b, c] in &mesh.triangles {
            for (v, others) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
                let free = &mut next[v as usize];
                all[*free as usize] = others[0];
                all[*free as usize + 1] = others[1];
                *free += 2;
            }
        }
        let mut adjacency = Self {
            offsets: vec![0],
            neighbours: Vec::with_capacity(all.len() / 2),
        };
        for (v, range) in starts.windows(2).enumerate() {
            let list = &mut all[range[0] as usize..range[1] as usize];
            list.sort_unstable();
            let first = adjacency.neighbours.len();
            for &w in list.iter().filter(|&&w| w as usize != v) {
                if adjacency.neighbours[first..].last() != Some(&w) {
                    adjacency.neighbours.push(w);
                }
            }
            adjacency.offsets.push(adjacency.neighbours.len() as u32);
        }
        adjacency
    }

    /// The number of places in all lists of neighbours.
    pub fn len(&self) -> usize {
        self.neighbours.len()
    }

    /// The place of a vertex in the list of another.
    pub fn place(&self, v: u32, neighbour: u32) -> Option<u32> {
        let found = self.around(v).binary_search(&neighbour).ok()?;
        Some(self.offsets[v as usize] + found as u32)
    }

    /// The neighbours of a vertex, ascending.
    pub fn around(&self, v: u32) -> &[u32] {
        let range = self.offsets[v as usize] as usize..self.offsets[v as usize + 1] as usize;
        &self.neighbours[range]
    }
}

/// Finds the neighbourhoods of a mesh's vertices.
pub(super) struct Neighbourhoods<'a> {
    pub mesh: &'a TriangleMesh,
    /// `[vertices]`: unit, or zero.
    pub normals: &'a [DVec3],
    pub adjacency: &'a Adjacency,
    /// `[vertices]`: whether a ball that comes to it goes no further: it lies on a sharp edge.
    pub is_barrier: &'a [bool],
    pub radius: f64,
}

impl Neighbourhoods<'_> {
    /// The neighbourhoods of some vertices as groups for the kernel, with their frames.
    pub fn local(&self, vertices: &[u32]) -> (JetInput, Vec<JetFrame>) {
        let vertex_count = self.mesh.positions.len();
        let parts: Vec<_> = vertices
            .par_chunks(GRAIN)
            .map_init(
                || Walk::new(vertex_count),
                |walk, part| {
                    let mut local = Local::default();
                    for &v in part {
                        walk.ball(self, v);
                        local.push(self, v, &walk.found);
                    }
                    local
                },
            )
            .collect();
        let mut input = JetInput {
            offsets: vec![0],
            points: Vec::with_capacity(parts.iter().map(|p| p.points.len()).sum()),
        };
        let mut frames = Vec::with_capacity(vertices.len());
        for part in parts {
            let base = input.points.len();
            input
                .offsets
                .extend(part.ends.iter().map(|end| (base + end) as u32));
            input.points.extend(part.points);
            frames.extend(part.frames);
        }
        (input, frames)
    }
}

/// Neighbourhoods of consecutive vertices.
#[derive(Default)]
struct Local {
    ends: Vec<usize>,
    points: Vec<DVec3>,
    frames: Vec<JetFrame>,
}

impl Local {
    /// Appends the found vertices in coordinates along the normal of `v`, as large as they reach.
    fn push(&mut self, all: &Neighbourhoods<'_>, v: u32, found: &[u32]) {
        let at = |v: u32| all.mesh.positions[v as usize];
        let origin = at(v);
        let normal = all.normals[v as usize];
        let axes = match normal == DVec3::ZERO {
            true => DMat3::IDENTITY,
            false => {
                let (x, y) = normal.any_orthonormal_pair();
                DMat3::from_cols(x, y, normal)
            }
        };
        let count = found.len().min(MAX_POINTS);
        let chosen = || (0..count).map(|k| at(found[k * found.len() / count]) - origin);
        let reach = chosen()
            .map(DVec3::length_squared)
            .fold(0.0, f64::max)
            .sqrt();
        let radius = if reach > 0.0 { reach } else { 1.0 };
        let to_local = axes.transpose() * (1.0 / radius);
        self.points.extend(chosen().map(|p| to_local * p));
        self.ends.push(self.points.len());
        self.frames.push(JetFrame { axes, radius });
    }
}

/// A walk over the mesh from a vertex.
struct Walk {
    /// `[vertices]`: the walk that last saw each.
    seen: Vec<u32>,
    walk: u32,
    /// In the order of rings.
    found: Vec<u32>,
    /// Seen beyond the ball.
    outside: Vec<u32>,
}

impl Walk {
    fn new(vertices: usize) -> Self {
        Self {
            seen: vec![0; vertices],
            walk: 0,
            found: Vec::new(),
            outside: Vec::new(),
        }
    }

    /// Finds the ball of a vertex, with itself first.
    fn ball(&mut self, all: &Neighbourhoods<'_>, v: u32) {
        self.walk += 1;
        self.found.clear();
        self.outside.clear();
        self.found.push(v);
        self.seen[v as usize] = self.walk;
        let mut head = 0;
        while head < self.found.len() && self.found.len() < MAX_WALK {
            self.visit(all, v, head..head + 1, all.radius);
            head += 1;
        }
        while self.found.len() < MIN_POINTS && !self.outside.is_empty() {
            let begin = self.found.len();
            self.found.append(&mut self.outside);
            self.visit(all, v, begin..self.found.len(), all.radius);
        }
    }

    /// Looks at the neighbours of some found vertices.
    fn visit(&mut self, all: &Neighbourhoods<'_>, v: u32, range: Range<usize>, radius: f64) {
        let origin = all.mesh.positions[v as usize];
        let normal = all.normals[v as usize];
        for k in range {
            let at = self.found[k];
            if all.is_barrier[at as usize] && !all.is_barrier[v as usize] {
                continue;
            }
            for &w in all.adjacency.around(at) {
                let seen = &mut self.seen[w as usize];
                if *seen == self.walk {
                    continue;
                }
                *seen = self.walk;
                if all.normals[w as usize].dot(normal) <= FACING {
                    continue;
                }
                let near =
                    all.mesh.positions[w as usize].distance_squared(origin) <= radius * radius;
                match near {
                    true => self.found.push(w),
                    false => self.outside.push(w),
                }
            }
        }
    }
}
