//! Finds the correspondences between the boundary of a volume and its target.

use super::body::Body;
use super::correspondence::{Correspondences, Goal};
use super::target::{Samples, VolumeTarget};
use crate::device::Device;
use crate::error::Result;
use crate::fit::{Place, Target};
use crate::geometry::bvh::ClosestPoint;
use crate::kernel::closest_point::ClosestPoints;
use crate::kernel::sparse::Csr;
use crate::mesh::TriangleMesh;
use crate::model::volume::{BoundaryPoint, BoundarySurface};
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
    target: VolumeTarget<'a>,
    /// Its unknowns are out of date.
    body: &'a Body,
    boundary: BoundarySurface,
    samples: Samples,
    /// 1/(A L²).
    scale: f64,
}

/// How far the boundary and the target are apart, as sampled.
#[derive(Debug, Clone)]
pub(super) struct Gap {
    /// `[boundary faces]`: the integral of the squared distance over the face and what is closest to it, over A L².
    pub by_face: Vec<f64>,
    /// The largest distance.
    pub largest: f64,
    /// The root mean square distance over both surfaces.
    pub rms: f64,
}

impl<'a> Surface<'a> {
    /// Samples the boundary and the target. `scale` is 1/(A L²).
    pub fn new(
        device: &'a Device,
        target: VolumeTarget<'a>,
        body: &'a Body,
        scale: f64,
        seed: u64,
    ) -> Self {
        let boundary = body.boundary_surface(body.volume().highest_order() + FINER);
        let count = (SAMPLES.0 * boundary.matrix.row_count()).max(SAMPLES.1);
        Self {
            device,
            target,
            body,
            boundary,
            samples: target.samples(count, seed),
            scale,
        }
    }

    /// The correspondences at the present unknowns.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn correspond(&self, unknowns: &[DVec3]) -> Result<Correspondences> {
        Ok(self.correspond_by_triangle(unknowns)?.0)
    }

    /// The same with the triangles of the boundary that the samples of T are closest to.
    fn correspond_by_triangle(&self, unknowns: &[DVec3]) -> Result<(Correspondences, Vec<u32>)> {
        let mesh = self.boundary.mesh(unknowns);
        let (matrix, mut goals) = match self.target {
            VolumeTarget::Surface(target) => {
                (Some(&self.boundary.matrix), of_boundary(target, &mesh)?)
            }
            VolumeTarget::Points(_) => (None, Vec::new()),
        };
        let of_surface = goals.len();
        let found = self.closest(&mesh)?;
        // By triangle, and so by face: runs of rows with the same nodes.
        let mut order: Vec<usize> = (0..found.len()).collect();
        order.sort_by_key(|&k| found[k].triangle);
        let mut points = Vec::with_capacity(found.len());
        for k in order {
            points.push(BoundaryPoint {
                triangle: found[k].triangle,
                barycentric: found[k].barycentric,
            });
            goals.push(self.of_sample(&mesh, k, &found[k]));
        }
        let rows = self.body.boundary_rows(&self.boundary, &points);
        let parts: Vec<Csr> = matrix.cloned().into_iter().chain([rows]).collect();
        let rows = Csr::stack(&parts, unknowns.len());
        let triangles = points.iter().map(|p| p.triangle).collect();
        let found = Correspondences::new(rows, goals, of_surface, self.scale);
        Ok((found, triangles))
    }

    fn closest(&self, mesh: &TriangleMesh) -> Result<Vec<ClosestPoint>> {
        ClosestPoints::new(self.device, mesh)?.query(&self.samples.positions)
    }

    /// The goal of the point of S closest to sample `k` of T.
    fn of_sample(&self, mesh: &TriangleMesh, k: usize, found: &ClosestPoint) -> Goal {
        let (position, normal) = (self.samples.positions[k], self.samples.normals[k]);
        // Of points nobody else says on which side of a thin part they are.
        let is_behind = matches!(self.target, VolumeTarget::Points(_))
            && mesh.area_vector(found.triangle as usize).dot(normal) < 0.0;
        Goal {
            position,
            direction: direction(position - found.point, normal),
            weight: if is_behind {
                0.0
            } else {
                self.samples.areas[k]
            },
        }
    }

    /// The distances at the present unknowns.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn gap(&self, unknowns: &[DVec3]) -> Result<Gap> {
        let mesh = self.boundary.mesh(unknowns);
        let (found, closest) = self.correspond_by_triangle(unknowns)?;
        let distances = found.distances(unknowns);
        let faces = self.boundary.patches.last().map_or(0, |&f| f + 1);
        let mut gap = Gap {
            by_face: vec![0.0; faces as usize],
            largest: 0.0,
            rms: 0.0,
        };
        let mut all = 0.0;
        let mut add = |triangle: usize, area: f64, distance: f64| {
            let square = area * distance * distance;
            gap.by_face[self.boundary.patches[triangle] as usize] += self.scale * square;
            gap.largest = gap.largest.max(distance.abs());
            gap.rms += square;
            all += area;
        };
        let (of_surface, of_target) = found.goals_by_side();
        let on_target = distances[of_surface.len()..].iter().zip(of_target);
        for ((distance, goal), triangle) in on_target.zip(closest) {
            if goal.weight > 0.0 {
                add(triangle as usize, goal.weight, *distance);
            }
        }
        // None of points.
        for (t, corners) in mesh.triangles.iter().enumerate() {
            let third = mesh.area_vector(t).length() / 6.0;
            for &v in corners {
                if of_surface
                    .get(v as usize)
                    .is_some_and(|goal| goal.weight > 0.0)
                {
                    add(t, third, distances[v as usize]);
                }
            }
        }
        gap.rms = (gap.rms / all).sqrt();
        Ok(gap)
    }
}

/// The goals of the vertices of S on T.
fn of_boundary(target: &Target, mesh: &TriangleMesh) -> Result<Vec<Goal>> {
    let mut areas = vec![0.0; mesh.positions.len()];
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let third = mesh.area_vector(t).length() / 6.0;
        corners.iter().for_each(|&v| areas[v as usize] += third);
    }
    let closest = target.closest(&mesh.positions)?;
    let goals = mesh.positions.iter().zip(&closest).zip(&areas);
    Ok(goals
        .map(|((&x, c), &area)| Goal {
            position: c.point,
            direction: direction(c.point - x, c.normal),
            weight: match c.place {
                Place::Covered => area,
                Place::Bridge => BRIDGE * area,
                Place::Rim => 0.0,
            },
        })
        .collect())
}

/// The direction in which a distance changes: along it, or along the target's normal where there is none.
fn direction(distance: DVec3, normal: DVec3) -> DVec3 {
    if distance.length() > COINCIDENT {
        distance.normalize()
    } else {
        normal
    }
}
