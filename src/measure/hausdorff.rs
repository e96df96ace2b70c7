//! The one-sided Hausdorff distance max over x in A of d(x, B), between certain bounds.
//!
//! **Theory.** Any point of A gives a lower bound. For a triangle of A, or a part of it, with corners c_k and centre c there are two upper
//! bounds on d(x, B) over it: d(c, B) plus the distance from c to the furthest corner, since the distance to B is 1-Lipschitz; and the
//! largest d(c_k, τ) for any one triangle τ of B, since the distance to a convex set is convex. With τ the triangle closest to c the second
//! is exact as soon as all of the part lies over τ, and of second order in the part's size over a smooth surface. A part that might
//! hold a larger distance than is known is halved at its longest edge.
//!
//! **Practice.** Bounds hold up to the rounding of f64 distances. Rather than one part at a time from a priority queue, each round halves all parts whose upper bound is in
//! the upper half of the open interval: nearly the same order, parallel, and independent of the number of threads.

use crate::geometry::Bvh;
use crate::geometry::triangle::Triangle;
use crate::mesh::TriangleMesh;
use glam::DVec3;
use rayon::prelude::*;

/// Bounds that a value lies between.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// No larger than the value.
    pub lower: f64,
    /// No smaller than the value.
    pub upper: f64,
}

impl Interval {
    /// The interval of the larger of two values.
    pub fn max(self, other: Self) -> Self {
        Self {
            lower: self.lower.max(other.lower),
            upper: self.upper.max(other.upper),
        }
    }

    /// Both ends multiplied by a positive factor.
    pub(super) fn scaled(self, factor: f64) -> Self {
        Self {
            lower: factor * self.lower,
            upper: factor * self.upper,
        }
    }
}

/// When to stop: at either.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// The wanted width of the interval, relative to its lower end.
    pub relative: f64,
    /// The wanted width of the interval in the units of the coordinates, where that is larger.
    pub absolute: f64,
    /// The number of parts that may be looked at.
    pub parts: usize,
}

impl Limits {
    /// The upper bound that need not be improved.
    fn goal(&self, lower: f64) -> f64 {
        lower + self.absolute.max(self.relative * lower)
    }
}

/// A part of a triangle of A.
struct Part {
    corners: [DVec3; 3],
    /// The distance to B is nowhere larger.
    upper: f64,
}

/// The interval of the largest distance from points of `from` to `to`, whose tree is `tree`; `lower` is a distance that is known to occur.
pub(super) fn directed(
    from: &TriangleMesh,
    to: &TriangleMesh,
    tree: &Bvh,
    mut lower: f64,
    limits: Limits,
) -> Interval {
    let whole = (0..from.triangles.len())
        .map(|t| Part {
            corners: from.corners(t),
            upper: f64::INFINITY,
        })
        .collect();
    let mut looked_at = from.triangles.len();
    let mut open = bound(whole, to, tree, &mut lower);
    let mut settled = 0.0f64;
    loop {
        let goal = limits.goal(lower);
        open.retain(|part| {
            let is_open = part.upper > goal;
            if !is_open {
                settled = settled.max(part.upper);
            }
            is_open
        });
        let highest = open.iter().map(|part| part.upper).fold(0.0, f64::max);
        if open.is_empty() || looked_at >= limits.parts {
            return Interval {
                lower,
                upper: lower.max(settled).max(highest),
            };
        }
        let threshold = goal.max(0.5 * (lower + highest));
        let (urgent, waiting): (Vec<_>, Vec<_>) =
            open.into_iter().partition(|part| part.upper > threshold);
        let halves: Vec<_> = urgent.iter().flat_map(Part::halves).collect();
        looked_at += halves.len();
        open = waiting;
        open.extend(bound(halves, to, tree, &mut lower));
    }
}

/// Lowers the parts' upper bounds to what their centres tell, and raises `lower` to the distance of the furthest centre.
fn bound(mut parts: Vec<Part>, to: &TriangleMesh, tree: &Bvh, lower: &mut f64) -> Vec<Part> {
    let centers: Vec<DVec3> = parts.iter().map(Part::center).collect();
    let closest = tree.closest_all(&centers);
    parts
        .par_iter_mut()
        .zip(&centers)
        .zip(&closest)
        .with_min_len(256)
        .for_each(|((part, &center), closest)| {
            let triangle = Triangle::new(to.corners(closest.triangle as usize));
            let convex = part
                .corners
                .map(|c| triangle.nearest(c).distance_squared)
                .into_iter()
                .fold(0.0, f64::max)
                .sqrt();
            let radius = part
                .corners
                .map(|c| c.distance(center))
                .into_iter()
                .fold(0.0, f64::max);
            let lipschitz = closest.distance_squared.sqrt() + radius;
            part.upper = part.upper.min(convex).min(lipschitz);
        });
    *lower = closest
        .iter()
        .map(|c| c.distance_squared.sqrt())
        .fold(*lower, f64::max);
    parts
}

impl Part {
    fn center(&self) -> DVec3 {
        let [a, b, c] = self.corners;
        (a + b + c) / 3.0
    }

    /// The two parts on either side of the midpoint of the longest edge; they inherit the upper bound.
    fn halves(&self) -> [Self; 2] {
        let c = self.corners;
        let length = |k: usize| c[k].distance_squared(c[(k + 1) % 3]);
        let mut k = usize::from(length(1) > length(0));
        if length(2) > length(k) {
            k = 2;
        }
        let (a, b, opposite) = (c[k], c[(k + 1) % 3], c[(k + 2) % 3]);
        let middle = a.midpoint(b);
        [[a, middle, opposite], [middle, b, opposite]].map(|corners| Self {
            corners,
            upper: self.upper,
        })
    }
}
