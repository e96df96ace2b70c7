//! The target of a fit in the unit frame: its full detail for closest points, a decimated copy for Voronoi cells.

use crate::device::Device;
use crate::error::{Error, Result};
use crate::geometry::ClosestPoint;
use crate::geometry::triangle_tree::{TriangleTree, spatial_order};
use crate::kernel::candidates::Candidates;
use crate::kernel::closest_point::ClosestPoints;
use crate::kernel::restricted_voronoi::{self, Metric};
use crate::kernel::vsdm::FixedSide;
use crate::measure::{Boundary, Mended, Rim};
use crate::mesh::sample::{SurfacePoint, sample_by_area};
use crate::mesh::{Frame, TriangleMesh};
use crate::reconstruction::{Bridged, bridged};
use crate::topology::{self, Holes};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// Triangles of the decimated copy: enough for far and middle distances, where cells are larger than its detail.
const DECIMATED: usize = 20_000;

/// Lloyd steps that even out random samples. Even enough: one a vertex is only a sampling, and the polish does not use them.
const LLOYD_STEPS: usize = 6;

/// Triangles longer than this many cells are split, so that a triangle has few candidate seeds.
const MAX_EDGE: f64 = 2.0;

/// A target in the unit frame, its holes bridged unless the surface is to follow their rims.
///
/// Voronoi cells have no notion of a rim: without a bridge a closed surface over a hole is drawn to its edges and folds.
pub struct Target {
    /// From and to the input's coordinates.
    pub frame: Frame,
    /// The full mesh and the triangles that bridge its holes, in spatial order.
    pub mesh: TriangleMesh,
    /// `[triangles]`: whether it bridges a hole.
    bridge: Vec<bool>,
    /// `[triangles]`: how much it counts, 1 in the mean.
    pub(super) weights: Vec<f64>,
    /// Where its closest points are found.
    pub(super) device: Device,
    closest: ClosestPoints,
    /// What has become of its holes.
    pub holes: Holes,
    /// What is still open.
    boundary: Boundary,
    /// The rims that the surface is to follow.
    rim: Option<Rim>,
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
    /// How much it counts.
    pub weight: f64,
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
    /// `[samples]`: how much each counts, 1 in the mean.
    pub weights: Vec<f64>,
}

/// What lies far from a surface.
pub(super) struct Far {
    pub surface: ClosestPoints,
    /// From this distance on.
    pub cutoff: f64,
}

impl Target {
    /// Takes a target in its own coordinates. Equal positions are merged, triangles without area dropped, and which way the others face is put to
    /// the vote ([`topology::oriented`]).
    ///
    /// # Errors
    /// Where nothing with area is left, or the device fails.
    pub fn new(device: &Device, mesh: &TriangleMesh) -> Result<Self> {
        Self::with(device, mesh, &[], Holes::Bridge)
    }

    /// Like [`Self::new`], with a weight for every vertex by which the polish trusts it, or none for vertices that count alike.
    ///
    /// # Errors
    /// As [`Self::with`].
    pub fn with_confidence(
        device: &Device,
        mesh: &TriangleMesh,
        confidence: &[f64],
    ) -> Result<Self> {
        Self::with(device, mesh, confidence, Holes::Bridge)
    }

