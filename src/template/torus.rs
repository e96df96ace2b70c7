//! A torus grid around the hole of a target.

use super::hole::{self, Hole};
use crate::error::{Error, Result};
use crate::geometry::eigen;
use crate::mesh::{ControlMesh, TriangleMesh, shapes};
use glam::{DMat3, DVec3};
use std::f64::consts::TAU;

/// Directions around the axis in which the target's extent is measured.
const SECTORS: usize = 72;
/// Sectors to either side over which those extents are averaged (45°), so that the tube swells and narrows gently.
const SMOOTHING: usize = 9;

/// What a torus goes around.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Axis {
    /// The middle of the widest hole that is seen along one of the target's three axes of inertia.
    Inertia,
    /// A line, by a point and a direction (of any length but zero).
    Given {
        /// A point on it.
        point: DVec3,
        /// Its direction.
        direction: DVec3,
    },
}

/// A torus of about `control_points` (at least 9) nearly square quads around a target's hole, with elliptic sections that follow the
/// target's extent around the axis.
///
/// The hole, not the bounding box, is what the torus must be centred on: a torus whose hole is elsewhere never finds its way.
///
/// # Errors
/// Where no hole is seen along an axis of inertia, the given direction is zero, or the given line has no target around it.
pub fn torus(target: &TriangleMesh, axis: Axis, control_points: usize) -> Result<ControlMesh> {
    let (point, direction) = match axis {
        Axis::Given { point, direction } => (point, direction),
        Axis::Inertia => {
            let hole = widest_hole(target)?;
            (hole.center, hole.direction)
        }
    };
    let Some(axis) = direction.try_normalize() else {
        return Err(Error::input(
            "the torus's axis has no direction",
            "give a direction other than zero",
        ));
    };
    let (u, v) = axis.any_orthonormal_pair();
    let frame = DMat3::from_cols(u, v, axis);
    let tube = Tube::around(target, point, frame)?;
    let (rings, sections) = divide(control_points, tube.aspect());
    let mesh = shapes::torus_grid(rings, sections, |theta, phi| {
        point + frame * tube.point(theta, phi)
    });
    Ok(mesh.into())
}

/// The widest hole along the axes of inertia; of equal ones that around the axis of largest inertia.
pub(super) fn widest_hole(target: &TriangleMesh) -> Result<Hole> {
    let axes = eigen::symmetric(area_covariance(target)).1;
    let mut widest: Option<Hole> = None;
    for found in (0..3).filter_map(|k| hole::find(target, axes.col(k))) {
        if widest.is_none_or(|best| found.radius > best.radius) {
            widest = Some(found);
        }
    }
    widest.ok_or_else(|| {
        Error::input(
            "the target shows no hole along its axes of inertia",
            "give the torus an axis through the hole, or use another template",
        )
    })
}

/// ∫ (x − c)(x − c)ᵀ over the surface, c its centroid. Its smallest eigenvalue belongs to the axis of largest inertia.
pub(super) fn area_covariance(target: &TriangleMesh) -> DMat3 {
    let square = |p: DVec3| DMat3::from_cols(p * p.x, p * p.y, p * p.z);
    let area = |t: usize| 0.5 * target.area_vector(t).length();
    let triangles = || (0..target.triangles.len()).map(|t| (area(t), target.corners(t)));
    let (mass, moment) = triangles().fold((0.0, DVec3::ZERO), |(mass, moment), (a, [p, q, r])| {
        (mass + a, moment + a / 3.0 * (p + q + r))
    });
    if mass == 0.0 {
        return DMat3::ZERO;
    }
    let centroid = moment / mass;
    triangles().fold(DMat3::ZERO, |sum, (a, corners)| {
        let [p, q, r] = corners.map(|p| p - centroid);
        sum + (square(p) + square(q) + square(r) + square(p + q + r)) * (a / 12.0)
    })
}

/// The extent of the target's section in one direction from the axis.
#[derive(Debug, Clone, Copy)]
struct Section {
    /// Least and largest distance from the axis.
    out: [f64; 2],
    /// Least and largest height along it.
    up: [f64; 2],
}

impl Section {
    const EMPTY: Self = Self {
        out: [f64::INFINITY, f64::NEG_INFINITY],
        up: [f64::INFINITY, f64::NEG_INFINITY],
    };

    fn include(&mut self, out: f64, up: f64) {
        self.out = [self.out[0].min(out), self.out[1].max(out)];
        self.up = [self.up[0].min(up), self.up[1].max(up)];
    }

    fn is_empty(&self) -> bool {
        self.out[0] > self.out[1]
    }

    /// The weighted mean of sections.
    fn mean(sections: impl Iterator<Item = (f64, Self)>) -> Self {
        let zero = Self {
            out: [0.0; 2],
            up: [0.0; 2],
        };
        let (total, mut sum) = sections.fold((0.0, zero), |(total, mut sum), (w, s)| {
            for k in 0..2 {
                sum.out[k] += w * s.out[k];
                sum.up[k] += w * s.up[k];
            }
            (total + w, sum)
        });
        sum.out = sum.out.map(|x| x / total);
        sum.up = sum.up.map(|x| x / total);
        sum
    }
}

