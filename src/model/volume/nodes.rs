//! Between modes and nodes: files hold the positions of cells at evenly spaced nodes.

use super::{CurvedVolume, in_frame};
use crate::error::Result;
use crate::mesh::{CellShape, NodalVolume, VolumeMesh};
use crate::model::element::{Basis, Grid, Table, Tables};
use faer::Mat;
use faer::linalg::solvers::DenseSolveCore;
use glam::DVec3;

impl CurvedVolume {
    /// All cells as polynomials of one order, through their positions at evenly spaced nodes that neighbours share.
    ///
    /// Exact in the Legendre basis from [`CurvedVolume::highest_order`] on; of the Fourier basis it is an interpolation, with the error
    /// that [`CurvedVolume::interpolation_error`] measures.
    pub fn nodes(&self, order: usize) -> NodalVolume {
        let points = self.sampled(order);
        NodalVolume::from_cells(&self.topology(), order, &points.concat())
    }

    /// The largest distance between this volume and nodes made of it, by sampling twice as densely as the nodes.
    ///
    /// # Errors
    /// As [`CurvedVolume::from_nodes`].
    pub fn interpolation_error(&self, nodes: &NodalVolume) -> Result<f64> {
        let interpolant = Self::from_nodes(&self.topology(), nodes)?;
        let intervals = 2 * nodes.order() + 1;
        let (wanted, found) = (self.sampled(intervals), interpolant.sampled(intervals));
        let pairs = wanted.iter().flatten().zip(found.iter().flatten());
        Ok(pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max))
    }

    /// The volume of the Legendre basis that goes through nodes. `mesh`: the same cells, with the vertices that neighbours share. Where
    /// nodes of neighbours differ, the mean counts.
    ///
    /// # Errors
    /// As [`CurvedVolume::new`] and [`CurvedVolume::raised`].
    ///
    /// # Panics
    /// Where the cells are not as many or not of the same shapes.
    pub fn from_nodes(mesh: &VolumeMesh, nodes: &NodalVolume) -> Result<Self> {
        let order = nodes.order();
        let mut volume =
            Self::new(mesh, Basis::Legendre)?.raised(&vec![order; mesh.cell_count()])?;
        let to_modes = CellShape::ALL.map(|shape| {
            let used = mesh.cells().any(|(s, _)| s == shape);
            used.then(|| to_modes(shape, order))
        });
        let mut local = Vec::new();
        for (c, (shape, cell)) in nodes.cells().enumerate() {
            assert_eq!(shape, volume.shape(c), "shape of cell {c}");
            let points = in_frame(&Grid::lattice(shape, order), &volume.frame(c)).points();
            let lattice: Vec<[usize; 3]> = points
                .iter()
                .map(|u| (*u * order as f64).round().to_array().map(|x| x as usize))
                .collect();
            let places = NodalVolume::places(shape, order, &lattice);
            let mut positions = vec![DVec3::ZERO; cell.len()];
            for (at, &node) in places.into_iter().zip(cell) {
                positions[at] = nodes.positions[node as usize];
            }
            let tables = to_modes[shape as usize].iter();
            local.extend(tables.flat_map(|t| t.positions(&positions)));
        }
        let all: Vec<u32> = (0..mesh.cell_count() as u32).collect();
        let gather = volume.gather(&all);
        let mut weights = vec![0.0; volume.coefficients.len()];
        for row in 0..gather.row_count() {
            gather
                .row(row)
                .for_each(|(k, value)| weights[k as usize] += value * value);
        }
        // The gather of a cell is orthogonal: its transpose gives back the coefficients of each cell, which are averaged.
        let sums = gather.transpose().apply(&local);
        for ((coefficient, sum), weight) in volume.coefficients.iter_mut().zip(sums).zip(weights) {
            if weight > 0.0 {
                *coefficient = sum / weight;
            }
        }
        Ok(volume)
    }

    /// Positions at evenly spaced points of every cell.
    fn sampled(&self, intervals: usize) -> Vec<Vec<DVec3>> {
        let mut samples = vec![Vec::new(); self.cell_count()];
        for shape in CellShape::ALL {
            let cells: Vec<u32> = (0..self.cell_count() as u32)
                .filter(|&c| self.shape(c as usize) == shape)
                .collect();
            let grid = Grid::lattice(shape, intervals);
            let positions = self.positions(&cells, &grid);
            for (&c, points) in cells.iter().zip(positions.chunks_exact(grid.len())) {
                samples[c as usize] = points.to_vec();
            }
        }
        samples
    }

    /// The cells with straight edges between the vertices as they are now.
    fn topology(&self) -> VolumeMesh {
        let mut mesh = self.cells.clone();
        mesh.positions
            .copy_from_slice(&self.coefficients[..self.vertex_count()]);
        mesh
    }
}

