//! Modes at sample points, factored as the shape is: three lines, a triangle and a line, or a tetrahedron.
//!
//! A sum over all modes at all points is then a product with one small matrix after the other (sum factorization):
//! O(p⁴) on a hexahedron where the plain sum takes O(p⁶).

use super::dual::Dual;
use super::{Basis, kernels, mode_count, simplex, triangle_mode_count};
use crate::mesh::CellShape;
use glam::{DMat3, DVec3};

/// Sample points in one factor of a reference cell.
#[derive(Debug, Clone, PartialEq)]
pub enum Factor {
    /// In \[0, 1\].
    Line(Vec<f64>),
    /// (u, v) with u, v ≥ 0, u + v ≤ 1.
    Triangle(Vec<[f64; 2]>),
    /// (u, v, w) ≥ 0 with u + v + w ≤ 1.
    Tetrahedron(Vec<[f64; 3]>),
}

impl Factor {
    /// The number of points.
    pub fn len(&self) -> usize {
        match self {
            Self::Line(points) => points.len(),
            Self::Triangle(points) => points.len(),
            Self::Tetrahedron(points) => points.len(),
        }
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn coordinates(&self, point: usize) -> &[f64] {
        match self {
            Self::Line(points) => std::slice::from_ref(&points[point]),
            Self::Triangle(points) => &points[point],
            Self::Tetrahedron(points) => &points[point],
        }
    }
}

/// Sample points of a reference cell as a product of factors, points of the first factor fastest: three lines for a hexahedron, a triangle
/// and a line for a prism, a tetrahedron.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// In the order of the coordinates.
    pub factors: Vec<Factor>,
}

impl Grid {
    /// Equally spaced points, `n` intervals along an edge: `n + 1` points in a row, those on the boundary included.
    pub fn lattice(shape: CellShape, n: usize) -> Self {
        let step = 1.0 / n as f64;
        let at = |i: usize| if i == n { 1.0 } else { i as f64 * step };
        let line = Factor::Line((0..=n).map(at).collect());
        let factors = match shape {
            CellShape::Hexahedron => vec![line.clone(), line.clone(), line],
            CellShape::Prism => {
                let points = (0..=n).flat_map(|j| (0..=n - j).map(move |i| [i, j].map(at)));
                vec![Factor::Triangle(points.collect()), line]
            }
            CellShape::Tetrahedron => {
                let points = (0..=n).flat_map(|k| {
                    (0..=n - k).flat_map(move |j| (0..=n - k - j).map(move |i| [i, j, k].map(at)))
                });
                vec![Factor::Tetrahedron(points.collect())]
            }
        };
        Self { factors }
    }

    /// A single point.
    pub fn point(shape: CellShape, u: DVec3) -> Self {
        let line = |x| Factor::Line(vec![x]);
        let factors = match shape {
            CellShape::Hexahedron => vec![line(u.x), line(u.y), line(u.z)],
            CellShape::Prism => vec![Factor::Triangle(vec![[u.x, u.y]]), line(u.z)],
            CellShape::Tetrahedron => vec![Factor::Tetrahedron(vec![u.to_array()])],
        };
        Self { factors }
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.factors.iter().map(Factor::len).product()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The reference coordinates of every point.
    pub fn points(&self) -> Vec<DVec3> {
        (0..self.len())
            .map(|mut k| {
                let mut u = [0.0; 3];
                let mut first = 0;
                for factor in &self.factors {
                    let x = factor.coordinates(k % factor.len());
                    u[first..first + x.len()].copy_from_slice(x);
                    first += x.len();
                    k /= factor.len();
                }
                DVec3::from_array(u)
            })
            .collect()
    }
}

/// Modes of one factor at its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// The number of modes.
    pub modes: usize,
    /// `[points, modes]`.
    pub values: Vec<f64>,
    /// A derivative by each coordinate of the factor, each `[points, modes]`.
    pub derivatives: Vec<Vec<f64>>,
}

