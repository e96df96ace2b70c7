//! Specks: pieces of a scan that are too small to be seen, and what they would spoil.
//!
//! `vorofit fit` leaves them out, and says so; a library's caller decides. A stray triangle beside a bust made the bust's bounding box larger by a quarter, so that grids saw less of it, and was its largest error.

use super::PolygonMesh;
use super::check::DisjointSets;
use glam::DVec3;

/// A piece with less than this share of the area is a speck: its extent is about 0.03 % of the whole one's, less than the rms of a fit.
const SPECK: f64 = 1e-7;

/// The largest share of the area that all specks may have together. More is no dust: the faces of a mesh may share no vertices.
const DUST: f64 = 1e-3;

/// A mesh without its specks.
#[derive(Debug, Clone, PartialEq)]
pub struct Swept {
    /// All vertices, and the faces of the other pieces.
    pub mesh: PolygonMesh,
    /// How many faces are in specks.
    pub faces: usize,
    /// How far the farthest of them lies outside of the bounding box of the rest, in its diagonals.
    pub farthest: f64,
}

/// A [`sound`](super::check::sound) mesh without the pieces, connected through shared vertices, that have less than 10⁻⁷ of its area; none where it has no such, or where they
/// are more than 0.1 % of it together.
pub fn swept(mesh: &PolygonMesh) -> Option<Swept> {
    let mut pieces = DisjointSets::new(mesh.positions.len());
    for face in mesh.faces() {
        for pair in face.windows(2) {
            pieces.unite(pair[0], pair[1]);
        }
    }
    let mut piece = |face: &[u32]| pieces.root(face[0]) as usize;
    let mut areas = vec![0.0; mesh.positions.len()];
    for face in mesh.faces() {
        areas[piece(face)] += area(mesh, face);
    }
    let total: f64 = areas.iter().sum();
    let dust: f64 = areas.iter().filter(|&&a| a < SPECK * total).sum();
    if dust > DUST * total {
        return None;
    }
    let (specks, kept): (Vec<&[u32]>, Vec<&[u32]>) = mesh
        .faces()
        .partition(|face| areas[piece(face)] < SPECK * total);
    if specks.is_empty() || kept.is_empty() {
        return None;
    }
    let at = |&v: &u32| mesh.positions[v as usize];
    let grow = |(lo, hi): (DVec3, DVec3), p: DVec3| (lo.min(p), hi.max(p));
    let nothing = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (lo, hi) = kept.iter().copied().flatten().map(at).fold(nothing, grow);
    let outside = |p: DVec3| p.distance(p.clamp(lo, hi)) / (hi - lo).length();
    Some(Swept {
        faces: specks.len(),
        farthest: (specks.iter().copied().flatten().map(at))
            .map(outside)
            .fold(0.0, f64::max),
        mesh: PolygonMesh::from_faces(mesh.positions.clone(), kept),
    })
}

/// Of the triangles around the first corner.
fn area(mesh: &PolygonMesh, face: &[u32]) -> f64 {
    let at = |k: usize| mesh.positions[face[k] as usize] - mesh.positions[face[0] as usize];
    let doubled = (2..face.len()).map(|k| at(k - 1).cross(at(k)).length());
    0.5 * doubled.sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    /// A ball of diagonal 2√3 with a triangle of some size at some place.
    fn ball_and(size: f64, at: DVec3) -> PolygonMesh {
        let mut ball = shapes::sphere(1.0, 3);
        let first = ball.positions.len() as u32;
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y].map(|p| at + size * p);
        ball.positions.extend(corners);
        ball.triangles.push([first, first + 1, first + 2]);
        ball.into()
    }

    #[test]
    fn a_stray_triangle_is_swept_away_and_its_distance_told() {
        let dusty = ball_and(1e-5, DVec3::new(0.0, 0.0, 3.0));
        let swept = swept(&dusty).expect("a speck");
        assert_eq!(swept.faces, 1);
        assert_eq!(swept.mesh.face_count() + 1, dusty.face_count());
        assert_eq!(swept.mesh.positions, dusty.positions);
        assert!((swept.farthest - 2.0 / 12f64.sqrt()).abs() < 1e-3);
        let inside = super::swept(&ball_and(1e-5, DVec3::ZERO)).expect("a speck");
        assert_eq!(inside.farthest, 0.0);
    }

    #[test]
    fn what_can_be_seen_stays_and_so_do_faces_that_share_no_vertices() {
        assert_eq!(swept(&PolygonMesh::default()), None);
        assert_eq!(swept(&ball_and(0.01, DVec3::new(0.0, 0.0, 3.0))), None);
        assert_eq!(swept(&shapes::sphere(1.0, 3).into()), None);
        // All alike, and one without area, which is swept.
        let mut soup = PolygonMesh::default();
        for k in 0..300 {
            let at = DVec3::new(f64::from(k), 0.0, 0.0);
            soup.positions.extend([at, at + DVec3::X, at + DVec3::Y]);
            soup.push_face(&[0, 1, 2].map(|c| 3 * k + c));
        }
        assert_eq!(swept(&soup), None);
        soup.positions.extend([DVec3::ZERO; 3]);
        soup.push_face(&[900, 901, 902]);
        assert_eq!(swept(&soup).map(|s| s.faces), Some(1));
        let empty = PolygonMesh::from_faces(vec![DVec3::ZERO; 3], [[0, 1, 2]]);
        assert_eq!(swept(&empty), None);
    }
}
