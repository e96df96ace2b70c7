//! The target of a fit in the unit frame: its full detail for closest points, a decimated copy for Voronoi cells.

use crate::device::Device;
use crate::error::Result;
use crate::geometry::triangle_tree::{TriangleTree, spatial_order};
use crate::kernel::candidates::Candidates;
use crate::kernel::closest_point::ClosestPoints;
use crate::kernel::restricted_voronoi::{self, Metric};
use crate::kernel::vsdm::FixedSide;
use crate::measure::Boundary;
use crate::mesh::sample::{SurfacePoint, sample_by_area};
use crate::mesh::{Frame, TriangleMesh};
use crate::topology;
use glam::DVec3;

/// Triangles of the decimated copy: enough for far and middle distances, where cells are larger than its detail.
const DECIMATED: usize = 20_000;

/// Lloyd steps that even out random samples. Even enough: one a vertex is only a sampling, and the polish does not use them.
const LLOYD_STEPS: usize = 6;

/// Triangles longer than this many cells are split, so that a triangle has few candidate seeds.
const MAX_EDGE: f64 = 2.0;

/// A target in the unit frame, its holes bridged.
///
/// Voronoi cells have no notion of a rim: without a bridge the surface over a hole is drawn to its edges and folds.
pub struct Target {
    /// From and to the input's coordinates.
    pub frame: Frame,
    /// The full mesh and the triangles that bridge its holes, in spatial order.
    pub mesh: TriangleMesh,
    /// `[triangles]`: whether it bridges a hole.
    bridge: Vec<bool>,
    closest: ClosestPoints,
    /// What is still open.
    boundary: Boundary,
    decimated: TriangleMesh,
}

/// A closest point of the target.
#[derive(Debug, Clone, Copy)]
pub struct TargetPoint {
    /// Where it is.
    pub point: DVec3,
    /// The unit normal of its triangle; zero where that is degenerate.
    pub normal: DVec3,
    /// What is there.
    pub place: Place,
}

/// What a closest point of the target lies on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// On the target.
    Covered,
    /// On a bridge over one of its holes.
    Bridge,
    /// On an open rim: the query is beyond it.
    Rim,
}

/// Samples of the target with the normals there.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// `[samples]`.
    pub positions: Vec<DVec3>,
    /// `[samples]`, unit length.
    pub normals: Vec<DVec3>,
}

impl Target {
    /// Takes a target in its own coordinates. Equal positions are merged, triangles without area dropped.
    ///
    /// # Errors
    /// Where nothing with area is left, or the device fails.
    pub fn new(device: &Device, mesh: &TriangleMesh) -> Result<Self> {
        let frame = Frame::of(mesh)?;
        let mut mesh = topology::cleaned(mesh);
        mesh.positions
            .iter_mut()
            .for_each(|p| *p = frame.to_unit(*p));
        let real = mesh.triangles.len();
        mesh.triangles.extend(topology::fill_holes(&mesh));
        let centers: Vec<DVec3> = (0..mesh.triangles.len())
            .map(|t| mesh.corners(t).iter().sum::<DVec3>() / 3.0)
            .collect();
        let order: Vec<usize> = spatial_order(&centers)
            .into_iter()
            .map(|t| t as usize)
            .filter(|&t| mesh.area_vector(t) != DVec3::ZERO)
            .collect();
        let bridge = order.iter().map(|&t| t >= real).collect();
        mesh.triangles = order.iter().map(|&t| mesh.triangles[t]).collect();
        let decimated = if mesh.triangles.len() > DECIMATED {
            topology::simplify(&mesh, topology::Target::Faces(DECIMATED)).mesh
        } else {
            mesh.clone()
        };
        Ok(Self {
            frame,
            bridge,
            closest: ClosestPoints::new(device, &mesh)?,
            boundary: Boundary::of(&mesh),
            decimated,
            mesh,
        })
    }

