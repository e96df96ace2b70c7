//! Cutting handles: a closed surface of smaller genus, where a short loop is filled on both sides.
//!
//! Simplification under the link condition shrinks a handle or a tunnel until three edges go around it that no triangle fills. Cutting the surface
//! there and closing both ends with a triangle removes the handle, if the loop does not separate the surface.

use super::clean::compacted;
use crate::error::Result;
use crate::mesh::{Connectivity, TriangleMesh};
use glam::DVec3;

/// How far the ends of a cut are drawn in, as a share of the way to the middle of the triangles there.
const DRAWN_IN: f64 = 0.2;

/// A triangle mesh without its handles and tunnels of three edges that are together at most `longest`, the shortest first, and how many those were.
///
/// Loops that separate the surface or touch its boundary stay, whatever their length. O(n) for each handle.
///
/// # Errors
/// Where the mesh is no oriented manifold.
pub fn cut_handles(mesh: &TriangleMesh, longest: f64) -> Result<(TriangleMesh, usize)> {
    let mut mesh = mesh.clone();
    let mut cuts = 0;
    'cutting: loop {
        let connectivity = Connectivity::of(&mesh.clone().into())?;
        for cycle in short_loops(&mesh, &connectivity, longest) {
            if let Some(cut) = cut(&mesh, &connectivity, cycle) {
                mesh = cut;
                cuts += 1;
                continue 'cutting;
            }
        }
        return Ok((mesh, cuts));
    }
}

/// The loops of three edges inside the surface that bound no triangle and are not longer than `longest`, the shortest first.
fn short_loops(mesh: &TriangleMesh, connectivity: &Connectivity, longest: f64) -> Vec<[u32; 3]> {
    let at = |v: u32| mesh.positions[v as usize];
    let mut loops = Vec::new();
    for e in 0..connectivity.edge_count() as u32 {
        let [a, b] = connectivity.ends(e);
        let beside: Vec<u32> = connectivity.spokes(b).map(|(_, v)| v).collect();
        for (_, c) in connectivity.spokes(a) {
            // Each loop once, from its edge of the two smallest vertices.
            if c < a.max(b) || !beside.contains(&c) || has_triangle(connectivity, [a, b, c]) {
                continue;
            }
            if [a, b, c]
                .iter()
                .any(|&v| connectivity.is_boundary_vertex(v))
            {
                continue;
            }
            let length = at(a).distance(at(b)) + at(b).distance(at(c)) + at(c).distance(at(a));
            if length <= longest {
                loops.push((length, [a, b, c]));
            }
        }
    }
    loops.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
    loops.into_iter().map(|(_, cycle)| cycle).collect()
}

fn has_triangle(connectivity: &Connectivity, [a, b, c]: [u32; 3]) -> bool {
    let mut faces = connectivity.around(a).map(|h| connectivity.face_of(h));
    faces.any(|f| {
        let face = connectivity.face(f as usize);
        face.contains(&b) && face.contains(&c)
    })
}

/// The mesh cut along a loop with both ends closed, unless the loop separates it.
fn cut(mesh: &TriangleMesh, connectivity: &Connectivity, cycle: [u32; 3]) -> Option<TriangleMesh> {
    let mut result = mesh.clone();
    let mut copies = [0; 3];
    for k in 0..3 {
        let (v, next, previous) = (cycle[k], cycle[(k + 1) % 3], cycle[(k + 2) % 3]);
        copies[k] = result.positions.len() as u32;
        result.positions.push(mesh.positions[v as usize]);
        // The triangles on the left of the loop, counter-clockwise from one of its edges to the other.
        let fan: Vec<u32> = connectivity.around(v).collect();
        let first = fan.iter().position(|&h| connectivity.target(h) == next)?;
        for i in 0..fan.len() {
            let h = fan[(first + i) % fan.len()];
            if connectivity.target(h) == previous {
                break;
            }
            let f = connectivity.face_of(h) as usize;
            for corner in result.triangles[f].iter_mut().filter(|c| **c == v) {
                *corner = copies[k];
            }
        }
    }
    for v in cycle.into_iter().chain(copies) {
        draw_in(&mut result, v);
    }
    let [a, b, c] = copies;
    result.triangles.extend([[c, b, a], cycle]);
    let pieces = |connectivity: &Connectivity| connectivity.pieces().len();
    let is_whole = |cut: Connectivity| pieces(&cut) == pieces(connectivity);
    let is_whole = Connectivity::of(&result.clone().into()).is_ok_and(is_whole);
    is_whole.then(|| compacted(&result.positions, result.triangles))
}

/// Moves a vertex a little into its own side: the two sides must not be in the same place, where they would be merged again.
fn draw_in(mesh: &mut TriangleMesh, v: u32) {
    let around = mesh.triangles.iter().filter(|t| t.contains(&v));
    let (sum, count) = around.flatten().fold((DVec3::ZERO, 0), |(sum, n), &w| {
        (sum + mesh.positions[w as usize], n + 1)
    });
    let p = &mut mesh.positions[v as usize];
    *p += DRAWN_IN * (sum / f64::from(count.max(1)) - *p);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;
    use crate::topology::{Target, cleaned, simplify};
    use std::f64::consts::TAU;

    fn euler(mesh: &TriangleMesh) -> i64 {
        let connectivity = Connectivity::of(&mesh.clone().into()).expect("a manifold");
        connectivity.validate().expect("consistent");
        connectivity.euler_characteristic()
    }

    /// Three sections around: the shortest loop around the tube has three edges.
    fn ring() -> TriangleMesh {
        shapes::torus(1.0, 0.1, 24, 3).triangulate()
    }

    #[test]
    fn a_ring_is_cut_where_it_is_thin_enough() {
        let around = 3.0 * 0.1 * 3f64.sqrt();
        let (kept, cuts) = cut_handles(&ring(), 0.99 * around).expect("a manifold");
        assert_eq!((cuts, kept), (0, ring()));
        let (open, cuts) = cut_handles(&ring(), 1.01 * around).expect("a manifold");
        assert_eq!((cuts, euler(&open)), (1, 2));
        assert_eq!(open.positions.len(), ring().positions.len() + 3);
        assert_eq!(cleaned(&open), open, "the ends are apart");
    }

    #[test]
    fn a_tunnel_of_a_simplified_ring_is_closed() {
        let ring = shapes::torus(1.0, 0.9, 60, 60).triangulate();
        let coarse = simplify(&ring, Target::Vertices(60)).mesh;
        assert_eq!(euler(&coarse), 0);
        let (closed, cuts) = cut_handles(&coarse, 0.5 * TAU).expect("a manifold");
        assert_eq!((cuts, euler(&closed)), (1, 2));
    }

    #[test]
    fn a_neck_that_separates_is_not_cut_and_balls_have_none() {
        // Two tetrahedra on one triangle.
        let ring = ring();
        let necks = TriangleMesh {
            positions: ring.positions[..5].to_vec(),
            triangles: vec![
                [0, 1, 3],
                [1, 2, 3],
                [2, 0, 3],
                [1, 0, 4],
                [2, 1, 4],
                [0, 2, 4],
            ],
        };
        assert_eq!(cut_handles(&necks, 9.0).expect("a manifold"), (necks, 0));
        let ball = shapes::sphere(1.0, 2);
        assert_eq!(cut_handles(&ball, 9.0).expect("a manifold"), (ball, 0));
        let nothing = TriangleMesh::default();
        assert_eq!(cut_handles(&nothing, 9.0).expect("a manifold").1, 0);
    }
}
