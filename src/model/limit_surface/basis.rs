//! The basis functions of regular patches with their derivatives: quartic box splines over triangles, bicubic B-splines over quads.
//!
//! **Box spline.** Twelve control points of the regular triangulation act on a triangle. Nine of the basis functions are short
//! polynomials in the barycentric coordinates a, b, c, with one of three forms each (Stam 1998, appendix A, regrouped; s = x + y, t = x y):
//! - a point two edges away from the triangle's corner of weight x, on the side of the corner of weight y: x³ (x + 2 y);
//! - the point across the edge of weights x and y, with z the third: s⁴ + 2 t (s² + t) + 2 z s³;
//!
//! each over 12. Those of the three corners follow: all twelve sum to 1 and reproduce linear functions.

use super::LimitJet;
use glam::{DVec2, DVec3};

/// Where the control points of a triangle's patch are, in its own parameters: its corners; across the edge opposite to each corner;
/// and by corner k the two beyond it, on the line of corner k + 1 and on that of corner k + 2.
const TRIANGLE_POINTS: [[f64; 2]; 12] = [
    [0.0, 0.0],
    [1.0, 0.0],
    [0.0, 1.0],
    [1.0, 1.0],
    [-1.0, 1.0],
    [1.0, -1.0],
    [-1.0, 0.0],
    [0.0, -1.0],
    [2.0, -1.0],
    [2.0, 0.0],
    [0.0, 2.0],
    [-1.0, 2.0],
];

/// Sums over the nine points of twelve times their basis functions: of the values and the derivatives by three barycentric coordinates as if they were independent.
#[derive(Default)]
struct Homogeneous {
    value: DVec3,
    first: [DVec3; 3],
    /// By the coordinates (i, j) at [i][j], i ≤ j.
    second: [[DVec3; 3]; 3],
}

impl Homogeneous {
    /// Adds `p` times x³ (x + 2 y), x the weight of corner `I`, y that of corner `J`.
    #[inline(always)]
    fn beyond<const I: usize, const J: usize>(&mut self, w: [f64; 3], p: DVec3) {
        let (x, y) = (w[I], w[J]);
        let x2 = x * x;
        self.value += x2 * x * (x + 2.0 * y) * p;
        self.first[I] += x2 * (4.0 * x + 6.0 * y) * p;
        self.first[J] += 2.0 * x2 * x * p;
        self.second[I][I] += 12.0 * x * (x + y) * p;
        self.second[I.min(J)][I.max(J)] += 6.0 * x2 * p;
    }

    /// Adds `p` times s⁴ + 2 t (s² + t) + 2 z s³, z the weight of corner `K`, x and y those of the next, `I`, and the last, `J`.
    #[inline(always)]
    fn across<const K: usize, const I: usize, const J: usize>(&mut self, w: [f64; 3], p: DVec3) {
        let (x, y, z) = (w[I], w[J], w[K]);
        let (s, t) = (x + y, x * y);
        let (s2, s3) = (s * s, s * s * s);
        let both = 4.0 * s3 + 4.0 * s * t + 6.0 * z * s2;
        let bend = 12.0 * s2 + 4.0 * t + 12.0 * z * s;
        self.value += (s2 * s2 + 2.0 * t * (s2 + t) + 2.0 * z * s3) * p;
        self.first[I] += (both + 2.0 * y * (s2 + 2.0 * t)) * p;
        self.first[J] += (both + 2.0 * x * (s2 + 2.0 * t)) * p;
        self.first[K] += 2.0 * s3 * p;
        self.second[I][I] += (bend + 4.0 * y * (2.0 * s + y)) * p;
        self.second[J][J] += (bend + 4.0 * x * (2.0 * s + x)) * p;
        self.second[I.min(J)][I.max(J)] += (bend + 6.0 * s2 + 8.0 * t) * p;
        let mixed = 6.0 * s2 * p;
        self.second[I.min(K)][I.max(K)] += mixed;
        self.second[J.min(K)][J.max(K)] += mixed;
    }
}

