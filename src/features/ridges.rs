//! Ridges: where a principal curvature is extreme along its own direction.
//!
//! **Theory.** k₁ is extreme along d₁ where b₀ = 0, and k₂ along d₂ where b₃ = 0. Directions have no sign of their own, so that b is compared along an
//! edge after turning both ends alike: s = sgn(d_p·d_q), and the edge is crossed where b_p and s b_q differ in sign. Two crossings of a face are joined
//! where its three edges agree on a sign, s₀₁ s₁₂ s₂₀ > 0; elsewhere an umbilic is near.
//!
//! **Departures.** Which sort of extremum it is (the colour) is told by how b changes along its direction, m = (s b_q − b_p)((q − p)·(d_p + s d_q)), not by
//! P₁ and P₂, whose fourth derivatives no scan gives. b is averaged over neighbours first, with their weights (d_i·d_j)|d_i·d_j|.
//! Edges at sharp edges are left out, and so are vertices whose points leave third derivatives open.

use super::edges::{Edges, NONE};
use super::neighbourhood::Adjacency;
use super::trace::{Chain, Segment, chains};
use super::vertices::Vertices;
use crate::mesh::TriangleMesh;
use glam::DVec3;
use rayon::prelude::*;

/// Times that b is averaged.
const PASSES: usize = 3;

/// One of the two principal curvatures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Family {
    /// k₁ along d₁.
    Greater,
    /// k₂ along d₂.
    Lesser,
}

/// A point where an edge is crossed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cut {
    pub edge: u32,
    /// From the smaller end to the greater.
    pub share: f64,
    pub position: DVec3,
    /// Of the family, and the other one.
    pub curvatures: [f64; 2],
    /// Twice the change of b over the edge times the way along d, and the square of twice that way: their ratio is b's rate of change.
    pub change: [f64; 2],
    /// The change of b over the radius of a neighbourhood divided by this says how sure the ridge is.
    pub third_error: f64,
    pub radius: f64,
}

/// The ridges of one family, as chains of cuts.
pub(super) struct Ridges {
    pub cuts: Vec<Cut>,
    pub segments: Vec<Segment>,
    pub chains: Vec<Chain>,
}

/// One family's part of the Monge forms.
struct Fields<'a> {
    mesh: &'a TriangleMesh,
    vertices: &'a Vertices,
    family: Family,
    /// `[vertices]`: averaged; of no meaning where not known.
    extremality: Vec<f64>,
    is_known: &'a [bool],
}

/// All ridges of a family. `is_known`: `[vertices]`, those whose third derivatives mean something.
pub(super) fn ridges(
    mesh: &TriangleMesh,
    adjacency: &Adjacency,
    edges: &Edges,
    vertices: &Vertices,
    is_known: &[bool],
    family: Family,
) -> Ridges {
    let fields = Fields::new(mesh, adjacency, vertices, is_known, family);
    let cut_of: Vec<Option<Cut>> = edges
        .ends
        .par_iter()
        .enumerate()
        .with_min_len(1024)
        .map(|(edge, &ends)| fields.cut(edge as u32, ends))
        .collect();
    let mut node_of = vec![NONE; cut_of.len()];
    let mut cuts = Vec::new();
    for cut in cut_of.into_iter().flatten() {
        node_of[cut.edge as usize] = cuts.len() as u32;
        cuts.push(cut);
    }
    let mut segments = Vec::new();
    for (face, sides) in edges.of_face.iter().enumerate() {
        let nodes = sides.map(|e| if e == NONE { NONE } else { node_of[e as usize] });
        let ends = match nodes {
            [a, b, NONE] | [a, NONE, b] | [NONE, a, b] if a != NONE && b != NONE => [a, b],
            _ => continue,
        };
        if fields.agrees(mesh.triangles[face]) {
            let face = face as u32;
            segments.push(Segment { ends, face });
        }
    }
    let chains = chains(&segments, cuts.len());
    Ridges {
        cuts,
        segments,
        chains,
    }
}

impl<'a> Fields<'a> {
    fn new(
        mesh: &'a TriangleMesh,
        adjacency: &Adjacency,
        vertices: &'a Vertices,
        is_known: &'a [bool],
        family: Family,
    ) -> Self {
        let index = match family {
            Family::Greater => 0,
            Family::Lesser => 3,
        };
        let mut fields = Self {
            mesh,
            vertices,
            family,
            extremality: vertices
                .forms
                .iter()
                .map(|form| form.third[index])
                .collect(),
            is_known,
        };
        for _ in 0..PASSES {
            fields.extremality = (0..mesh.positions.len() as u32)
                .into_par_iter()
                .with_min_len(1024)
                .map(|v| fields.averaged(adjacency, v))
                .collect();
        }
        fields
    }

    /// Half of a vertex's own value and half of its neighbours', turned to its direction.
    fn averaged(&self, adjacency: &Adjacency, v: u32) -> f64 {
        let own = self.extremality[v as usize];
        if !self.is_known[v as usize] {
            return own;
        }
        let (mut sum, mut total) = (0.0, 0.0);
        for &w in adjacency.around(v) {
            if self.is_known[w as usize] {
                let cosine = self.direction(v).dot(self.direction(w));
                sum += cosine * cosine.abs() * self.extremality[w as usize];
                total += cosine * cosine;
            }
        }
        if total > 0.0 {
            0.5 * (own + sum / total)
        } else {
            own
        }
    }

    fn direction(&self, v: u32) -> DVec3 {
        self.vertices.forms[v as usize].directions[self.family as usize]
    }

    /// 1 or −1: by what the direction at the one end is turned to that at the other.
    fn sign(&self, p: u32, q: u32) -> f64 {
        if self.direction(p).dot(self.direction(q)) < 0.0 {
            -1.0
        } else {
            1.0
        }
    }

    fn agrees(&self, [a, b, c]: [u32; 3]) -> bool {
        self.sign(a, b) * self.sign(b, c) * self.sign(c, a) > 0.0
    }

    fn cut(&self, edge: u32, [p, q]: [u32; 2]) -> Option<Cut> {
        if p == q || !self.is_known[p as usize] || !self.is_known[q as usize] {
            return None;
        }
        let sign = self.sign(p, q);
        let (b_p, b_q) = (
            self.extremality[p as usize],
            sign * self.extremality[q as usize],
        );
        // 0 counts as positive, at every edge of its vertex alike.
        if (b_p < 0.0) == (b_q < 0.0) {
            return None;
        }
        let share = b_p.abs() / (b_p.abs() + b_q.abs());
        let between = |a: f64, b: f64| a + share * (b - a);
        let (from, to) = (
            self.mesh.positions[p as usize],
            self.mesh.positions[q as usize],
        );
        let along = (to - from).dot(self.direction(p) + sign * self.direction(q));
        let own = self.family as usize;
        let curvature = |k: usize| {
            let [a, b] = [p, q].map(|v| self.vertices.forms[v as usize].curvatures[k]);
            between(a, b)
        };
        let [trust_p, trust_q] = [p, q].map(|v| self.vertices.trust[v as usize]);
        Some(Cut {
            edge,
            share,
            position: from.lerp(to, share),
            curvatures: [curvature(own), curvature(1 - own)],
            change: [2.0 * (b_q - b_p) * along, along * along],
            third_error: between(trust_p.third_error, trust_q.third_error),
            radius: between(trust_p.radius, trust_q.radius),
        })
    }
}
