//! The end of the [polish](super::polish): lowers the largest distances.
//!
//! Least squares leave a few places (corners, rims, the bottoms of creases) at ten times the rms. Here each step adds to the
//! least squares a penalty on what is farther from its goal than a limit: such a footpoint is pulled with a large weight, but
//! only to the limit, and what is nearer feels nothing, so the rms hardly suffers. The limit is a share of the present largest
//! distance and never rises: where it did, what it held back sprang back. (Weights by a power of the distance, the usual way,
//! move the whole surface: the bunny with 1,538 points had 0.51 % so, and has 0.25 % now.)
//!
//! A peak must be seen to be lowered. Every few steps all vertices of both sides and dense samples are searched; those far away are
//! watched until the next search, and the surface with the least product of the largest distance in such a search and the mean squared distance is the result.
//! (The least largest distance alone is now and then that of an early search, with a rms still high: the rocker arm from a torus of 512 points ended
//! with 0.0952 in place of 0.0933 %, and the same largest distance.)

use super::least_squares::{Footpoint, Weights};
use super::polish::{Correspondence, Polish, Step, Surface};
use super::target::Samples;
use crate::error::Result;
use crate::mesh::TriangleMesh;
use crate::mesh::sample::{SurfacePoint, sample_by_area};
use glam::DVec3;

/// Steps; a multiple of [`SEARCH`], so that the last one is judged.
pub(super) const STEPS: usize = 21;
/// Steps from one dense search to the next.
const SEARCH: usize = 3;
/// Dense samples, in units of those of the polish.
const DENSE: usize = 2;
/// What is farther than this share of the largest distance is watched.
const WATCH: f64 = 0.25;
/// The share of the largest distance that the limit is at most, in the first step and in the last.
const LIMIT: (f64, f64) = (0.5, 0.9);
/// The weight of a footpoint beyond the limit, in units of the others'. With 500 the first steps raise the rms by a twelfth, and it takes as many
/// again to come down: the bunny with 1,538 points ends with 0.042 in place of 0.040 %, and no lower a peak.
const PENALTY: f64 = 200.0;

/// Points of either side.
#[derive(Default)]
struct Watched {
    of_target: Samples,
    of_surface: Vec<SurfacePoint>,
}

impl Polish<'_> {
    /// Runs all steps; ends with the best control points that a search saw. Where `observe` says stop, the present ones
    /// are left.
    pub(super) fn flatten_peaks(
        &mut self,
        mut surface: Surface,
        control_points: &mut Vec<DVec3>,
        weights: Weights,
        done: usize,
        mut observe: impl FnMut(Step) -> bool,
    ) -> Result<()> {
        let everything = self.dense_target();
        let mut best = (f64::INFINITY, control_points.clone());
        let mut watched = Watched::default();
        let mut limit = f64::INFINITY;
        for step in 0..=STEPS {
            self.choose_outliers(&surface)?;
            let mut found = self.correspond(&surface)?;
            if step % SEARCH == 0 {
                let max;
                (max, watched) = self.search(&surface, &everything, found.max())?;
                let error = max * found.step(step).mean_square;
                if error < best.0 {
                    best = (error, control_points.clone());
                }
            }
            let Watched {
                of_target,
                of_surface,
            } = &watched;
            let far = self.correspond_at(&surface, of_target, of_surface, 0.0)?;
            let mut state = found.step(done + step);
            state.max = state.max.max(far.max());
            if !observe(state) {
                return Ok(());
            }
            if step == STEPS {
                break;
            }
            let progress = step as f64 / (STEPS - 1) as f64;
            limit = limit.min((LIMIT.0 + progress * (LIMIT.1 - LIMIT.0)) * state.max);
            let penalties = [penalties(&found, limit), penalties(&far, limit)].concat();
            found.footpoints.extend(penalties);
            self.solve(&surface, &found, weights, control_points);
            self.follow(&mut surface, control_points)?;
        }
        *control_points = best.1;
        Ok(())
    }

    /// All vertices of T and dense samples of it.
    fn dense_target(&self) -> Samples {
        let mut all = self.target.samples(DENSE * self.samples, self.seed + 2);
        let vertices = self.target.vertices();
        all.positions.extend(vertices.positions);
        all.normals.extend(vertices.normals);
        all.weights.extend(vertices.weights);
        all
    }

    /// The largest distance of all, and what to watch. `known`: a distance that some point has; what is too near to be watched then is not looked at
    /// closely.
    fn search(&self, surface: &Surface, of_target: &Samples, known: f64) -> Result<(f64, Watched)> {
        let mut of_surface = sample_by_area(&surface.mesh, DENSE * self.samples, self.seed + 3);
        of_surface.extend(vertices(&surface.mesh));
        let found = self.correspond_at(surface, of_target, &of_surface, WATCH * known)?;
        let mut rims = Correspondence::default();
        self.follow_rims(surface, &mut rims);
        let max = found.max().max(rims.max());
        let mut watched = Watched::default();
        for (k, (f, &distance)) in found.footpoints.iter().zip(&found.distances).enumerate() {
            if distance < WATCH * max {
                continue;
            }
            if let Some(&position) = of_target.positions.get(k) {
                watched.of_target.positions.push(position);
                watched.of_target.normals.push(of_target.normals[k]);
                watched.of_target.weights.push(of_target.weights[k]);
            } else {
                watched.of_surface.push(SurfacePoint {
                    triangle: f.triangle,
                    barycentric: f.barycentric,
                });
            }
        }
        Ok((max, watched))
    }
}

