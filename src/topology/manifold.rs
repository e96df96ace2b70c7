//! An oriented 2-manifold with boundary from any triangles: cut where it is none.
//!
//! Neighbours are what shares an edge with exactly one other triangle. Walking over those from triangle to triangle orients each connected piece like
//! its first triangle, and where a walk comes back the other way round (a Möbius strip) the edge is cut. Then every fan of triangles around a vertex gets
//! a vertex of its own. All cuts become boundaries; positions do not move.

use crate::mesh::TriangleMesh;

/// The outcome of [`manifold`].
#[derive(Debug, Clone, PartialEq)]
pub struct Manifold {
    /// The mesh, its triangles in the input's order, some turned over.
    pub mesh: TriangleMesh,
    /// Triangles turned over.
    pub turned: usize,
    /// Edges cut: of three and more triangles, or of two that cannot be oriented alike.
    pub cut_edges: usize,
    /// Vertices added, for fans that had one in common.
    pub added_vertices: usize,
}

/// Half-edge 3 t + k runs from corner k of triangle t to the next.
fn next(h: usize) -> usize {
    if h % 3 == 2 { h - 2 } else { h + 1 }
}

/// Makes triangles an oriented manifold, by turning over and by cutting.
///
/// Expects a mesh as [`super::cleaned`] leaves it: three different vertices to a triangle. O(n log n).
pub fn manifold(mesh: &TriangleMesh) -> Manifold {
    let (mut neighbours, mut cut_edges) = pairs(&mesh.triangles);
    let (turn, cut) = orient(mesh, &mut neighbours);
    cut_edges += cut;
    let corners = corners_of_fans(mesh, &neighbours);
    let mut positions = mesh.positions.clone();
    let mut taken = vec![false; positions.len()];
    let mut vertex_of_fan = vec![None; corners.len()];
    let mut triangles = mesh.triangles.clone();
    for (h, &fan) in corners.iter().enumerate() {
        let vertex = vertex_of_fan[fan].get_or_insert_with(|| {
            let v = mesh.triangles[h / 3][h % 3];
            if !std::mem::replace(&mut taken[v as usize], true) {
                return v;
            }
            positions.push(mesh.positions[v as usize]);
            positions.len() as u32 - 1
        });
        triangles[h / 3][h % 3] = *vertex;
    }
    for (triangle, _) in triangles.iter_mut().zip(&turn).filter(|(_, turn)| **turn) {
        triangle.swap(1, 2);
    }
    Manifold {
        added_vertices: positions.len() - mesh.positions.len(),
        mesh: TriangleMesh {
            positions,
            triangles,
        },
        turned: turn.iter().filter(|&&t| t).count(),
        cut_edges,
    }
}

/// The half-edge across each edge of exactly two triangles, in whatever direction it runs; and the number of edges of more.
pub(super) fn pairs(triangles: &[[u32; 3]]) -> (Vec<Option<usize>>, usize) {
    let mut edges: Vec<([u32; 2], usize)> = (0..3 * triangles.len())
        .map(|h| {
            let ends = [h, next(h)].map(|h| triangles[h / 3][h % 3]);
            ([ends[0].min(ends[1]), ends[0].max(ends[1])], h)
        })
        .collect();
    edges.sort_unstable();
    let mut neighbours = vec![None; edges.len()];
    let mut crowded = 0;
    for edge in edges.chunk_by(|a, b| a.0 == b.0) {
        match *edge {
            [_] => {}
            [(_, g), (_, h)] => (neighbours[g], neighbours[h]) = (Some(h), Some(g)),
            _ => crowded += 1,
        }
    }
    (neighbours, crowded)
}

