//! Which way triangles face, by vote: scans come with some turned over, or all.

use super::manifold::{orient, pairs};
use crate::mesh::TriangleMesh;
use glam::DVec3;

/// All is turned over only where it clearly encloses a negative volume, as a share of the sum of the parts' sizes: of an open sheet nobody can say.
const CLEAR: f64 = 0.01;

/// The mesh with every triangle facing like the larger part, by area, of those that it is connected with, and all of it outwards if it encloses anything.
///
/// Connected is what shares an edge with exactly one other triangle. A mesh that faces outwards everywhere comes back with its own bits. Expects a mesh as [`super::cleaned`]
/// leaves it. O(n log n).
pub fn oriented(mesh: &TriangleMesh) -> TriangleMesh {
    let (mut neighbours, _) = pairs(&mesh.triangles);
    let (mut turn, _) = orient(mesh, &mut neighbours);
    let area = |t: usize| 0.5 * mesh.area_vector(t).length();
    for piece in pieces(&neighbours) {
        let (as_given, turned) =
            piece
                .iter()
                .fold((0.0, 0.0), |(given, turned), &t| match turn[t] {
                    false => (given + area(t), turned),
                    true => (given, turned + area(t)),
                });
        if turned > as_given {
            for &t in &piece {
                turn[t] = !turn[t];
            }
        }
    }
    let mut result = mesh.clone();
    turn_over(&mut result, |t| turn[t]);
    if faces_inwards(&result) {
        turn_over(&mut result, |_| true);
    }
    result
}

fn turn_over(mesh: &mut TriangleMesh, which: impl Fn(usize) -> bool) {
    for (t, triangle) in mesh.triangles.iter_mut().enumerate() {
        if which(t) {
            triangle.swap(1, 2);
        }
    }
}

/// The sets of triangles that are connected through neighbours across edges.
fn pieces(neighbours: &[Option<usize>]) -> Vec<Vec<usize>> {
    let mut seen = vec![false; neighbours.len() / 3];
    let mut pieces = Vec::new();
    for start in 0..seen.len() {
        if std::mem::replace(&mut seen[start], true) {
            continue;
        }
        let mut piece = vec![start];
        let mut next = 0;
        while let Some(&t) = piece.get(next) {
            next += 1;
            for o in neighbours[3 * t..3 * t + 3].iter().flatten() {
                if !std::mem::replace(&mut seen[o / 3], true) {
                    piece.push(o / 3);
                }
            }
        }
        pieces.push(piece);
    }
    pieces
}

/// Whether the volume under the triangles, seen from their middle, is clearly negative.
fn faces_inwards(mesh: &TriangleMesh) -> bool {
    let triangles = || {
        (0..mesh.triangles.len()).map(|t| {
            let center = mesh.corners(t).iter().sum::<DVec3>() / 3.0;
            (center, mesh.area_vector(t))
        })
    };
    let (total, first) = triangles().fold((0.0, DVec3::ZERO), |(total, first), (c, a)| {
        (total + a.length(), first + a.length() * c)
    });
    let middle = first / total;
    let (volume, size) = triangles().fold((0.0, 0.0), |(volume, size), (c, a)| {
        let out = c - middle;
        (volume + out.dot(a), size + out.length() * a.length())
    });
    volume < -CLEAR * size
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    fn disturbed(step: usize) -> TriangleMesh {
        let mut ball = shapes::sphere(1.0, 2);
        for t in ball.triangles.iter_mut().step_by(step) {
            t.swap(0, 1);
        }
        ball
    }

    fn outwards(mesh: &TriangleMesh) -> usize {
        let out = |&t: &usize| mesh.area_vector(t).dot(mesh.corners(t)[0]) > 0.0;
        (0..mesh.triangles.len()).filter(out).count()
    }

    #[test]
    fn what_faces_outwards_stays_and_nothing_is_no_error() {
        let ball = shapes::sphere(1.0, 2);
        assert_eq!(oriented(&ball), ball);
        let torus = shapes::torus(2.0, 1.0, 12, 8).triangulate();
        assert_eq!(oriented(&torus), torus);
        assert_eq!(oriented(&TriangleMesh::default()), TriangleMesh::default());
    }

    #[test]
    fn turned_triangles_are_turned_back() {
        for step in [1, 2, 3, 7] {
            let ball = oriented(&disturbed(step));
            assert_eq!(outwards(&ball), ball.triangles.len(), "every {step}th");
        }
    }

    #[test]
    fn a_sheet_keeps_the_side_that_most_of_it_faces() {
        let mut sheet = shapes::sphere(1.0, 2);
        let flat = |p: &mut DVec3| p.z = 0.0;
        let upper = |t: &[u32; 3]| t.iter().all(|&v| sheet.positions[v as usize].z > 0.1);
        sheet.triangles = sheet.triangles.iter().copied().filter(upper).collect();
        sheet.positions.iter_mut().for_each(flat);
        let up =
            |mesh: &TriangleMesh| (0..mesh.triangles.len()).all(|t| mesh.area_vector(t).z > 0.0);
        assert!(up(&sheet));
        let given = sheet.clone();
        for t in sheet.triangles.iter_mut().step_by(3) {
            t.swap(0, 1);
        }
        assert!(up(&oriented(&sheet)));
        assert_eq!(oriented(&given), given);
    }
}
