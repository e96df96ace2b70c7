//! The point of a triangle that is closest to a given point, whatever the triangle's shape.
//!
//! Projecting on the plane is ill-conditioned on slivers and undefined on triangles that are a segment or a point. Here every
//! candidate is a point of the triangle by construction, and the nearest candidate wins: rounding can then only make the answer
//! sub-optimal, never a point that is not there. On well-shaped triangles the distance is right to rounding; on a sliver of
//! length L and height h by at most min(h, ε L²/h) ≤ √ε L, and that only for points nearer to it than this.

use glam::DVec3;

/// Below this sine squared of the angle at the first corner a projection on the plane is not trusted alone: it has lost half the
/// digits in the area.
const SLIVER: f64 = 1e-16;

/// A triangle as a corner and the two edges that leave it.
///
/// Differences are formed before anything else, so that triangles far from the origin lose no more than their coordinates have lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangle {
    /// The first corner.
    pub a: DVec3,
    /// From the first corner to the second.
    pub ab: DVec3,
    /// From the first corner to the third.
    pub ac: DVec3,
}

/// The point of a triangle nearest to a point p.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// Weights of the three corners: non-negative, their sum 1 to rounding. Exactly 0 where the point is on the opposite edge.
    pub barycentric: [f64; 3],
    /// The squared distance to p.
    pub distance_squared: f64,
}

impl Triangle {
    /// The triangle with these corners.
    pub fn new([a, b, c]: [DVec3; 3]) -> Self {
        Self {
            a,
            ab: b - a,
            ac: c - a,
        }
    }

    /// The point with the given barycentric coordinates.
    pub fn point(&self, [_, v, w]: [f64; 3]) -> DVec3 {
        self.a + v * self.ab + w * self.ac
    }

    /// The point of the triangle nearest to `p`.
    #[inline]
    pub fn nearest(&self, p: DVec3) -> Nearest {
        let ap = p - self.a;
        let normal = self.ab.cross(self.ac);
        let area = normal.length_squared();
        let v = ap.cross(self.ac).dot(normal);
        let w = self.ab.cross(ap).dot(normal);
        if v < 0.0 || w < 0.0 || v + w > area || area == 0.0 {
            return self.nearest_on_edges(ap);
        }
        let (v, w) = (v / area, w / area);
        let inside = Nearest {
            barycentric: [(1.0 - v - w).max(0.0), v, w],
            distance_squared: (ap - v * self.ab - w * self.ac).length_squared(),
        };
        if area > SLIVER * self.ab.length_squared() * self.ac.length_squared() {
            inside
        } else {
            inside.or(self.nearest_on_edges(ap))
        }
    }

    /// The nearest of the three edges' nearest points; `ap` leads from the first corner to the point.
    #[inline]
    fn nearest_on_edges(&self, ap: DVec3) -> Nearest {
        let (ab, tab) = nearest_on_segment(ap, self.ab);
        let (ac, tac) = nearest_on_segment(ap, self.ac);
        let (bc, tbc) = nearest_on_segment(ap - self.ab, self.ac - self.ab);
        Nearest {
            barycentric: [1.0 - tab, tab, 0.0],
            distance_squared: ab,
        }
        .or(Nearest {
            barycentric: [1.0 - tac, 0.0, tac],
            distance_squared: ac,
        })
        .or(Nearest {
            barycentric: [0.0, 1.0 - tbc, tbc],
            distance_squared: bc,
        })
    }
}

impl Nearest {
    /// The nearer of two, the first where they are equally far.
    #[inline]
    fn or(self, other: Self) -> Self {
        if other.distance_squared < self.distance_squared {
            other
        } else {
            self
        }
    }
}