    /// Like [`Self::with_confidence`], with what becomes of holes: bridged, or their rims followed by surfaces that have a boundary.
    ///
    /// # Errors
    /// As [`Self::new`], and where the weights are of another number, negative, not finite or all zero.
    pub fn with(
        device: &Device,
        mesh: &TriangleMesh,
        confidence: &[f64],
        holes: Holes,
    ) -> Result<Self> {
        let frame = Frame::of(mesh)?;
        let confidence = Confidence::new(mesh, confidence)?;
        let mut mesh = topology::oriented(&topology::cleaned(mesh));
        let mut weights = confidence.of_triangles(&mesh);
        mesh.positions
            .iter_mut()
            .for_each(|p| *p = frame.to_unit(*p));
        let Bridged { mut mesh, real } = bridged(mesh, holes);
        if holes == Holes::Follow && mesh.triangles.len() > real {
            log::info!("holes less than 3.5 % of the diagonal around are bridged all the same");
        }
        weights.resize(mesh.triangles.len(), 1.0);
        let centers: Vec<DVec3> = (0..mesh.triangles.len())
            .map(|t| mesh.corners(t).iter().sum::<DVec3>() / 3.0)
            .collect();
        let order: Vec<usize> = spatial_order(&centers)
            .into_iter()
            .map(|t| t as usize)
            .filter(|&t| mesh.area_vector(t) != DVec3::ZERO)
            .collect();
        let bridge = order.iter().map(|&t| t >= real).collect();
        let weights = order.iter().map(|&t| weights[t]).collect();
        mesh.triangles = order.iter().map(|&t| mesh.triangles[t]).collect();
        let decimated = if mesh.triangles.len() > DECIMATED {
            topology::simplify(&mesh, topology::Target::Faces(DECIMATED)).mesh
        } else {
            mesh.clone()
        };
        Ok(Self {
            frame,
            bridge,
            weights,
            device: device.clone(),
            closest: ClosestPoints::new(device, &mesh)?,
            holes,
            boundary: Boundary::of(&mesh),
            rim: match holes {
                Holes::Bridge | Holes::Leave => None,
                Holes::Follow => Rim::of(&mesh),
            },
            decimated,
            mesh,
        })
    }

    /// The same as surfaces are to be held against it.
    ///
    /// # Errors
    /// None: there are triangles.
    pub fn mended(&self) -> Result<Mended> {
        Mended::new(self.mesh.clone(), self.bridge.clone(), self.holes)
    }

    /// The rims that the surface is to follow, if it is to follow any.
    pub fn rim(&self) -> Option<&Rim> {
        self.rim.as_ref()
    }

    /// Closest points of the full target.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn closest(&self, points: &[DVec3]) -> Result<Vec<TargetPoint>> {
        self.closest_beyond(points, 0.0)
    }

    /// The same of those points that are further than `enough` from the target; for the others any point of it that is no further.
    pub(super) fn closest_beyond(&self, points: &[DVec3], enough: f64) -> Result<Vec<TargetPoint>> {
        let found = self.closest.query_beyond(points, enough)?;
        Ok(found.par_iter().map(|c| self.describe(c)).collect())
    }

    /// The closest of its points that face like `facing`, if it is no further than `distance`.
    pub(super) fn closest_facing(
        &self,
        point: DVec3,
        facing: DVec3,
        distance: f64,
    ) -> Option<TargetPoint> {
        let faces_alike = |t: u32| self.mesh.area_vector(t as usize).dot(facing) > 0.0;
        let found = self.closest.query_of(point, distance, faces_alike);
        found.map(|c| self.describe(&c))
    }

    fn describe(&self, c: &ClosestPoint) -> TargetPoint {
        TargetPoint {
            point: c.point,
            normal: self.normal(c.triangle),
            place: if self.bridge[c.triangle as usize] {
                Place::Bridge
            } else if self.boundary.holds(c) {
                Place::Rim
            } else {
                Place::Covered
            },
            weight: self.weights[c.triangle as usize],
        }
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
            weights: points
                .iter()
                .map(|p| self.weights[p.triangle as usize])
                .collect(),
        }
    }

    /// The vertices of the full target, but those that are only a bridge's.
    pub fn vertices(&self) -> Samples {
        let normals = self.mesh.vertex_normals();
        let mut weights = vec![(0.0, 0.0); normals.len()];
        let triangles = self.mesh.triangles.iter().zip(&self.weights);
        let real = triangles.zip(&self.bridge).filter(|(_, bridge)| !**bridge);
        for ((triangle, weight), _) in real {
            for &v in triangle {
                let (sum, count) = &mut weights[v as usize];
                *sum += weight;
                *count += 1.0;
            }
        }
        let mut samples = Samples::default();
        for (v, &normal) in normals.iter().enumerate() {
            if normal != DVec3::ZERO && weights[v].1 > 0.0 {
                samples.positions.push(self.mesh.positions[v]);
                samples.normals.push(normal);
                samples.weights.push(weights[v].0 / weights[v].1);
            }
        }
        samples
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
        self.trimmed_fixed_side(vertices, seed, None)
    }

    /// The same of what is not `far`.
    pub(super) fn trimmed_fixed_side(
        &self,
        vertices: usize,
        seed: u64,
        far: Option<Far>,
    ) -> Result<FixedSide> {
        let cell = (self.decimated.area() / vertices as f64).sqrt();
        let mut triangles = split_long(&self.decimated, MAX_EDGE * cell);
        let trimmed = far.is_some();
        if let Some(far) = far {
            let centers: Vec<DVec3> = triangles
                .iter()
                .map(|t| t.iter().sum::<DVec3>() / 3.0)
                .collect();
            let mut distances = far
                .surface
                .query(&centers)?
                .into_iter()
                .map(|c| c.distance_squared.sqrt());
            triangles.retain(|_| distances.next().is_some_and(|d| d <= far.cutoff));
        }
        let even = self.even_samples(&triangles, vertices, seed, trimmed)?;
        Ok(FixedSide::new(&triangles, even.positions, even.normals))
    }

    /// Centroidal samples: random by area, then Lloyd's steps, then back onto the target. Where the triangles are only part of it, less those
    /// that own nothing of them.
    fn even_samples(
        &self,
        triangles: &[[DVec3; 3]],
        count: usize,
        seed: u64,
        trimmed: bool,
    ) -> Result<Samples> {
        let mut seeds: Vec<DVec3> = sample_by_area(&self.mesh, count, seed)
            .iter()
            .map(|p| self.position(p))
            .collect();
        let tree = TriangleTree::new(triangles);
        let mut areas = Vec::new();
        for _ in 0..LLOYD_STEPS {
            let candidates = Candidates::find(&tree, triangles, &seeds, 0.0);
            let cells = restricted_voronoi::cpu(triangles, &seeds, &candidates, Metric::ISOTROPIC);
            for (i, seed) in seeds.iter_mut().enumerate() {
                if cells.area[i] > 0.0 {
                    *seed += cells.moment[i] / cells.area[i];
                }
            }
            areas = cells.area;
        }
        if trimmed {
            let mut area = areas.iter();
            seeds.retain(|_| area.next().is_some_and(|&area| area > 0.0));
        }
        let closest = self.closest(&seeds)?;
        Ok(Samples {
            positions: closest.iter().map(|c| c.point).collect(),
            normals: closest.iter().map(|c| c.normal).collect(),
            weights: vec![1.0; closest.len()],
        })
    }
}

