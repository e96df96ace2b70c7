//! What a geometric fit is to reach: points, in the unit frame.

use crate::error::{Error, Result};
use crate::geometry::morton;
use crate::mesh::sample::sample_by_area;
use crate::mesh::{Connectivity, ControlMesh, Frame, TriangleMesh};
use crate::template::{self, Align};
use crate::topology;
use glam::DVec3;

/// The share of a mesh's vertices that it is simplified to where nothing else is asked for, and the least number: the paper takes 1 to 5 %.
const SHARE: f64 = 0.02;
const FEWEST: usize = 50;

/// Where a geometric fit starts, in the target's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub enum Start {
    /// The target itself, simplified to so many control points; by default to 2 % of its vertices.
    Simplified(Option<usize>),
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
    /// `[points]`: whether it lies on the boundary of the target, and so belongs to the boundary of the surface.
    pub on_boundary: Vec<bool>,
    /// The target in the unit frame, an oriented manifold; a cloud of points has none.
    mesh: Option<TriangleMesh>,
}

impl Data {
    /// The vertices of a mesh or, with `samples`, so many points spread evenly over its area and the vertices of its boundary.
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
        let is_boundary = |v: usize| connectivity.is_boundary_vertex(v as u32);
        let vertices = mesh.positions.iter().enumerate();
        let mut points: Vec<(DVec3, bool)> = vertices
            .map(|(v, &p)| (p, is_boundary(v)))
            .filter(|&(_, on_boundary)| samples.is_none() || on_boundary)
            .collect();
        if let Some(count) = samples {
            let spread = sample_by_area(&mesh, count, seed);
            points.extend(
                spread
                    .iter()
                    .map(|s| (s.position(mesh.corners(s.triangle as usize)), false)),
            );
        }
        Ok(Self {
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
        let points: Vec<_> = points.iter().map(|&p| (frame.to_unit(p), false)).collect();
        Ok(Self::ordered(frame, &points))
    }

    /// The control mesh that a fit starts from, in the unit frame.
    ///
    /// # Errors
    /// As [`template::simplified`] and [`template::placed`]; also where a cloud of points is to be simplified.
    pub fn control_mesh(&self, start: &Start) -> Result<ControlMesh> {
        match (start, &self.mesh) {
            (Start::Simplified(count), Some(mesh)) => {
                let share = (SHARE * mesh.positions.len() as f64) as usize;
                template::simplified(mesh, count.unwrap_or(share.max(FEWEST)))
            }
            (Start::Simplified(_), None) => Err(Error::input(
                "a cloud of points has no triangles that could be simplified",
                "give a control mesh near the points with --template FILE",
            )),
            (Start::Mesh { control, align }, _) => {
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

    /// Of points in the unit frame and whether each is on the boundary.
    fn ordered(frame: Frame, points: &[(DVec3, bool)]) -> Self {
        let positions: Vec<DVec3> = points.iter().map(|p| p.0).collect();
        let order = morton::order(&positions);
        Self {
            frame,
            points: order.iter().map(|&i| positions[i as usize]).collect(),
            on_boundary: order.iter().map(|&i| points[i as usize].1).collect(),
            mesh: None,
        }
    }
}
