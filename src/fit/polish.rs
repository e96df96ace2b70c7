//! The least-squares polish: Gauss–Newton on closest points both ways, from a surface that is already near.
//!
//! Voronoi terms measure distances between samples, so their minimum is off by about the square of the sample spacing.
//! Closest points have no such floor. Each step freezes the footpoints of area samples of T on S and of S on T, solves
//! the linear least squares for all control points ([`super::least_squares`]), and starts again; the regularizer falls
//! from step to step. A distance changes only along the line to its goal, so that direction is the one that counts
//! fully. (With the normals of T there instead, as in point-to-plane registration, Igea's rms ends a tenth higher.)
//! Where the target's rims are to be followed, samples of its boundary curves and of the surface's are footpoints of one another too.
//! Where walls are thin against the faces, the closest point is often on a wall's other side, and a surface that follows it is turned over. From templates of which that is
//! known, a closest point that faces the other way gives its place to the closest one that does not, if that is hardly further ([`ALIKE`]). Peaks are lowered to
//! closest points all the same: these are what is measured.
//! Last, [`super::peaks`] lowers the largest distances, unless the surface is to be subdivided: its finer successor has other peaks, and where these
//! had been lowered first it ended with larger errors (Igea with 6,146 points with 0.131 in place of 0.114 %, the bunny with 0.248 in place of 0.161 %),
//! more folds, and later.

use super::least_squares::{Footpoint, LeastSquares, Shape, Weights};
use super::outliers;
use super::peaks;
use super::target::{Place, Samples, Target, TargetPoint};
use super::voronoi::Options;
use crate::device::Device;
use crate::energy::Smoothness;
use crate::error::Result;
use crate::geometry::ClosestPoint;
use crate::kernel::closest_point::ClosestPoints;
use crate::kernel::sparse::Csr;
use crate::measure::{Rim, RimPoint};
use crate::mesh::TriangleMesh;
use crate::mesh::sample::{SurfacePoint, sample_by_area};
use crate::model::Model;
use glam::DVec3;
use rayon::prelude::*;

/// μ: what a tangential distance counts against a normal one.
const SLIDING: f64 = 0.01;

/// (λ_n, λ_t) and the number of steps with them: the measured schedule.
const SCHEDULE: [(f64, f64, usize); 3] = [(1.0, 1.0, 1), (0.1, 0.5, 2), (0.01, 0.03, 6)];

/// The same before it, where the surface comes from a template that lies on the target and no other phase has run: stiff enough to go there
/// as a whole, and to unfold on the way. With 10 in place of 100 errors are the same and folds a little more.
const APPROACH: (f64, f64, usize) = (100.0, 100.0, 3);

/// The relative residual of the linear solves. With 1e-2 the penalties on peaks throw up new ones elsewhere.
const TOLERANCE: f64 = 1e-3;

/// Area samples a side for each control point, and their least and largest number. A balance
/// with time: at 386 points on the bunny 60,000 in place of 20,000 lower the rms by 3 %.
const SAMPLES_PER_POINT: usize = 25;
const SAMPLES: (usize, usize) = (20_000, 100_000);

/// The weight of a sample of a rim, where rims are followed, against one of the area; along the rim they are as far apart as those are. A curve has fewer of them to a control point.
const ON_RIM: f64 = 4.0;

/// The weight of a bridge over a hole against the target: it is a guess.
const BRIDGE: f64 = 0.1;

/// Below this cosine between the normals of S and T a patch is taken to fold. On sharp edges normals differ by right
/// angles without folds, so not above 0.
const FOLDED: f64 = 0.0;
/// The factor on the regularizer of a patch that folds, for each step that finds it so, and the largest such factor. Some patches face
/// the wrong way for good, on the rims of holes that curl inwards: with 8 and 1000 their error was twice that of all others.
const STIFFEN: f64 = 2.0;
const STIFFEST: f64 = 8.0;
/// The factor for each step that finds it unfolded.
const RELAX: f64 = 0.8;

