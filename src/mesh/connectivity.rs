//! Who is next to whom in a polygon mesh: half-edges, edges and the faces around a vertex, as flat arrays.
//!
//! A half-edge is named by the corner that it starts from: half-edge `h` runs from corner `h` to the next corner of the same face, with
//! the face on its left. Together with its opposite in the neighbouring face it makes an edge; an edge with a single half-edge
//! is a boundary. Everything here presupposes an oriented 2-manifold, with or without boundary, and [`Connectivity::of`]
//! refuses anything else.

use super::PolygonMesh;
use crate::error::{Error, Result};

/// No half-edge.
const NONE: u32 = u32::MAX;

/// The half-edges and edges of an oriented 2-manifold polygon mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Connectivity {
    /// `[faces + 1]`: the half-edges of face `f` are `offsets[f]..offsets[f + 1]`.
    offsets: Vec<u32>,
    /// `[half-edges]`: the vertex it starts from.
    origins: Vec<u32>,
    /// `[half-edges]`: the face on its left.
    faces: Vec<u32>,
    /// `[half-edges]`: the one that runs back in the neighbouring face, or `NONE`.
    opposites: Vec<u32>,
    /// `[half-edges]`: the edge it belongs to.
    edges: Vec<u32>,
    /// `[edges]`: the edge's half-edge of smaller index.
    sides: Vec<u32>,
    /// `[vertices]`: a half-edge that leaves it, the one on the boundary if there is one; `NONE` without faces.
    outgoing: Vec<u32>,
}

impl Connectivity {
    /// The connectivity of a mesh. O(corners).
    ///
    /// # Errors
    /// Names the element where a face has under three corners, an index out of range or a vertex twice; where an edge belongs to
    /// more than two faces or to two of opposite orientation; where the faces around a vertex are not one fan.
    pub fn of(mesh: &PolygonMesh) -> Result<Self> {
        let vertex_count = mesh.positions.len();
        for (f, face) in mesh.faces().enumerate() {
            check_face(f, face, vertex_count)?;
        }
        let opposites = pair(mesh.offsets(), mesh.corners(), vertex_count)?;
        let connectivity = Self::from_opposites(
            vertex_count,
            mesh.offsets().to_vec(),
            mesh.corners().to_vec(),
            opposites,
        );
        connectivity.check_fans()?;
        Ok(connectivity)
    }

    /// The connectivity of faces whose half-edges are already paired: what a refinement or a submesh of a manifold knows
    /// without a search. `opposites` must be an involution that runs each edge back, `u32::MAX` at the boundary.
    pub(crate) fn from_opposites(
        vertex_count: usize,
        offsets: Vec<u32>,
        origins: Vec<u32>,
        opposites: Vec<u32>,
    ) -> Self {
        let mut faces = vec![0; origins.len()];
        for (f, range) in offsets.windows(2).enumerate() {
            faces[range[0] as usize..range[1] as usize].fill(f as u32);
        }
        let mut edges = vec![0; origins.len()];
        let mut sides = Vec::with_capacity(origins.len() / 2);
        let mut outgoing = vec![NONE; vertex_count];
        for (h, &opposite) in opposites.iter().enumerate() {
            if (opposite as usize) < h {
                edges[h] = edges[opposite as usize];
            } else {
                edges[h] = sides.len() as u32;
                sides.push(h as u32);
            }
            let out = &mut outgoing[origins[h] as usize];
            if opposite == NONE || *out == NONE {
                *out = h as u32;
            }
        }
        Self {
            offsets,
            origins,
            faces,
            opposites,
            edges,
            sides,
            outgoing,
        }
    }

    /// The number of vertices, with those that no face uses.
    pub fn vertex_count(&self) -> usize {
        self.outgoing.len()
    }

    /// The number of edges.
    pub fn edge_count(&self) -> usize {
        self.sides.len()
    }

    /// The number of faces.
    pub fn face_count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// The number of half-edges, which is that of corners.
    pub fn half_edge_count(&self) -> usize {
        self.origins.len()
    }

    /// The vertices of face `f`, counter-clockwise.
    pub fn face(&self, f: usize) -> &[u32] {
        &self.origins[self.offsets[f] as usize..self.offsets[f + 1] as usize]
    }

    /// The vertex lists of all faces, in order.
    pub fn faces(&self) -> impl ExactSizeIterator<Item = &[u32]> + Clone {
        self.offsets
            .windows(2)
            .map(|w| &self.origins[w[0] as usize..w[1] as usize])
    }

