//! The edges of a triangle mesh that need not be a manifold, and which of them are sharp.

use super::neighbourhood::Adjacency;
use crate::mesh::TriangleMesh;
use glam::DVec3;

/// No face.
pub(super) const NONE: u32 = u32::MAX;

/// An edge between less than this many degrees is never sharp: facets of turned parts are.
const SHARP_DEGREES: f64 = 30.0;
/// Nor is one of less than so many times the usual angle: on a rough scan 30° say nothing.
const SHARP_FACTOR: f64 = 15.0;

/// Edges by their place in the lists of neighbours: that of the greater vertex in the list of the smaller.
pub(super) struct Edges {
    /// `[places, 2]`: the smaller and the greater vertex; equal where the place is not one of an edge.
    pub ends: Vec<[u32; 2]>,
    /// `[places, 2]`: the faces at an edge of one or two; `NONE` otherwise.
    pub faces: Vec<[u32; 2]>,
    /// `[triangles, 3]`: the edges from each corner to the next.
    pub of_face: Vec<[u32; 3]>,
}

impl Edges {
    pub fn of(mesh: &TriangleMesh, adjacency: &Adjacency) -> Self {
        let places = adjacency.len();
        let mut edges = Self {
            ends: vec![[0; 2]; places],
            faces: vec![[NONE; 2]; places],
            of_face: Vec::with_capacity(mesh.triangles.len()),
        };
        let mut counts = vec![0u8; places];
        for (t, &[a, b, c]) in mesh.triangles.iter().enumerate() {
            let sides = [[a, b], [b, c], [c, a]].map(|[a, b]| {
                let ends = [a.min(b), a.max(b)];
                let Some(edge) = adjacency.place(ends[0], ends[1]) else {
                    return NONE;
                };
                let count = &mut counts[edge as usize];
                let faces = &mut edges.faces[edge as usize];
                match *count {
                    0 | 1 => faces[*count as usize] = t as u32,
                    _ => *faces = [NONE; 2],
                }
                *count = (*count + 1).min(3);
                edges.ends[edge as usize] = ends;
                edge
            });
            edges.of_face.push(sides);
        }
        edges
    }

    /// The signed angle between the faces at every edge that has two: positive where the surface is convex, 0 elsewhere.
    fn angles(&self, mesh: &TriangleMesh) -> Vec<f64> {
        let normals: Vec<DVec3> = (0..mesh.triangles.len())
            .map(|t| mesh.area_vector(t).normalize_or_zero())
            .collect();
        let angle = |[f, g]: &[u32; 2]| {
            if *g == NONE {
                return 0.0;
            }
            let [n, m] = [f, g].map(|&f| normals[f as usize]);
            let middle = |f: u32| mesh.corners(f as usize).iter().sum::<DVec3>() / 3.0;
            let convex = (middle(*g) - middle(*f)).dot(n) <= 0.0;
            let angle = n.cross(m).length().atan2(n.dot(m));
            if convex { angle } else { -angle }
        };
        self.faces.iter().map(angle).collect()
    }

    /// The angles at sharp edges; 0 at all others.
    pub fn sharp(&self, mesh: &TriangleMesh) -> Vec<f64> {
        let mut angles = self.angles(mesh);
        let two_sided = |e: &usize| self.faces[*e][1] != NONE;
        let mut sizes: Vec<f64> = (0..angles.len())
            .filter(two_sided)
            .map(|e| angles[e].abs())
            .collect();
        let middle = sizes.len() / 2;
        let usual = match sizes.is_empty() {
            true => 0.0,
            false => *sizes.select_nth_unstable_by(middle, f64::total_cmp).1,
        };
        let least = SHARP_DEGREES.to_radians().max(SHARP_FACTOR * usual);
        for angle in &mut angles {
            // Faces that lie on each other are a fold of the data, not an edge of the shape.
            if angle.abs() < least || angle.abs() > 175f64.to_radians() {
                *angle = 0.0;
            }
        }
        angles
    }
}