/// Distances under this, in diagonals, have no direction of their own.
const COINCIDENT: f64 = 1e-7;

/// How much further than the closest point, in diagonals, a footpoint may be that faces alike: twice the rms of a fit to overlapping scans. With 0.01 the largest error of overlapping scans is twice
/// what it is without.
const ALIKE: f64 = 0.002;

/// The weight of a closest point of T that faces the other way, where none near faces alike: most often the surface is behind a gap in T there. With 1 twice as much of
/// overlapping scans ends turned over.
const OPPOSED: f64 = 0.3;

/// Where in a fit a polish is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Role {
    /// Whether the surface comes straight from a template on the target.
    pub approaches: bool,
    /// Whether footpoints are to face alike ([`ALIKE`]).
    pub tells_sides: bool,
    /// Whether nothing comes after it.
    pub finishes: bool,
}

/// Polishes one model against one target.
pub(super) struct Polish<'a> {
    device: &'a Device,
    pub target: &'a Target,
    model: &'a Model,
    equations: LeastSquares,
    /// `[patches]`: factors on the regularizer's weights, raised where the surface folds.
    stiffness: Vec<f64>,
    smoothness: f64,
    /// The share of T's samples that are left out, and the distance beyond which they are.
    outliers: f64,
    cutoff: f64,
    /// The schedule, after [`APPROACH`] where that is wanted.
    schedule: Vec<(f64, f64, usize)>,
    tells_sides: bool,
    finishes: bool,
    /// Area samples a side, and those of T.
    pub samples: usize,
    of_target: Samples,
    /// Samples a rim, where rims are followed, and those of T's.
    rim_samples: usize,
    of_target_rim: Vec<RimPoint>,
    pub seed: u64,
}

/// The surface at some control points.
pub(super) struct Surface {
    pub mesh: TriangleMesh,
    tree: ClosestPoints,
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

/// Which footpoints are asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Wanted {
    /// Those that face alike, where they are hardly further than the closest.
    Alike,
    /// The closest; for samples no further than this, any that is no further.
    Closest(f64),
}

/// Where samples of both sides should go, and what that says of the surface.
#[derive(Default)]
pub(super) struct Correspondence {
    /// Those of the samples of T, then those of the samples of S that are closest to T itself.
    pub footpoints: Vec<Footpoint>,
    /// `[footpoints]`: their distances from their goals.
    pub distances: Vec<f64>,
    /// Those of the samples of S over holes of T. They count little, and not at all in the figures.
    pub over_holes: Vec<Footpoint>,
    /// `[patches]`: whether some of it faces the wrong way.
    pub folded: Vec<bool>,
}

impl<'a> Polish<'a> {
    /// Steps at most.
    pub fn steps(&self) -> usize {
        let peaks = if self.finishes { peaks::STEPS } else { 0 };
        self.schedule.iter().map(|s| s.2).sum::<usize>() + peaks
    }