    /// The half-edges of face `f`.
    pub fn half_edges(&self, f: usize) -> std::ops::Range<u32> {
        self.offsets[f]..self.offsets[f + 1]
    }

    /// The vertex that half-edge `h` starts from.
    pub fn origin(&self, h: u32) -> u32 {
        self.origins[h as usize]
    }

    /// The vertex that half-edge `h` ends at.
    pub fn target(&self, h: u32) -> u32 {
        self.origin(self.next(h))
    }

    /// The face on the left of half-edge `h`.
    pub fn face_of(&self, h: u32) -> u32 {
        self.faces[h as usize]
    }

    /// The edge of half-edge `h`.
    pub fn edge_of(&self, h: u32) -> u32 {
        self.edges[h as usize]
    }

    /// The half-edge that runs back along `h` in the neighbouring face; `None` at the boundary.
    pub fn opposite(&self, h: u32) -> Option<u32> {
        let opposite = self.opposites[h as usize];
        (opposite != NONE).then_some(opposite)
    }

    /// The half-edge after `h` around its face.
    pub fn next(&self, h: u32) -> u32 {
        let range = self.half_edges(self.face_of(h) as usize);
        if h + 1 == range.end {
            range.start
        } else {
            h + 1
        }
    }

    /// The half-edge before `h` around its face.
    pub fn previous(&self, h: u32) -> u32 {
        let range = self.half_edges(self.face_of(h) as usize);
        if h == range.start {
            range.end - 1
        } else {
            h - 1
        }
    }

    /// The half-edge of edge `e` that has the smaller index.
    pub fn half_edge(&self, e: u32) -> u32 {
        self.sides[e as usize]
    }

    /// The end vertices of edge `e`.
    pub fn ends(&self, e: u32) -> [u32; 2] {
        let h = self.half_edge(e);
        [self.origin(h), self.target(h)]
    }

    /// Whether edge `e` has a face on one side only.
    pub fn is_boundary_edge(&self, e: u32) -> bool {
        self.opposite(self.half_edge(e)).is_none()
    }

    /// Whether vertex `v` lies on the boundary. A vertex without faces does not.
    pub fn is_boundary_vertex(&self, v: u32) -> bool {
        self.outgoing_of(v)
            .is_some_and(|h| self.opposite(h).is_none())
    }

    /// The vertices of each loop of the boundary, in order.
    pub fn boundary_vertices(&self) -> Vec<Vec<u32>> {
        let vertices = |half_edges: Vec<u32>| half_edges.iter().map(|&h| self.origin(h)).collect();
        self.boundary_loops().into_iter().map(vertices).collect()
    }

    /// The half-edges of each loop of the boundary, in order; a loop begins with the first of its half-edges.
    pub fn boundary_loops(&self) -> Vec<Vec<u32>> {
        let is_boundary = |h: u32| self.opposite(h).is_none();
        let mut seen = vec![false; self.half_edge_count()];
        let mut loops = Vec::new();
        for start in (0..self.half_edge_count() as u32).filter(|&h| is_boundary(h)) {
            let mut border = Vec::new();
            let mut h = start;
            while !std::mem::replace(&mut seen[h as usize], true) {
                border.push(h);
                h = self.next(h);
                while let Some(o) = self.opposite(h) {
                    h = self.next(o);
                }
            }
            if !border.is_empty() {
                loops.push(border);
            }
        }
        loops
    }

    /// The half-edges that leave vertex `v`, one for each face around it, counter-clockwise, from one boundary to the other where there is one.
    pub fn around(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let first = self.outgoing_of(v);
        std::iter::successors(first, move |&h| {
            self.opposite(self.previous(h))
                .filter(|&h| Some(h) != first)
        })
    }

