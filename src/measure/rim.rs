//! The rims of surfaces: their boundary curves, the points of these that are closest to others, and how far the rims of two surfaces are apart.
//!
//! A rim is all edges that have one triangle, as segments. Its search tree is that of triangles, with segments as triangles that have two equal corners.

use super::sampling::{Figures, Sums};
use super::surface_error::Boundary;
use crate::geometry::Bvh;
use crate::mesh::TriangleMesh;
use crate::mesh::sample::SurfacePoint;
use crate::topology::{self, Holes};
use glam::DVec3;

/// The boundary edges of a triangle mesh.
pub struct Rim {
    edges: Vec<Edge>,
    tree: Bvh,
    length: f64,
}

/// A boundary edge.
#[derive(Debug, Clone, Copy)]
struct Edge {
    triangle: u32,
    /// The corner of the triangle that the edge begins at; it ends at the next.
    corner: usize,
    ends: [DVec3; 2],
}

/// A point of a rim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RimPoint {
    /// Where it is on the mesh.
    pub on: SurfacePoint,
    /// Where it is in space.
    pub point: DVec3,
    /// The direction of its edge; zero if that has no length.
    pub tangent: DVec3,
}

/// How far the rims of a target and of a surface are apart, in the units of their coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RimError {
    /// From all of the target's rim to that of the surface.
    pub target_to_surface: Figures,
    /// From the surface's rim to that of the target.
    pub surface_to_target: Figures,
}

impl Rim {
    /// The rim of a mesh of finite positions and valid indices, equal positions taken as one; `None` where it is closed.
    pub fn of(mesh: &TriangleMesh) -> Option<Self> {
        let edges: Vec<Edge> = Boundary::of(mesh)
            .edges()
            .map(|(triangle, corner)| {
                let corners = mesh.corners(triangle as usize);
                Edge {
                    triangle,
                    corner,
                    ends: [corners[corner], corners[(corner + 1) % 3]],
                }
            })
            .collect();
        let ends: Vec<DVec3> = edges.iter().flat_map(|e| e.ends).collect();
        let segments: Vec<[u32; 3]> = (0..edges.len() as u32)
            .map(|k| [2 * k, 2 * k + 1, 2 * k + 1])
            .collect();
        Some(Self {
            tree: Bvh::new(&ends, &segments).ok()?,
            length: edges.iter().map(Edge::length).sum(),
            edges,
        })
    }

    /// The length of all edges.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// For each point the closest one of the rim.
    pub fn closest(&self, points: &[DVec3]) -> Vec<RimPoint> {
        let closest = self.tree.closest_all(points);
        let on_edge = closest.iter().map(|c| {
            let [start, ..] = c.barycentric;
            self.edges[c.triangle as usize].at(1.0 - start)
        });
        on_edge.collect()
    }

    /// Points at equal distances along the edges in their order, `count` of them, and none where the rim has no length.
    pub fn samples(&self, count: usize) -> Vec<RimPoint> {
        let mut points = Vec::with_capacity(count);
        let step = self.length / count as f64;
        let mut before = 0.0;
        for edge in &self.edges {
            let length = edge.length();
            while points.len() < count && (points.len() as f64 + 0.5) * step < before + length {
                let along = (points.len() as f64 + 0.5) * step - before;
                points.push(edge.at((along / length).clamp(0.0, 1.0)));
            }
            before += length;
        }
        points
    }
}

impl Edge {
    fn length(&self) -> f64 {
        self.ends[0].distance(self.ends[1])
    }

    /// The point at a share of the way.
    fn at(&self, share: f64) -> RimPoint {
        let [a, b] = self.ends;
        let mut barycentric = [0.0; 3];
        barycentric[self.corner] = 1.0 - share;
        barycentric[(self.corner + 1) % 3] = share;
        RimPoint {
            on: SurfacePoint {
                triangle: self.triangle,
                barycentric,
            },
            point: a.lerp(b, share),
            tangent: (b - a).normalize_or_zero(),
        }
    }
}

/// How far the rims of a target and a surface are apart, by `samples` points on each; the target's tiny holes ([`Holes::Follow`]) do not count. `None` where
/// one of them is closed. Both need finite positions and valid indices.
pub fn rim_error(
    target: &TriangleMesh,
    surface: &TriangleMesh,
    samples: usize,
) -> Option<RimError> {
    let mut target = topology::cleaned(target);
    target
        .triangles
        .extend(topology::fill_holes(&target, Holes::Follow));
    let (target, surface) = (Rim::of(&target)?, Rim::of(surface)?);
    let from_to = |from: &Rim, to: &Rim| {
        let mut sums = Sums::default();
        let spread = from.samples(samples).into_iter().map(|p| (p.point, 1.0));
        let vertices = from.edges.iter().map(|e| (e.ends[0], 0.0));
        let (points, weights): (Vec<DVec3>, Vec<f64>) = spread.chain(vertices).unzip();
        for ((p, q), weight) in points.iter().zip(to.closest(&points)).zip(weights) {
            sums.add(p.distance_squared(q.point), weight);
        }
        sums.figures()
    };
    Some(RimError {
        target_to_surface: from_to(&target, &surface),
        surface_to_target: from_to(&surface, &target),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::shapes::grid;

    #[test]
    fn what_is_closed_or_nothing_has_no_rim() {
        assert!(Rim::of(&TriangleMesh::default()).is_none());
        let ball = crate::mesh::shapes::sphere(1.0, 2);
        assert!(Rim::of(&ball).is_none());
        assert!(rim_error(&ball, &grid(2, 1.0), 10).is_none());
    }

    #[test]
    fn points_of_a_squares_rim_lie_on_its_sides() {
        let rim = Rim::of(&grid(5, 3.0)).expect("open");
        assert!((rim.length() - 12.0).abs() < 1e-12);
        let samples = rim.samples(60);
        assert_eq!(samples.len(), 60);
        let mesh = grid(5, 3.0);
        for p in &samples {
            let on = p.on.position(mesh.corners(p.on.triangle as usize));
            assert!(on.distance(p.point) < 1e-14);
            let inner = |x: f64| x > 1e-9 && x < 3.0 - 1e-9;
            assert!(!(inner(p.point.x) && inner(p.point.y)));
        }
        let [near] = rim.closest(&[DVec3::new(1.7, 0.4, 2.0)])[..] else {
            panic!("one for each");
        };
        assert!(near.point.distance(DVec3::new(1.7, 0.0, 0.0)) < 1e-14);
        assert_eq!(near.tangent.abs(), DVec3::X);
    }

    #[test]
    fn a_smaller_square_is_nearer_to_the_larger_ones_sides_than_its_corners_are() {
        let mut small = grid(4, 1.0);
        for p in &mut small.positions {
            *p += DVec3::new(1.0, 1.0, 0.0);
        }
        let error = rim_error(&grid(6, 3.0), &small, 1200).expect("both open");
        assert!((error.target_to_surface.max - 2f64.sqrt()).abs() < 1e-12);
        assert!((error.surface_to_target.max - 1.0).abs() < 1e-12);
        assert!((error.surface_to_target.rms - 1.0).abs() < 1e-12);
    }
}
