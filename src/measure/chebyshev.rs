//! Polynomials on a cube as Chebyshev series: from samples, halved, bounded from below.
//!
//! A Bernstein form of the whole polynomial would bound it too, but the conversion is unstable in f64 beyond degree 15 or so;
//! here only the part of degree 5 or less is converted, and the rest, small after a few halvings, is bounded by its coefficients.

use std::f64::consts::PI;
use std::ops::{AddAssign, Mul};

/// The degree to which a series is bounded by its Bernstein coefficients.
const LOW: usize = 5;

/// Trailing coefficients whose sum is less than this share of the largest are dropped, and counted as error instead.
const NEGLIGIBLE: f64 = 1e-13;

/// The `n` nodes of the Gauss–Chebyshev rule, moved to \[0, 1\].
pub fn nodes(n: usize) -> Vec<f64> {
    (0..n).map(|i| 0.5 * (1.0 + (angle(i, n)).cos())).collect()
}

fn angle(i: usize, n: usize) -> f64 {
    PI * (i as f64 + 0.5) / n as f64
}

/// Coefficients from the values at the nodes, `[n, n]`.
pub fn transform(n: usize) -> Vec<f64> {
    let entry = |k: usize, i: usize| {
        let scale = if k == 0 { 1.0 } else { 2.0 } / n as f64;
        scale * (k as f64 * angle(i, n)).cos()
    };
    (0..n)
        .flat_map(|k| (0..n).map(move |i| entry(k, i)))
        .collect()
}

/// T_k(2x − 1) for k < `n` at points x, `[points, n]`.
fn values(n: usize, points: &[f64]) -> Vec<f64> {
    let angles = points
        .iter()
        .map(|x| (2.0 * x - 1.0).clamp(-1.0, 1.0).acos());
    angles
        .flat_map(|a| (0..n).map(move |k| (k as f64 * a).cos()))
        .collect()
}

/// Values at the nodes of `to` from those at the nodes of `from`, of a polynomial of degree `from` − 1: `[to, from]`.
pub fn resample(from: usize, to: usize) -> Vec<f64> {
    multiply(&values(from, &nodes(to)), &transform(from), from)
}

/// The product of matrices with rows of `n`.
fn multiply(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    a.chunks_exact(n)
        .flat_map(|row| {
            (0..n).map(move |j| {
                row.iter()
                    .zip(b[j..].iter().step_by(n))
                    .map(|(x, y)| x * y)
                    .sum()
            })
        })
        .collect()
}

/// Applies a `[rows, n]` matrix along the middle axis of an array `[outer, n, inner]`.
pub fn along_axis<T>(matrix: &[f64], n: usize, inner: usize, array: &[T]) -> Vec<T>
where
    T: Copy + AddAssign + Mul<f64, Output = T>,
{
    let mut product = Vec::with_capacity(array.len() / n * (matrix.len() / n));
    for block in array.chunks_exact(n * inner) {
        for row in matrix.chunks_exact(n) {
            let first = product.len();
            product.extend(block[..inner].iter().map(|&x| x * row[0]));
            for (&weight, line) in row[1..].iter().zip(block[inner..].chunks_exact(inner)) {
                let sums = &mut product[first..];
                sums.iter_mut()
                    .zip(line)
                    .for_each(|(s, &x)| *s += x * weight);
            }
        }
    }
    product
}

/// Applies a matrix along each axis of a cube whose sides are given, x fastest; the matrices have rows of those sides.
pub fn along_all<T>(matrices: [&[f64]; 3], sides: [usize; 3], array: &[T]) -> Vec<T>
where
    T: Copy + AddAssign + Mul<f64, Output = T>,
{
    let rows = |k: usize| matrices[k].len() / sides[k];
    let x = along_axis(matrices[0], sides[0], 1, array);
    let y = along_axis(matrices[1], sides[1], rows(0), &x);
    along_axis(matrices[2], sides[2], rows(0) * rows(1), &y)
}

/// Matrices for series with up to some number of coefficients an axis.
#[derive(Debug)]
pub struct Tools {
    n: usize,
    /// Coefficients over the lower and the upper half, `[n, n]`.
    halves: [Vec<f64>; 2],
    /// Bernstein coefficients of degree 5 from the first six of a series, `[6, 6]`.
    bernstein: Vec<f64>,
}

impl Tools {
    pub fn new(n: usize) -> Self {
        let half = |shift: f64| {
            let points: Vec<f64> = nodes(n).iter().map(|x| 0.5 * (x + shift)).collect();
            multiply(&transform(n), &values(n, &points), n)
        };
        Self {
            n,
            halves: [half(0.0), half(1.0)],
            bernstein: chebyshev_to_bernstein(),
        }
    }

    /// The leading `[n, n]` block of the matrix of a half: T_k over a half has no degree above k.
    fn half(&self, side: usize, n: usize) -> Vec<f64> {
        let rows = self.halves[side].chunks_exact(self.n).take(n);
        rows.flat_map(|row| &row[..n]).copied().collect()
    }
}