/// What takes the positions at the nodes of a cell, in its frame, to its local modes: the inverse of the tables, factor by factor.
fn to_modes(shape: CellShape, order: usize) -> Tables {
    let tables = Tables::new(Basis::Legendre, order, &Grid::lattice(shape, order));
    let inverse = |table: &Table| {
        let n = table.modes;
        let values = Mat::from_fn(n, n, |point, mode| table.values[point * n + mode]);
        let inverse = values.partial_piv_lu().inverse();
        Table {
            modes: n,
            values: (0..n * n).map(|k| inverse[(k / n, k % n)]).collect(),
            derivatives: Vec::new(),
        }
    };
    Tables {
        factors: tables.factors.iter().map(inverse).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cube, a prism beside it and a tetrahedron on top of the prism, with vertices numbered in a given order.
    fn mixed(order: [usize; 11]) -> VolumeMesh {
        let points = [
            [0, 0, 0],
            [1, 0, 0],
            [1, 1, 0],
            [0, 1, 0],
            [0, 0, 1],
            [1, 0, 1],
            [1, 1, 1],
            [0, 1, 1],
            [2, 0, 0],
            [2, 0, 1],
            [2, 1, 2],
        ];
        let mut positions = vec![DVec3::ZERO; 11];
        for (p, &at) in points.iter().zip(&order) {
            positions[at] = DVec3::from(p.map(f64::from));
        }
        let mut mesh = VolumeMesh::new(positions);
        let mut push = |shape, cell: &[usize]| {
            let cell: Vec<u32> = cell.iter().map(|&v| order[v] as u32).collect();
            mesh.push_cell(shape, &cell);
        };
        push(CellShape::Hexahedron, &[0, 1, 2, 3, 4, 5, 6, 7]);
        push(CellShape::Prism, &[1, 8, 2, 5, 9, 6]);
        push(CellShape::Tetrahedron, &[6, 5, 9, 10]);
        mesh
    }

    /// A volume with coefficients that bend every edge, face and cell.
    fn bent(mesh: &VolumeMesh, basis: Basis, order: usize) -> CurvedVolume {
        let volume = CurvedVolume::new(mesh, basis).unwrap();
        let mut volume = volume.raised(&vec![order; mesh.cell_count()]).unwrap();
        for (k, c) in volume
            .coefficients
            .iter_mut()
            .enumerate()
            .skip(mesh.positions.len())
        {
            let k = k as f64;
            *c += 0.1 * DVec3::new((3.0 * k).sin(), (5.0 * k).sin(), (7.0 * k).sin());
        }
        volume
    }

    const NUMBERINGS: [[usize; 11]; 3] = [
        [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10],
        [10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0],
        [3, 7, 1, 10, 0, 9, 4, 6, 2, 5, 8],
    ];

    #[test]
    fn nodes_and_modes_are_two_ways_to_say_the_same() {
        for numbering in NUMBERINGS {
            for order in [1, 2, 3, 5, 8] {
                let volume = bent(&mixed(numbering), Basis::Legendre, order);
                let back =
                    CurvedVolume::from_nodes(&mixed(numbering), &volume.nodes(order)).unwrap();
                let pairs = volume.coefficients.iter().zip(&back.coefficients);
                let worst = pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
                // Measured at order 8: 3e-12. Evenly spaced nodes amplify rounding about as 2^order.
                let tolerance = 1e-13 * f64::from(1 << order);
                assert!(worst < tolerance, "order {order}: {worst}");
            }
        }
    }

    #[test]
    fn interpolation_is_exact_for_polynomials_and_measured_for_sines() {
        let legendre = bent(&mixed(NUMBERINGS[2]), Basis::Legendre, 4);
        let error = |volume: &CurvedVolume, order| {
            volume.interpolation_error(&volume.nodes(order)).unwrap()
        };
        assert!(error(&legendre, 4) < 1e-13 && error(&legendre, 6) < 1e-12);
        assert!(error(&legendre, 3) > 1e-4);
        let fourier = bent(&mixed(NUMBERINGS[2]), Basis::Fourier, 3);
        let errors = [4, 8, 12].map(|order| error(&fourier, order));
        assert!(
            errors[0] > 1e-4 && errors[1] < 1e-2 * errors[0] && errors[2] < 1e-2 * errors[1],
            "{errors:?}"
        );
    }
}
