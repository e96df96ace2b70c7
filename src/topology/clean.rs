//! What every topological algorithm wants of a scan first: shared vertices, and no triangle that is none.

use crate::mesh::TriangleMesh;
use crate::mesh::weld::{equal_positions, first_equal};
use glam::DVec3;

/// The mesh with equal positions merged, triangles that then repeat a vertex or another triangle dropped, and unreferenced vertices dropped.
///
/// Positions are equal where only rounding parts them, as for [`crate::mesh::weld`]. Triangles repeat each other where they
/// have the same three vertices in any order; the first one stays. A triangle without area whose vertices differ stays too: without it a
/// closed mesh would be open. What stays keeps its order and its bits. Indices must be in range. O(vertices + triangles).
pub fn cleaned(mesh: &TriangleMesh) -> TriangleMesh {
    let merged = equal_positions(&mesh.positions);
    let mut triangles: Vec<[u32; 3]> = mesh
        .triangles
        .iter()
        .map(|t| t.map(|v| merged[v as usize]))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    let keys: Vec<[u64; 3]> = triangles
        .iter()
        .map(|&t| sorted(t).map(u64::from))
        .collect();
    let first = first_equal(&keys);
    let mut index = 0..;
    triangles.retain(|_| index.next().is_some_and(|t: usize| first[t] as usize == t));
    compacted(&mesh.positions, triangles)
}

/// The mesh of the given triangles over the positions that they refer to, in the same order.
pub(super) fn compacted(positions: &[DVec3], mut triangles: Vec<[u32; 3]>) -> TriangleMesh {
    const UNUSED: u32 = u32::MAX;
    let mut number = vec![UNUSED; positions.len()];
    for &v in triangles.iter().flatten() {
        number[v as usize] = 0;
    }
    let mut kept = Vec::new();
    for (number, &position) in number.iter_mut().zip(positions) {
        if *number != UNUSED {
            *number = kept.len() as u32;
            kept.push(position);
        }
    }
    for v in triangles.iter_mut().flatten() {
        *v = number[*v as usize];
    }
    TriangleMesh {
        positions: kept,
        triangles,
    }
}

fn sorted(mut triangle: [u32; 3]) -> [u32; 3] {
    triangle.sort_unstable();
    triangle
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degenerate_duplicate_and_unreferenced_go() {
        let p = |x, y| DVec3::new(x, y, 0.0);
        let mesh = TriangleMesh {
            // 3 repeats 0 with the other zero, 4 is unreferenced, 5 lies between 0 and 1.
            positions: vec![
                p(0.0, 0.0),
                p(2.0, 0.0),
                p(0.0, 2.0),
                p(-0.0, 0.0),
                p(9.0, 9.0),
                p(1.0, 0.0),
            ],
            triangles: vec![[0, 1, 2], [3, 2, 1], [0, 3, 1], [1, 1, 2], [0, 5, 1]],
        };
        let clean = cleaned(&mesh);
        assert_eq!(clean.triangles, [[0, 1, 2], [0, 3, 1]]);
        assert_eq!(
            clean.positions,
            [p(0.0, 0.0), p(2.0, 0.0), p(0.0, 2.0), p(1.0, 0.0)]
        );
    }

    #[test]
    fn nothing_comes_of_nothing() {
        assert_eq!(cleaned(&TriangleMesh::default()), TriangleMesh::default());
    }
}
