//! Points spread over a surface by area.

use super::TriangleMesh;
use crate::geometry::random::Random;
use glam::DVec3;
use rayon::prelude::*;

/// A point on a triangle mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// The triangle.
    pub triangle: u32,
    /// Weights of its corners: non-negative, sum 1.
    pub barycentric: [f64; 3],
}

impl SurfacePoint {
    /// Where it is.
    pub fn position(&self, corners: [DVec3; 3]) -> DVec3 {
        let [a, b, c] = self.barycentric;
        corners[0] * a + corners[1] * b + corners[2] * c
    }
}

/// `count` points of equal share of the area: the area in the order of the triangles is cut into equal parts, and each
/// gets one random point. Fewer only where the mesh has no area: none.
pub fn sample_by_area(mesh: &TriangleMesh, count: usize, seed: u64) -> Vec<SurfacePoint> {
    let areas: Vec<f64> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| mesh.area_vector(t).length())
        .collect();
    let total: f64 = areas.iter().sum();
    let mut points = Vec::with_capacity(count);
    let mut random = Random::new(seed);
    let mut before = 0.0;
    for (t, area) in areas.iter().enumerate() {
        // Point k lies at a random place in [k, k + 1) / count of the area; a triangle takes those that start in it.
        let end = (before + area) / total * count as f64;
        while points.len() < count && (points.len() as f64 + 0.5) < end {
            points.push(SurfacePoint {
                triangle: t as u32,
                barycentric: random_barycentric(&mut random),
            });
        }
        before += area;
    }
    points
}

/// Uniform on a triangle.
fn random_barycentric(random: &mut Random) -> [f64; 3] {
    let (a, b) = (random.uniform(), random.uniform());
    let root = a.sqrt();
    [1.0 - root, root * (1.0 - b), root * b]
}