/// The target's smoothed extent in all directions around an axis.
struct Tube {
    sections: Vec<Section>,
}

impl Tube {
    /// Measured on the triangles' corners, edge and face middles.
    fn around(target: &TriangleMesh, point: DVec3, frame: DMat3) -> Result<Self> {
        let mut raw = vec![Section::EMPTY; SECTORS];
        let inverse = frame.transpose();
        for t in 0..target.triangles.len() {
            let [a, b, c] = target.corners(t).map(|p| inverse * (p - point));
            let middle = (a + b + c) / 3.0;
            for p in [a, b, c, 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a), middle] {
                let turn = p.y.atan2(p.x).rem_euclid(TAU) / TAU;
                let sector = ((turn * SECTORS as f64) as usize).min(SECTORS - 1);
                raw[sector].include(p.x.hypot(p.y), p.z);
            }
        }
        let sections: Vec<Section> = (0..SECTORS).map(|i| smoothed(&raw, i)).collect();
        if raw.iter().all(Section::is_empty) || sections.iter().any(|s| s.out[0] <= 0.0) {
            return Err(Error::input(
                "the torus's axis does not pass through a hole of the target",
                "give an axis that the target goes around",
            ));
        }
        Ok(Self { sections })
    }

    /// Where the tube is at angle θ around the axis and φ around its section, in the axis's frame.
    fn point(&self, theta: f64, phi: f64) -> DVec3 {
        let at = theta / TAU * SECTORS as f64 - 0.5;
        let before = at.floor();
        let section = |k: f64| self.sections[k.rem_euclid(SECTORS as f64) as usize];
        let t = at - before;
        let Section { out, up } =
            Section::mean([(1.0 - t, section(before)), (t, section(before + 1.0))].into_iter());
        let distance = 0.5 * (out[0] + out[1] + (out[1] - out[0]) * phi.cos());
        let height = 0.5 * (up[0] + up[1] + (up[1] - up[0]) * phi.sin());
        DVec3::new(distance * theta.cos(), distance * theta.sin(), height)
    }

    /// The length of the tube's middle line over the mean circumference of its sections.
    fn aspect(&self) -> f64 {
        let n = SECTORS as f64;
        let middles: f64 = self
            .sections
            .iter()
            .map(|s| 0.5 * (s.out[0] + s.out[1]))
            .sum();
        // Of an ellipse: 2π times the root mean square of its half axes, within 11 %.
        let half = |[lo, hi]: [f64; 2]| 0.5 * (hi - lo);
        let around = |s: &Section| TAU * (0.5 * (half(s.out).powi(2) + half(s.up).powi(2))).sqrt();
        let circumference: f64 = self.sections.iter().map(around).sum();
        (TAU * middles / n) / (circumference / n).max(f64::MIN_POSITIVE)
    }
}

/// The mean of the sections within [`SMOOTHING`] of sector `i`, with weights falling linearly; further away where all of those are empty.
fn smoothed(raw: &[Section], i: usize) -> Section {
    let near = |reach: usize| {
        (0..=2 * reach).filter_map(move |k| {
            let section = raw[(i + SECTORS + k - reach) % SECTORS];
            let weight = (reach + 1 - k.abs_diff(reach)) as f64;
            (!section.is_empty()).then_some((weight, section))
        })
    };
    let reach = match near(SMOOTHING).next() {
        Some(_) => SMOOTHING,
        None => SECTORS / 2,
    };
    Section::mean(near(reach))
}

/// Rings and sections, at least three of each: the product nearest to the count whose quads are at most twice as long as wide, and of equal
/// ones that with the squarest quads.
fn divide(control_points: usize, aspect: f64) -> (u32, u32) {
    let count = control_points.max(9) as u32;
    let stretch = |&(rings, sections): &(u32, u32)| {
        (f64::from(rings) / (f64::from(sections) * aspect))
            .ln()
            .abs()
    };
    let divisions = (3..=count / 3).map(|sections| ((count + sections / 2) / sections, sections));
    let badness = |division: &(u32, u32)| {
        let excess = (stretch(division) - 2f64.ln()).max(0.0);
        (
            excess,
            (division.0 * division.1).abs_diff(count),
            stretch(division),
        )
    };
    let best = divisions.min_by(|a, b| {
        let (a, b) = (badness(a), badness(b));
        a.0.total_cmp(&b.0)
            .then(a.1.cmp(&b.1))
            .then(a.2.total_cmp(&b.2))
    });
    best.unwrap_or((3, 3))
}

#[cfg(test)]
mod tests {
    use super::divide;

    #[test]
    fn counts_are_met_with_nearly_square_quads() {
        assert_eq!(divide(512, 2.0), (32, 16));
        assert_eq!(divide(128, 2.0), (16, 8));
        assert_eq!(divide(0, 2.0), (3, 3));
        for n in [100, 317, 1000] {
            let (rings, sections) = divide(n, 3.0);
            assert!((rings * sections).abs_diff(n as u32) * 50 <= n as u32);
            assert!((rings as f64 / (3.0 * sections as f64)).ln().abs() < 0.7);
        }
    }
}
