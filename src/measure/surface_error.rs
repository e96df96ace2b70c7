//! The error of a fitted surface against its target, with what lies over the target's holes apart.
//!
//! Where the target has a hole a good surface closes it, and the distance from there to the target says nothing about the fit. Such points
//! are known by their closest point on the target with its holes bridged ([`Mended`]): it lies on a bridge, or on a
//! boundary edge that is left. (The rim of the unbridged target does not tell: where it curls inwards, points over the hole are closest
//! to its inside.)

use super::mended::Mended;
use super::sampling::{Figures, Sums, for_each_sample, for_each_vertex};
use crate::device::Device;
use crate::error::Result;
use crate::geometry::{Bvh, ClosestPoint};
use crate::kernel::closest_point::ClosestPoints;
use crate::mesh::TriangleMesh;
use crate::topology::Holes;
use glam::DVec3;
use std::collections::HashMap;

/// How far a surface and its target are apart, in the units of their coordinates.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SurfaceError {
    /// From all of the target to the surface.
    pub target_to_surface: Figures,
    /// From the surface to the target, without what lies over holes.
    pub surface_to_target: Figures,
    /// The share of the surface's area that lies over holes of the target or beyond its rim.
    pub share_over_holes: f64,
    /// The largest distance from there to the bridge or rim; 0 where there is no such part.
    pub max_over_holes: f64,
    /// The share of the rest of the surface's area that faces away from the target ([`Mended`]); 1 where there is no rest.
    pub share_folded: f64,
}

impl SurfaceError {
    /// The largest distance either way, holes left out.
    pub fn max(&self) -> f64 {
        self.target_to_surface.max.max(self.surface_to_target.max)
    }
}

/// The error of `surface` against `target`, from at least `samples` area samples and the vertices of each.
///
/// Both need finite positions and valid indices.
///
/// # Errors
/// Where either has no triangle or no area.
pub fn surface_error(
    target: &TriangleMesh,
    surface: &TriangleMesh,
    samples: usize,
) -> Result<SurfaceError> {
    Mended::of(target, Holes::Bridge)?.surface_error(target, surface, samples)
}

impl Mended {
    /// The error of `surface` against `target`, which this is made of, as [`surface_error`] tells it.
    ///
    /// # Errors
    /// As [`surface_error`].
    pub fn surface_error(
        &self,
        target: &TriangleMesh,
        surface: &TriangleMesh,
        samples: usize,
    ) -> Result<SurfaceError> {
        let tree = Bvh::new(&surface.positions, &surface.triangles)?;
        let mut forth = Sums::default();
        for_each_sample(target, &tree, samples, |closest, area, _| {
            forth.add(closest.distance_squared, area);
        })?;
        for_each_vertex(target, &tree, forth.max, |closest| {
            forth.add(closest.distance_squared, 0.0);
            forth.max
        });
        let mut back = self.sums(surface, samples)?;
        self.add_vertices(surface, &mut back);
        Ok(SurfaceError {
            target_to_surface: forth.figures(),
            surface_to_target: back.covered.figures(),
            share_over_holes: back.over_holes.area / (back.over_holes.area + back.covered.area),
            max_over_holes: back.over_holes.figures().max,
            share_folded: match back.covered.area > 0.0 {
                true => back.folded / back.covered.area,
                false => 1.0,
            },
        })
    }

    fn sums(&self, surface: &TriangleMesh, samples: usize) -> Result<Back> {
        let mut back = Back::default();
        for_each_sample(surface, self.tree(), samples, |closest, area, triangle| {
            if !self.covers(closest) {
                return back.over_holes.add(closest.distance_squared, area);
            }
            back.covered.add(closest.distance_squared, area);
            if self.faces_away(surface.area_vector(triangle), closest) {
                back.folded += area;
            }
        })?;
        Ok(back)
    }

