//! Bringing a template onto the target: by their boxes, or by a rigid motion or similarity.
//!
//! The similarity is found by iterated closest points in both directions at once (one way alone, the scale could shrink to
//! nothing), on the tangent planes of the target (Chen & Medioni 1992) with some weight on the distances across, in the seven
//! parameters of a small similarity. Residuals are weighted by Cauchy's function, so that parts that one of the two lacks do not
//! count. The search starts with the orientations as given and with the 24 rotations that bring the principal axes of one onto
//! those of the other; a few samples decide which of these are carried to the end.

use super::Align;
use crate::error::{Error, Result};
use crate::geometry::eigen;
use crate::geometry::{Bvh, ClosestPoint};
use crate::mesh::TriangleMesh;
use crate::mesh::sample::sample_by_area;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use glam::{DAffine3, DMat3, DQuat, DVec3};

/// Samples a side and iterations while choosing among the starts.
const COARSE: (usize, usize) = (300, 20);

/// Samples a side and iterations at the end.
const FINE: (usize, usize) = (4_000, 60);

/// Starts that are carried to the end.
const FINALISTS: usize = 4;

/// The orientation as given is kept unless another leaves less than this share of its error: symmetric shapes have
/// several equal answers.
const PREFERENCE: f64 = 0.8;

/// What a distance across the normal counts against one along it.
const ACROSS: f64 = 0.05;

/// Iterations end when a step moves nothing by more than this share of the target's size.
const SETTLED: f64 = 1e-9;

/// Cauchy's width, in medians of the distances.
const WIDTH: f64 = 3.0;

/// The map that brings a template with this surface onto the target.
///
/// # Errors
/// Where either has no triangles or, unless it is their boxes that count, no area.
pub fn alignment(align: Align, template: &TriangleMesh, target: &TriangleMesh) -> Result<DAffine3> {
    match align {
        Align::None => Ok(DAffine3::IDENTITY),
        Align::Box => box_to_box(template, target),
        Align::Rigid => registration(template, target, false),
        Align::Similarity => registration(template, target, true),
    }
}

fn box_to_box(template: &TriangleMesh, target: &TriangleMesh) -> Result<DAffine3> {
    let bounds = |mesh: &TriangleMesh| mesh.bounding_box().ok_or_else(nothing_to_align);
    let ((from_lo, from_hi), (lo, hi)) = (bounds(template)?, bounds(target)?);
    // A flat template stays flat, in the middle.
    let ratio = |to: f64, from: f64| if from > 0.0 { to / from } else { 0.0 };
    let (size, from_size) = (hi - lo, from_hi - from_lo);
    let scale = DVec3::new(
        ratio(size.x, from_size.x),
        ratio(size.y, from_size.y),
        ratio(size.z, from_size.z),
    );
    let from_center = 0.5 * (from_lo + from_hi);
    Ok(DAffine3 {
        matrix3: DMat3::from_diagonal(scale),
        translation: 0.5 * (lo + hi) - scale * from_center,
    })
}

fn nothing_to_align() -> Error {
    Error::input(
        "the template cannot be aligned: it or the target has no extent",
        "check both files",
    )
}