/// Pulls what is farther than `limit` from its goal to that distance from it.
fn penalties(found: &Correspondence, limit: f64) -> Vec<Footpoint> {
    let beyond = found
        .footpoints
        .iter()
        .zip(&found.distances)
        .filter(|(_, d)| **d > limit);
    beyond
        .map(|(f, _)| Footpoint {
            goal: f.goal - limit * f.normal,
            weight: PENALTY * f.weight,
            ..*f
        })
        .collect()
}

/// Each vertex as a corner of one of its triangles.
fn vertices(mesh: &TriangleMesh) -> Vec<SurfacePoint> {
    let mut seen = vec![false; mesh.positions.len()];
    let mut points = Vec::with_capacity(mesh.positions.len());
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        for (k, &v) in corners.iter().enumerate() {
            if !std::mem::replace(&mut seen[v as usize], true) {
                let mut barycentric = [0.0; 3];
                barycentric[k] = 1.0;
                points.push(SurfacePoint {
                    triangle: triangle as u32,
                    barycentric,
                });
            }
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn only_what_is_beyond_the_limit_is_pulled_and_only_to_it() {
        let footpoint = Footpoint {
            triangle: 0,
            barycentric: [1.0, 0.0, 0.0],
            goal: 3.0 * DVec3::X,
            normal: DVec3::X,
            weight: 0.5,
        };
        let found = Correspondence {
            footpoints: vec![footpoint; 3],
            distances: vec![0.0, 1.0, 3.0],
            ..Correspondence::default()
        };
        let pulled = penalties(&found, 1.0);
        assert_eq!(pulled.len(), 1);
        assert_eq!(pulled[0].goal, 2.0 * DVec3::X);
        assert_eq!(pulled[0].weight, 0.5 * PENALTY);
        assert!(penalties(&Correspondence::default(), 0.0).is_empty());
    }

    #[test]
    fn each_vertex_of_a_triangle_is_a_point_once() {
        let mut mesh = shapes::sphere(1.0, 1);
        let count = mesh.positions.len();
        mesh.positions.push(DVec3::splat(9.0));
        let points: Vec<DVec3> = vertices(&mesh)
            .iter()
            .map(|p| p.position(mesh.corners(p.triangle as usize)))
            .collect();
        assert_eq!(points.len(), count);
        assert!(mesh.positions[..count].iter().all(|p| points.contains(p)));
    }
}
