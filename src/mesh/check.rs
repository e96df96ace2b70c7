//! The door: what a mesh from outside must satisfy, and a census of the flaws that it may have.
//!
//! [`sound`] refuses what no computation can use: no faces, coordinates that are not finite, indices out of range, no extent.
//! [`Census::of`] counts what the fit copes with but its user should know: raw scans have holes, overlaps, slivers and duplicates.

use super::PolygonMesh;
use crate::error::Defect;
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

/// A face whose doubled area is below this share of the sum of its squared edge lengths counts as degenerate.
/// Collinear corners computed in f64 leave about 1e-16; the thinnest triangle of f32 coordinates that is not collinear about 1e-8.
const DEGENERATE_SHARE: f64 = 1e-12;

/// Whether the mesh can be computed with: at least one face, three corners a face, finite coordinates, indices in range, a bounding box
/// with an extent.
///
/// # Errors
/// The first vertex or face that is wrong, counted from 0.
pub fn sound(mesh: &PolygonMesh) -> Result<(), Defect> {
    if mesh.face_count() == 0 {
        return Err(Defect::new(
            "faces",
            format!("there are {} vertices but no faces", mesh.positions.len()),
            "give a surface: a mesh with triangles or polygons",
        ));
    }
    if let Some(v) = mesh.positions.iter().position(|p| !p.is_finite()) {
        return Err(Defect::new(
            format!("vertex {v} (counted from 0)"),
            "its coordinates are not finite",
            "remove the vertex and its faces, or export the mesh again",
        ));
    }
    let vertices = mesh.positions.len();
    let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (f, face) in mesh.faces().enumerate() {
        if face.len() < 3 {
            return Err(Defect::new(
                format!("face {f} (counted from 0)"),
                format!("it has {} corners", face.len()),
                "leave it out: a face has three corners or more",
            ));
        }
        for &v in face {
            let p = *mesh.positions.get(v as usize).ok_or_else(|| {
                Defect::new(
                    format!("face {f} (counted from 0)"),
                    format!("it names vertex {v} of {vertices}"),
                    "export the mesh again",
                )
            })?;
            (lo, hi) = (lo.min(p), hi.max(p));
        }
    }
    check_extent(lo, hi)
}

/// Whether a cloud of points can be computed with: at least one, finite coordinates, a bounding box with an extent.
///
/// # Errors
/// The first point that is wrong, counted from 0.
pub fn sound_points(points: &[DVec3]) -> Result<(), Defect> {
    if points.is_empty() {
        return Err(Defect::new("points", "there are none", "give some"));
    }
    if let Some(k) = points.iter().position(|p| !p.is_finite()) {
        return Err(Defect::new(
            format!("point {k} (counted from 0)"),
            "its coordinates are not finite",
            "remove the point",
        ));
    }
    let lo = points.iter().fold(DVec3::INFINITY, |lo, &p| lo.min(p));
    let hi = points.iter().fold(DVec3::NEG_INFINITY, |hi, &p| hi.max(p));
    check_extent(lo, hi)
}

fn check_extent(lo: DVec3, hi: DVec3) -> Result<(), Defect> {
    let diagonal = (hi - lo).length();
    if !(diagonal > 0.0 && diagonal.is_finite()) {
        return Err(Defect::new(
            "bounding box",
            format!("its diagonal is {diagonal}"),
            "check the coordinates and their units",
        ));
    }
    Ok(())
}

/// How many of each flaw a mesh has. All counts are 0 for a closed, oriented manifold, apart from the sizes and `components` (1).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Census {
    /// Vertices, referenced or not.
    pub vertices: usize,
    /// Faces of three corners and more.
    pub faces: usize,
    /// Faces of fewer than three corners in the file, left out of the mesh.
    pub short_faces: usize,
    /// Faces with a repeated corner or, to rounding, without area.
    pub degenerate_faces: usize,
    /// Faces over the same vertices as an earlier one, in whatever order.
    pub duplicate_faces: usize,
    /// Vertices of no face.
    pub unreferenced_vertices: usize,
    /// Sets of faces that are connected through shared vertices.
    pub components: usize,
    /// Edges of one face.
    pub boundary_edges: usize,
    /// Connected sets of boundary edges. Holes that touch at a vertex count as one.
    pub boundary_loops: usize,
    /// Edges of three faces and more.
    pub non_manifold_edges: usize,
    /// Edges whose two faces run through them in the same direction.
    pub inconsistent_edges: usize,
}

