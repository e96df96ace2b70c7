//! Where the volume integrals of an element are sampled, and with which weights.
//!
//! **Departure from the paper.** Its trapezoidal rule with 2p − 1 samples a dimension is of second order: at p = 2 the energy of a
//! hexahedron is a third off, on simplices up to 70 %. It stays as an option. The default, Gauss–Lobatto with p + 2 points on hexahedra and
//! along prisms and collapsed Gauss–Jacobi with p + 2 points a direction on triangles and tetrahedra, is more accurate with fewer points.
//! Collapsed rules have no points on the boundary, where det J fails first, so they come with check points there.

use super::dual::Dual;
use super::kernels::jacobi;
use super::tables::{Factor, Grid};
use crate::mesh::CellShape;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Families of rules.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Rule {
    /// Gauss–Lobatto and collapsed Gauss–Jacobi.
    #[default]
    Gauss,
    /// The paper's: 2p − 1 equally spaced samples a dimension, 2 at order 1.
    Trapezoid,
}

/// Points and weights for the integral over a reference cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Quadrature {
    /// The points.
    pub grid: Grid,
    /// `[points]`, in the order of the grid; their sum is the volume of the reference cell: 1, ½ or ⅙.
    pub weights: Vec<f64>,
    /// Further points, where det J must be positive too: vertices, edges and faces that the rule leaves out.
    pub checks: Option<Grid>,
}

impl Quadrature {
    /// The rule for elements of a shape and an order.
    pub fn new(rule: Rule, shape: CellShape, order: usize) -> Self {
        let line = match rule {
            Rule::Gauss => gauss_lobatto(order + 2),
            Rule::Trapezoid => trapezoid_line(trapezoid_intervals(order)),
        };
        let (points, line_weights): (Vec<f64>, Vec<f64>) = line.into_iter().unzip();
        let line = Factor::Line(points);
        match shape {
            CellShape::Hexahedron => Self {
                grid: Grid {
                    factors: vec![line.clone(), line.clone(), line],
                },
                weights: outer(&outer(&line_weights, &line_weights), &line_weights),
                checks: None,
            },
            CellShape::Prism => {
                let (points, weights) = triangle(rule, order);
                let checks = (rule == Rule::Gauss).then(|| Grid {
                    factors: vec![triangle_boundary(order + 1), line.clone()],
                });
                Self {
                    grid: Grid {
                        factors: vec![Factor::Triangle(points), line],
                    },
                    weights: outer(&weights, &line_weights),
                    checks,
                }
            }
            CellShape::Tetrahedron => {
                let (points, weights) = tetrahedron(rule, order);
                let checks = (rule == Rule::Gauss).then(|| Grid {
                    factors: vec![tetrahedron_boundary(order + 1)],
                });
                Self {
                    grid: Grid {
                        factors: vec![Factor::Tetrahedron(points)],
                    },
                    weights,
                    checks,
                }
            }
        }
    }
}

/// The collapsed axes (s, t, r) of the default rule on tetrahedra of an order, as (point, weight): its points are
/// [`collapse`]`(s, t, r)` with s fastest, its weights the products.
pub fn collapsed_axes(order: usize) -> [Vec<(f64, f64)>; 3] {
    [0, 1, 2].map(|alpha| gauss_jacobi(order + 2, alpha))
}

/// u = (1−r)(1−t)s, v = (1−r)t, w = r: the unit cube onto the tetrahedron; with r = 0, the unit square onto the triangle.
pub fn collapse(s: f64, t: f64, r: f64) -> [f64; 3] {
    [(1.0 - r) * (1.0 - t) * s, (1.0 - r) * t, r]
}

/// Products of every pair, the first list fastest.
fn outer(a: &[f64], b: &[f64]) -> Vec<f64> {
    b.iter()
        .flat_map(|y| a.iter().map(move |x| x * y))
        .collect()
}

fn triangle(rule: Rule, order: usize) -> (Vec<[f64; 2]>, Vec<f64>) {
    match rule {
        Rule::Trapezoid => trapezoid_simplex(trapezoid_intervals(order), &[[0, 1], [1, 0]], 0.5),
        Rule::Gauss => gauss_jacobi(order + 2, 1)
            .into_iter()
            .flat_map(|(t, b)| {
                gauss_jacobi(order + 2, 0).into_iter().map(move |(s, a)| {
                    let [u, v, _] = collapse(s, t, 0.0);
                    ([u, v], a * b)
                })
            })
            .unzip(),
    }
}

fn tetrahedron(rule: Rule, order: usize) -> (Vec<[f64; 3]>, Vec<f64>) {
    let orders = [
        [0, 1, 2],
        [0, 2, 1],
        [1, 0, 2],
        [1, 2, 0],
        [2, 0, 1],
        [2, 1, 0],
    ];
    match rule {
        Rule::Trapezoid => trapezoid_simplex(trapezoid_intervals(order), &orders, 1.0 / 6.0),
        Rule::Gauss => {
            let [first, second, third] = collapsed_axes(order);
            let mut points = Vec::new();
            let mut weights = Vec::new();
            for &(r, c) in &third {
                for &(t, b) in &second {
                    for &(s, a) in &first {
                        points.push(collapse(s, t, r));
                        weights.push(a * b * c);
                    }
                }
            }
            (points, weights)
        }
    }
}

