//! The quadric: a weighted sum of squared distances to planes and points, as ten numbers.

use glam::DVec3;
use std::ops::{Add, AddAssign};

/// x ↦ xᵀAx + 2 bᵀx + c, with A symmetric and positive semidefinite [GH97, section 5].
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Quadric {
    /// A's diagonal.
    diagonal: DVec3,
    /// A's entries yz, zx and xy.
    mixed: DVec3,
    b: DVec3,
    c: f64,
}

impl Quadric {
    /// `weight` times the squared distance to the plane through `point` with unit normal `n`.
    pub fn plane(n: DVec3, point: DVec3, weight: f64) -> Self {
        let offset = -n.dot(point);
        let m = weight * n;
        Self {
            diagonal: m * n,
            mixed: DVec3::new(m.y * n.z, m.z * n.x, m.x * n.y),
            b: m * offset,
            c: weight * offset * offset,
        }
    }

    /// `weight` times the squared distance to `point`.
    pub fn point(point: DVec3, weight: f64) -> Self {
        Self {
            diagonal: DVec3::splat(weight),
            mixed: DVec3::ZERO,
            b: -weight * point,
            c: weight * point.length_squared(),
        }
    }

    /// Its value; never negative, though rounding may say so.
    pub fn at(&self, x: DVec3) -> f64 {
        (self.times(x) + 2.0 * self.b).dot(x).max(-self.c) + self.c
    }

    /// The sum of the weights of its planes (and three times those of its points): the trace of A.
    pub fn weight(&self) -> f64 {
        self.diagonal.element_sum()
    }

    /// Where it is least, found as a step from `near` so that rounding is relative to the step; `None` where A is singular.
    pub fn minimizer(&self, near: DVec3) -> Option<DVec3> {
        /// Relative to the cubed weight. A plane with points of weight w, relative to it, has w²; rounding is far below.
        const SINGULAR: f64 = 1e-14;
        let (d, m) = (self.diagonal, self.mixed);
        // The adjugate of A: rows are cross products of A's rows.
        let (rx, ry, rz) = (
            DVec3::new(d.x, m.z, m.y),
            DVec3::new(m.z, d.y, m.x),
            DVec3::new(m.y, m.x, d.z),
        );
        let (ax, ay, az) = (ry.cross(rz), rz.cross(rx), rx.cross(ry));
        let determinant = rx.dot(ax);
        if determinant <= SINGULAR * self.weight().powi(3) {
            return None;
        }
        let gradient = self.times(near) + self.b;
        Some(near - DVec3::new(ax.dot(gradient), ay.dot(gradient), az.dot(gradient)) / determinant)
    }

    /// A x.
    fn times(&self, x: DVec3) -> DVec3 {
        let m = self.mixed;
        self.diagonal * x
            + DVec3::new(
                m.z * x.y + m.y * x.z,
                m.z * x.x + m.x * x.z,
                m.y * x.x + m.x * x.y,
            )
    }
}

impl Add for Quadric {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            diagonal: self.diagonal + other.diagonal,
            mixed: self.mixed + other.mixed,
            b: self.b + other.b,
            c: self.c + other.c,
        }
    }
}

impl AddAssign for Quadric {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_squared_distances() {
        let n = DVec3::new(2.0, -1.0, 2.0) / 3.0;
        let p = DVec3::new(0.3, 0.1, -0.2);
        let plane = Quadric::plane(n, p, 5.0);
        assert!((plane.at(p + 0.7 * n) - 5.0 * 0.49).abs() < 1e-14);
        assert!(plane.at(p + n.any_orthonormal_vector()) < 1e-14);
        assert!((plane.weight() - 5.0).abs() < 1e-14);
        let x = DVec3::new(0.4, -0.3, 0.2);
        assert!((Quadric::point(p, 2.0).at(x) - 2.0 * p.distance_squared(x)).abs() < 1e-15);
    }

    #[test]
    fn three_planes_meet_where_they_should_and_two_do_not() {
        let p = DVec3::new(0.3, 0.1, -0.2);
        let two =
            Quadric::plane(DVec3::X, p, 1.0) + Quadric::plane(DVec3::new(0.6, 0.8, 0.0), p, 2.0);
        assert!(two.minimizer(DVec3::ZERO).is_none());
        let three = two + Quadric::plane(DVec3::new(0.0, 0.28, 0.96), p, 0.1);
        assert!(
            three
                .minimizer(DVec3::ONE)
                .is_some_and(|x| x.distance(p) < 1e-13)
        );
        assert!(Quadric::default().minimizer(p).is_none());
    }
}
