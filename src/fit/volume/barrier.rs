//! The barrier of [`crate::energy::BernsteinBarrier`] on some elements of a volume, of all shapes and orders.
//!
//! Only elements that would leave its domain are watched: the barrier is not in the preconditioner, and with all those watched that are
//! near it, a fit stalls.

use crate::energy::BernsteinBarrier;
use crate::error::Result;
use crate::kernel::sparse::Csr;
use crate::model::volume::CurvedVolume;
use glam::DVec3;

/// Elements of a volume of fixed orders whose determinants are watched.
pub(super) struct Watch {
    parts: Vec<Part>,
    cell_count: usize,
}

/// The watched elements of one shape and order.
struct Part {
    cells: Vec<u32>,
    gather: Csr,
    scatter: Csr,
    barrier: BernsteinBarrier,
}

impl Watch {
    /// On `cells`, ascending, among elements whose ideal shapes have edges of length `sizes`, `[cells of the volume]`.
    ///
    /// # Errors
    /// As [`BernsteinBarrier::new`].
    pub fn new(volume: &CurvedVolume, sizes: &[f64], cells: &[u32]) -> Result<Self> {
        let mut parts = Vec::new();
        for mut group in volume.groups() {
            group.cells.retain(|c| cells.binary_search(c).is_ok());
            if group.cells.is_empty() {
                continue;
            }
            let inverse =
                |&c: &u32| volume.reference_inverse(c as usize) * sizes[c as usize].recip();
            let inverses = group.cells.iter().map(inverse).collect();
            let gather = volume.gather(&group.cells);
            parts.push(Part {
                scatter: gather.transpose(),
                gather,
                barrier: BernsteinBarrier::new(
                    group.shape,
                    volume.basis(),
                    group.order,
                    inverses,
                    sizes.len(),
                )?,
                cells: group.cells,
            });
        }
        Ok(Self {
            parts,
            cell_count: sizes.len(),
        })
    }

    /// The least Bernstein coefficient of every cell of the volume; infinite where it is not watched.
    pub fn bounds(&self, coefficients: &[DVec3]) -> Vec<f64> {
        let mut bounds = vec![f64::INFINITY; self.cell_count];
        for part in &self.parts {
            let least = part.barrier.bounds(&part.gather.apply(coefficients));
            for (&c, bound) in part.cells.iter().zip(least) {
                bounds[c as usize] = bound;
            }
        }
        bounds
    }

    /// The barrier and its gradient; infinite where a coefficient is not positive.
    pub fn evaluate(&self, coefficients: &[DVec3]) -> (f64, Vec<DVec3>) {
        let mut value = 0.0;
        let mut gradient = vec![DVec3::ZERO; coefficients.len()];
        for part in &self.parts {
            let (term, local) = part.barrier.evaluate(&part.gather.apply(coefficients));
            value += term;
            let sum = part.scatter.apply(&local);
            gradient.iter_mut().zip(&sum).for_each(|(g, s)| *g += *s);
        }
        (value, gradient)
    }
}