fn registration(template: &TriangleMesh, target: &TriangleMesh, scales: bool) -> Result<DAffine3> {
    let (from, to) = (Moments::of(template)?, Moments::of(target)?);
    let scale = if scales { to.size / from.size } else { 1.0 };
    let mut pair = Pair {
        template: Bvh::new(&template.positions, &template.triangles)?,
        target: Bvh::new(&target.positions, &target.triangles)?,
        points: Vec::new(),
        goals: Vec::new(),
        normals: normals(target),
        size: to.size,
        scales,
    };
    pair.sample(template, target, COARSE.0);
    let mut found: Vec<(f64, usize, Motion)> = std::iter::once(DQuat::IDENTITY)
        .chain(cube_rotations().map(|turn| to.axes * turn * from.axes.inverse()))
        .map(|rotation| Motion {
            rotation,
            scale,
            translation: to.center - rotation * (scale * from.center),
        })
        .enumerate()
        .map(|(k, start)| {
            let (error, motion) = pair.improve(start, COARSE.1);
            (error, k, motion)
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let finalists = found.iter().enumerate();
    let finalists = finalists.filter(|(place, (_, k, _))| *place < FINALISTS || *k == 0);
    pair.sample(template, target, FINE.0);
    let best = finalists
        .map(|(_, &(_, k, motion))| {
            let (error, motion) = pair.improve(motion, FINE.1);
            (if k == 0 { PREFERENCE * error } else { error }, motion)
        })
        .min_by(|a, b| a.0.total_cmp(&b.0));
    best.map(|(_, motion)| motion.affine())
        .ok_or_else(nothing_to_align)
}

/// Where a surface is, how large, and how it lies.
struct Moments {
    center: DVec3,
    /// The root mean square distance from the centre.
    size: f64,
    /// From the coordinate axes to the principal ones.
    axes: DQuat,
}

impl Moments {
    fn of(mesh: &TriangleMesh) -> Result<Self> {
        let (mut area, mut first) = (0.0, DVec3::ZERO);
        let mut second = DMat3::ZERO;
        for t in 0..mesh.triangles.len() {
            let corners = mesh.corners(t);
            let part = 0.5 * mesh.area_vector(t).length() / 3.0;
            for k in 0..3 {
                // Exact for quadratics: the middles of the edges.
                let p = 0.5 * (corners[k] + corners[(k + 1) % 3]);
                area += part;
                first += part * p;
                second += outer(p, p) * part;
            }
        }
        let center = first / area;
        let covariance = second * (1.0 / area) - outer(center, center);
        let (values, axes) = eigen::symmetric(covariance);
        let size = values.element_sum().max(0.0).sqrt();
        if !(size.is_finite() && size > 0.0) {
            return Err(nothing_to_align());
        }
        Ok(Self {
            center,
            size,
            axes: DQuat::from_mat3(&axes),
        })
    }
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// The 24 rotations of a cube: an axis goes to one of six directions, the next one to one of the four across.
fn cube_rotations() -> impl Iterator<Item = DQuat> {
    let directions = [
        DVec3::X,
        DVec3::NEG_X,
        DVec3::Y,
        DVec3::NEG_Y,
        DVec3::Z,
        DVec3::NEG_Z,
    ];
    directions.into_iter().flat_map(move |x| {
        let across = directions.into_iter().filter(move |y| x.dot(*y) == 0.0);
        across.map(move |y| DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y))))
    })
}

fn normals(mesh: &TriangleMesh) -> Vec<DVec3> {
    let normal = |t| mesh.area_vector(t).normalize_or_zero();
    (0..mesh.triangles.len()).map(normal).collect()
}

/// A similarity: x ↦ scale · rotation x + translation.
#[derive(Debug, Clone, Copy)]
struct Motion {
    rotation: DQuat,
    scale: f64,
    translation: DVec3,
}

impl Motion {
    fn apply(&self, p: DVec3) -> DVec3 {
        self.scale * (self.rotation * p) + self.translation
    }

    fn undo(&self, p: DVec3) -> DVec3 {
        self.rotation.inverse() * (p - self.translation) / self.scale
    }

    fn affine(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(
            DVec3::splat(self.scale),
            self.rotation,
            self.translation,
        )
    }

    /// After it, a small one about `center`: rotation vector, translation, logarithm of the scale.
    fn then(&self, center: DVec3, [a, b, c, x, y, z, log]: [f64; 7]) -> Self {
        let turn = DQuat::from_scaled_axis(DVec3::new(a, b, c));
        let scale = log.exp();
        Self {
            rotation: (turn * self.rotation).normalize(),
            scale: scale * self.scale,
            translation: center
                + DVec3::new(x, y, z)
                + scale * (turn * (self.translation - center)),
        }
    }
}