    /// `cage`: the squared Laplacian of the control mesh.
    pub fn new(
        device: &'a Device,
        target: &'a Target,
        model: &'a Model,
        smoothness: &Smoothness,
        cage: &Csr,
        role: Role,
        options: &Options,
    ) -> Self {
        let approach = role.approaches.then_some(APPROACH);
        let samples = (SAMPLES_PER_POINT * model.matrix.column_count).clamp(SAMPLES.0, SAMPLES.1);
        let spacing = (target.mesh.area() / samples as f64).sqrt();
        let rim_samples = target
            .rim()
            .map_or(0, |rim| (rim.length() / spacing).ceil() as usize);
        Self {
            device,
            target,
            model,
            equations: LeastSquares::new(model, smoothness, cage),
            stiffness: vec![1.0; model.patches.last().map_or(0, |&p| p as usize + 1)],
            smoothness: options.smoothness,
            outliers: options.outliers,
            cutoff: f64::INFINITY,
            schedule: approach.into_iter().chain(SCHEDULE).collect(),
            tells_sides: role.tells_sides,
            finishes: role.finishes,
            samples,
            of_target: target.samples(samples, options.seed),
            rim_samples,
            of_target_rim: target
                .rim()
                .map_or(Vec::new(), |rim| rim.samples(rim_samples)),
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

    /// Runs the schedule, and at the end of the fit flattens the peaks. `observe` sees the state before each step and
    /// returns whether to go on.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn run(
        &mut self,
        control_points: &mut Vec<DVec3>,
        mut observe: impl FnMut(Step) -> bool,
    ) -> Result<()> {
        let mut done = 0;
        let mut surface = self.surface(control_points)?;
        for stage in self.schedule.clone() {
            for _ in 0..stage.2 {
                self.choose_outliers(&surface)?;
                let found = self.correspond(&surface)?;
                if !observe(found.step(done)) {
                    return Ok(());
                }
                self.solve(&surface, &found, self.weights(stage), control_points);
                self.follow(&mut surface, control_points)?;
                done += 1;
            }
        }
        if !self.finishes {
            return Ok(());
        }
        let weights = self.weights(SCHEDULE[SCHEDULE.len() - 1]);
        self.flatten_peaks(surface, control_points, weights, done, observe)
    }

    /// The least squares with the footpoints of `found`, from `control_points` on.
    pub(super) fn solve(
        &mut self,
        surface: &Surface,
        found: &Correspondence,
        weights: Weights,
        control_points: &mut [DVec3],
    ) {
        for (stiffness, &folded) in self.stiffness.iter_mut().zip(&found.folded) {
            *stiffness = if folded {
                (*stiffness * STIFFEN).min(STIFFEST)
            } else {
                (*stiffness * RELAX).max(1.0)
            };
        }
        let mut stiffness = vec![1.0; surface.mesh.positions.len()];
        for (triangle, &patch) in self.model.triangles.iter().zip(&self.model.patches) {
            for &v in triangle {
                let at: &mut f64 = &mut stiffness[v as usize];
                *at = at.max(self.stiffness[patch as usize]);
            }
        }
        let shape = Shape {
            normals: surface.mesh.vertex_normals(),
            stiffness,
        };
        let footpoints = [found.footpoints.as_slice(), &found.over_holes].concat();
        self.equations
            .solve(&footpoints, &shape, weights, control_points, TOLERANCE);
    }

    /// The surface at given control points.
    pub(super) fn surface(&self, control_points: &[DVec3]) -> Result<Surface> {
        let mesh = TriangleMesh {
            positions: self.model.positions(control_points),
            triangles: self.model.triangles.clone(),
        };
        Ok(Surface {
            tree: ClosestPoints::new(self.device, &mesh)?,
            mesh,
        })
    }

    /// Brings the surface to other control points.
    pub(super) fn follow(&self, surface: &mut Surface, control_points: &[DVec3]) -> Result<()> {
        surface.mesh.positions = self.model.positions(control_points);
        surface.tree.refit(&surface.mesh)
    }

    /// Finds the distance from the surface beyond which the target's samples are left out.
    pub(super) fn choose_outliers(&mut self, surface: &Surface) -> Result<()> {
        if self.outliers > 0.0 {
            let closest = surface.tree.query(&self.of_target.positions)?;
            let distances = closest.into_iter().map(|c| c.distance_squared.sqrt());
            self.cutoff = outliers::cutoff(distances, self.outliers);
        }
        Ok(())
    }

    /// Closest points both ways from samples spread evenly.
    pub(super) fn correspond(&self, surface: &Surface) -> Result<Correspondence> {
        let of_surface = sample_by_area(&surface.mesh, self.samples, self.seed + 1);
        let wanted = match self.tells_sides {
            true => Wanted::Alike,
            false => Wanted::Closest(0.0),
        };
        let mut found = self.footpoints(surface, &self.of_target, &of_surface, wanted)?;
        self.follow_rims(surface, &mut found);
        Ok(found)
    }

    /// Closest points of the rims both ways, where they are to be followed and the surface has one.
    pub(super) fn follow_rims(&self, surface: &Surface, found: &mut Correspondence) {
        let Some(target) = self.target.rim() else {
            return;
        };
        let Some(of_surface) = Rim::of(&surface.mesh) else {
            return;
        };
        let positions =
            |points: &[RimPoint]| -> Vec<DVec3> { points.iter().map(|p| p.point).collect() };
        let here = of_surface.samples(self.rim_samples);
        let there = target.closest(&positions(&here));
        let pulled = of_surface.closest(&positions(&self.of_target_rim));
        let pairs = pulled.iter().zip(&self.of_target_rim);
        for (from, to) in pairs.chain(here.iter().zip(&there)) {
            found.footpoints.push(Footpoint {
                triangle: from.on.triangle,
                barycentric: from.on.barycentric,
                goal: to.point,
                normal: direction(to.point - from.point, from.tangent.any_orthonormal_vector()),
                weight: ON_RIM / self.samples as f64,
            });
            found.distances.push(from.point.distance(to.point));
        }
    }

    /// Closest points both ways; for samples no further than `enough`, any that is no further.
    pub(super) fn correspond_at(
        &self,
        surface: &Surface,
        of_target: &Samples,
        of_surface: &[SurfacePoint],
        enough: f64,
    ) -> Result<Correspondence> {
        self.footpoints(surface, of_target, of_surface, Wanted::Closest(enough))
    }

    /// Footpoints both ways, and the distances of the closest points. Beyond open rims there are none: there the surface follows the regularizer.
    fn footpoints(
        &self,
        surface: &Surface,
        of_target: &Samples,
        of_surface: &[SurfacePoint],
        wanted: Wanted,
    ) -> Result<Correspondence> {
        let mut found = Correspondence {
            folded: vec![false; self.stiffness.len()],
            ..Correspondence::default()
        };
        self.pull_to_samples(surface, of_target, wanted, &mut found)?;
        self.push_to_target(surface, of_surface, wanted, &mut found)?;
        Ok(found)
    }

    /// A footpoint, with the trust in its goal, and its distance from that as far as it is trusted. One beyond the cutoff is an outlier, which
    /// counts as being where it should.
    fn trimmed(&self, footpoint: Footpoint, trust: f64, distance: f64) -> (Footpoint, f64) {
        if distance > self.cutoff {
            let weight = 0.0;
            return (
                Footpoint {
                    weight,
                    ..footpoint
                },
                0.0,
            );
        }
        (footpoint, trust.min(1.0) * distance)
    }

    /// T → S: each sample of T pulls its closest point of S.
    fn pull_to_samples(
        &self,
        surface: &Surface,
        samples: &Samples,
        wanted: Wanted,
        found: &mut Correspondence,
    ) -> Result<()> {
        let closest = surface
            .tree
            .query_beyond(&samples.positions, wanted.enough())?;
        let samples = samples
            .positions
            .par_iter()
            .zip(&samples.normals)
            .zip(&samples.weights);
        let pulled =
            closest
                .par_iter()
                .zip(samples)
                .map(|(closest, ((&goal, &normal), weight))| {
                    let alike = || surface.facing_alike(closest, goal, normal);
                    let alike = (wanted == Wanted::Alike).then(alike).flatten();
                    let c = alike.as_ref().unwrap_or(closest);
                    let footpoint = Footpoint {
                        triangle: c.triangle,
                        barycentric: c.barycentric,
                        goal,
                        normal: direction(goal - c.point, normal),
                        weight: weight / self.samples as f64,
                    };
                    self.trimmed(footpoint, *weight, closest.distance_squared.sqrt())
                });
        (found.footpoints, found.distances) = pulled.unzip();
        Ok(())
    }

    /// Where `closest`, the target's closest point to `p`, faces the other way than the surface there: the closest that does not, if it is hardly further.
    fn facing_alike(&self, closest: &TargetPoint, p: DVec3, facing: DVec3) -> Option<TargetPoint> {
        if facing.dot(closest.normal) >= FOLDED {
            return None;
        }
        let reach = closest.point.distance(p) + ALIKE;
        self.target.closest_facing(p, facing, reach)
    }

    /// S → T: each sample of S is pushed to its closest point of T. Tells also which patches fold there.
    fn push_to_target(
        &self,
        surface: &Surface,
        samples: &[SurfacePoint],
        wanted: Wanted,
        found: &mut Correspondence,
    ) -> Result<()> {
        let mesh = &surface.mesh;
        let points: Vec<DVec3> = samples
            .par_iter()
            .map(|s| s.position(mesh.corners(s.triangle as usize)))
            .collect();
        let closest = self.target.closest_beyond(&points, wanted.enough())?;
        let pushed: Vec<(Place, Footpoint, bool)> = closest
            .par_iter()
            .zip(samples.par_iter().zip(&points))
            .map(|(closest, (s, &point))| {
                let facing = mesh.area_vector(s.triangle as usize).normalize_or_zero();
                let alike = || self.facing_alike(closest, point, facing);
                let alike = (wanted == Wanted::Alike).then(alike).flatten();
                let c = alike.as_ref().unwrap_or(closest);
                let folded = facing.dot(c.normal) < FOLDED;
                let trust = match folded && wanted == Wanted::Alike {
                    true => OPPOSED,
                    false => 1.0,
                };
                let footpoint = Footpoint {
                    triangle: s.triangle,
                    barycentric: s.barycentric,
                    goal: c.point,
                    normal: direction(c.point - point, c.normal),
                    weight: trust * c.weight / self.samples as f64,
                };
                (c.place, footpoint, folded)
            })
            .collect();
        for (c, (&point, (place, footpoint, folded))) in
            closest.iter().zip(points.iter().zip(pushed))
        {
            match place {
                Place::Rim => {}
                Place::Bridge => found.over_holes.push(Footpoint {
                    weight: BRIDGE * footpoint.weight,
                    ..footpoint
                }),
                Place::Covered => {
                    let patch = self.model.patches[footpoint.triangle as usize];
                    found.folded[patch as usize] |= folded;
                    let distance = c.point.distance(point);
                    let (footpoint, distance) = self.trimmed(footpoint, c.weight, distance);
                    found.footpoints.push(footpoint);
                    found.distances.push(distance);
                }
            }
        }
        Ok(())
    }
}

impl Wanted {
    fn enough(self) -> f64 {
        match self {
            Self::Alike => 0.0,
            Self::Closest(enough) => enough,
        }
    }
}

impl Surface {
    /// Where `closest`, the surface's closest point to `p`, faces the other way than `normal`: the closest that does not, if it is hardly further.
    fn facing_alike(
        &self,
        closest: &ClosestPoint,
        p: DVec3,
        normal: DVec3,
    ) -> Option<ClosestPoint> {
        let facing = |t: u32| self.mesh.area_vector(t as usize);
        if facing(closest.triangle).dot(normal) >= FOLDED {
            return None;
        }
        let reach = closest.distance_squared.sqrt() + ALIKE;
        self.tree
            .query_of(p, reach, |t| facing(t).dot(normal) > 0.0)
    }
}

impl Correspondence {
    /// The largest distance.
    pub fn max(&self) -> f64 {
        self.distances.iter().copied().fold(0.0, f64::max)
    }

    pub fn step(&self, done: usize) -> Step {
        let n = self.distances.len().max(1) as f64;
        Step {
            done,
            max: self.max(),
            mean: self.distances.iter().sum::<f64>() / n,
            mean_square: self.distances.iter().map(|d| d * d).sum::<f64>() / n,
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
