//! Symmetric 3×3 matrices by their six different entries: two thirds of the memory that large systems of such blocks stream through.

use glam::{DMat3, DVec3};
use std::ops::{Add, AddAssign, Mul};

/// A symmetric 3×3 matrix: xx, xy, xz, yy, yz, zz.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Symmetric3([f64; 6]);

impl Symmetric3 {
    pub const ZERO: Self = Self([0.0; 6]);

    /// along · n nᵀ + across · (I − n nᵀ), for a unit vector n.
    pub fn split(n: DVec3, along: f64, across: f64) -> Self {
        let excess = along - across;
        Self([
            n.x * n.x * excess + across,
            n.x * n.y * excess,
            n.x * n.z * excess,
            n.y * n.y * excess + across,
            n.y * n.z * excess,
            n.z * n.z * excess + across,
        ])
    }

    /// All nine entries.
    pub fn matrix(self) -> DMat3 {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
    }
}

impl Add for Symmetric3 {
    type Output = Self;

    #[inline]
    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl AddAssign for Symmetric3 {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        for (a, b) in self.0.iter_mut().zip(other.0) {
            *a += b;
        }
    }
}

impl Mul<f64> for Symmetric3 {
    type Output = Self;

    #[inline]
    fn mul(self, factor: f64) -> Self {
        Self(self.0.map(|a| a * factor))
    }
}

impl Mul<DVec3> for Symmetric3 {
    type Output = DVec3;

    #[inline]
    fn mul(self, v: DVec3) -> DVec3 {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        DVec3::new(
            xx * v.x + xy * v.y + xz * v.z,
            xy * v.x + yy * v.y + yz * v.z,
            xz * v.x + yz * v.y + zz * v.z,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_matrix_that_it_stands_for() {
        let n = DVec3::new(2.0, -1.0, 2.0) / 3.0;
        let v = DVec3::new(0.5, 4.0, -3.0);
        let split = Symmetric3::split(n, 7.0, 2.0);
        let expected = 7.0 * n * n.dot(v) + 2.0 * (v - n * n.dot(v));
        assert!((split * v).distance(expected) < 1e-14);
        assert!((split.matrix() * v).distance(expected) < 1e-14);
        let sum = split * 2.0 + Symmetric3::split(DVec3::Z, 1.0, 1.0);
        assert!((sum * v).distance(2.0 * expected + v) < 1e-14);
        assert_eq!(Symmetric3::ZERO * v, DVec3::ZERO);
    }
}