/// A point of the moved template, the point of the target that it belongs to, and the normal there.
#[derive(Debug, Clone, Copy)]
struct Match {
    at: DVec3,
    goal: DVec3,
    normal: DVec3,
}

/// Two surfaces made ready for registration.
struct Pair {
    template: Bvh,
    target: Bvh,
    /// On the template.
    points: Vec<DVec3>,
    /// On the target, with the normals there.
    goals: Vec<(DVec3, DVec3)>,
    /// Of the target's triangles.
    normals: Vec<DVec3>,
    /// Of the target.
    size: f64,
    scales: bool,
}

impl Pair {
    fn sample(&mut self, template: &TriangleMesh, target: &TriangleMesh, count: usize) {
        let points = sample_by_area(template, count, 0);
        let on = |mesh: &TriangleMesh, p: &crate::mesh::sample::SurfacePoint| {
            p.position(mesh.corners(p.triangle as usize))
        };
        self.points = points.iter().map(|p| on(template, p)).collect();
        let goals = sample_by_area(target, count, 1);
        self.goals = goals
            .iter()
            .map(|p| (on(target, p), self.normals[p.triangle as usize]))
            .collect();
    }

    fn matches(&self, motion: &Motion) -> Vec<Match> {
        let moved: Vec<DVec3> = self.points.iter().map(|&p| motion.apply(p)).collect();
        let forth = self.target.closest_all(&moved);
        let undone: Vec<DVec3> = self.goals.iter().map(|g| motion.undo(g.0)).collect();
        let back = self.template.closest_all(&undone);
        let forth = moved
            .iter()
            .zip(&forth)
            .map(|(&at, c): (_, &ClosestPoint)| Match {
                at,
                goal: c.point,
                normal: self.normals[c.triangle as usize],
            });
        let back = self.goals.iter().zip(&back).map(|(g, c)| Match {
            at: motion.apply(c.point),
            goal: g.0,
            normal: g.1,
        });
        forth.chain(back).collect()
    }

    /// Steps until settled. The robust mean of the squared distances at the end, and the motion.
    fn improve(&self, mut motion: Motion, iterations: usize) -> (f64, Motion) {
        for _ in 0..iterations {
            let matches = self.matches(&motion);
            let step = self.step(&matches);
            motion = motion.then(center(&matches), step);
            let largest = step.iter().fold(0.0, |m: f64, s| m.max(s.abs()));
            if largest <= SETTLED * self.size.min(1.0) {
                break;
            }
        }
        let matches = self.matches(&motion);
        let squares = matches.iter().map(|m| m.at.distance_squared(m.goal));
        let mean = squares.sum::<f64>() / matches.len().max(1) as f64;
        (mean, motion)
    }

    /// One step of Gauss and Newton on the matches.
    fn step(&self, matches: &[Match]) -> [f64; 7] {
        let center = center(matches);
        let mut distances: Vec<f64> = matches.iter().map(|m| m.at.distance(m.goal)).collect();
        distances.sort_by(f64::total_cmp);
        let median = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
        let width = (WIDTH * median).max(f64::MIN_POSITIVE);
        let unknowns = if self.scales { 7 } else { 6 };
        let mut normal = Mat::<f64>::zeros(unknowns, unknowns);
        let mut right = Mat::<f64>::zeros(unknowns, 1);
        for m in matches {
            let weight = 1.0 / (1.0 + m.at.distance_squared(m.goal) / (width * width));
            let directions = [
                (m.normal, weight),
                (DVec3::X, ACROSS * weight),
                (DVec3::Y, ACROSS * weight),
                (DVec3::Z, ACROSS * weight),
            ];
            for (n, weight) in directions {
                let arm = m.at - center;
                let turn = arm.cross(n);
                let row = [turn.x, turn.y, turn.z, n.x, n.y, n.z, arm.dot(n)];
                let residual = n.dot(m.goal - m.at);
                for i in 0..unknowns {
                    right[(i, 0)] += weight * row[i] * residual;
                    for j in 0..unknowns {
                        normal[(i, j)] += weight * row[i] * row[j];
                    }
                }
            }
        }
        let mut step = [0.0; 7];
        // Singular only for points that all coincide: then there is nothing to turn.
        if let Ok(factor) = normal.llt(Side::Lower) {
            let solution = factor.solve(&right);
            for (s, k) in step.iter_mut().zip(0..unknowns) {
                *s = solution[(k, 0)];
            }
        }
        step
    }
}

