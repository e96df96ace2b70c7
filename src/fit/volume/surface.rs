//! Finds the correspondences between the boundary of a volume and its target.

use super::correspondence::{Correspondences, Goal};
use crate::device::Device;
use crate::error::Result;
use crate::fit::{Place, Samples, Target};
use crate::kernel::closest_point::ClosestPoints;
use crate::kernel::sparse::Csr;
use crate::model::volume::{BoundaryPoint, BoundarySurface, CurvedVolume};
use glam::DVec3;

/// Distances under this, in diagonals, have no direction of their own.
const COINCIDENT: f64 = 1e-9;

/// The weight of a bridge over a hole of the target against the target: it is a guess.
const BRIDGE: f64 = 0.1;

/// Samples of the boundary along an edge of order p: p + 2 intervals. With twice as many the error is the same.
const FINER: usize = 2;

/// Area samples of T for each sample of the boundary, and their least number.
const SAMPLES: (usize, usize) = (4, 2_000);

/// The boundary of a volume of fixed orders, ready to be compared with a target.
pub(super) struct Surface<'a> {
    device: &'a Device,
    target: &'a Target,
    /// Its coefficients are out of date.
    volume: &'a CurvedVolume,
    boundary: BoundarySurface,
    samples: Samples,
    /// 1/(A L²).
    scale: f64,
}

impl<'a> Surface<'a> {
    /// Samples the boundary and the target. `scale` is 1/(A L²).
    pub fn new(
        device: &'a Device,
        target: &'a Target,
        volume: &'a CurvedVolume,
        scale: f64,
        seed: u64,
    ) -> Self {
        let boundary = volume.boundary_surface(volume.highest_order() + FINER);
        let count = (SAMPLES.0 * boundary.matrix.row_count()).max(SAMPLES.1);
        Self {
            device,
            target,
            volume,
            boundary,
            samples: target.samples(count, seed),
            scale,
        }
    }

    /// The correspondences at the present coefficients.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn correspond(&self, coefficients: &[DVec3]) -> Result<Correspondences> {
        let mesh = self.boundary.mesh(coefficients);
        let mut areas = vec![0.0; mesh.positions.len()];
        for (t, corners) in mesh.triangles.iter().enumerate() {
            let third = mesh.area_vector(t).length() / 6.0;
            corners.iter().for_each(|&v| areas[v as usize] += third);
        }
        let closest = self.target.closest(&mesh.positions)?;
        let mut goals: Vec<Goal> = mesh
            .positions
            .iter()
            .zip(&closest)
            .zip(&areas)
            .map(|((&x, c), &area)| Goal {
                position: c.point,
                direction: direction(c.point - x, c.normal),
                weight: match c.place {
                    Place::Covered => area,
                    Place::Bridge => BRIDGE * area,
                    Place::Rim => 0.0,
                },
            })
            .collect();
        let samples = &self.samples;
        let found = ClosestPoints::new(self.device, &mesh)?.query(&samples.positions)?;
        let share = self.target.mesh.area() / found.len() as f64;
        // By triangle, and so by face: runs of rows with the same nodes.
        let mut order: Vec<usize> = (0..found.len()).collect();
        order.sort_by_key(|&k| found[k].triangle);
        let mut points = Vec::with_capacity(found.len());
        for k in order {
            points.push(BoundaryPoint {
                triangle: found[k].triangle,
                barycentric: found[k].barycentric,
            });
            goals.push(Goal {
                position: samples.positions[k],
                direction: direction(samples.positions[k] - found[k].point, samples.normals[k]),
                weight: share,
            });
        }
        let rows = self.volume.boundary_rows(&self.boundary, &points);
        let rows = Csr::stack(&[self.boundary.matrix.clone(), rows], coefficients.len());
        let of_surface = mesh.positions.len();
        Ok(Correspondences::new(rows, goals, of_surface, self.scale))
    }
}

/// The direction in which a distance changes: along it, or along the target's normal where there is none.
fn direction(distance: DVec3, normal: DVec3) -> DVec3 {
    if distance.length() > COINCIDENT {
        distance.normalize()
    } else {
        normal
    }
}
