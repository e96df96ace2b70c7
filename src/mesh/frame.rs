//! The unit frame: the target's bounding box centred at the origin with diagonal 1.

use super::TriangleMesh;
use crate::error::{Error, Result};
use glam::DVec3;

/// The similarity between the input's coordinates and the unit frame, kept in f64: scans come with coordinates of 10⁶ and more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// The centre of the target's bounding box, in input coordinates.
    pub center: DVec3,
    /// The diagonal of that box, in input units.
    pub diagonal: f64,
}

impl Frame {
    /// The frame of a target.
    ///
    /// # Errors
    /// Where the target has no triangle or a bounding box without extent.
    pub fn of(target: &TriangleMesh) -> Result<Self> {
        let Some(bounds) = target.bounding_box() else {
            return Err(Error::input(
                "the target has no triangles",
                "give a mesh with faces",
            ));
        };
        Self::of_box(bounds)
    }

    /// The frame of a cloud of points.
    ///
    /// # Errors
    /// Where there are none, or all of them coincide.
    pub fn of_points(points: &[DVec3]) -> Result<Self> {
        let grow = |(lo, hi): (DVec3, DVec3), p: &DVec3| (lo.min(*p), hi.max(*p));
        let Some(&first) = points.first() else {
            return Err(Error::input("the target has no points", "give some"));
        };
        Self::of_box(points.iter().fold((first, first), grow))
    }

    fn of_box((lo, hi): (DVec3, DVec3)) -> Result<Self> {
        let diagonal = (hi - lo).length();
        if !(diagonal > 0.0 && diagonal.is_finite()) {
            return Err(Error::input(
                "the target's bounding box has no extent: all its vertices coincide",
                "check the file's coordinates and units",
            ));
        }
        Ok(Self {
            center: lo + 0.5 * (hi - lo),
            diagonal,
        })
    }

    /// From input coordinates to the unit frame.
    pub fn to_unit(&self, p: DVec3) -> DVec3 {
        (p - self.center) / self.diagonal
    }

    /// From the unit frame back to input coordinates.
    pub fn to_input(&self, p: DVec3) -> DVec3 {
        self.center + p * self.diagonal
    }
}
