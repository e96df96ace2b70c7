//! The hole of a target: where a line can pass through it without touching.
//!
//! The target is seen along a direction, as the shadow that it casts on a grid. Lit cells that the light around the shadow
//! does not reach are a hole, and its middle is the lit cell furthest from any shadow.

use crate::mesh::TriangleMesh;
use glam::{DVec2, DVec3};
use std::collections::VecDeque;

/// Cells along the longer side of the shadow: a hole of 2 % of that is still five cells wide.
const RESOLUTION: usize = 256;

/// A passage through the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hole {
    /// A point on its middle line.
    pub center: DVec3,
    /// The direction of that line.
    pub direction: DVec3,
    /// The distance from the line to the nearest shadow.
    pub radius: f64,
}

/// The widest hole seen along a unit direction, if there is any.
pub(super) fn find(target: &TriangleMesh, direction: DVec3) -> Option<Hole> {
    let (u, v) = direction.any_orthonormal_pair();
    let shadow = Shadow::cast(target, u, v)?;
    let (cell, radius) = shadow.innermost()?;
    let middle = shadow.origin + shadow.cell_size * cell;
    Some(Hole {
        center: middle.x * u + middle.y * v,
        direction,
        radius: radius * shadow.cell_size,
    })
}

/// Which cells of a grid the target covers, with an empty margin of a cell around it.
struct Shadow {
    origin: DVec2,
    cell_size: f64,
    width: usize,
    height: usize,
    covered: Vec<bool>,
}

impl Shadow {
    fn cast(target: &TriangleMesh, u: DVec3, v: DVec3) -> Option<Self> {
        let flat = |p: DVec3| DVec2::new(p.dot(u), p.dot(v));
        let triangles = || (0..target.triangles.len()).map(|t| target.corners(t).map(flat));
        let (lo, hi) = triangles()
            .flatten()
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), p| {
                (lo.min(p), hi.max(p))
            });
        let cell_size = (hi - lo).max_element() / RESOLUTION as f64;
        if !(cell_size > 0.0 && cell_size.is_finite()) {
            return None;
        }
        let [width, height] = ((hi - lo) / cell_size).to_array().map(|n| n as usize + 3);
        let mut shadow = Self {
            origin: lo - DVec2::splat(cell_size),
            cell_size,
            width,
            height,
            covered: vec![false; width * height],
        };
        for corners in triangles() {
            shadow.cover(corners.map(|p| (p - shadow.origin) / cell_size));
        }
        Some(shadow)
    }

    /// Covers the cells of a triangle, by points no further apart than half a cell.
    fn cover(&mut self, [a, b, c]: [DVec2; 3]) {
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        let steps = (2.0 * longest).ceil().max(1.0) as usize;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (s, t) = (i as f64 / steps as f64, j as f64 / steps as f64);
                let p = a + (b - a) * s + (c - a) * t;
                self.covered[p.y as usize * self.width + p.x as usize] = true;
            }
        }
    }

    /// The middle (in cells) of the lit cell furthest from the shadow among those inside it, and that distance in cells.
    fn innermost(&self) -> Option<(DVec2, f64)> {
        let outside = self.outside();
        let middle = |k: usize| {
            let (x, y) = (k % self.width, k / self.width);
            DVec2::new(x as f64 + 0.5, y as f64 + 0.5)
        };
        // Only shadow with light beside it can be nearest to a lit cell.
        let edge: Vec<DVec2> = (0..self.covered.len())
            .filter(|&k| self.covered[k] && self.beside(k).any(|n| !self.covered[n]))
            .map(middle)
            .collect();
        (0..self.covered.len())
            .filter(|&k| !self.covered[k] && !outside[k])
            .map(|k| {
                let nearest = edge.iter().map(|e| e.distance_squared(middle(k)));
                (middle(k), nearest.fold(f64::INFINITY, f64::min).sqrt())
            })
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The lit cells that are connected with the margin.
    fn outside(&self) -> Vec<bool> {
        let mut reached = vec![false; self.covered.len()];
        reached[0] = true;
        let mut queue = VecDeque::from([0]);
        while let Some(k) = queue.pop_front() {
            for n in self.beside(k) {
                if !self.covered[n] && !reached[n] {
                    reached[n] = true;
                    queue.push_back(n);
                }
            }
        }
        reached
    }

    /// The up to four cells beside cell `k`.
    fn beside(&self, k: usize) -> impl Iterator<Item = usize> + use<> {
        let (x, y, w) = (k % self.width, k / self.width, self.width);
        let candidates = [
            (x > 0).then(|| k - 1),
            (x + 1 < w).then_some(k + 1),
            (y > 0).then(|| k - w),
            (y + 1 < self.height).then_some(k + w),
        ];
        candidates.into_iter().flatten()
    }
}