/// How much the vertices of a target count, by their positions: merging and dropping some does not change these.
struct Confidence(HashMap<[u64; 3], f64>);

impl Confidence {
    fn new(mesh: &TriangleMesh, weights: &[f64]) -> Result<Self> {
        if weights.is_empty() {
            return Ok(Self(HashMap::new()));
        }
        let wrong = weights.iter().find(|w| !(w.is_finite() && **w >= 0.0));
        let problem = if weights.len() != mesh.positions.len() {
            format!(
                "there are {} weights for {} vertices",
                weights.len(),
                mesh.positions.len()
            )
        } else if let Some(weight) = wrong {
            format!("a vertex has the confidence {weight}")
        } else if weights.iter().all(|&w| w == 0.0) {
            "every vertex has the confidence 0".into()
        } else {
            let by_position = mesh
                .positions
                .iter()
                .map(Self::key)
                .zip(weights.iter().copied());
            return Ok(Self(by_position.collect()));
        };
        Err(Error::input(problem, "mend or remove the confidence"))
    }

    fn key(p: &DVec3) -> [u64; 3] {
        // Adding zero turns −0 into 0 and changes nothing else.
        (*p + DVec3::ZERO).to_array().map(f64::to_bits)
    }

    /// `[triangles]`, with an area-weighted mean of 1.
    fn of_triangles(&self, mesh: &TriangleMesh) -> Vec<f64> {
        if self.0.is_empty() {
            return vec![1.0; mesh.triangles.len()];
        }
        let weight = |p: DVec3| self.0.get(&Self::key(&p)).copied().unwrap_or(1.0);
        let weights: Vec<f64> = (0..mesh.triangles.len())
            .map(|t| mesh.corners(t).map(weight).iter().sum::<f64>() / 3.0)
            .collect();
        let area = |t: usize| 0.5 * mesh.area_vector(t).length();
        let total: f64 = weights.iter().enumerate().map(|(t, w)| w * area(t)).sum();
        let scale = mesh.area() / total;
        match scale.is_finite() {
            true => weights.iter().map(|w| w * scale).collect(),
            false => vec![1.0; weights.len()],
        }
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