/// Squared distance from the point `p` to the segment from the origin to `edge`, and the parameter of the nearest point in 0..=1.
#[inline]
fn nearest_on_segment(p: DVec3, edge: DVec3) -> (f64, f64) {
    let length = edge.length_squared();
    let along = p.dot(edge);
    let t = if along <= 0.0 || length == 0.0 {
        0.0
    } else if along >= length {
        1.0
    } else {
        along / length
    };
    ((p - t * edge).length_squared(), t)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> Triangle {
        Triangle::new([a.into(), b.into(), c.into()])
    }

    fn distance(t: &Triangle, p: [f64; 3]) -> f64 {
        t.nearest(p.into()).distance_squared.sqrt()
    }

    /// The smallest distance to points of the triangle on a fine lattice: never smaller than the true one.
    fn sampled_distance(t: &Triangle, p: DVec3) -> f64 {
        let n = 200;
        (0..=n)
            .flat_map(|i| {
                (0..=n - i).map(move |j| {
                    [
                        0.0,
                        f64::from(i) / f64::from(n),
                        f64::from(j) / f64::from(n),
                    ]
                })
            })
            .map(|weights| t.point(weights).distance(p))
            .fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn a_point_and_a_segment_are_triangles_too() {
        let point = triangle([1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]);
        assert_eq!(distance(&point, [1.0, 2.0, 8.0]), 5.0);
        for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1]] {
            let ends = [[0.0; 3], [4.0, 0.0, 0.0], [1.0, 0.0, 0.0]];
            let segment = triangle(ends[order[0]], ends[order[1]], ends[order[2]]);
            assert_eq!(distance(&segment, [3.0, 2.0, 0.0]), 2.0);
            assert_eq!(distance(&segment, [7.0, 4.0, 0.0]), 5.0);
        }
    }

    #[test]
    fn all_seven_regions_of_a_right_triangle() {
        let t = triangle([0.0; 3], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]);
        assert_eq!(distance(&t, [1.0, 1.0, 2.0]), 2.0);
        assert_eq!(distance(&t, [-3.0, -4.0, 0.0]), 5.0);
        assert_eq!(distance(&t, [6.0, -4.0, 0.0]), 5.0);
        assert_eq!(distance(&t, [-3.0, 7.0, 0.0]), 5.0);
        assert_eq!(distance(&t, [1.0, -2.0, 0.0]), 2.0);
        assert_eq!(distance(&t, [-2.0, 1.0, 0.0]), 2.0);
        assert!((distance(&t, [3.0, 3.0, 0.0]) - 1.5 * 2.0f64.sqrt()).abs() < 1e-15);
        assert_eq!(t.nearest(DVec3::new(1.0, -2.0, 0.0)).barycentric[2], 0.0);
        assert_eq!(t.nearest(DVec3::new(3.0, 3.0, 0.0)).barycentric[0], 0.0);
    }

    #[test]
    fn slivers_of_every_height_give_the_distance_of_their_points() {
        for exponent in 0..30 {
            let h = 10f64.powi(-exponent);
            let t = triangle([0.0; 3], [1.0, 0.3, 0.2], [0.4, 0.12 + h, 0.08]);
            for k in 0..50 {
                let s = f64::from(k);
                let p = DVec3::new((s * 0.7).sin(), (s * 1.3).cos(), (s * 2.1).sin());
                let nearest = t.nearest(p);
                let d = nearest.distance_squared.sqrt();
                assert!(d <= sampled_distance(&t, p) + 1e-15, "h {h}: {d}");
                assert!((t.point(nearest.barycentric).distance(p) - d).abs() < 1e-14);
                assert!(
                    nearest
                        .barycentric
                        .iter()
                        .all(|&b| (0.0..=1.0).contains(&b))
                );
                assert!((nearest.barycentric.iter().sum::<f64>() - 1.0).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn a_point_of_a_sliver_is_found_on_it() {
        for exponent in 0..30 {
            let h = 10f64.powi(-exponent);
            let t = triangle([0.0; 3], [1.0, 0.3, 0.2], [0.4, 0.12 + h, 0.08]);
            let p = t.point([0.0, 0.31, 0.17]);
            // √ε, the bound that the module states.
            assert!(t.nearest(p).distance_squared.sqrt() < 1.5e-8, "h {h}");
        }
    }

    #[test]
    fn shift_and_scale_carry_over() {
        let corners = [[0.1, 0.2, 0.3], [1.1, 0.0, 0.4], [0.2, 0.9, -0.3]].map(DVec3::from);
        let p = DVec3::new(0.6, 0.7, 0.9);
        let d = Triangle::new(corners).nearest(p).distance_squared.sqrt();
        for scale in [1e-12, 1e12] {
            let scaled = Triangle::new(corners.map(|c| c * scale)).nearest(p * scale);
            assert!((scaled.distance_squared.sqrt() / scale - d).abs() < 1e-15);
        }
        let shift = DVec3::splat(5e6);
        let far = Triangle::new(corners.map(|c| c + shift)).nearest(p + shift);
        // The shift itself rounds the coordinates to 2⁻³⁰.
        assert!((far.distance_squared.sqrt() - d).abs() < 4e-9);
    }
}