impl Census {
    /// Counts the flaws of a [`sound`] mesh. Cost O(n log n), in parallel.
    ///
    /// # Panics
    /// On indices out of range and faces of fewer than three corners, which [`sound`] refuses.
    pub fn of(mesh: &PolygonMesh) -> Self {
        let mut pieces = DisjointSets::new(mesh.positions.len());
        for face in mesh.faces() {
            for pair in face.windows(2) {
                pieces.unite(pair[0], pair[1]);
            }
        }
        let mut referenced = vec![false; mesh.positions.len()];
        for &v in mesh.faces().flatten() {
            referenced[v as usize] = true;
        }
        let sorted = with_sorted_corners(mesh);
        let degenerate = |&(face, sorted): &(&[u32], &[u32])| {
            sorted.windows(2).any(|pair| pair[0] == pair[1]) || has_no_area(mesh, face)
        };
        let census = Self {
            vertices: mesh.positions.len(),
            faces: mesh.face_count(),
            degenerate_faces: mesh.faces().zip(sorted.faces()).filter(degenerate).count(),
            duplicate_faces: count_equal_faces(&sorted),
            unreferenced_vertices: referenced.iter().filter(|&&r| !r).count(),
            components: pieces.count(|v| referenced[v as usize]),
            ..Self::default()
        };
        census.with_edges(mesh)
    }

    fn with_edges(mut self, mesh: &PolygonMesh) -> Self {
        let edges = sorted_edges(mesh);
        let mut holes = DisjointSets::new(mesh.positions.len());
        let mut on_boundary = vec![false; mesh.positions.len()];
        for same in edges.chunk_by(|a, b| a.edge == b.edge) {
            match same {
                [side] => {
                    self.boundary_edges += 1;
                    let (a, b) = ((side.edge >> 32) as u32, side.edge as u32);
                    holes.unite(a, b);
                    on_boundary[a as usize] = true;
                }
                [one, other] => {
                    self.inconsistent_edges += usize::from(one.forward == other.forward);
                }
                _ => self.non_manifold_edges += 1,
            }
        }
        // The lower end of an edge is marked, and every root is the lowest vertex of its set: it is marked where the set has an edge.
        self.boundary_loops = holes.count(|v| on_boundary[v as usize]);
        self
    }

    /// What a user should know, a line for each kind of flaw found; empty for a closed, connected, oriented manifold.
    pub fn warnings(&self) -> Vec<String> {
        let lines = [
            (
                self.short_faces,
                "faces of fewer than three corners, left out",
            ),
            (
                self.degenerate_faces,
                "degenerate faces (a repeated corner or no area)",
            ),
            (self.duplicate_faces, "duplicate faces"),
            (self.unreferenced_vertices, "vertices that no face uses"),
            (
                self.components.saturating_sub(1),
                "separate pieces beside the first",
            ),
            (self.boundary_loops, "boundary loops (the surface is open)"),
            (
                self.non_manifold_edges,
                "non-manifold edges (three faces or more)",
            ),
            (
                self.inconsistent_edges,
                "edges between faces of opposite orientation",
            ),
        ];
        lines
            .into_iter()
            .filter(|&(count, _)| count > 0)
            .map(|(count, what)| format!("{count} {what}"))
            .collect()
    }
}

fn has_no_area(mesh: &PolygonMesh, face: &[u32]) -> bool {
    let at = |k: usize| mesh.positions[face[k % face.len()] as usize];
    let origin = at(0);
    let (mut area, mut squares) = (DVec3::ZERO, 0.0);
    for k in 0..face.len() {
        let (a, b) = (at(k) - origin, at(k + 1) - origin);
        area += a.cross(b);
        squares += (b - a).length_squared();
    }
    area.length() <= DEGENERATE_SHARE * squares
}

/// The faces with their corners in rising order.
fn with_sorted_corners(mesh: &PolygonMesh) -> PolygonMesh {
    let mut sorted = PolygonMesh::default();
    let mut corners = Vec::new();
    for face in mesh.faces() {
        corners.clear();
        corners.extend_from_slice(face);
        corners.sort_unstable();
        sorted.push_face(&corners);
    }
    sorted
}

/// How many faces repeat an earlier one.
fn count_equal_faces(mesh: &PolygonMesh) -> usize {
    // Comparing the two lowest corners first spares most of the jumps into the corner lists.
    let key = |face: &[u32]| (u64::from(face[0]) << 32) | u64::from(face[1]);
    let mut order: Vec<(u64, usize)> = mesh.faces().map(key).zip(0..).collect();
    let by_corners = |a: &(u64, usize), b: &(u64, usize)| mesh.face(a.1).cmp(mesh.face(b.1));
    order.par_sort_unstable_by(|a, b| a.0.cmp(&b.0).then_with(|| by_corners(a, b)));
    order
        .windows(2)
        .filter(|pair| mesh.face(pair[0].1) == mesh.face(pair[1].1))
        .count()
}

/// A side of a face, filed under its vertices in rising order.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Side {
    /// The lower vertex in the high half: one number sorts much faster than two.
    edge: u64,
    /// Whether the face runs from the lower vertex to the higher.
    forward: bool,
}

/// The sides of all faces, those of one edge next to each other. Sides from a vertex to itself are left out.
fn sorted_edges(mesh: &PolygonMesh) -> Vec<Side> {
    let mut sides: Vec<Side> = mesh
        .faces()
        .flat_map(|face| (0..face.len()).map(move |k| (face[k], face[(k + 1) % face.len()])))
        .filter(|(a, b)| a != b)
        .map(|(a, b)| Side {
            edge: (u64::from(a.min(b)) << 32) | u64::from(a.max(b)),
            forward: a < b,
        })
        .collect();
    sides.par_sort_unstable();
    sides
}

