//! A surface from a cloud of points, which Voronoi squared distances and templates need, and what closes the holes of scans (`bridges`).
//!
//! Normals are estimated and turned outwards (`normals`), unless the cloud has some. Each point then becomes a small triangle across its normal that
//! stands for its share of the surface, and what these triangles go around is inside, by their winding numbers as of any soup ([`crate::template::skin`]).
//! That surface is moved onto the points by moving least squares (`mls`), and what no point is near to, or none that faces alike, is left open: a hole of the scan,
//! which a fit bridges and reports apart.

mod bridges;
mod mls;
mod neighbours;
mod normals;

pub use bridges::{Bridged, bridged};

use crate::error::{Error, Result};
use crate::mesh::weld::equal_positions;
use crate::mesh::{Frame, PointCloud, TriangleMesh};
use crate::template;
use glam::DVec3;
use neighbours::Neighbours;
use rayon::prelude::*;

/// The least cell of the grid, in mean spacings of the points: between points that are further apart there is no inside and outside.
const CELL: f64 = 0.5;
/// What is farther from all points than so many of their spacings is open.
const OPEN: f64 = 3.0;
/// The share of the area around points that they must cover to enclose anything. Of a ball from the front it is two thirds, of a sheet half: the other half is its back.
const SEEN: f64 = 0.63;
/// The fewest points that can be told from noise.
const FEWEST: usize = 50;

/// The points of a cloud, equal ones once, as samples of a surface, in the unit frame.
#[derive(Debug, Clone)]
pub struct OrientedPoints {
    /// From and to the cloud's coordinates.
    pub frame: Frame,
    /// `[points]`.
    pub positions: Vec<DVec3>,
    /// `[points]`, of length 1, out of what the points bound.
    pub normals: Vec<DVec3>,
    /// `[points]`: how much of the surface's area each stands for.
    pub areas: Vec<f64>,
    /// For each point an equilateral triangle about it, across its normal and of its area.
    pub splats: TriangleMesh,
    neighbours: Neighbours,
}

/// Samples of the surface that a cloud of points lies on. Normals of the cloud are taken as they are, but for their common sign; they are
/// estimated if there are none, or if they do not fit the points.
///
/// # Errors
/// Where there are fewer than 50 different points, or no extent.
pub fn oriented(cloud: &PointCloud) -> Result<OrientedPoints> {
    let frame = Frame::of_points(&cloud.positions)?;
    let first = equal_positions(&cloud.positions);
    let different = (0..first.len()).filter(|&i| first[i] as usize == i);
    let points = PointCloud {
        positions: different
            .clone()
            .map(|i| frame.to_unit(cloud.positions[i]))
            .collect(),
        normals: match cloud.normals.is_empty() {
            true => Vec::new(),
            false => different.map(|i| cloud.normals[i]).collect(),
        },
        confidence: Vec::new(),
    };
    if points.positions.len() < FEWEST {
        return Err(Error::input(
            format!("there are {} different points", points.positions.len()),
            "give at least 50",
        ));
    }
    let neighbours = Neighbours::of_points(&points.positions);
    let normals = normals::oriented(&points, &neighbours);
    Ok(OrientedPoints {
        frame,
        areas: (0..points.positions.len())
            .map(|i| neighbours.area(i))
            .collect(),
        splats: splats(&points.positions, &normals, &neighbours),
        positions: points.positions,
        normals,
        neighbours,
    })
}

/// The surface of a cloud of points, in its coordinates: triangles, open where there are no points.
///
/// Normals as in [`oriented`]. Details smaller than a cell of the grid, 1/128 of the diagonal or half the points' spacing, are smoothed away.
///
/// # Errors
/// As [`oriented`], and where there is nothing that the points go around, as where a thin or composed thing was seen from one side only.
pub fn surface(cloud: &PointCloud) -> Result<TriangleMesh> {
    let OrientedPoints {
        frame,
        positions,
        normals,
        areas,
        splats,
        neighbours,
    } = oriented(cloud)?;
    let spacing = (areas.iter().sum::<f64>() / positions.len() as f64).sqrt();
    let mut mesh = template::skin(&splats, CELL * spacing)?;
    mesh.positions = mls::projected(&mesh.positions, &positions, &normals, &neighbours);
    let around = mesh.area();
    let mesh = covered(&mesh, &positions, &normals, &neighbours);
    if mesh.area() < SEEN * around {
        return Err(Error::input(
            format!(
                "the points enclose nothing: they are on {:.0} % of what goes around them",
                100.0 * mesh.area() / around
            ),
            "add the other side, as scans from all around have it, or give --method geometric and a mesh to start from, which needs points only",
        ));
    }
    Ok(TriangleMesh {
        positions: mesh.positions.iter().map(|&p| frame.to_input(p)).collect(),
        triangles: mesh.triangles,
    })
}

/// For each point an equilateral triangle about it across its normal, with its share of the area.
fn splats(positions: &[DVec3], normals: &[DVec3], neighbours: &Neighbours) -> TriangleMesh {
    let mut splats = TriangleMesh::default();
    for (i, (&p, &n)) in positions.iter().zip(normals).enumerate() {
        let radius = (4.0 * neighbours.area(i) / 27f64.sqrt()).sqrt();
        let (u, v) = n.any_orthonormal_pair();
        let corner = |x: f64, y: f64| p + radius * (x * u + y * v);
        let half = 0.75f64.sqrt();
        splats.triangles.push([0, 1, 2].map(|k| 3 * i as u32 + k));
        splats
            .positions
            .extend([corner(1.0, 0.0), corner(-0.5, half), corner(-0.5, -half)]);
    }
    splats
}

/// The triangles that have a point near that faces as they do. Around points that enclose nothing the skin has two sides, of which one is not theirs.
fn covered(
    mesh: &TriangleMesh,
    points: &[DVec3],
    normals: &[DVec3],
    neighbours: &Neighbours,
) -> TriangleMesh {
    let normal_near = |p: &DVec3| {
        let i = neighbours.nearest(*p).next()?;
        let reach = OPEN * OPEN * neighbours.area(i);
        (points[i].distance_squared(*p) < reach).then_some(normals[i])
    };
    let near: Vec<Option<DVec3>> = mesh.positions.par_iter().map(normal_near).collect();
    let is_covered = |&t: &usize| {
        let facing = mesh.area_vector(t);
        let mut near = mesh.triangles[t].iter().map(|&v| near[v as usize]);
        near.any(|normal| normal.is_some_and(|normal| normal.dot(facing) > 0.0))
    };
    let kept = (0..mesh.triangles.len()).filter(is_covered);
    TriangleMesh {
        positions: mesh.positions.clone(),
        triangles: kept.map(|t| mesh.triangles[t]).collect(),
    }
}