/// Which triangles to turn over; cuts, and counts, the edges where that does not help.
pub(super) fn orient(mesh: &TriangleMesh, neighbours: &mut [Option<usize>]) -> (Vec<bool>, usize) {
    let start = |h: usize| mesh.triangles[h / 3][h % 3];
    let mut turn: Vec<Option<bool>> = vec![None; mesh.triangles.len()];
    let mut cut = 0;
    let mut pending = Vec::new();
    for seed in 0..turn.len() {
        if turn[seed].is_none() {
            turn[seed] = Some(false);
            pending.push(seed);
        }
        while let Some(t) = pending.pop() {
            for h in 3 * t..3 * t + 3 {
                let Some(o) = neighbours[h] else { continue };
                // Alike where the two run along the edge in opposite directions.
                let wanted = turn[t].map(|turned| turned ^ (start(h) == start(o)));
                match turn[o / 3] {
                    None => {
                        turn[o / 3] = wanted;
                        pending.push(o / 3);
                    }
                    Some(_) if turn[o / 3] != wanted => {
                        (neighbours[h], neighbours[o]) = (None, None);
                        cut += 1;
                    }
                    Some(_) => {}
                }
            }
        }
    }
    (turn.into_iter().map(|t| t == Some(true)).collect(), cut)
}

/// `[corners]`: a number for its fan, that of one of the fan's corners.
fn corners_of_fans(mesh: &TriangleMesh, neighbours: &[Option<usize>]) -> Vec<usize> {
    let start = |h: usize| mesh.triangles[h / 3][h % 3];
    let mut fan: Vec<usize> = (0..neighbours.len()).collect();
    fn root(fan: &mut [usize], mut c: usize) -> usize {
        while fan[c] != c {
            fan[c] = fan[fan[c]];
            c = fan[c];
        }
        c
    }
    for (h, &opposite) in neighbours.iter().enumerate() {
        let Some(o) = opposite else { continue };
        for c in [h, next(h)] {
            let across = if start(o) == start(c) { o } else { next(o) };
            let (a, b) = (root(&mut fan, c), root(&mut fan, across));
            fan[a.max(b)] = a.min(b);
        }
    }
    (0..fan.len()).map(|c| root(&mut fan, c)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Connectivity, PolygonMesh, shapes};
    use glam::DVec3;

    fn checked(mesh: &TriangleMesh) -> (Manifold, Connectivity) {
        let result = manifold(mesh);
        let polygons = PolygonMesh::from(result.mesh.clone());
        let connectivity = Connectivity::of(&polygons).expect("a manifold");
        (result, connectivity)
    }

    #[test]
    fn a_manifold_stays_as_it_is() {
        let ball = shapes::sphere(1.0, 2);
        let (result, _) = checked(&ball);
        assert_eq!(result.mesh, ball);
        assert_eq!((result.turned, result.cut_edges), (0, 0));
        assert!(
            checked(&TriangleMesh::default())
                .0
                .mesh
                .triangles
                .is_empty()
        );
    }

    #[test]
    fn triangles_are_turned_like_their_neighbours() {
        let mut ball = shapes::sphere(1.0, 2);
        let good = ball.clone();
        let against = (1..ball.triangles.len()).step_by(3);
        for t in against.clone() {
            ball.triangles[t].swap(0, 1);
        }
        let (result, connectivity) = checked(&ball);
        assert_eq!(connectivity.euler_characteristic(), 2);
        assert_eq!((result.turned, result.cut_edges), (against.len(), 0));
        for t in 0..good.triangles.len() {
            assert!(result.mesh.area_vector(t).dot(good.area_vector(t)) > 0.0);
        }
    }

    #[test]
    fn books_bow_ties_and_moebius_strips_are_cut() {
        let mesh = |vertices: u32, triangles: Vec<[u32; 3]>| TriangleMesh {
            positions: (0..vertices).map(|v| DVec3::splat(f64::from(v))).collect(),
            triangles,
        };
        let book = checked(&mesh(5, vec![[0, 1, 2], [0, 1, 3], [0, 1, 4]])).0;
        assert_eq!((book.cut_edges, book.added_vertices), (1, 4));
        let bow_tie = checked(&mesh(5, vec![[0, 1, 2], [0, 3, 4]])).0;
        assert_eq!((bow_tie.cut_edges, bow_tie.added_vertices), (0, 1));
        let strip = (0..5).map(|k| [k, (k + 1) % 5, (k + 2) % 5]).collect();
        let (moebius, connectivity) = checked(&mesh(5, strip));
        assert_eq!(moebius.cut_edges, 1);
        assert_eq!(connectivity.euler_characteristic(), 1);
    }
}