    /// The edges at vertex `v` with their other ends, counter-clockwise: as many as faces, and one more on the boundary.
    pub fn spokes(&self, v: u32) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.around(v).flat_map(|h| {
            let back = self.previous(h);
            let last = || (self.edge_of(back), self.origin(back));
            std::iter::once((self.edge_of(h), self.target(h)))
                .chain(self.opposite(back).is_none().then(last))
        })
    }

    /// The edge between two vertices, if they are neighbours.
    pub fn edge_between(&self, a: u32, b: u32) -> Option<u32> {
        self.spokes(a).find(|s| s.1 == b).map(|s| s.0)
    }

    /// The faces that are connected with face `start` through edges, `start` first, among those that `belong`. Marks them as seen and leaves out what has been.
    pub fn connected(
        &self,
        start: usize,
        seen: &mut [bool],
        belong: impl Fn(usize) -> bool,
    ) -> Vec<usize> {
        let mut found = vec![start];
        seen[start] = true;
        let mut next = 0;
        while let Some(&f) = found.get(next) {
            next += 1;
            for o in self.half_edges(f).filter_map(|h| self.opposite(h)) {
                let g = self.face_of(o) as usize;
                if belong(g) && !std::mem::replace(&mut seen[g], true) {
                    found.push(g);
                }
            }
        }
        found
    }

    /// The sets of faces that are connected through edges, each from its first face on.
    pub fn pieces(&self) -> Vec<Vec<usize>> {
        let mut seen = vec![false; self.face_count()];
        let mut pieces = Vec::new();
        for start in 0..seen.len() {
            if !seen[start] {
                pieces.push(self.connected(start, &mut seen, |_| true));
            }
        }
        pieces
    }

    /// Whether all faces are connected through edges.
    pub fn is_connected(&self) -> bool {
        self.pieces().len() <= 1
    }

    /// V − E + F over the vertices that a face uses: 2 − 2g for a closed surface of genus g.
    pub fn euler_characteristic(&self) -> i64 {
        let used = self.outgoing.iter().filter(|&&h| h != NONE).count();
        used as i64 - self.edge_count() as i64 + self.face_count() as i64
    }

    /// Checks every table against the others, for use in tests after an edit.
    ///
    /// # Errors
    /// Names the first half-edge or vertex where two tables disagree.
    pub fn validate(&self) -> Result<()> {
        for h in 0..self.half_edge_count() as u32 {
            let paired = self.opposite(h).is_none_or(|o| {
                self.opposite(o) == Some(h)
                    && self.edge_of(o) == self.edge_of(h)
                    && self.origin(o) == self.target(h)
                    && self.target(o) == self.origin(h)
            });
            let first = self.half_edge(self.edge_of(h));
            let listed = first == h || self.opposite(h) == Some(first);
            if !(paired && listed && self.previous(self.next(h)) == h) {
                return Err(inconsistent(format!("half-edge {h}")));
            }
        }
        for v in 0..self.vertex_count() as u32 {
            if self.outgoing_of(v).is_some_and(|h| self.origin(h) != v) {
                return Err(inconsistent(format!("vertex {v}")));
            }
        }
        self.check_fans()
    }

    fn outgoing_of(&self, v: u32) -> Option<u32> {
        let h = self.outgoing[v as usize];
        (h != NONE).then_some(h)
    }

    /// Every vertex reaches all its corners by walking around it.
    fn check_fans(&self) -> Result<()> {
        let mut corners = vec![0usize; self.vertex_count()];
        for &v in &self.origins {
            corners[v as usize] += 1;
        }
        for (v, &count) in corners.iter().enumerate() {
            if self.around(v as u32).count() != count {
                return Err(Error::input(
                    format!("the faces around vertex {v} form more than one fan"),
                    "give each fan a vertex of its own",
                ));
            }
        }
        Ok(())
    }
}

fn inconsistent(place: String) -> Error {
    Error::input(
        format!("the connectivity contradicts itself at {place}"),
        "report this with the mesh: it is a fault of the program",
    )
}

/// Refuses a face that is no polygon.
fn check_face(f: usize, face: &[u32], vertex_count: usize) -> Result<()> {
    let problem = if face.len() < 3 {
        format!("face {f} has only {} corners", face.len())
    } else if let Some(v) = face.iter().find(|&&v| v as usize >= vertex_count) {
        format!("face {f} refers to vertex {v} of {vertex_count}")
    } else if let Some(v) = (1..face.len()).find(|&i| face[..i].contains(&face[i])) {
        format!("face {f} passes twice through vertex {}", face[v])
    } else {
        return Ok(());
    };
    Err(Error::input(problem, "remove or mend the face"))
}

