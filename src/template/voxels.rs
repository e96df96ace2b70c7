//! Sets of cubes in a grid, and their surface: what is inside a target, however broken its triangles are.

use crate::mesh::PolygonMesh;
use glam::{DVec3, UVec3};
use std::cmp::Reverse;
use std::sync::OnceLock;

/// Layers of cubes around a box, so that what grows in it stays away from the border of the grid.
const MARGIN: f64 = 3.0;

/// Equal cubes that fill a box.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    lo: DVec3,
    /// The edge of a cube.
    pub h: f64,
    size: [usize; 3],
}

impl Grid {
    /// Cubes of edge `h` in the box from `lo` to `hi` and in a margin around it.
    pub fn around((lo, hi): (DVec3, DVec3), h: f64) -> Self {
        let size = ((hi - lo) / h).ceil() + 2.0 * MARGIN;
        Self {
            // The box in the middle of the grid.
            lo: 0.5 * (lo + hi - size * h),
            h,
            size: size
                .as_uvec3()
                .max(UVec3::ONE)
                .to_array()
                .map(|n| n as usize),
        }
    }

    /// The centres of all cubes, in their order: x runs fastest.
    pub fn centers(&self) -> Vec<DVec3> {
        let [nx, ny, nz] = self.size;
        let rows = (0..nz).flat_map(|k| (0..ny).map(move |j| (j, k)));
        rows.flat_map(|(j, k)| (0..nx).map(move |i| [i, j, k]))
            .map(|at| self.corner(at) + 0.5 * self.h)
            .collect()
    }

    /// The cube that a point is in; none outside of the grid.
    pub fn cell_at(&self, p: DVec3) -> Option<usize> {
        let at = ((p - self.lo) / self.h).floor().to_array();
        let is_in = (0..3).all(|k| at[k] >= 0.0 && at[k] < self.size[k] as f64);
        is_in.then(|| {
            let strides = self.strides();
            (0..3).map(|k| at[k] as usize * strides[k]).sum()
        })
    }

    /// The lowest corner of a cube.
    fn corner(&self, at: [usize; 3]) -> DVec3 {
        self.lo + self.h * DVec3::from(at.map(|i| i as f64))
    }

    /// From a cube's index to that of the next one along each axis.
    fn strides(&self) -> [usize; 3] {
        [1, self.size[0], self.size[0] * self.size[1]]
    }

    fn place(&self, cell: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [cell % nx, cell / nx % ny, cell / (nx * ny)]
    }
}

/// Some cubes of a grid, none on its border.
#[derive(Debug, Clone)]
pub(super) struct Voxels {
    grid: Grid,
    /// `[cubes]`.
    inside: Vec<bool>,
}

impl Voxels {
    /// The cubes that are marked; `inside`: `[cubes]`.
    pub fn new(grid: &Grid, inside: Vec<bool>) -> Self {
        let mut voxels = Self {
            grid: grid.clone(),
            inside,
        };
        for cell in 0..voxels.inside.len() {
            let at = grid.place(cell);
            let border = (0..3).any(|k| at[k] == 0 || at[k] + 1 == grid.size[k]);
            voxels.inside[cell] &= !border;
        }
        voxels
    }

    /// Keeps of the sets that are connected through faces the largest, at most so many, that have this share of the cubes of the first.
    pub fn keep_large(&mut self, most: usize, share: f64) {
        let mut seen = vec![false; self.inside.len()];
        let mut pieces = Vec::new();
        for cell in 0..self.inside.len() {
            if self.inside[cell] && !seen[cell] {
                pieces.push(self.flood(cell, &mut seen));
            }
        }
        pieces.sort_by_key(|piece| Reverse(piece.len()));
        pieces.truncate(most);
        let largest = pieces.first().map_or(0, Vec::len);
        pieces.retain(|piece| piece.len() as f64 >= share * largest as f64);
        self.inside.fill(false);
        for cell in pieces.into_iter().flatten() {
            self.inside[cell] = true;
        }
    }

    /// Adds what the outside cannot reach through faces.
    pub fn fill_cavities(&mut self) {
        let mut seen = vec![false; self.inside.len()];
        self.flood(0, &mut seen);
        self.inside = seen.into_iter().map(|outside| !outside).collect();
    }

    /// Removes the outermost layer.
    pub fn erode(&mut self) {
        let kept = |cell| self.inside[cell] && self.neighbours(cell).all(|n| self.inside[n]);
        self.inside = (0..self.inside.len()).map(kept).collect();
    }