    /// Adds the vertices, which count for the largest distances only.
    fn add_vertices(&self, surface: &TriangleMesh, back: &mut Back) {
        let has_holes = self.has_holes();
        let enough = |back: &Back| match has_holes {
            true => back.covered.max.min(back.over_holes.max),
            false => back.covered.max,
        };
        for_each_vertex(surface, self.tree(), enough(back), |closest| {
            let part = match self.covers(closest) {
                true => &mut back.covered,
                false => &mut back.over_holes,
            };
            part.add(closest.distance_squared, 0.0);
            enough(back)
        });
    }
}

/// The distances of points from a surface, each of which counts alike.
///
/// # Errors
/// Where the surface has no triangle.
pub fn point_error(points: &[DVec3], surface: &TriangleMesh) -> Result<Figures> {
    let mut sums = Sums::default();
    let tree = Bvh::new(&surface.positions, &surface.triangles)?;
    for closest in tree.closest_all(points) {
        sums.add(closest.distance_squared, 1.0);
    }
    Ok(sums.figures())
}

/// What a surface's samples sum to.
#[derive(Default)]
struct Back {
    covered: Sums,
    over_holes: Sums,
    /// The area of what is covered and faces away.
    folded: f64,
}

/// The distance from each of `points` to a surface, for colouring.
///
/// # Errors
/// Where the surface has no triangle.
pub fn distances(surface: &TriangleMesh, points: &[DVec3]) -> Result<Vec<f64>> {
    let closest = ClosestPoints::new(&Device::Cpu, surface)?.query(points)?;
    Ok(closest.iter().map(|c| c.distance_squared.sqrt()).collect())
}

/// The edges of a mesh that have exactly one triangle once vertices at equal positions are one, and their vertices.
///
/// Triangles with two such corners are left out: they have no two sides.
pub struct Boundary {
    /// `[triangles, 3]`: whether the edge opposite to the corner is a boundary edge.
    edges: Vec<[bool; 3]>,
    /// `[triangles, 3]`: whether the corner is an end of a boundary edge.
    corners: Vec<[bool; 3]>,
}

impl Boundary {
    /// The boundary of a mesh.
    pub fn of(mesh: &TriangleMesh) -> Self {
        let vertices = merged_vertices(&mesh.positions);
        let triangles: Vec<[u32; 3]> = mesh
            .triangles
            .iter()
            .map(|t| t.map(|v| vertices[v as usize]))
            .collect();
        let edge = |t: &[u32; 3], k: usize| {
            let (a, b) = (t[(k + 1) % 3], t[(k + 2) % 3]);
            (a.min(b), a.max(b))
        };
        let is_proper = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
        let mut counts: HashMap<(u32, u32), u32> = HashMap::new();
        for t in triangles.iter().filter(|t| is_proper(t)) {
            for k in 0..3 {
                *counts.entry(edge(t, k)).or_default() += 1;
            }
        }
        let mut on_boundary = vec![false; mesh.positions.len()];
        for (&(a, b), _) in counts.iter().filter(|&(_, &count)| count == 1) {
            on_boundary[a as usize] = true;
            on_boundary[b as usize] = true;
        }
        Self {
            edges: triangles
                .iter()
                .map(|t| [0, 1, 2].map(|k| counts.get(&edge(t, k)) == Some(&1)))
                .collect(),
            corners: triangles
                .iter()
                .map(|t| t.map(|v| on_boundary[v as usize]))
                .collect(),
        }
    }

    /// The boundary edges, each as its triangle and the corner there that it begins at.
    pub fn edges(&self) -> impl Iterator<Item = (u32, usize)> {
        let opposite = |(t, edges): (u32, &[bool; 3])| {
            let edges = *edges;
            (0..3).filter_map(move |k| edges[k].then_some((t, (k + 1) % 3)))
        };
        (0..).zip(&self.edges).flat_map(opposite)
    }

