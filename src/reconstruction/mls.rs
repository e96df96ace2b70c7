//! Projection onto the surface that points with normals describe: implicit moving least squares.
//!
//! Near x the surface is where the weighted mean of the distances to the points' planes, f(x) = Σ wᵢ nᵢ · (x − pᵢ) / Σ wᵢ, is zero [R. Kolluri, *Provably good
//! moving least squares*, 2005], with Gaussian weights as wide as the points around are apart. The weights vary slowly, so x ← x − f(x) n(x), n the
//! weighted mean of the normals, comes near in a few steps.

use super::neighbours::Neighbours;
use glam::DVec3;
use rayon::prelude::*;

/// Steps towards the surface.
const STEPS: usize = 3;
/// The width of a weight, in spacings of the points around.
const WIDTH: f64 = 1.0;

/// The positions moved onto the surface of the points.
pub(super) fn projected(
    positions: &[DVec3],
    points: &[DVec3],
    normals: &[DVec3],
    neighbours: &Neighbours,
) -> Vec<DVec3> {
    let project = |&start: &DVec3| {
        let mut x = start;
        for _ in 0..STEPS {
            let near: Vec<usize> = neighbours.nearest(x).collect();
            let square = near.iter().map(|&i| neighbours.area(i)).sum::<f64>() / near.len() as f64;
            let (mut weights, mut distance, mut normal) = (0.0, 0.0, DVec3::ZERO);
            for i in near {
                let offset = x - points[i];
                let weight = (-offset.length_squared() / (WIDTH * WIDTH * square)).exp();
                weights += weight;
                distance += weight * normals[i].dot(offset);
                normal += weight * normals[i];
            }
            if weights > f64::MIN_POSITIVE {
                // Beyond a rim the planes of points that face various ways meet anywhere.
                let spacing = square.sqrt();
                let distance = (distance / weights).clamp(-spacing, spacing);
                x -= distance * normal.normalize_or_zero();
            }
        }
        x
    };
    positions.par_iter().map(project).collect()
}
