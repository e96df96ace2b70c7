//! A box of hexahedra.

use crate::mesh::{CellShape, VolumeMesh};
use glam::DVec3;

/// The box from `lo` to `hi` as `cells` hexahedra along x, y and z (each at least 1).
pub fn grid(lo: DVec3, hi: DVec3, cells: [u32; 3]) -> VolumeMesh {
    let [a, b, c] = cells;
    let lattice = (0..=c).flat_map(|k| (0..=b).flat_map(move |j| (0..=a).map(move |i| [i, j, k])));
    let share = |i: u32, n: u32| f64::from(i) / f64::from(n);
    let mut mesh = VolumeMesh::new(
        lattice
            .map(|[i, j, k]| lo + (hi - lo) * DVec3::new(share(i, a), share(j, b), share(k, c)))
            .collect(),
    );
    let index = |[i, j, k]: [u32; 3]| i + (a + 1) * (j + (b + 1) * k);
    for k in 0..c {
        for (j, i) in (0..b).flat_map(|j| (0..a).map(move |i| (j, i))) {
            mesh.push_cell(CellShape::Hexahedron, &cube_corners([i, j, k]).map(index));
        }
    }
    mesh
}

/// The corners of a lattice cube in the local numbering of a hexahedron.
pub(super) fn cube_corners([i, j, k]: [u32; 3]) -> [[u32; 3]; 8] {
    [0, 1]
        .map(|dk| [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[di, dj]| [i + di, j + dj, k + dk]))
        .as_flattened()
        .try_into()
        .expect("two times four corners")
}

#[cfg(test)]
mod tests {
    use super::super::tests::corner_determinants;
    use super::*;

    #[test]
    fn grids_fill_their_box() {
        for cells in [[1, 1, 1], [3, 2, 4]] {
            let (lo, hi) = (DVec3::new(-1.0, 2.0, 0.5), DVec3::new(2.0, 4.0, 1.5));
            let mesh = grid(lo, hi, cells);
            let count = cells.iter().product::<u32>() as usize;
            assert_eq!(mesh.cell_count(), count);
            let lattice: u32 = cells.iter().map(|n| n + 1).product();
            assert_eq!(mesh.positions.len(), lattice as usize);
            for det in corner_determinants(&mesh) {
                assert!((det - 6.0 / count as f64).abs() < 1e-14);
            }
        }
    }
}