/// Disjoint sets of vertices; the root of a set is its lowest vertex.
pub(super) struct DisjointSets {
    parent: Vec<u32>,
}

impl DisjointSets {
    pub fn new(vertices: usize) -> Self {
        Self {
            parent: (0..vertices as u32).collect(),
        }
    }

    pub fn root(&mut self, mut v: u32) -> u32 {
        while self.parent[v as usize] != v {
            let grandparent = self.parent[self.parent[v as usize] as usize];
            self.parent[v as usize] = grandparent;
            v = grandparent;
        }
        v
    }

    pub fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// The number of sets whose root satisfies a condition.
    fn count(&self, condition: impl Fn(u32) -> bool) -> usize {
        (0..self.parent.len() as u32)
            .filter(|&v| self.parent[v as usize] == v && condition(v))
            .count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    fn corner_points() -> Vec<DVec3> {
        vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]
    }

    fn census(faces: &[&[u32]]) -> Census {
        Census::of(&PolygonMesh::from_faces(corner_points(), faces))
    }

    #[test]
    fn meshes_that_cannot_be_computed_with_are_refused_at_their_element() {
        let place = |positions: Vec<DVec3>, faces: &[[u32; 3]]| {
            sound(&PolygonMesh::from_faces(positions, faces))
                .unwrap_err()
                .place
        };
        assert_eq!(place(vec![], &[]), "faces");
        assert_eq!(place(corner_points(), &[]), "faces");
        assert!(place(corner_points(), &[[0, 1, 2], [1, 2, 4]]).starts_with("face 1 "));
        let edge = PolygonMesh::from_faces(corner_points(), [&[0, 1, 2][..], &[0, 1]]);
        assert!(sound(&edge).unwrap_err().place.starts_with("face 1 "));
        for bad in [f64::NAN, f64::INFINITY] {
            let mut positions = corner_points();
            positions[3].y = bad;
            assert!(place(positions, &[[0, 1, 2]]).starts_with("vertex 3 "));
        }
        assert_eq!(place(vec![DVec3::ONE; 3], &[[0, 1, 2]]), "bounding box");
        let huge = vec![DVec3::ZERO, DVec3::X * 1e300, DVec3::Y * 1e300];
        assert_eq!(place(huge, &[[0, 1, 2]]), "bounding box");
        // An unreferenced vertex gives no extent.
        assert_eq!(place(corner_points(), &[[1, 1, 1]]), "bounding box");
    }

    #[test]
    fn a_tetrahedron_has_no_flaws() {
        let mesh = PolygonMesh::from_faces(corner_points(), TETRAHEDRON);
        assert_eq!(sound(&mesh), Ok(()));
        let census = Census::of(&mesh);
        assert_eq!(census.warnings(), Vec::<String>::new());
        assert_eq!(
            (census.vertices, census.faces, census.components),
            (4, 4, 1)
        );
    }

    #[test]
    fn flaws_are_counted_one_by_one() {
        let open = census(&[&[0, 2, 1], &[0, 1, 3], &[1, 2, 3]]);
        assert_eq!((open.boundary_edges, open.boundary_loops), (3, 1));

        let fan = census(&[&[0, 1, 2], &[1, 0, 3], &[0, 1, 3]]);
        assert_eq!((fan.non_manifold_edges, fan.duplicate_faces), (1, 1));

        let turned = census(&[&[0, 2, 1], &[0, 1, 3], &[1, 2, 3], &[0, 2, 3]]);
        assert_eq!(turned.inconsistent_edges, 3);

        let flat = census(&[&[0, 1, 1], &[0, 1, 0, 2], &[0, 1, 2]]);
        assert_eq!((flat.degenerate_faces, flat.unreferenced_vertices), (2, 1));
    }

    #[test]
    fn collinear_corners_are_degenerate_at_any_scale_and_slivers_are_not() {
        for scale in [1e-9, 1.0, 1e9] {
            let face = |tip: DVec3| {
                let points = [DVec3::ZERO, DVec3::new(0.1, 0.3, 0.7), tip].map(|p| p * scale);
                Census::of(&PolygonMesh::from_faces(points.to_vec(), [[0, 1, 2]])).degenerate_faces
            };
            assert_eq!(face(DVec3::new(0.1, 0.3, 0.7) / 3.0), 1);
            assert_eq!(face(DVec3::new(0.05, 0.15, 0.35 + 1e-7)), 0);
        }
    }

    #[test]
    fn pieces_and_their_loops_are_told_apart() {
        let positions = (0..6)
            .map(|k| DVec3::new(f64::from(k), f64::from(k * k), 0.0))
            .collect();
        let two = Census::of(&PolygonMesh::from_faces(positions, [[0, 1, 2], [5, 4, 3]]));
        assert_eq!(
            (two.components, two.boundary_loops, two.boundary_edges),
            (2, 2, 6)
        );
        assert_eq!(two.warnings().len(), 2);
    }
}
