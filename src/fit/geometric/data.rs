//! What a geometric fit is to reach: points, in the unit frame.

use crate::device::Device;
use crate::error::{Error, Result};
use crate::geometry::morton;
use crate::mesh::sample::sample_by_area;
use crate::mesh::{Connectivity, ControlMesh, Frame, TriangleMesh};
use crate::progress::Progress;
use crate::template::{self, Align};
use crate::topology;
use glam::DVec3;

/// The share of a mesh's vertices that it is simplified to where nothing else is asked for, and the least number: the paper takes 1 to 5 %.
const SHARE: f64 = 0.02;
const FEWEST: usize = 50;

/// Points to an edge of the target's boundary, its first vertex among them. With the vertices alone, the surface's boundary bulges between them.
const POINTS_TO_AN_EDGE: u32 = 4;

/// Where a geometric fit starts, in the target's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub enum Start {
    /// The target itself, simplified to so many control points; by default to 2 % of its vertices and as many more as its boundary
    /// has, without which jagged rims are not found again, or as far as its topology allows.
    Simplified(Option<usize>),
    /// A network on the target that follows its curvature ([`template::adaptive`]); of so many control points, or as many as above.
    Adaptive {
        /// Control points.
        control_points: Option<usize>,
        /// The seed of its first point.
        seed: u64,
    },
    /// A network on the target's ridges and umbilics ([`template::ridges`]).
    Ridges {
        /// Control points.
        control_points: Option<usize>,
        /// Whether edges are flipped along ridges of one colour.
        flips: bool,
    },
    /// A control mesh of triangles.
    Mesh {
        /// The mesh.
        control: ControlMesh,
        /// How it is brought onto the target.
        align: Align,
    },
}

/// The points that a surface is fitted to, in the unit frame and in an order in which neighbours are near.
#[derive(Debug, Clone)]
pub struct Data {
    /// From and to the input's coordinates.
    pub frame: Frame,
    /// `[points]`.
    pub points: Vec<DVec3>,
    /// `[points]`: the loop of the target's boundary that it lies on, if any, by number from 0.
    pub rims: Vec<Option<u32>>,
    /// The loops of the target's boundary: the vertices of each, in order.
    pub(super) loops: Vec<Vec<DVec3>>,
    /// The target in the unit frame, an oriented manifold; a cloud of points has none.
    mesh: Option<TriangleMesh>,
}

impl Data {
    /// The vertices of a mesh or, with `samples`, so many points spread evenly over its area; and in both cases points along its boundary, four to an edge.
    ///
    /// Equal positions are merged first, and where the mesh is no oriented manifold it is cut ([`topology::manifold`]); cuts count as
    /// boundaries.
    ///
    /// # Errors
    /// Where the mesh has no extent.
    pub fn of_mesh(mesh: &TriangleMesh, samples: Option<usize>, seed: u64) -> Result<Self> {
        let frame = Frame::of(mesh)?;
        let mut mesh = topology::manifold(&topology::cleaned(mesh)).mesh;
        let to_unit = |p: &mut DVec3| *p = frame.to_unit(*p);
        mesh.positions.iter_mut().for_each(to_unit);
        let connectivity = Connectivity::of(&mesh.clone().into())?;
        let mut points: Vec<(DVec3, Option<u32>)> = match samples {
            None => (0..mesh.positions.len())
                .filter(|&v| !connectivity.is_boundary_vertex(v as u32))
                .map(|v| (mesh.positions[v], None))
                .collect(),
            Some(count) => sample_by_area(&mesh, count, seed)
                .iter()
                .map(|s| (s.position(mesh.corners(s.triangle as usize)), None))
                .collect(),
        };
        let at = |v: u32| mesh.positions[v as usize];
        let loops: Vec<Vec<DVec3>> = (connectivity.boundary_vertices().into_iter())
            .map(|vertices| vertices.into_iter().map(at).collect())
            .collect();
        for (rim, vertices) in loops.iter().enumerate() {
            for (k, &a) in vertices.iter().enumerate() {
                let b = vertices[(k + 1) % vertices.len()];
                let along = |k| a.lerp(b, f64::from(k) / f64::from(POINTS_TO_AN_EDGE));
                points.extend((0..POINTS_TO_AN_EDGE).map(|k| (along(k), Some(rim as u32))));
            }
        }
        Ok(Self {
            loops,
            mesh: Some(mesh),
            ..Self::ordered(frame, &points)
        })
    }

