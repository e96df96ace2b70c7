//! The least-squares polish: Gauss–Newton on closest points both ways, from a surface that is already near.
//!
//! Voronoi terms measure distances between samples, so their minimum is off by about the square of the sample spacing.
//! Closest points have no such floor. Each step freezes the footpoints of area samples of T on S and of S on T, solves
//! the linear least squares for all control points ([`super::least_squares`]), and starts again; the regularizer falls
//! from step to step. A distance changes only along the line to its goal, so that direction is the one that counts
//! fully. (With the normals of T there instead, as in point-to-plane registration, Igea's rms ends a tenth higher.) A last round weights each footpoint by its squared residual, which is Newton's way to the fourth
//! power of distances, and lowers the largest error.

use super::least_squares::{Footpoint, LeastSquares, Shape, Weights};
use super::target::{Place, Target};
use super::voronoi::Options;
use crate::device::Device;
use crate::energy::Smoothness;
use crate::error::Result;
use crate::kernel::closest_point::ClosestPoints;
use crate::kernel::sparse::Csr;
use crate::mesh::TriangleMesh;
use crate::mesh::sample::{SurfacePoint, sample_by_area};
use crate::model::Model;
use glam::DVec3;
use rayon::prelude::*;

/// μ: what a tangential distance counts against a normal one.
const SLIDING: f64 = 0.01;

/// (λ_n, λ_t) and the number of steps with them: the measured schedule.
const SCHEDULE: [(f64, f64, usize); 3] = [(1.0, 1.0, 2), (0.1, 0.5, 3), (0.01, 0.03, 8)];

/// Steps with weights for the fourth power.
const PEAK_STEPS: usize = 14;

/// The share of each such step that is taken. Reweighting overshoots by p − 1 = 3 near the minimum of the fourth power.
const PEAK_SHARE: f64 = 0.5;

/// The relative residual of the linear solves.
const TOLERANCE: f64 = 1e-2;

/// Area samples a side for each control point, and their least and largest number. A balance
/// with time: at 386 points on the bunny 60,000 in place of 20,000 lower the rms by 3 %.
const SAMPLES_PER_POINT: usize = 40;
const SAMPLES: (usize, usize) = (20_000, 100_000);

/// The weight of a bridge over a hole against the target: it is a guess.
const BRIDGE: f64 = 0.1;

/// Below this cosine between the normals of S and T a patch is taken to fold. On sharp edges normals differ by right
/// angles without folds, so not above 0.
const FOLDED: f64 = 0.0;
/// The factor on the regularizer of a patch that folds, for each step that finds it so.
const STIFFEN: f64 = 8.0;
/// The largest such factor.
const STIFFEST: f64 = 1000.0;
/// The factor for each step that finds it unfolded.
const RELAX: f64 = 0.8;

/// Distances under this, in diagonals, have no direction of their own.
const COINCIDENT: f64 = 1e-7;

/// A footpoint's largest weight in the last round, in units of their mean: a few outliers must not take over.
const MAX_WEIGHT: f64 = 30.0;

/// Polishes one model against one target.
pub(super) struct Polish<'a> {
    device: &'a Device,
    target: &'a Target,
    model: &'a Model,
    equations: LeastSquares,
    /// `[patches]`: factors on the regularizer's weights, raised where the surface folds.
    stiffness: Vec<f64>,
    smoothness: f64,
    /// Area samples a side.
    samples: usize,
    seed: u64,
}

/// What a step of the polish saw before it, in the unit frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    /// Steps done before.
    pub done: usize,
    /// The largest distance of a footpoint from its goal.
    pub max: f64,
    /// The mean distance.
    pub mean: f64,
    /// The mean squared distance.
    pub mean_square: f64,
}

/// Footpoints of one step, and what they say of the surface before it.
struct Correspondence {
    footpoints: Vec<Footpoint>,
    /// Unit normals of S at its vertices.
    normals: Vec<DVec3>,
    /// `[patches]`: whether some of it faces the wrong way.
    folded: Vec<bool>,
    /// Squared distances of the footpoints from their goals.
    squared: Vec<f64>,
}