fn center(matches: &[Match]) -> DVec3 {
    matches.iter().map(|m| m.at).sum::<DVec3>() / matches.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    /// A shape without symmetries.
    fn potato() -> TriangleMesh {
        let mut mesh = shapes::sphere(1.0, 4);
        for p in &mut mesh.positions {
            let bump = 1.0 + 0.3 * p.x + 0.2 * p.y * p.z + 0.15 * p.z * p.z * p.x;
            *p *= bump * DVec3::new(1.5, 1.0, 0.7);
        }
        mesh
    }

    fn moved(mesh: &TriangleMesh, by: &DAffine3) -> TriangleMesh {
        TriangleMesh {
            positions: mesh
                .positions
                .iter()
                .map(|&p| by.transform_point3(p))
                .collect(),
            triangles: mesh.triangles.clone(),
        }
    }

    fn largest_miss(template: &TriangleMesh, map: &DAffine3, target: &TriangleMesh) -> f64 {
        let there = moved(template, map).positions;
        let pairs = there.iter().zip(&target.positions);
        pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    }

    #[test]
    fn a_known_similarity_is_found() {
        let template = potato();
        for (scale, axis) in [
            (1.0, DVec3::ZERO),
            (40.0, DVec3::new(2.0, -1.0, 0.5)),
            (0.01, DVec3::Y * 3.0),
        ] {
            let there = DAffine3::from_scale_rotation_translation(
                DVec3::splat(scale),
                DQuat::from_scaled_axis(axis),
                DVec3::new(300.0, -20.0, 5.0),
            );
            let target = moved(&template, &there);
            let map = alignment(Align::Similarity, &template, &target).unwrap();
            assert!(
                largest_miss(&template, &map, &target) < 1e-7 * scale,
                "{scale}"
            );
        }
    }

    #[test]
    fn a_rigid_motion_keeps_the_scale() {
        let template = potato();
        let there = DAffine3::from_rotation_translation(
            DQuat::from_rotation_x(2.5),
            DVec3::new(-7.0, 3.0, 1.0),
        );
        let target = moved(&template, &there);
        let map = alignment(Align::Rigid, &template, &target).unwrap();
        assert!(largest_miss(&template, &map, &target) < 1e-7);
        let larger = moved(&target, &DAffine3::from_scale(DVec3::splat(1.3)));
        let map = alignment(Align::Rigid, &template, &larger).unwrap();
        assert!((map.matrix3.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn symmetric_shapes_keep_their_orientation() {
        let template = shapes::torus(2.0, 0.5, 40, 20).triangulate();
        let there = DAffine3::from_scale_rotation_translation(
            DVec3::splat(3.0),
            DQuat::IDENTITY,
            DVec3::new(1.0, 2.0, 3.0),
        );
        let target = moved(&template, &there);
        let map = alignment(Align::Similarity, &template, &target).unwrap();
        assert!(largest_miss(&template, &map, &target) < 0.2);
    }

    #[test]
    fn boxes_are_stretched_and_nothing_is_refused() {
        let template = potato();
        let there = DAffine3::from_scale(DVec3::new(2.0, 3.0, 4.0));
        let target = moved(&template, &there);
        let map = alignment(Align::Box, &template, &target).unwrap();
        assert!(largest_miss(&template, &map, &target) < 1e-12);
        let nothing = TriangleMesh::default();
        for align in [Align::Box, Align::Rigid, Align::Similarity] {
            assert!(alignment(align, &nothing, &target).is_err());
            assert!(alignment(align, &template, &nothing).is_err());
        }
    }
}
