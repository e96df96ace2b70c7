//! What a volume is fitted to: a closed surface, or points on one.

use crate::device::Device;
use crate::error::{Error, Result};
use crate::fit::Target;
use crate::kernel::closest_point::ClosestPoints;
use crate::mesh::{Frame, PointCloud, TriangleMesh};
use crate::reconstruction;
use glam::DVec3;

/// What a volume is fitted to.
#[derive(Clone, Copy)]
pub enum VolumeTarget<'a> {
    /// A closed surface: distances count both ways.
    Surface(&'a Target),
    /// Points on one: what counts is the distance of each from the boundary of the volume, by its share of the area.
    Points(&'a PointTarget),
}

impl<'a> From<&'a Target> for VolumeTarget<'a> {
    fn from(target: &'a Target) -> Self {
        Self::Surface(target)
    }
}

impl<'a> From<&'a PointTarget> for VolumeTarget<'a> {
    fn from(target: &'a PointTarget) -> Self {
        Self::Points(target)
    }
}

/// A cloud of points on a closed surface, in the unit frame.
///
/// ```
/// use vorofit::device::Device;
/// use vorofit::fit::{PointTarget, VolumeOptions, VolumeStart, VolumeTemplate, fit_volume};
/// use vorofit::mesh::{PointCloud, shapes};
/// use vorofit::progress::Silent;
///
/// # fn main() -> vorofit::Result<()> {
/// let cloud = PointCloud {
///     positions: shapes::lobed_ball(4).positions,
///     ..PointCloud::default()
/// };
/// let target = PointTarget::new(&cloud)?;
/// let start = VolumeStart::new(&target, &VolumeTemplate::Ball(1))?;
/// let fit = fit_volume(&Device::Cpu, &target, start, &VolumeOptions::default(), &Silent)?;
/// assert_eq!(fit.volume.cell_count(), 7);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct PointTarget {
    /// From and to the input's coordinates.
    pub frame: Frame,
    /// Where they are, which way the surface faces there, and how much of its area each stands for.
    samples: Samples,
    /// A triangle for each.
    splats: TriangleMesh,
}

/// Points of a target with the normals there. `[samples]` all.
#[derive(Debug, Clone)]
pub(super) struct Samples {
    pub positions: Vec<DVec3>,
    /// Outwards, of length 1.
    pub normals: Vec<DVec3>,
    /// How much of the target's area each stands for.
    pub areas: Vec<f64>,
}

impl PointTarget {
    /// Takes a cloud in its own coordinates. Normals are estimated where it has none and turned outwards ([`reconstruction::oriented`]).
    ///
    /// # Errors
    /// As [`reconstruction::oriented`].
    pub fn new(cloud: &PointCloud) -> Result<Self> {
        let points = reconstruction::oriented(cloud)?;
        Ok(Self {
            frame: points.frame,
            samples: Samples {
                positions: points.positions,
                normals: points.normals,
                areas: points.areas,
            },
            splats: points.splats,
        })
    }

    /// The points, equal ones once. `[points]`.
    pub fn positions(&self) -> &[DVec3] {
        &self.samples.positions
    }
}

impl VolumeTarget<'_> {
    /// The unit frame.
    pub fn frame(&self) -> &Frame {
        match self {
            Self::Surface(target) => &target.frame,
            Self::Points(target) => &target.frame,
        }
    }

    /// Triangles that stand for it: those of a surface, or one across each point that is its share of the area.
    pub(super) fn mesh(&self) -> &TriangleMesh {
        match self {
            Self::Surface(target) => &target.mesh,
            Self::Points(target) => &target.splats,
        }
    }

    /// The squared distances of some points from that.
    pub(super) fn squared_distances(&self, points: &[DVec3]) -> Result<Vec<f64>> {
        match self {
            Self::Surface(target) => {
                let found = target.closest(points)?.into_iter().zip(points);
                Ok(found.map(|(c, p)| c.point.distance_squared(*p)).collect())
            }
            Self::Points(target) => {
                let found = ClosestPoints::new(&Device::Cpu, &target.splats)?.query(points)?;
                Ok(found.into_iter().map(|c| c.distance_squared).collect())
            }
        }
    }

    /// About `count` samples of a surface; of points all.
    pub(super) fn samples(&self, count: usize, seed: u64) -> Samples {
        match self {
            Self::Surface(target) => {
                let samples = target.samples(count, seed);
                let area = target.mesh.area() / samples.positions.len() as f64;
                Samples {
                    areas: vec![area; samples.positions.len()],
                    positions: samples.positions,
                    normals: samples.normals,
                }
            }
            Self::Points(target) => target.samples.clone(),
        }
    }

    /// What it encloses.
    ///
    /// # Errors
    /// Where that is nothing.
    pub(super) fn enclosure(&self) -> Result<Enclosure> {
        let enclosure = match self {
            Self::Surface(target) => Enclosure::of_surface(target),
            Self::Points(target) => Enclosure::of_points(&target.samples),
        };
        if enclosure.volume > Enclosure::LEAST * enclosure.area {
            return Ok(enclosure);
        }
        Err(Error::input(
            "the target encloses no volume",
            "give a closed surface whose faces are oriented consistently",
        ))
    }
}

/// What a closed surface encloses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Enclosure {
    pub area: f64,
    pub volume: f64,
}

impl Enclosure {
    /// The least V/A of a target, in diagonals: a sheet, or one whose triangles face either way, encloses nothing.
    const LEAST: f64 = 1e-4;

    fn of_surface(target: &Target) -> Self {
        let mesh = &target.mesh;
        let volume = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                a.dot(b.cross(c)) / 6.0
            })
            .sum::<f64>()
            .abs();
        Self {
            area: mesh.area(),
            volume,
        }
    }

    /// By the flux through the points' shares of the surface.
    fn of_points(samples: &Samples) -> Self {
        let area: f64 = samples.areas.iter().sum();
        let all = || samples.positions.iter().zip(&samples.areas);
        let center = all().map(|(p, a)| *p * *a).sum::<DVec3>() / area;
        let flux: f64 = all()
            .zip(&samples.normals)
            .map(|((p, a), n)| a * n.dot(*p - center))
            .sum();
        Self {
            area,
            volume: flux / 3.0,
        }
    }

    /// 1/(A L²), L = V/A.
    pub fn scale(&self) -> f64 {
        self.area / (self.volume * self.volume)
    }
}