impl<'a> Polish<'a> {
    /// Steps at most.
    pub const STEPS: usize = SCHEDULE[0].2 + SCHEDULE[1].2 + SCHEDULE[2].2 + PEAK_STEPS;

    /// `cage`: the squared Laplacian of the control mesh.
    pub fn new(
        device: &'a Device,
        target: &'a Target,
        model: &'a Model,
        smoothness: &Smoothness,
        cage: &Csr,
        options: &Options,
    ) -> Self {
        Self {
            device,
            target,
            model,
            equations: LeastSquares::new(model, smoothness, cage),
            stiffness: vec![1.0; model.patches.last().map_or(0, |&p| p as usize + 1)],
            smoothness: options.smoothness,
            samples: (SAMPLES_PER_POINT * model.matrix.column_count).clamp(SAMPLES.0, SAMPLES.1),
            seed: options.seed,
        }
    }

    /// The weights of a step, not below what the caller asked for at the end.
    fn weights(&self, (normal, tangential, _): (f64, f64, usize)) -> Weights {
        let last = SCHEDULE[SCHEDULE.len() - 1];
        Weights {
            normal: normal.max(self.smoothness),
            tangential: tangential.max(last.1 / last.0 * self.smoothness),
            sliding: SLIDING,
        }
    }

    /// Runs the schedule. `observe` sees the state before each step and returns whether to go on.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn run(
        &mut self,
        control_points: &mut Vec<DVec3>,
        mut observe: impl FnMut(Step) -> bool,
    ) -> Result<()> {
        let mut done = 0;
        for stage in SCHEDULE {
            for _ in 0..stage.2 {
                let found = self.correspond(control_points)?;
                if !observe(found.step(done)) {
                    return Ok(());
                }
                self.solve(&found, self.weights(stage), control_points);
                done += 1;
            }
        }
        self.flatten_peaks(control_points, done, observe)
    }

    /// Steps with weights w = r² / mean r², a share of the way to each solution; ends at the least mean fourth power seen.
    fn flatten_peaks(
        &mut self,
        control_points: &mut Vec<DVec3>,
        mut done: usize,
        mut observe: impl FnMut(Step) -> bool,
    ) -> Result<()> {
        let weights = self.weights(SCHEDULE[SCHEDULE.len() - 1]);
        let mut best = (f64::INFINITY, control_points.clone());
        for left in (0..=PEAK_STEPS).rev() {
            let mut found = self.correspond(control_points)?;
            let power = found.fourth_power();
            if power < best.0 {
                best = (power, control_points.clone());
            }
            if !observe(found.step(done)) || left == 0 {
                break;
            }
            found.weight_by_residual();
            let mut solution = control_points.clone();
            self.solve(&found, weights, &mut solution);
            for (p, s) in control_points.iter_mut().zip(&solution) {
                *p += PEAK_SHARE * (*s - *p);
            }
            done += 1;
        }
        *control_points = best.1;
        Ok(())
    }

    fn solve(&mut self, found: &Correspondence, weights: Weights, control_points: &mut [DVec3]) {
        for (stiffness, &folded) in self.stiffness.iter_mut().zip(&found.folded) {
            *stiffness = if folded {
                (*stiffness * STIFFEN).min(STIFFEST)
            } else {
                (*stiffness * RELAX).max(1.0)
            };
        }
        let mut stiffness = vec![1.0; found.normals.len()];
        for (triangle, &patch) in self.model.triangles.iter().zip(&self.model.patches) {
            for &v in triangle {
                let at: &mut f64 = &mut stiffness[v as usize];
                *at = at.max(self.stiffness[patch as usize]);
            }
        }
        let shape = Shape {
            normals: found.normals.clone(),
            stiffness,
        };
        self.equations.solve(
            &found.footpoints,
            &shape,
            weights,
            control_points,
            TOLERANCE,
        );
    }

    /// Closest points both ways at the present control points. Beyond open rims there are none: there the surface
    /// follows the regularizer.
    fn correspond(&self, control_points: &[DVec3]) -> Result<Correspondence> {
        let surface = TriangleMesh {
            positions: self.model.positions(control_points),
            triangles: self.model.triangles.clone(),
        };
        let mut footpoints = self.pull_to_samples(&surface)?;
        let folded = self.push_to_target(&surface, &mut footpoints)?;
        let squared = footpoints
            .par_iter()
            .map(|f| {
                let at = SurfacePoint {
                    triangle: f.triangle,
                    barycentric: f.barycentric,
                };
                (at.position(surface.corners(f.triangle as usize)) - f.goal).length_squared()
            })
            .collect();
        Ok(Correspondence {
            footpoints,
            normals: vertex_normals(&surface),
            folded,
            squared,
        })
    }

    /// T → S: each sample of T pulls its closest point of S.
    fn pull_to_samples(&self, surface: &TriangleMesh) -> Result<Vec<Footpoint>> {
        let samples = self.target.samples(self.samples, self.seed);
        let closest = ClosestPoints::new(self.device, surface)?.query(&samples.positions)?;
        let weight = 1.0 / closest.len() as f64;
        Ok(closest
            .iter()
            .zip(samples.positions.iter().zip(&samples.normals))
            .map(|(c, (&goal, &normal))| Footpoint {
                triangle: c.triangle,
                barycentric: c.barycentric,
                goal,
                normal: direction(goal - c.point, normal),
                weight,
            })
            .collect())
    }

    /// S → T: area samples of S are pushed to their closest points of T. Returns which patches fold there.
    fn push_to_target(
        &self,
        surface: &TriangleMesh,
        footpoints: &mut Vec<Footpoint>,
    ) -> Result<Vec<bool>> {
        let samples = sample_by_area(surface, self.samples, self.seed + 1);
        let points: Vec<DVec3> = samples
            .par_iter()
            .map(|s| s.position(surface.corners(s.triangle as usize)))
            .collect();
        let weight = 1.0 / points.len() as f64;
        let mut folded = vec![false; self.stiffness.len()];
        for ((c, s), &point) in self
            .target
            .closest(&points)?
            .iter()
            .zip(&samples)
            .zip(&points)
        {
            if c.place == Place::Rim {
                continue;
            }
            let facing = surface.area_vector(s.triangle as usize).normalize_or_zero();
            if c.place == Place::Covered && facing.dot(c.normal) < FOLDED {
                folded[self.model.patches[s.triangle as usize] as usize] = true;
            }
            footpoints.push(Footpoint {
                triangle: s.triangle,
                barycentric: s.barycentric,
                goal: c.point,
                normal: direction(c.point - point, c.normal),
                weight: if c.place == Place::Bridge {
                    BRIDGE * weight
                } else {
                    weight
                },
            });
        }
        Ok(folded)
    }
}