/// The quartic box spline with control points `p` at (u, v) of the triangle (0,0), (1,0), (0,1).
#[inline]
pub fn box_spline(p: &[DVec3; 12], at: DVec2) -> LimitJet {
    let [a, b, c, ..] = *p;
    let w = [1.0 - at.x - at.y, at.x, at.y];
    // The basis reproduces linear functions: what the nine other points are beside the one through the corners is all that bends.
    let scaled = |point: DVec3| point * (1.0 / 12.0);
    let mut sum = Homogeneous::default();
    sum.across::<0, 1, 2>(w, scaled(p[3] - (b + c - a)));
    sum.across::<1, 2, 0>(w, scaled(p[4] - (c + a - b)));
    sum.across::<2, 0, 1>(w, scaled(p[5] - (a + b - c)));
    sum.beyond::<0, 2>(w, scaled(p[6] - (2.0 * a - b)));
    sum.beyond::<0, 1>(w, scaled(p[7] - (2.0 * a - c)));
    sum.beyond::<1, 0>(w, scaled(p[8] - (2.0 * b - c)));
    sum.beyond::<1, 2>(w, scaled(p[9] - (2.0 * b - a)));
    sum.beyond::<2, 1>(w, scaled(p[10] - (2.0 * c - a)));
    sum.beyond::<2, 0>(w, scaled(p[11] - (2.0 * c - b)));
    let (d, dd) = (&sum.first, &sum.second);
    LimitJet {
        position: w[0] * a + w[1] * b + w[2] * c + sum.value,
        du: b - a + d[1] - d[0],
        dv: c - a + d[2] - d[0],
        duu: dd[1][1] - 2.0 * dd[0][1] + dd[0][0],
        duv: dd[1][2] - dd[0][1] - dd[0][2] + dd[0][0],
        dvv: dd[2][2] - 2.0 * dd[0][2] + dd[0][0],
    }
}

/// The values of its basis functions at (u, v).
pub fn box_spline_values(at: DVec2) -> [f64; 12] {
    let w = [1.0 - at.x - at.y, at.x, at.y];
    let across = |k: usize| {
        let (x, y, z) = (w[(k + 1) % 3], w[(k + 2) % 3], w[k]);
        let (s, t) = (x + y, x * y);
        let s2 = s * s;
        (s2 * s2 + 2.0 * t * (s2 + t) + 2.0 * z * s * s2) * (1.0 / 12.0)
    };
    let beyond = |i: usize, j: usize| w[i].powi(3) * (w[i] + 2.0 * w[j]) * (1.0 / 12.0);
    let mut values = [
        0.0,
        0.0,
        0.0,
        across(0),
        across(1),
        across(2),
        beyond(0, 2),
        beyond(0, 1),
        beyond(1, 0),
        beyond(1, 2),
        beyond(2, 1),
        beyond(2, 0),
    ];
    // What is left of 1, u and v.
    let left = |of: f64, share: fn([f64; 2]) -> f64| {
        let others = values.iter().zip(TRIANGLE_POINTS).skip(3);
        others.fold(of, |left, (value, point)| left - share(point) * value)
    };
    let (sum, x, y) = (
        left(1.0, |_| 1.0),
        left(at.x, |p| p[0]),
        left(at.y, |p| p[1]),
    );
    [values[0], values[1], values[2]] = [sum - x - y, x, y];
    values
}

/// The four cubic B-splines that act on [0, 1], with their first and second derivatives.
fn cubic(t: f64) -> [[f64; 4]; 3] {
    let s = 1.0 - t;
    let (t2, s2) = (t * t, s * s);
    [
        [
            s2 * s / 6.0,
            2.0 / 3.0 - 0.5 * t2 * (1.0 + s),
            2.0 / 3.0 - 0.5 * s2 * (1.0 + t),
            t2 * t / 6.0,
        ],
        [
            -0.5 * s2,
            t * (1.5 * t - 2.0),
            s * (2.0 - 1.5 * s),
            0.5 * t2,
        ],
        [s, 3.0 * t - 2.0, 3.0 * s - 2.0, t],
    ]
}

