//! The control points of a regular patch and the sums of basis functions over them.

use super::LimitJet;
use super::basis::Jets;
use glam::DVec3;

/// Control points, coordinate by coordinate so that sums over them run in vector registers.
pub struct Control<const N: usize> {
    coordinates: [[f64; N]; 3],
}

impl<const N: usize> Control<N> {
    /// Points by number.
    pub fn gather(point: impl Fn(usize) -> DVec3) -> Self {
        let points: [DVec3; N] = std::array::from_fn(point);
        Self {
            coordinates: [
                points.map(|p| p.x),
                points.map(|p| p.y),
                points.map(|p| p.z),
            ],
        }
    }

    /// Combinations of points: a matrix `[N, points]` by columns times points by number.
    pub fn pick(matrix: &[f64], point: impl Fn(usize) -> DVec3) -> Self {
        let [mut x, mut y, mut z] = [[0.0; N]; 3];
        for (i, column) in matrix.as_chunks::<N>().0.iter().enumerate() {
            let p = point(i);
            for r in 0..N {
                x[r] += column[r] * p.x;
                y[r] += column[r] * p.y;
                z[r] += column[r] * p.z;
            }
        }
        Self {
            coordinates: [x, y, z],
        }
    }

    /// The points one by one.
    pub fn points(&self) -> Vec<DVec3> {
        let [x, y, z] = &self.coordinates;
        (0..N).map(|i| DVec3::new(x[i], y[i], z[i])).collect()
    }

    /// The surface from the basis functions at a parameter.
    pub fn jet(&self, basis: &Jets<N>) -> LimitJet {
        let [mut x, mut y, mut z] = [[0.0; 6]; 3];
        for (i, weights) in basis.iter().enumerate() {
            let [px, py, pz] = [0, 1, 2].map(|axis| self.coordinates[axis][i]);
            for order in 0..6 {
                x[order] += weights[order] * px;
                y[order] += weights[order] * py;
                z[order] += weights[order] * pz;
            }
        }
        LimitJet::from_array(std::array::from_fn(|o| DVec3::new(x[o], y[o], z[o])))
    }
}