    /// A cloud of points, whose boundary is not known.
    ///
    /// # Errors
    /// Where there are none, or their bounding box has no extent.
    pub fn of_points(points: &[DVec3]) -> Result<Self> {
        let frame = Frame::of_points(points)?;
        let points: Vec<_> = points.iter().map(|&p| (frame.to_unit(p), None)).collect();
        Ok(Self::ordered(frame, &points))
    }

    /// The control mesh that a fit starts from, in the unit frame; interrupted, a network of fewer points.
    ///
    /// # Errors
    /// As [`template::simplified`], [`template::adaptive`], [`template::ridges`] and [`template::placed`]; also where a cloud of points is to be simplified.
    pub fn control_mesh(
        &self,
        device: &Device,
        start: &Start,
        progress: &dyn Progress,
    ) -> Result<ControlMesh> {
        match start {
            Start::Simplified(count) => {
                let mesh = self.triangles()?;
                match count {
                    Some(count) => template::simplified(mesh, *count),
                    None => Ok(template::simplified_towards(mesh, self.usual_count(mesh)).0),
                }
            }
            Start::Adaptive {
                control_points,
                seed,
            } => {
                let mesh = self.triangles()?;
                let count = control_points.unwrap_or_else(|| self.usual_count(mesh));
                template::adaptive(device, mesh, count, *seed, progress)
            }
            Start::Ridges {
                control_points,
                flips,
            } => {
                let mesh = self.triangles()?;
                let count = control_points.unwrap_or_else(|| self.usual_count(mesh));
                template::ridges(device, mesh, count, *flips, progress)
            }
            Start::Mesh { control, align } => {
                let mut control = control.clone();
                for p in &mut control.mesh.positions {
                    *p = self.frame.to_unit(*p);
                }
                let target = self.alignment_target(*align)?;
                let mut placed = template::placed(&control, *align, &target)?;
                placed.mesh = placed.mesh.triangulate().into();
                Ok(placed)
            }
        }
    }

    /// Control points where nothing else is asked for.
    fn usual_count(&self, mesh: &TriangleMesh) -> usize {
        let rims: usize = self.loops.iter().map(Vec::len).sum();
        FEWEST.max((SHARE * mesh.positions.len() as f64) as usize) + rims
    }

    fn triangles(&self) -> Result<&TriangleMesh> {
        self.mesh.as_ref().ok_or_else(|| {
            Error::input(
                "a cloud of points has no triangles that a control mesh could be made from",
                "give a control mesh near the points with --template FILE",
            )
        })
    }

    /// What a template is aligned to: the target or, of a cloud, a triangle with its bounding box.
    fn alignment_target(&self, align: Align) -> Result<TriangleMesh> {
        if let Some(mesh) = &self.mesh {
            return Ok(mesh.clone());
        }
        if matches!(align, Align::Rigid | Align::Similarity) {
            return Err(Error::input(
                "a cloud of points has no surface that a template could be turned onto",
                "use --align box, or bring the template near the points yourself",
            ));
        }
        let points = || self.points.iter();
        let lo = points().fold(DVec3::INFINITY, |lo, &p| lo.min(p));
        let hi = points().fold(DVec3::NEG_INFINITY, |hi, &p| hi.max(p));
        Ok(TriangleMesh {
            positions: vec![lo, hi],
            triangles: vec![[0, 1, 1]],
        })
    }

    /// Of points in the unit frame and the rim of each.
    fn ordered(frame: Frame, points: &[(DVec3, Option<u32>)]) -> Self {
        let positions: Vec<DVec3> = points.iter().map(|p| p.0).collect();
        let order = morton::order(&positions);
        Self {
            frame,
            points: order.iter().map(|&i| positions[i as usize]).collect(),
            rims: order.iter().map(|&i| points[i as usize].1).collect(),
            loops: Vec::new(),
            mesh: None,
        }
    }
}
