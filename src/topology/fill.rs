//! Filling holes: triangles over the boundary loops of a mesh, on its own vertices.
//!
//! Ears are cut off a loop shortest cut first, convex ones (seen along the loop's area vector) before others. That is
//! no minimal surface, but a plausible floor under a fit: where the target says nothing, the surface bridges.

use crate::mesh::TriangleMesh;
use glam::DVec3;
use std::collections::HashMap;

/// Which boundary loops are holes to be filled; the others are outlines of an open surface.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Holes {
    /// Loops up to a diagonal of the bounding box around: a scan of something closed.
    #[default]
    Bridge,
    /// Only what is less than 3.5 % of the diagonal around, or four and a half cells of the grid that templates come from: a surface with rims.
    Follow,
    /// Nothing from rim to rim: of several scans that overlap, what is a hole in one is mostly there in another ([`crate::reconstruction::bridged`] closes the rest).
    Leave,
}

impl Holes {
    /// In diagonals.
    const fn longest(self) -> f64 {
        match self {
            Self::Bridge => 1.0,
            Self::Follow => 4.5 / 128.0,
            Self::Leave => 0.0,
        }
    }
}

/// Triangles that close the holes of a mesh. Loops that touch themselves are left open.
///
/// Equal positions should be merged first ([`crate::mesh::weld`]), or every seam is a hole.
pub fn fill_holes(mesh: &TriangleMesh, holes: Holes) -> Vec<[u32; 3]> {
    let longest = mesh
        .bounding_box()
        .map_or(0.0, |(lo, hi)| holes.longest() * (hi - lo).length());
    let at = |v: u32| mesh.positions[v as usize];
    let length = |l: &[u32]| -> f64 {
        (0..l.len())
            .map(|k| (at(l[k]) - at(l[(k + 1) % l.len()])).length())
            .sum()
    };
    boundary_loops(mesh)
        .into_iter()
        .filter(|l| length(l) <= longest)
        .flat_map(|l| cut_ears(l, &at))
        .collect()
}

/// Simple closed loops of boundary edges, in the direction that triangles on them have.
fn boundary_loops(mesh: &TriangleMesh) -> Vec<Vec<u32>> {
    let directed = |t: &[u32; 3]| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])];
    let mut used: HashMap<(u32, u32), u32> = HashMap::new();
    for (a, b) in mesh.triangles.iter().flat_map(directed) {
        *used.entry((a.min(b), a.max(b))).or_default() += 1;
    }
    // A filling triangle runs against the edge of its neighbour. None where several boundary edges leave a vertex.
    let mut next: HashMap<u32, Option<u32>> = HashMap::new();
    let mut starts = Vec::new();
    for (a, b) in mesh.triangles.iter().flat_map(directed) {
        if used[&(a.min(b), a.max(b))] == 1 {
            next.entry(b).and_modify(|n| *n = None).or_insert(Some(a));
            starts.push(b);
        }
    }
    let mut loops = Vec::new();
    for start in starts {
        let mut trail = vec![start];
        let mut at = next.insert(start, None).flatten();
        while let Some(v) = at {
            if v == start {
                if trail.len() > 2 {
                    loops.push(trail);
                }
                break;
            }
            trail.push(v);
            at = next.insert(v, None).flatten();
        }
    }
    loops
}

/// Triangulates one loop.
fn cut_ears(mut border: Vec<u32>, at: &impl Fn(u32) -> DVec3) -> Vec<[u32; 3]> {
    let mut triangles = Vec::with_capacity(border.len());
    let origin = at(border[0]);
    let up: DVec3 = (0..border.len())
        .map(|k| (at(border[k]) - origin).cross(at(border[(k + 1) % border.len()]) - origin))
        .sum();
    while border.len() > 3 {
        let n = border.len();
        let ear = |k: usize| [border[(k + n - 1) % n], border[k], border[(k + 1) % n]];
        let cost = |k: usize| {
            let [a, b, c] = ear(k).map(at);
            let convex = (b - a).cross(c - b).dot(up) > 0.0;
            (!convex, (c - a).length_squared())
        };
        let best = (0..n)
            .map(|k| (cost(k), k))
            .min_by(|((p, x), _), ((q, y), _)| p.cmp(q).then(x.total_cmp(y)));
        let Some((_, k)) = best else { break };
        triangles.push(ear(k));
        border.remove(k);
    }
    triangles.push([border[0], border[1], border[2]]);
    triangles
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn a_sphere_with_holes_is_closed_again() {
        let mut sphere = shapes::sphere(1.0, 3);
        let whole = sphere.triangles.len();
        let far = |p: DVec3, from: DVec3| p.distance(from) > 0.4;
        let positions = sphere.positions.clone();
        sphere.triangles.retain(|t| {
            t.iter().all(|&v| {
                let p = positions[v as usize];
                far(p, DVec3::X) && far(p, DVec3::new(0.0, -0.6, 0.8))
            })
        });
        assert!(sphere.triangles.len() < whole - 20);
        assert!(fill_holes(&sphere, Holes::Follow).is_empty());
        let filled = fill_holes(&sphere, Holes::Bridge);
        sphere.triangles.extend(filled);
        assert!(boundary_loops(&sphere).is_empty());
        // Flat caps: a little less than the sphere, and nothing folded outwards.
        assert!((sphere.area() - shapes::sphere(1.0, 3).area()).abs() < 0.1);
    }

    #[test]
    fn outlines_and_soups_are_left() {
        let sheet = TriangleMesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            triangles: vec![[0, 1, 2]],
        };
        assert!(fill_holes(&sheet, Holes::Bridge).is_empty());
        assert!(fill_holes(&TriangleMesh::default(), Holes::Bridge).is_empty());
    }
}
