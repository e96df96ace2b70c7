//! A ball of hexahedra without a coarse edge on its surface.

use super::grid::cube_corners;
use crate::mesh::{CellShape, VolumeMesh};
use glam::DVec3;
use std::collections::HashMap;
use std::f64::consts::FRAC_PI_4;

/// The half side of a unit ball's inner cube. At 0.5 and two cells to an edge the sizes of the cells differ by a third.
const INNER: f64 = 0.5;

/// How far the inner cube's surface bulges towards the ball: 0 leaves it a cube, 1 makes it a ball. In between the angles along
/// its edges, which three blocks share, are nearer to 120°.
const BULGE: f64 = 0.3;

/// The ellipsoid in the box from `lo` to `hi` as 7 n³ hexahedra: an inner cube, and a block on each of its sides, of n³ each.
///
/// No hexahedron has two faces on the surface, where a perfect fit would make them coplanar and the corner between them degenerate.
pub fn ball(lo: DVec3, hi: DVec3, n: u32) -> VolumeMesh {
    let mut builder = Ball {
        n,
        center: 0.5 * (lo + hi),
        radii: 0.5 * (hi - lo),
        mesh: VolumeMesh::default(),
        index: HashMap::new(),
    };
    for k in 0..n {
        for (j, i) in (0..n).flat_map(|j| (0..n).map(move |i| (j, i))) {
            builder.push(cube_corners([i, j, k]).map(|at| (at, 0)));
        }
    }
    for axis in 0..3 {
        for layer in 0..n {
            for (j, i) in (0..n).flat_map(|j| (0..n).map(move |i| (j, i))) {
                for side in [0, n] {
                    let mut quad = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[di, dj]| {
                        let mut at = [side; 3];
                        (at[(axis + 1) % 3], at[(axis + 2) % 3]) = (i + di, j + dj);
                        at
                    });
                    if side == 0 {
                        quad.reverse();
                    }
                    let corner = |k: usize| (quad[k % 4], layer + k as u32 / 4);
                    builder.push([0, 1, 2, 3, 4, 5, 6, 7].map(corner));
                }
            }
        }
    }
    builder.mesh
}

/// A ball under construction. A vertex is a point of the inner cube's lattice and a layer outside of it, 0 for the cube itself.
struct Ball {
    n: u32,
    center: DVec3,
    radii: DVec3,
    mesh: VolumeMesh,
    index: HashMap<([u32; 3], u32), u32>,
}

impl Ball {
    fn push(&mut self, corners: [([u32; 3], u32); 8]) {
        let vertices = corners.map(|key| {
            if let Some(&v) = self.index.get(&key) {
                return v;
            }
            let v = self.mesh.positions.len() as u32;
            self.index.insert(key, v);
            self.mesh.positions.push(self.position(key));
            v
        });
        self.mesh.push_cell(CellShape::Hexahedron, &vertices);
    }

    fn position(&self, (at, layer): ([u32; 3], u32)) -> DVec3 {
        let n = f64::from(self.n);
        let cube = DVec3::from(at.map(|i| 2.0 * f64::from(i) / n - 1.0));
        let reach = cube.abs().max_element();
        // Equal angles, not equal lengths, along the edges of the cube.
        let on_sphere =
            DVec3::from(cube.to_array().map(|x| (FRAC_PI_4 * x).tan())).normalize_or_zero();
        let inner = INNER * cube.lerp(reach * on_sphere, BULGE);
        let unit = inner.lerp(on_sphere, f64::from(layer) / n);
        self.center + self.radii * unit
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::corner_determinants;
    use super::*;

    #[test]
    fn balls_are_not_inverted_and_end_on_the_ellipsoid() {
        for n in [1, 2, 3, 5] {
            let mesh = ball(DVec3::new(-1.0, -2.0, -3.0), DVec3::new(1.0, 2.0, 5.0), n);
            assert_eq!(mesh.cell_count(), 7 * (n as usize).pow(3));
            assert!(corner_determinants(&mesh).iter().all(|&det| det > 0.0));
            let radius = |p: &DVec3| ((*p - DVec3::Z) / DVec3::new(1.0, 2.0, 4.0)).length();
            let outside = mesh
                .positions
                .iter()
                .filter(|p| (radius(p) - 1.0).abs() < 1e-14);
            assert_eq!(outside.count(), 6 * (n as usize).pow(2) + 2);
            assert!(mesh.positions.iter().all(|p| radius(p) < 1.0 + 1e-14));
        }
    }
}
