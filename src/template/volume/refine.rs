//! Refinement: every hexahedron cut into eight.

use crate::mesh::{CellShape, NodalVolume, VolumeMesh};
use glam::DVec3;

/// The hexahedra of a mesh, each halved in its three directions; other cells are left out.
pub(super) fn refined(mesh: &VolumeMesh) -> VolumeMesh {
    const HEXAHEDRON: CellShape = CellShape::Hexahedron;
    let lattice = NodalVolume::lattice(HEXAHEDRON, 2);
    let points: Vec<DVec3> = mesh
        .cells()
        .filter(|cell| cell.0 == HEXAHEDRON)
        .flat_map(|(_, cell)| {
            let at = |k: usize| mesh.positions[cell[k] as usize];
            let corners: [DVec3; 8] = std::array::from_fn(at);
            lattice.iter().map(move |point| {
                let [u, v, w] = point.map(|i| 0.5 * i as f64);
                let square = |k: usize| {
                    let [a, b, c, d] = [0, 1, 2, 3].map(|l| corners[4 * k + l]);
                    a.lerp(b, u).lerp(d.lerp(c, u), v)
                };
                square(0).lerp(square(1), w)
            })
        })
        .collect();
    let nodes = NodalVolume::from_cells(mesh, 2, &points);
    let mut refined = VolumeMesh::new(nodes.positions.clone());
    for (_, cell) in nodes.cells() {
        for part in NodalVolume::lattice(HEXAHEDRON, 1) {
            let corner = |[i, j, k]: [usize; 3]| {
                let [i, j, k] = [i + part[0], j + part[1], k + part[2]];
                cell[i + 3 * (j + 3 * k)]
            };
            let corners = NodalVolume::corner_points(HEXAHEDRON, 1);
            let corners: Vec<u32> = corners.into_iter().map(corner).collect();
            refined.push_cell(HEXAHEDRON, &corners);
        }
    }
    refined
}

#[cfg(test)]
mod tests {
    use super::super::grid;
    use super::super::tests::corner_determinants;
    use super::*;

    #[test]
    fn neighbours_share_what_lies_between_them() {
        let two = grid(DVec3::ZERO, DVec3::new(2.0, 1.0, 1.0), [2, 1, 1]);
        let refined = refined(&two);
        assert_eq!((refined.cell_count(), refined.positions.len()), (16, 45));
        crate::mesh::check_volume::sound(&refined).unwrap();
        let det = corner_determinants(&refined);
        assert!(det.into_iter().all(|det| (det - 0.125).abs() < 1e-15));
    }
}