    /// Whether a closest point on this mesh lies on a boundary edge or at an end of one.
    pub fn holds(&self, closest: &ClosestPoint) -> bool {
        let t = closest.triangle as usize;
        let weights = closest.barycentric;
        (0..3).any(|k| {
            (weights[k] == 0.0 && self.edges[t][k])
                || (weights[(k + 1) % 3] == 0.0
                    && weights[(k + 2) % 3] == 0.0
                    && self.corners[t][k])
        })
    }
}

/// For each vertex the first one at the same position.
fn merged_vertices(positions: &[DVec3]) -> Vec<u32> {
    let mut first: HashMap<[u64; 3], u32> = HashMap::with_capacity(positions.len());
    positions
        .iter()
        .zip(0..)
        .map(|(p, i)| {
            // Adding 0 makes −0 the same as 0.
            let key = p.to_array().map(|x| (x + 0.0).to_bits());
            *first.entry(key).or_insert(i)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::shapes::grid;

    /// The middle ninth of a square of side 3, of n² cells, is a hole.
    fn square_with_hole(n: u32) -> TriangleMesh {
        let mut mesh = grid(n, 3.0);
        let positions = mesh.positions.clone();
        mesh.triangles.retain(|t| {
            let center = t
                .iter()
                .map(|&v| positions[v as usize] / 3.0)
                .sum::<DVec3>();
            !(center.x > 1.0 && center.x < 2.0 && center.y > 1.0 && center.y < 2.0)
        });
        mesh
    }

    fn lifted(mut mesh: TriangleMesh, height: f64) -> TriangleMesh {
        for p in &mut mesh.positions {
            p.z += height;
        }
        mesh
    }

    #[test]
    fn what_lies_over_a_hole_is_reported_apart() {
        let target = square_with_hole(12);
        let surface = lifted(grid(30, 3.0), 0.1);
        let error = surface_error(&target, &surface, 50_000).expect("areas");
        for figures in [error.target_to_surface, error.surface_to_target] {
            for value in [figures.max, figures.mean, figures.rms] {
                assert!((value - 0.1).abs() < 1e-12);
            }
        }
        assert!((error.share_over_holes - 1.0 / 9.0).abs() < 1e-9);
        // The bridge over a flat hole is flat.
        assert!((error.max_over_holes - 0.1).abs() < 1e-12);
        assert_eq!(error.max(), error.target_to_surface.max);
    }

    #[test]
    fn an_unmerged_target_has_the_same_boundary() {
        let target = square_with_hole(12);
        let soup = TriangleMesh {
            positions: target
                .triangles
                .iter()
                .flatten()
                .map(|&v| target.positions[v as usize])
                .collect(),
            triangles: (0..target.triangles.len() as u32)
                .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
                .collect(),
        };
        let surface = lifted(grid(7, 3.0), 0.2);
        assert_eq!(
            surface_error(&target, &surface, 5000).expect("areas"),
            surface_error(&soup, &surface, 5000).expect("areas"),
        );
    }

    #[test]
    fn degenerate_triangles_do_not_open_or_close_edges() {
        let mut mesh = grid(3, 1.0);
        let count = |mesh: &TriangleMesh| {
            Boundary::of(mesh)
                .edges
                .iter()
                .flatten()
                .filter(|&&b| b)
                .count()
        };
        assert_eq!(count(&mesh), 12);
        let [a, b, _] = mesh.triangles[0];
        mesh.triangles.extend([[a, b, b], [a, a, a]]);
        let boundary = Boundary::of(&mesh);
        let proper = boundary.edges.len() - 2;
        assert_eq!(
            boundary.edges[..proper]
                .iter()
                .flatten()
                .filter(|&&b| b)
                .count(),
            12
        );
    }

    #[test]
    fn distances_come_in_the_order_of_the_points() {
        let points: Vec<_> = (0..100)
            .map(|i| DVec3::new(0.5, 0.5, f64::from(i * 7 % 100)))
            .collect();
        let distances = distances(&grid(4, 1.0), &points).expect("triangles");
        for (p, d) in points.iter().zip(distances) {
            assert!((p.z - d).abs() < 1e-13);
        }
    }
}