impl Table {
    /// The modes of a line, a triangle or a tetrahedron of an order, at points.
    pub fn new(basis: Basis, order: usize, factor: &Factor) -> Self {
        match factor {
            Factor::Line(points) => Self::collect(order + 1, points, |&x| {
                let pair =
                    |[value, slope]: [f64; 2]| Dual::<1>::coordinate(0, 0.0).chain(value, slope);
                kernels::axis(basis, order, x)
                    .into_iter()
                    .map(pair)
                    .collect()
            }),
            Factor::Triangle(points) => Self::collect(triangle_mode_count(order), points, |u| {
                let [b, c] = [0, 1].map(|k| Dual::<2>::coordinate(k, u[k]));
                simplex::triangle(basis, order, [Dual::ONE - b - c, b, c])
            }),
            Factor::Tetrahedron(points) => {
                Self::collect(mode_count(CellShape::Tetrahedron, order), points, |u| {
                    let [b, c, d] = [0, 1, 2].map(|k| Dual::<3>::coordinate(k, u[k]));
                    simplex::tetrahedron(basis, order, [Dual::ONE - b - c - d, b, c, d])
                })
            }
        }
    }

    fn collect<P, const N: usize>(
        count: usize,
        points: &[P],
        modes: impl Fn(&P) -> Vec<Dual<N>>,
    ) -> Self {
        let mut table = Self {
            modes: count,
            values: Vec::with_capacity(points.len() * count),
            derivatives: vec![Vec::new(); N],
        };
        for point in points {
            let modes = modes(point);
            table.values.extend(modes.iter().map(|m| m.value));
            for (k, derivative) in table.derivatives.iter_mut().enumerate() {
                derivative.extend(modes.iter().map(|m| m.gradient[k]));
            }
        }
        table
    }
}

/// The local modes of a cell at the points of a [`Grid`], a [`Table`] a factor.
#[derive(Debug, Clone, PartialEq)]
pub struct Tables {
    /// In the order of the grid's factors.
    pub factors: Vec<Table>,
}

impl Tables {
    /// The modes of an order at the points of a grid.
    pub fn new(basis: Basis, order: usize, grid: &Grid) -> Self {
        let table = |factor| Table::new(basis, order, factor);
        Self {
            factors: grid.factors.iter().map(table).collect(),
        }
    }

    /// h at every point of the grid, from the coefficients of the local modes.
    pub fn positions(&self, coefficients: &[DVec3]) -> Vec<DVec3> {
        let values: Vec<_> = self.factors.iter().map(|t| t.values.as_slice()).collect();
        self.contract(&values, coefficients)
    }

    /// ∇h at every point of the grid, the derivatives by u, v and w in its columns.
    pub fn gradients(&self, coefficients: &[DVec3]) -> Vec<DMat3> {
        let mut columns = Vec::with_capacity(3);
        for (owner, table) in self.factors.iter().enumerate() {
            for derivative in &table.derivatives {
                let mut factors: Vec<_> =
                    self.factors.iter().map(|t| t.values.as_slice()).collect();
                factors[owner] = derivative;
                columns.push(self.contract(&factors, coefficients));
            }
        }
        (0..columns[0].len())
            .map(|k| DMat3::from_cols(columns[0][k], columns[1][k], columns[2][k]))
            .collect()
    }

    /// The weight of every local mode in h, at a point of the grid.
    pub fn row(&self, point: usize) -> Vec<f64> {
        let mut point = point;
        let mut row = vec![1.0];
        for table in &self.factors {
            let points = table.values.len() / table.modes;
            let start = point % points * table.modes;
            let values = &table.values[start..start + table.modes];
            row = values
                .iter()
                .flat_map(|v| row.iter().map(move |r| r * v))
                .collect();
            point /= points;
        }
        row
    }

    /// Applies the `[points, modes]` matrix of each factor in turn.
    fn contract(&self, matrices: &[&[f64]], coefficients: &[DVec3]) -> Vec<DVec3> {
        let mut array = coefficients.to_vec();
        let mut inner = 1;
        for (table, matrix) in self.factors.iter().zip(matrices) {
            let rows = matrix.chunks_exact(table.modes);
            let mut product = Vec::with_capacity(array.len() / table.modes * rows.len());
            for block in array.chunks_exact(table.modes * inner) {
                for row in rows.clone() {
                    let first = product.len();
                    product.resize(first + inner, DVec3::ZERO);
                    let sums = &mut product[first..];
                    for (&weight, line) in row.iter().zip(block.chunks_exact(inner)) {
                        sums.iter_mut()
                            .zip(line)
                            .for_each(|(s, &x)| *s += weight * x);
                    }
                }
            }
            array = product;
            inner *= rows.len();
        }
        array
    }
}