    /// Adds cubes until the surface is a manifold: none that touches another in an edge or a corner only, inside or outside.
    pub fn fill_pinches(&mut self) {
        let [x, y, z] = self.grid.strides();
        let block = [0, x, y, x + y, z, x + z, y + z, x + y + z];
        let blocks = self.inside.len() - block[7];
        let mended = mended_blocks();
        loop {
            let mut changed = false;
            for first in 0..blocks {
                let mask = (0..8).fold(0, |mask, k| {
                    mask | usize::from(self.inside[first + block[k]]) << k
                });
                if mended[mask] as usize != mask {
                    for k in (0..8).filter(|k| mended[mask] >> k & 1 == 1) {
                        self.inside[first + block[k]] = true;
                    }
                    changed = true;
                }
            }
            if !changed {
                return;
            }
        }
    }

    /// The squares between inside and outside, facing outwards. A closed manifold after [`Self::fill_pinches`].
    pub fn surface(&self) -> PolygonMesh {
        const NONE: u32 = u32::MAX;
        let size = self.grid.size.map(|n| n + 1);
        let mut vertex = vec![NONE; size[0] * size[1] * size[2]];
        let mut mesh = PolygonMesh::default();
        let strides = self.grid.strides();
        for cell in (0..self.inside.len()).filter(|&c| self.inside[c]) {
            let at = self.grid.place(cell);
            for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
                let beyond = cell + side * 2 * strides[axis] - strides[axis];
                if self.inside[beyond] {
                    continue;
                }
                let mut quad = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[u, v]| {
                    let mut corner = at;
                    corner[axis] += side;
                    corner[(axis + 1) % 3] += u;
                    corner[(axis + 2) % 3] += v;
                    let index = corner[0] + size[0] * (corner[1] + size[1] * corner[2]);
                    if vertex[index] == NONE {
                        vertex[index] = mesh.positions.len() as u32;
                        mesh.positions.push(self.grid.corner(corner));
                    }
                    vertex[index]
                });
                if side == 0 {
                    quad.reverse();
                }
                mesh.push_face(&quad);
            }
        }
        mesh
    }

    /// The cubes across the faces of a cube that is not on the border.
    fn neighbours(&self, cell: usize) -> impl Iterator<Item = usize> {
        let strides = self.grid.strides();
        strides.into_iter().flat_map(move |s| [cell - s, cell + s])
    }

    /// What is connected to `start` through faces and on the same side as it; marks it as seen.
    fn flood(&self, start: usize, seen: &mut [bool]) -> Vec<usize> {
        let mut found = vec![start];
        seen[start] = true;
        let mut next = 0;
        while let Some(&cell) = found.get(next) {
            next += 1;
            let at = self.grid.place(cell);
            for (axis, stride) in self.grid.strides().into_iter().enumerate() {
                let below = (at[axis] > 0).then(|| cell - stride);
                let above = (at[axis] + 1 < self.grid.size[axis]).then(|| cell + stride);
                for n in [below, above].into_iter().flatten() {
                    if !seen[n] && self.inside[n] == self.inside[start] {
                        seen[n] = true;
                        found.push(n);
                    }
                }
            }
        }
        found
    }
}

/// For each set of the eight cubes around a corner the smallest one with it whose surface is one disc there (the lowest number among equals): both
/// sides must be connected through faces.
fn mended_blocks() -> &'static [u8; 256] {
    static TABLE: OnceLock<[u8; 256]> = OnceLock::new();
    TABLE.get_or_init(|| {
        let good: Vec<u8> = (0..=255u8)
            .filter(|&mask| is_connected(mask) && is_connected(!mask))
            .collect();
        std::array::from_fn(|mask| {
            let mask = mask as u8;
            let above = good.iter().copied().filter(|g| g & mask == mask);
            above.min_by_key(|g| g.count_ones()).unwrap_or(u8::MAX)
        })
    })
}