/// The bicubic B-spline with control points `p` at (u, v) of the unit square; control point (i, j), at (i − 1, j − 1), is number i + 4 j.
#[inline]
pub fn bicubic(p: &[DVec3; 16], at: DVec2) -> LimitJet {
    let (u, v) = (cubic(at.x), cubic(at.y));
    // By order, along u and then along v.
    let mut jet = [[DVec3::ZERO; 3]; 3];
    for (j, row) in p.as_chunks::<4>().0.iter().enumerate() {
        for du in 0..3 {
            let along = (0..4).fold(DVec3::ZERO, |sum, i| sum + u[du][i] * row[i]);
            for dv in 0..3 - du {
                jet[du][dv] += v[dv][j] * along;
            }
        }
    }
    LimitJet {
        position: jet[0][0],
        du: jet[1][0],
        dv: jet[0][1],
        duu: jet[2][0],
        duv: jet[1][1],
        dvv: jet[0][2],
    }
}

/// The values of its basis functions at (u, v).
pub fn bicubic_values(at: DVec2) -> [f64; 16] {
    let (u, v) = (cubic(at.x)[0], cubic(at.y)[0]);
    std::array::from_fn(|k| u[k % 4] * v[k / 4])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spots() -> Vec<DVec2> {
        (0..=6)
            .flat_map(|i| (0..=6 - i).map(move |j| DVec2::new(f64::from(i), f64::from(j)) / 6.0))
            .collect()
    }

    /// The value and the derivatives u, v, uu, uv, vv of each basis function, that of control point k by a spline that is 1 there and 0 at the others.
    fn jets<const N: usize>(
        spline: impl Fn(&[DVec3; N], DVec2) -> LimitJet,
        at: DVec2,
    ) -> [[f64; 6]; N] {
        std::array::from_fn(|k| {
            let mut points = [DVec3::ZERO; N];
            points[k] = DVec3::Y;
            spline(&points, at).to_array().map(|p| p.y)
        })
    }

    /// Differences of what a basis returns against its derivatives, and what it sums to.
    fn check<const N: usize>(
        spline: impl Fn(&[DVec3; N], DVec2) -> LimitJet,
        values: impl Fn(DVec2) -> [f64; N],
        point: impl Fn(usize) -> DVec2,
    ) {
        let basis = |at| jets(&spline, at);
        let h = 1e-5;
        for at in spots() {
            let here = basis(at);
            let values = values(at);
            for (jet, value) in here.iter().zip(values) {
                assert!((jet[0] - value).abs() < 1e-15, "{at}: {jet:?} {value}");
            }
            let sum = |order: usize, f: &dyn Fn(DVec2) -> f64| -> f64 {
                (0..N).map(|k| here[k][order] * f(point(k))).sum()
            };
            for (order, expected) in [1.0, 0.0, 0.0, 0.0, 0.0, 0.0].into_iter().enumerate() {
                assert!((sum(order, &|_| 1.0) - expected).abs() < 1e-14);
            }
            assert!(
                (sum(0, &|p| p.x) - at.x).abs() < 1e-14 && (sum(1, &|p| p.x) - 1.0).abs() < 1e-14
            );
            assert!(
                (sum(0, &|p| p.y) - at.y).abs() < 1e-14 && (sum(2, &|p| p.y) - 1.0).abs() < 1e-14
            );
            for (axis, from, to) in [
                (DVec2::X, 0, 1),
                (DVec2::Y, 0, 2),
                (DVec2::X, 1, 3),
                (DVec2::Y, 1, 4),
                (DVec2::X, 2, 4),
                (DVec2::Y, 2, 5),
            ] {
                let (after, before) = (basis(at + h * axis), basis(at - h * axis));
                for k in 0..N {
                    let difference = (after[k][from] - before[k][from]) / (2.0 * h);
                    assert!(
                        (difference - here[k][to]).abs() < 1e-9,
                        "{at}: {k}, {from} to {to}"
                    );
                }
            }
            assert!(here.iter().all(|b| b[0] > -1e-16), "{at}: {here:?}");
        }
    }

    #[test]
    fn both_bases_sum_to_one_reproduce_linear_functions_and_have_the_derivatives_they_claim() {
        check(box_spline, box_spline_values, |k| {
            DVec2::from_array(TRIANGLE_POINTS[k])
        });
        check(bicubic, bicubic_values, |k| {
            DVec2::new((k % 4) as f64, (k / 4) as f64) - 1.0
        });
    }
}
