//! The basis functions of regular patches with their derivatives: quartic box splines over triangles, bicubic B-splines over quads.
//!
//! **Box spline.** Twelve control points of the regular triangulation act on a triangle. Nine of the basis functions are short
//! polynomials in the barycentric coordinates a, b, c, with one of three forms each (Stam 1998, appendix A, regrouped; s = x + y, t = x y):
//! - a point two edges away from the triangle's corner of weight x, on the side of the corner of weight y: x³ (x + 2 y);
//! - the point across the edge of weights x and y, with z the third: s⁴ + 2 t (s² + t) + 2 z s³;
//!
//! each over 12. Those of the three corners follow: all twelve sum to 1 and reproduce linear functions.

use glam::DVec2;

/// The value and the derivatives u, v, uu, uv, vv of each of `N` basis functions.
pub type Jets<const N: usize> = [[f64; 6]; N];

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

/// Twelve times a basis function: its value and derivatives by three barycentric coordinates as if they were independent.
#[derive(Default)]
struct Homogeneous {
    value: f64,
    first: [f64; 3],
    second: [[f64; 3]; 3],
}

impl Homogeneous {
    /// x³ (x + 2 y), x the weight of corner `I`, y that of corner `J`.
    #[inline(always)]
    fn beyond<const I: usize, const J: usize>(w: [f64; 3]) -> Self {
        let (x, y) = (w[I], w[J]);
        let x2 = x * x;
        let mut p = Self {
            value: x2 * x * (x + 2.0 * y),
            ..Self::default()
        };
        p.first[I] = x2 * (4.0 * x + 6.0 * y);
        p.first[J] = 2.0 * x2 * x;
        p.second[I][I] = 12.0 * x * (x + y);
        p.set_mixed(I, J, 6.0 * x2);
        p
    }

    /// s⁴ + 2 t (s² + t) + 2 z s³, z the weight of corner `K`, x and y those of the next, `I`, and the last, `J`.
    #[inline(always)]
    fn across<const K: usize, const I: usize, const J: usize>(w: [f64; 3]) -> Self {
        let (x, y, z) = (w[I], w[J], w[K]);
        let (s, t) = (x + y, x * y);
        let (s2, s3) = (s * s, s * s * s);
        let mut p = Self {
            value: s2 * s2 + 2.0 * t * (s2 + t) + 2.0 * z * s3,
            ..Self::default()
        };
        let both = 4.0 * s3 + 4.0 * s * t + 6.0 * z * s2;
        let bend = 12.0 * s2 + 4.0 * t + 12.0 * z * s;
        p.first[I] = both + 2.0 * y * (s2 + 2.0 * t);
        p.first[J] = both + 2.0 * x * (s2 + 2.0 * t);
        p.first[K] = 2.0 * s3;
        p.second[I][I] = bend + 4.0 * y * (2.0 * s + y);
        p.second[J][J] = bend + 4.0 * x * (2.0 * s + x);
        p.set_mixed(I, J, bend + 6.0 * s2 + 8.0 * t);
        p.set_mixed(I, K, 6.0 * s2);
        p.set_mixed(J, K, 6.0 * s2);
        p
    }

    #[inline(always)]
    fn set_mixed(&mut self, i: usize, j: usize, value: f64) {
        self.second[i][j] = value;
        self.second[j][i] = value;
    }

    /// By (u, v), the weights being (1 − u − v, u, v).
    #[inline(always)]
    fn jet(&self) -> [f64; 6] {
        let (d, dd) = (&self.first, &self.second);
        [
            self.value,
            d[1] - d[0],
            d[2] - d[0],
            dd[1][1] - 2.0 * dd[0][1] + dd[0][0],
            dd[1][2] - dd[0][1] - dd[0][2] + dd[0][0],
            dd[2][2] - 2.0 * dd[0][2] + dd[0][0],
        ]
        .map(|value| value * (1.0 / 12.0))
    }
}

/// The quartic box spline at (u, v) of the triangle (0,0), (1,0), (0,1).
#[inline]
pub fn box_spline(at: DVec2) -> Jets<12> {
    let w = [1.0 - at.x - at.y, at.x, at.y];
    let mut jets = [
        [0.0; 6],
        [0.0; 6],
        [0.0; 6],
        Homogeneous::across::<0, 1, 2>(w).jet(),
        Homogeneous::across::<1, 2, 0>(w).jet(),
        Homogeneous::across::<2, 0, 1>(w).jet(),
        Homogeneous::beyond::<0, 2>(w).jet(),
        Homogeneous::beyond::<0, 1>(w).jet(),
        Homogeneous::beyond::<1, 0>(w).jet(),
        Homogeneous::beyond::<1, 2>(w).jet(),
        Homogeneous::beyond::<2, 1>(w).jet(),
        Homogeneous::beyond::<2, 0>(w).jet(),
    ];
    // What is left of the jets of 1, u and v.
    let mut sum = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let mut x = [at.x, 1.0, 0.0, 0.0, 0.0, 0.0];
    let mut y = [at.y, 0.0, 1.0, 0.0, 0.0, 0.0];
    for (jet, point) in jets.iter().zip(TRIANGLE_POINTS).skip(3) {
        for order in 0..6 {
            sum[order] -= jet[order];
            x[order] -= point[0] * jet[order];
            y[order] -= point[1] * jet[order];
        }
    }
    jets[0] = std::array::from_fn(|order| sum[order] - x[order] - y[order]);
    (jets[1], jets[2]) = (x, y);
    jets
}

/// Its values alone.
pub fn box_spline_values(at: DVec2) -> [f64; 12] {
    // Inlined, the derivatives are never computed.
    box_spline(at).map(|jet| jet[0])
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

/// The bicubic B-spline at (u, v) of the unit square; control point (i, j), at (i − 1, j − 1), is number i + 4 j.
#[inline]
pub fn bicubic(at: DVec2) -> Jets<16> {
    let (u, v) = (cubic(at.x), cubic(at.y));
    let orders = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)];
    std::array::from_fn(|k| orders.map(|(du, dv)| u[du][k % 4] * v[dv][k / 4]))
}

/// Its values alone.
pub fn bicubic_values(at: DVec2) -> [f64; 16] {
    bicubic(at).map(|jet| jet[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spots() -> Vec<DVec2> {
        (0..=6)
            .flat_map(|i| (0..=6 - i).map(move |j| DVec2::new(f64::from(i), f64::from(j)) / 6.0))
            .collect()
    }

    /// Differences of what a basis returns against its derivatives, and what it sums to.
    fn check<const N: usize>(basis: impl Fn(DVec2) -> Jets<N>, point: impl Fn(usize) -> DVec2) {
        let h = 1e-5;
        for at in spots() {
            let here = basis(at);
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
        check(box_spline, |k| DVec2::from_array(TRIANGLE_POINTS[k]));
        check(bicubic, |k| {
            DVec2::new((k % 4) as f64, (k / 4) as f64) - 1.0
        });
    }
}