/// The opposite of every half-edge, found by gathering half-edges at the lower of their two vertices.
fn pair(offsets: &[u32], corners: &[u32], vertex_count: usize) -> Result<Vec<u32>> {
    let mut ends = Vec::with_capacity(corners.len());
    for range in offsets.windows(2) {
        let face = &corners[range[0] as usize..range[1] as usize];
        ends.extend((0..face.len()).map(|k| [face[k], face[(k + 1) % face.len()]]));
    }
    let mut starts = vec![0u32; vertex_count + 1];
    for [a, b] in &ends {
        starts[*a.min(b) as usize + 1] += 1;
    }
    for v in 0..vertex_count {
        starts[v + 1] += starts[v];
    }
    let mut next = starts.clone();
    let mut gathered = vec![(0, 0); ends.len()];
    for (h, [a, b]) in ends.iter().enumerate() {
        let slot = &mut next[*a.min(b) as usize];
        gathered[*slot as usize] = (*a.max(b), h as u32);
        *slot += 1;
    }
    let mut opposites = vec![NONE; ends.len()];
    for range in starts.windows(2) {
        let bucket = &mut gathered[range[0] as usize..range[1] as usize];
        bucket.sort_unstable();
        for edge in bucket.chunk_by(|a, b| a.0 == b.0) {
            match *edge {
                [_] => {}
                [(_, g), (_, h)] if ends[g as usize][0] == ends[h as usize][1] => {
                    opposites[g as usize] = h;
                    opposites[h as usize] = g;
                }
                _ => return Err(not_manifold(ends[edge[0].1 as usize], edge.len())),
            }
        }
    }
    Ok(opposites)
}

fn not_manifold([a, b]: [u32; 2], face_count: usize) -> Error {
    if face_count == 2 {
        Error::input(
            format!("the two faces at the edge of vertices {a} and {b} are oriented differently"),
            "orient all faces the same way",
        )
    } else {
        Error::input(
            format!("{face_count} faces meet at the edge of vertices {a} and {b}"),
            "give a mesh with at most two faces at each edge",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn mesh(vertices: usize, faces: &[&[u32]]) -> PolygonMesh {
        PolygonMesh::from_faces(vec![DVec3::ZERO; vertices], faces)
    }

    fn refusal(vertices: usize, faces: &[&[u32]]) -> String {
        Connectivity::of(&mesh(vertices, faces))
            .expect_err("must be refused")
            .to_string()
    }

    #[test]
    fn bad_faces_are_refused_by_name() {
        assert!(refusal(3, &[&[0, 1]]).contains("face 0 has only 2 corners"));
        assert!(refusal(3, &[&[0, 1, 2], &[0, 2, 3]]).contains("face 1 refers to vertex 3"));
        assert!(refusal(3, &[&[0, 1, 1]]).contains("twice through vertex 1"));
    }

    #[test]
    fn non_manifold_edges_and_vertices_are_refused_by_name() {
        let book = refusal(5, &[&[0, 1, 2], &[1, 0, 3], &[0, 1, 4]]);
        assert!(
            book.contains("3 faces meet at the edge of vertices 0 and 1"),
            "{book}"
        );
        let turned = refusal(4, &[&[0, 1, 2], &[0, 1, 3]]);
        assert!(
            turned.contains("vertices 0 and 1 are oriented differently"),
            "{turned}"
        );
        let bow_tie = refusal(5, &[&[0, 1, 2], &[0, 3, 4]]);
        assert!(
            bow_tie.contains("vertex 0 form more than one fan"),
            "{bow_tie}"
        );
    }

    #[test]
    fn an_empty_mesh_and_unused_vertices_are_no_error() {
        let empty = Connectivity::of(&mesh(2, &[])).unwrap();
        assert_eq!(empty.euler_characteristic(), 0);
        assert_eq!(empty.around(1).count(), 0);
        empty.validate().unwrap();
    }

    #[test]
    fn a_closed_cube_has_its_edges_and_rings() {
        let cube = Connectivity::of(&mesh(
            8,
            &[
                &[0, 2, 3, 1],
                &[4, 5, 7, 6],
                &[0, 1, 5, 4],
                &[2, 6, 7, 3],
                &[0, 4, 6, 2],
                &[1, 3, 7, 5],
            ],
        ))
        .unwrap();
        cube.validate().unwrap();
        assert_eq!((cube.edge_count(), cube.euler_characteristic()), (12, 2));
        for v in 0..8 {
            assert_eq!(cube.around(v).count(), 3);
            assert_eq!(cube.spokes(v).count(), 3);
            assert!(!cube.is_boundary_vertex(v));
        }
        assert!(cube.edge_between(0, 1).is_some() && cube.edge_between(0, 7).is_none());
    }

    #[test]
    fn around_a_boundary_vertex_runs_from_boundary_to_boundary() {
        let fan = Connectivity::of(&mesh(5, &[&[0, 2, 3], &[0, 3, 4], &[0, 1, 2]])).unwrap();
        fan.validate().unwrap();
        let ends: Vec<u32> = fan.spokes(0).map(|s| s.1).collect();
        assert_eq!(ends, [1, 2, 3, 4]);
        assert!(fan.is_boundary_vertex(0));
        assert_eq!(fan.euler_characteristic(), 1);
    }
}