/// The points of a lattice that are on the boundary of the triangle.
fn triangle_boundary(n: usize) -> Factor {
    let point = |i: usize, j: usize| [i, j].map(|k| k as f64 / n as f64);
    let inside = |i: usize, j: usize| i > 0 && j > 0 && i + j < n;
    let all = (0..=n).flat_map(|j| (0..=n - j).map(move |i| (i, j)));
    let boundary = all.filter(|&(i, j)| !inside(i, j));
    Factor::Triangle(boundary.map(|(i, j)| point(i, j)).collect())
}

/// The points of a lattice that are on the boundary of the tetrahedron.
fn tetrahedron_boundary(n: usize) -> Factor {
    let inside = |u: &[usize; 3]| u.iter().all(|&k| k > 0) && u.iter().sum::<usize>() < n;
    let all = (0..=n)
        .flat_map(|k| (0..=n - k).flat_map(move |j| (0..=n - k - j).map(move |i| [i, j, k])));
    let boundary = all.filter(|u| !inside(u));
    Factor::Tetrahedron(boundary.map(|u| u.map(|k| k as f64 / n as f64)).collect())
}

/// Intervals of the paper's rule: one fewer than its samples.
fn trapezoid_intervals(order: usize) -> usize {
    (2 * order - 2).max(1)
}

/// (point, weight) of the composite trapezoidal rule with `n` intervals.
fn trapezoid_line(n: usize) -> Vec<(f64, f64)> {
    let step = 1.0 / n as f64;
    (0..=n)
        .map(|i| {
            let weight = if i == 0 || i == n { 0.5 * step } else { step };
            (i as f64 * step, weight)
        })
        .collect()
}

/// The integral of the piecewise linear interpolant over Kuhn's subdivision of a simplex of a volume, `n` intervals along an edge;
/// `orders` are all permutations of the axes.
///
/// In the sums x_1 = u_1, x_2 = u_1 + u_2 … the simplex is 0 ≤ x_1 ≤ x_2 … ≤ 1, a union of paths along the axes through lattice cubes.
fn trapezoid_simplex<const D: usize>(
    n: usize,
    orders: &[[usize; D]],
    volume: f64,
) -> (Vec<[f64; D]>, Vec<f64>) {
    let share = volume / (n.pow(D as u32) * (D + 1)) as f64;
    let mut weights: BTreeMap<[usize; D], f64> = BTreeMap::new();
    for cube in 0..n.pow(D as u32) {
        let corner: [usize; D] = std::array::from_fn(|k| cube / n.pow(k as u32) % n);
        for order in orders {
            let mut path = vec![corner];
            for &axis in order {
                let mut next = path[path.len() - 1];
                next[axis] += 1;
                path.push(next);
            }
            if path.iter().all(|x| x.is_sorted()) {
                for x in path {
                    *weights.entry(x).or_default() += share;
                }
            }
        }
    }
    let difference = |x: &[usize; D], k: usize| if k == 0 { x[0] } else { x[k] - x[k - 1] };
    weights
        .iter()
        .map(|(x, &w)| {
            let u = std::array::from_fn(|k| difference(x, k) as f64 / n as f64);
            (u, w)
        })
        .unzip()
}

/// (point, weight) of the Gauss–Lobatto rule with `n` ≥ 2 points on \[0, 1\], ends included: exact to degree 2n − 3.
pub fn gauss_lobatto(n: usize) -> Vec<(f64, f64)> {
    let mut nodes = vec![-1.0];
    nodes.extend(jacobi_roots(n - 2, 1, 1));
    nodes.push(1.0);
    // The roots are symmetric; make them so to the last bit.
    let symmetric = (0..n).map(|k| 0.5 * (nodes[k] - nodes[n - 1 - k]));
    symmetric
        .map(|x| {
            let p = jacobi::<0>(0, 0, n, Dual::constant(x), Dual::ONE)[n - 1].value;
            (0.5 * (1.0 + x), 1.0 / ((n * (n - 1)) as f64 * p * p))
        })
        .collect()
}

/// (point, weight) of the Gauss–Jacobi rule for ∫ f(x) (1 − x)^α dx over \[0, 1\]: exact to degree 2n − 1.
pub fn gauss_jacobi(n: usize, alpha: usize) -> Vec<(f64, f64)> {
    jacobi_roots(n, alpha, 0)
        .into_iter()
        .map(|x| {
            let slope =
                jacobi(alpha, 0, n + 1, Dual::<1>::coordinate(0, x), Dual::ONE)[n].gradient[0];
            (0.5 * (1.0 + x), 1.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

/// The roots of P_n^(α, β), ascending, by Newton's method on what is left after dividing by the roots already found.
fn jacobi_roots(n: usize, alpha: usize, beta: usize) -> Vec<f64> {
    let value = |x: f64| jacobi(alpha, beta, n + 1, Dual::<1>::coordinate(0, x), Dual::ONE)[n];
    let mut roots: Vec<f64> = Vec::with_capacity(n);
    for k in 0..n {
        let mut x = -((2 * k + 1) as f64 / (2 * n) as f64 * PI).cos();
        if let Some(last) = roots.last() {
            x = 0.5 * (x + last);
        }
        // Quadratic from here: 10 steps reach rounding, the rest cost nothing.
        for _ in 0..50 {
            let p = value(x);
            let others: f64 = roots.iter().map(|r| 1.0 / (x - r)).sum();
            let step = p.value / (p.gradient[0] - p.value * others);
            x -= step;
            if step.abs() < 1e-16 {
                break;
            }
        }
        roots.push(x);
    }
    roots
}
