//! Triangles of a mesh that cross each other.
//!
//! Two triangles without a common vertex cross where an edge of one passes through the other; two with one common vertex, where the edge opposite to it
//! does. Signs of volumes decide, in f64, and one of 0 is no crossing: what only touches, lies in one plane or shares an edge never counts.

use super::triangle_tree::{Aabb, TriangleTree, spatial_order};
use glam::DVec3;
use rayon::prelude::*;

/// The pairs of triangles that cross each other, the lower number first, ascending. Cost O(n log n) and the number of overlapping boxes.
pub fn crossings(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let corners = |t: u32| triangles[t as usize].map(|v| positions[v as usize]);
    let centers: Vec<DVec3> = (0..triangles.len() as u32)
        .map(|t| corners(t).into_iter().sum::<DVec3>() / 3.0)
        .collect();
    let order = spatial_order(&centers);
    let sorted: Vec<[DVec3; 3]> = order.iter().map(|&t| corners(t)).collect();
    let tree = TriangleTree::new(&sorted);
    let crossed_by = |k: usize| {
        let mut found = Vec::new();
        let own = Aabb::of(&sorted[k..=k]);
        let mut next = tree.root();
        while let Some(node) = next {
            if node.range().end <= k + 1 || !tree.bounds(node).meets(own) {
                next = node.next();
                continue;
            }
            if !node.is_leaf() {
                next = Some(node.children()[0]);
                continue;
            }
            let later = node.range().filter(|&l| l > k);
            let pairs = later.map(|l| [order[k], order[l]]);
            found
                .extend(pairs.filter(|pair| cross(positions, pair.map(|t| triangles[t as usize]))));
            next = node.next();
        }
        found
    };
    let mut pairs: Vec<[u32; 2]> = (0..triangles.len())
        .into_par_iter()
        .flat_map_iter(crossed_by)
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    pairs.sort_unstable();
    pairs
}

fn cross(positions: &[DVec3], [one, other]: [[u32; 3]; 2]) -> bool {
    let shared = one.iter().filter(|v| other.contains(v)).count();
    let passes = |edge: [u32; 2], through: [u32; 3]| {
        let meets_corner = edge.iter().any(|v| through.contains(v));
        !meets_corner
            && passes(
                edge.map(|v| positions[v as usize]),
                through.map(|v| positions[v as usize]),
            )
    };
    let edges = |[a, b, c]: [u32; 3]| [[a, b], [b, c], [c, a]];
    shared < 2
        && (edges(one).into_iter().any(|edge| passes(edge, other))
            || edges(other).into_iter().any(|edge| passes(edge, one)))
}

/// Whether a segment passes through the inside of a triangle.
fn passes([p, q]: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> bool {
    let volume = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).cross(c - a).dot(d - a);
    if volume(a, b, c, p) * volume(a, b, c, q) >= 0.0 {
        return false;
    }
    let around = [[a, b], [b, c], [c, a]].map(|[a, b]| volume(p, q, a, b));
    around.iter().all(|v| *v > 0.0) || around.iter().all(|v| *v < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;
    use crate::mesh::{TriangleMesh, shapes};

    fn of(mesh: &TriangleMesh) -> Vec<[u32; 2]> {
        crossings(&mesh.positions, &mesh.triangles)
    }

    #[test]
    fn what_touches_does_not_cross() {
        assert!(crossings(&[], &[]).is_empty());
        let point = [[0, 0, 0]; 3];
        assert!(crossings(&[DVec3::ONE], &point).is_empty());
        assert!(of(&shapes::sphere(1.0, 3)).is_empty());
        // In one plane, one over the other; and one that stands on the other.
        let positions = [
            DVec3::ZERO,
            DVec3::X,
            DVec3::Y,
            DVec3::new(0.1, 0.1, 0.0),
            DVec3::new(1.1, 0.1, 0.0),
            DVec3::new(0.1, 1.1, 0.0),
            DVec3::new(0.2, 0.2, 0.0),
            DVec3::new(0.2, 0.2, 1.0),
            DVec3::new(0.3, 0.2, 1.0),
        ];
        assert!(crossings(&positions, &[[0, 1, 2], [3, 4, 5], [6, 7, 8]]).is_empty());
    }

    #[test]
    fn a_common_vertex_hides_no_crossing() {
        let positions = [
            DVec3::ZERO,
            DVec3::new(2.0, -1.0, 0.0),
            DVec3::new(2.0, 1.0, 0.0),
            DVec3::new(1.0, 0.0, -1.0),
            DVec3::new(1.0, 0.0, 1.0),
        ];
        assert_eq!(crossings(&positions, &[[0, 1, 2], [3, 4, 0]]), [[0, 1]]);
        let apart = positions.map(|p| if p.z == 0.0 { p } else { p + 3.0 * DVec3::Y });
        assert!(crossings(&apart, &[[0, 1, 2], [3, 4, 0]]).is_empty());
    }

    #[test]
    fn the_tree_finds_what_all_pairs_have() {
        let mut random = Random::new(5);
        let mut point = |size: f64| DVec3::from([0; 3].map(|_| random.between(-size, size)));
        let mut positions = Vec::new();
        for _ in 0..400 {
            let center = point(1.0);
            positions.extend([0; 3].map(|_| center + point(0.2)));
        }
        let triangles: Vec<[u32; 3]> = (0..400).map(|t| [0, 1, 2].map(|k| 3 * t + k)).collect();
        let found = crossings(&positions, &triangles);
        let all = (0..400).flat_map(|a| (a + 1..400).map(move |b| [a, b]));
        let wanted: Vec<[u32; 2]> = all
            .filter(|pair| cross(&positions, pair.map(|t| triangles[t as usize])))
            .collect();
        assert_eq!(found, wanted);
        assert!(found.len() > 50, "{}", found.len());
    }
}