    /// Closest points of the full target.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn closest(&self, points: &[DVec3]) -> Result<Vec<TargetPoint>> {
        let found = self.closest.query(points)?;
        Ok(found
            .into_iter()
            .map(|c| TargetPoint {
                point: c.point,
                normal: self.normal(c.triangle),
                place: if self.bridge[c.triangle as usize] {
                    Place::Bridge
                } else if self.boundary.holds(&c) {
                    Place::Rim
                } else {
                    Place::Covered
                },
            })
            .collect())
    }

    /// About `count` area samples of the full target, none on bridges.
    pub fn samples(&self, count: usize, seed: u64) -> Samples {
        let points: Vec<SurfacePoint> = sample_by_area(&self.mesh, count, seed)
            .into_iter()
            .filter(|p| !self.bridge[p.triangle as usize])
            .collect();
        Samples {
            positions: points.iter().map(|p| self.position(p)).collect(),
            normals: points.iter().map(|p| self.normal(p.triangle)).collect(),
        }
    }

    /// The vertices of the full target.
    pub fn vertices(&self) -> Samples {
        let normals = self.mesh.vertex_normals();
        let used = self.mesh.positions.iter().zip(normals);
        let (positions, normals) = used.filter(|(_, n)| *n != DVec3::ZERO).unzip();
        Samples { positions, normals }
    }

    fn position(&self, point: &SurfacePoint) -> DVec3 {
        point.position(self.mesh.corners(point.triangle as usize))
    }

    fn normal(&self, triangle: u32) -> DVec3 {
        self.mesh.area_vector(triangle as usize).normalize_or_zero()
    }

    /// The fixed side of the Voronoi terms for a surface of `vertices` vertices: decimated triangles no longer than about
    /// a cell, and as many samples as vertices, evened out by Lloyd's steps on the restricted cells.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn fixed_side(&self, vertices: usize, seed: u64) -> Result<FixedSide> {
        let cell = (self.decimated.area() / vertices as f64).sqrt();
        let triangles = split_long(&self.decimated, MAX_EDGE * cell);
        let even = self.even_samples(&triangles, vertices, seed)?;
        Ok(FixedSide::new(&triangles, even.positions, even.normals))
    }

    /// Centroidal samples: random by area, then Lloyd's steps, then back onto the target.
    fn even_samples(&self, triangles: &[[DVec3; 3]], count: usize, seed: u64) -> Result<Samples> {
        let mut seeds: Vec<DVec3> = sample_by_area(&self.mesh, count, seed)
            .iter()
            .map(|p| self.position(p))
            .collect();
        let tree = TriangleTree::new(triangles);
        for _ in 0..LLOYD_STEPS {
            let candidates = Candidates::find(&tree, triangles, &seeds, 0.0);
            let cells = restricted_voronoi::cpu(triangles, &seeds, &candidates, Metric::ISOTROPIC);
            for (i, seed) in seeds.iter_mut().enumerate() {
                if cells.area[i] > 0.0 {
                    *seed += cells.moment[i] / cells.area[i];
                }
            }
        }
        let closest = self.closest(&seeds)?;
        Ok(Samples {
            positions: closest.iter().map(|c| c.point).collect(),
            normals: closest.iter().map(|c| c.normal).collect(),
        })
    }
}

/// The triangles, each bisected at its longest edge until none is longer than `longest`; spatial order is up to the caller.
fn split_long(mesh: &TriangleMesh, longest: f64) -> Vec<[DVec3; 3]> {
    let mut done = Vec::with_capacity(mesh.triangles.len());
    let mut pending: Vec<[DVec3; 3]> = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
    while let Some([a, b, c]) = pending.pop() {
        let lengths = [(b - a).length(), (c - b).length(), (a - c).length()];
        if lengths.iter().all(|&l| l <= longest) {
            done.push([a, b, c]);
        } else if lengths[0] >= lengths[1] && lengths[0] >= lengths[2] {
            let m = 0.5 * (a + b);
            pending.extend([[a, m, c], [m, b, c]]);
        } else if lengths[1] >= lengths[2] {
            let m = 0.5 * (b + c);
            pending.extend([[a, b, m], [a, m, c]]);
        } else {
            let m = 0.5 * (c + a);
            pending.extend([[a, b, m], [m, b, c]]);
        }
    }
    done
}