/// Whether the cubes of a set around a corner are connected through faces.
fn is_connected(mask: u8) -> bool {
    let mut reached = mask & mask.wrapping_neg();
    loop {
        let grown = (0..8).filter(|k| reached >> k & 1 == 1);
        let grown = grown.fold(reached, |all, k: u32| {
            all | (1 << (k ^ 1)) | (1 << (k ^ 2)) | (1 << (k ^ 4))
        }) & mask;
        if grown == reached {
            return reached == mask;
        }
        reached = grown;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Connectivity;

    fn grid(n: usize) -> Grid {
        Grid {
            lo: DVec3::ZERO,
            h: 1.0,
            size: [n; 3],
        }
    }

    fn voxels(n: usize, marked: impl Fn([usize; 3]) -> bool) -> Voxels {
        let grid = grid(n);
        let inside = (0..n * n * n).map(|c| marked(grid.place(c))).collect();
        Voxels::new(&grid, inside)
    }

    fn euler(voxels: &Voxels) -> i64 {
        Connectivity::of(&voxels.surface())
            .expect("a manifold")
            .euler_characteristic()
    }

    #[test]
    fn nothing_has_no_surface_and_the_border_is_never_inside() {
        let mut all = voxels(4, |_| true);
        assert_eq!(all.inside.iter().filter(|&&i| i).count(), 8);
        assert_eq!(euler(&all), 2);
        all.erode();
        all.keep_large(1, 1.0);
        all.fill_cavities();
        all.fill_pinches();
        assert_eq!(all.surface().face_count(), 0);
    }

    #[test]
    fn random_cubes_become_a_manifold_and_none_is_lost() {
        let mut random = crate::geometry::random::Random::new(3);
        for share in [0.1, 0.3, 0.5, 0.7] {
            let marks: Vec<bool> = (0..1000).map(|_| random.uniform() < share).collect();
            let before = Voxels::new(&grid(10), marks);
            let mut after = before.clone();
            after.fill_pinches();
            Connectivity::of(&after.surface()).expect("a manifold");
            let kept = before.inside.iter().zip(&after.inside);
            assert!(kept.into_iter().all(|(before, after)| !before | after));
        }
    }

    #[test]
    fn cubes_that_touch_in_an_edge_or_a_corner_are_joined() {
        let pair = |other: [usize; 3]| {
            let mut pair = voxels(6, |at| at == [2, 2, 2] || at == other);
            pair.fill_pinches();
            (pair.inside.iter().filter(|&&i| i).count(), euler(&pair))
        };
        assert_eq!(pair([3, 3, 2]), (3, 2));
        assert_eq!(pair([3, 3, 3]), (4, 2));
    }

    #[test]
    fn cavities_are_filled_and_tunnels_are_not() {
        let ring = |at: [usize; 3]| at[2] == 2 && (at[0] != 3 || at[1] != 3);
        let ring = |at: [usize; 3]| ring(at) && (2..5).contains(&at[0]) && (2..5).contains(&at[1]);
        let mut tunnel = voxels(7, ring);
        tunnel.fill_cavities();
        assert_eq!(euler(&tunnel), 0);
        let shell = |at: [usize; 3]| at.iter().all(|&i| (2..5).contains(&i)) && at != [3, 3, 3];
        let mut shell = voxels(7, shell);
        assert_eq!(euler(&shell), 4);
        shell.fill_cavities();
        assert_eq!(euler(&shell), 2);
        let mut two = voxels(9, |at| at[0] == 1 || at[0] == 6 && at[1] > 3);
        two.keep_large(2, 0.3);
        assert_eq!(euler(&two), 4);
        let mut first = two.clone();
        first.keep_large(1, 0.3);
        assert_eq!(euler(&first), 2);
        two.keep_large(2, 0.9);
        assert!(two.inside[two.grid.strides()[0] + 9 * 3 + 81 * 3]);
        assert_eq!(euler(&two), 2);
    }

    #[test]
    fn the_surface_faces_outwards_at_the_cubes() {
        let one = voxels(5, |at| at == [2, 2, 2]).surface();
        let triangles = one.triangulate();
        for t in 0..triangles.triangles.len() {
            let out = triangles.corners(t)[0] - DVec3::splat(2.5);
            assert!(triangles.area_vector(t).dot(out) > 0.0);
        }
        assert!((triangles.area() - 6.0).abs() < 1e-12);
    }

    #[test]
    fn a_box_lies_inside_its_grid() {
        let grid = Grid::around((DVec3::NEG_ONE, DVec3::new(1.0, 2.0, -1.0)), 0.3);
        let centers = grid.centers();
        let hull = centers
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), &c| {
                (lo.min(c), hi.max(c))
            });
        assert!(hull.0.cmplt(DVec3::splat(-1.5)).all());
        assert!(hull.1.cmpgt(DVec3::new(1.5, 2.5, -0.5)).all());
    }

    #[test]
    fn points_are_in_their_cube() {
        let grid = Grid::around((DVec3::NEG_ONE, DVec3::ONE), 0.4);
        for (cell, center) in grid.centers().into_iter().enumerate() {
            for off in [-0.19, 0.0, 0.19] {
                assert_eq!(grid.cell_at(center + off), Some(cell));
            }
        }
        for far in [9.0, -9.0, f64::NAN] {
            assert_eq!(grid.cell_at(far * DVec3::X), None);
        }
    }
}