/// Row i: the Bernstein coefficient i of T_0 … T_5, through powers of x on \[0, 1\].
fn chebyshev_to_bernstein() -> Vec<f64> {
    const N: usize = LOW + 1;
    let mut t = [[0.0; N]; N];
    t[0][0] = 1.0;
    (t[1][0], t[1][1]) = (-1.0, 2.0);
    for k in 2..N {
        for j in 0..N {
            let shifted = if j > 0 { t[k - 1][j - 1] } else { 0.0 };
            t[k][j] = 4.0 * shifted - 2.0 * t[k - 1][j] - t[k - 2][j];
        }
    }
    let binomial =
        |n: usize, k: usize| (0..k).fold(1.0, |b, i| b * (n - i) as f64 / (i + 1) as f64);
    (0..N)
        .flat_map(|i| {
            t.map(|powers| {
                let share = |j: usize| binomial(i, j) / binomial(LOW, j);
                (0..=i).map(|j| share(j) * powers[j]).sum()
            })
        })
        .collect()
}

/// A polynomial on a box, and by how much it may be off from the function that it stands for.
#[derive(Debug, Clone)]
pub struct Series {
    sides: [usize; 3],
    coefficients: Vec<f64>,
    pub error: f64,
}

impl Series {
    /// From values at the tensor product of [`nodes`], x fastest.
    pub fn from_values(sides: [usize; 3], values: &[f64], error: f64) -> Self {
        let matrices = sides.map(transform);
        Self {
            sides,
            coefficients: along_all(matrices.each_ref().map(Vec::as_slice), sides, values),
            error,
        }
    }

    fn index(&self, mut i: usize) -> [usize; 3] {
        self.sides.map(|side| {
            let k = i % side;
            i /= side;
            k
        })
    }

    /// Drops trailing coefficients that amount to nothing.
    pub fn trim(&mut self) {
        let largest = self
            .coefficients
            .iter()
            .fold(0.0, |m: f64, c| m.max(c.abs()));
        for axis in 0..3 {
            let mut slabs = vec![0.0; self.sides[axis]];
            for (i, c) in self.coefficients.iter().enumerate() {
                slabs[self.index(i)[axis]] += c.abs();
            }
            let mut kept = self.sides[axis];
            let mut dropped = 0.0;
            while kept > 1 && dropped + slabs[kept - 1] <= NEGLIGIBLE * largest {
                dropped += slabs[kept - 1];
                kept -= 1;
            }
            if kept < self.sides[axis] {
                let inside = |i: usize| self.index(i)[axis] < kept;
                self.coefficients = (0..self.coefficients.len())
                    .filter(|&i| inside(i))
                    .map(|i| self.coefficients[i])
                    .collect();
                self.sides[axis] = kept;
                self.error += dropped;
            }
        }
    }

    /// A number that no value of the function on the box is below.
    pub fn lower_bound(&self, tools: &Tools) -> f64 {
        const N: usize = LOW + 1;
        let mut low = vec![0.0; N * N * N];
        let mut rest = 0.0;
        for (i, &c) in self.coefficients.iter().enumerate() {
            let [x, y, z] = self.index(i);
            if x.max(y).max(z) <= LOW {
                low[x + N * (y + N * z)] = c;
            } else {
                rest += c.abs();
            }
        }
        let bernstein = along_all([&tools.bernstein; 3], [N; 3], &low);
        bernstein.into_iter().fold(f64::INFINITY, f64::min) - rest - self.error
    }

    /// Whether a value of the function is certainly 0 or less, at a lattice with the corners, edges and faces of the box.
    pub fn is_negative_somewhere(&self) -> bool {
        let matrices = self.sides.map(|n| {
            let last = n.max(2) - 1;
            let points: Vec<f64> = (0..=last)
                .map(|i| 0.5 - 0.5 * (PI * i as f64 / last as f64).cos())
                .collect();
            values(n, &points)
        });
        let matrices = matrices.each_ref().map(Vec::as_slice);
        let lattice = along_all(matrices, self.sides, &self.coefficients);
        lattice.into_iter().any(|v| v <= -self.error)
    }

    /// The two halves along the axis on which the series varies most.
    pub fn halves(&self, tools: &Tools) -> [Self; 2] {
        let mut variation = [0.0; 3];
        for (i, c) in self.coefficients.iter().enumerate() {
            for (v, k) in variation.iter_mut().zip(self.index(i)) {
                *v += k as f64 * c.abs();
            }
        }
        let axis = (1..3).fold(0, |best, k| {
            if variation[k] > variation[best] {
                k
            } else {
                best
            }
        });
        let inner = self.sides[..axis].iter().product();
        let n = self.sides[axis];
        [0, 1].map(|side| Self {
            sides: self.sides,
            coefficients: along_axis(&tools.half(side, n), n, inner, &self.coefficients),
            error: self.error,
        })
    }
}