impl Correspondence {
    fn step(&self, done: usize) -> Step {
        let n = self.squared.len().max(1) as f64;
        Step {
            done,
            max: self.squared.iter().copied().fold(0.0, f64::max).sqrt(),
            mean: self.squared.iter().map(|r| r.sqrt()).sum::<f64>() / n,
            mean_square: self.squared.iter().sum::<f64>() / n,
        }
    }

    fn fourth_power(&self) -> f64 {
        self.squared.iter().map(|r| r * r).sum::<f64>() / self.squared.len().max(1) as f64
    }

    fn weight_by_residual(&mut self) {
        let mean = self.squared.iter().sum::<f64>() / self.squared.len().max(1) as f64;
        if mean > 0.0 {
            for (f, r) in self.footpoints.iter_mut().zip(&self.squared) {
                f.weight *= (r / mean).min(MAX_WEIGHT);
            }
        }
    }
}

/// The direction in which a distance changes: along it, or along the target's normal where there is none.
fn direction(distance: DVec3, normal: DVec3) -> DVec3 {
    if distance.length() > COINCIDENT {
        distance.normalize()
    } else {
        normal
    }
}

/// Area-weighted unit normals at the vertices; zero where the faces around one cancel.
pub(super) fn vertex_normals(surface: &TriangleMesh) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; surface.positions.len()];
    for (t, corners) in surface.triangles.iter().enumerate() {
        let area_vector = surface.area_vector(t);
        for &v in corners {
            normals[v as usize] += area_vector;
        }
    }
    normals.iter().map(|n| n.normalize_or_zero()).collect()
}
