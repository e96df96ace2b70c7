use glam::{DMat3, DVec2, DVec3};

/// How far the camera is from the centre of what it sees, in radii: near enough for some perspective, and nothing is ever behind it.
const DISTANCE: f64 = 4.5;

/// An axis of the coordinates.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Axis {
    /// The first.
    X,
    /// The second: what graphics calls up.
    #[default]
    Y,
    /// The third: what engineering calls up.
    Z,
}

impl Axis {
    /// Its direction.
    pub fn direction(self) -> DVec3 {
        match self {
            Self::X => DVec3::X,
            Self::Y => DVec3::Y,
            Self::Z => DVec3::Z,
        }
    }
}

/// From where to look; the length of the directions is of no account.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Towards the eye.
    pub from: DVec3,
    /// What is upwards in the picture.
    pub up: DVec3,
}

impl View {
    /// From the front, somewhat to the right and above, where an axis points upwards.
    pub fn with_up(axis: Axis) -> Self {
        let up = axis.direction();
        let right = match axis {
            Axis::X => DVec3::Y,
            Axis::Y | Axis::Z => DVec3::X,
        };
        Self {
            from: right.cross(up) + 0.55 * right + 0.4 * up,
            up,
        }
    }
}

/// A perspective view from outside of everything that it frames.
#[derive(Debug, Clone, Copy)]
pub struct Camera {
    /// Right, up and towards the eye, as rows.
    axes: DMat3,
    center: DVec3,
    distance: f64,
    /// Pixels to a unit of length at the centre's depth.
    scale: f64,
    /// Where the centre is in the picture.
    offset: DVec2,
}

impl Camera {
    /// The camera that shows all of some points as large as the rectangle between two corners (pixels, y downwards) allows.
    pub fn framing(
        view: &View,
        points: impl Iterator<Item = DVec3> + Clone,
        rectangle: [DVec2; 2],
    ) -> Self {
        let outside = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let grow = |(lo, hi): (DVec3, DVec3), p: DVec3| (lo.min(p), hi.max(p));
        let (lo, hi) = points.clone().fold(outside, grow);
        let (center, radius) = match (hi - lo).length() {
            extent if !extent.is_finite() => (DVec3::ZERO, 1.0),
            0.0 => (lo, 1.0),
            extent => (lo + 0.5 * (hi - lo), 0.5 * extent),
        };
        let mut camera = Self {
            axes: axes(view),
            center,
            distance: DISTANCE * radius,
            scale: 1.0,
            offset: DVec2::ZERO,
        };
        let outside = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let seen = points.map(|p| camera.project(p).truncate());
        let (lo, hi) = seen.fold(outside, |(lo, hi), p| (lo.min(p), hi.max(p)));
        let [low, high] = rectangle;
        let fits = ((high - low) / (hi - lo).max(DVec2::splat(1e-9 * radius))).min_element();
        if lo.is_finite() && fits.is_finite() {
            camera.scale = fits;
            camera.offset = 0.5 * (low + high) - 0.5 * fits * (lo + hi);
        }
        camera
    }

    /// Where a point is in the picture, in pixels with y downwards; the third coordinate is larger the nearer the point is, 1 at the depth of
    /// the centre, and linear over the picture of a plane.
    pub fn project(&self, p: DVec3) -> DVec3 {
        let local = self.axes * (p - self.center);
        let nearness = self.distance / (self.distance - local.z);
        let at = self.offset + self.scale * nearness * DVec2::new(local.x, -local.y);
        at.extend(nearness)
    }

    /// A direction along right, up and towards the eye.
    pub fn direction(&self, n: DVec3) -> DVec3 {
        self.axes * n
    }

    /// From 0 at the far end of what is framed to 1 at its near end.
    pub fn depth_share(nearness: f64) -> f64 {
        let (far, near) = (DISTANCE / (DISTANCE + 1.0), DISTANCE / (DISTANCE - 1.0));
        ((nearness - far) / (near - far)).clamp(0.0, 1.0)
    }
}

/// Right, up and towards the eye; any right where the view is along the upward direction.
fn axes(view: &View) -> DMat3 {
    let back = view.from.normalize_or(DVec3::Z);
    let right = view.up.normalize_or(DVec3::Y).cross(back);
    let right = right
        .try_normalize()
        .unwrap_or_else(|| back.any_orthonormal_vector());
    DMat3::from_cols(right, back.cross(right), back).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_framed_touches_the_rectangle_and_near_things_are_larger() {
        let points = [
            DVec3::ZERO,
            DVec3::new(4.0, 1.0, -3.0),
            DVec3::new(1e3, 5.0, 7.0),
        ];
        let rectangle = [DVec2::new(10.0, 20.0), DVec2::new(110.0, 320.0)];
        let view = View::with_up(Axis::Z);
        let camera = Camera::framing(&view, points.iter().copied(), rectangle);
        let seen = points.map(|p| camera.project(p));
        let (left, right) = seen
            .iter()
            .fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p.x), b.max(p.x)));
        assert!((left - 10.0).abs() < 1e-9 && (right - 110.0).abs() < 1e-9);
        assert!(seen.iter().all(|p| p.y > 20.0 && p.y < 320.0 && p.z > 0.0));
        let nearer = camera.project(DVec3::ZERO + view.from);
        assert!(nearer.z > seen[0].z);
        assert!(camera.project(DVec3::Z).y < seen[0].y, "up is up");
    }

    #[test]
    fn nothing_one_point_and_a_view_from_above_are_no_trouble() {
        let rectangle = [DVec2::ZERO, DVec2::splat(100.0)];
        let above = View {
            from: DVec3::Y,
            up: DVec3::Y,
        };
        for points in [vec![], vec![DVec3::splat(5e6)], vec![DVec3::ZERO, DVec3::X]] {
            let camera = Camera::framing(&above, points.into_iter(), rectangle);
            assert!(camera.project(DVec3::X).is_finite());
            assert!((camera.axes.determinant() - 1.0).abs() < 1e-12);
        }
    }
}
