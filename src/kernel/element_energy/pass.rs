//! From coefficients to derivatives at all points and back, [`LANES`](super::contraction::LANES) elements side by side.

use super::contraction::{Matrix, Node, ZERO};
use super::tables::{Collapsed, Factors, Samples};

/// Points of a slab where nothing factors.
const DENSE_SLAB: usize = 64;

/// Told of a slab: its first point, and the derivatives by u, v and w at its points.
pub(crate) type Visitor<'a> = dyn FnMut(usize, [&mut [Node]; 3]) + 'a;

/// Room for what lies between the ends, kept from call to call.
#[derive(Debug, Default)]
pub(crate) struct Scratch(Vec<Node>);

/// The matrices of [`Factors`], ready for use.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Pass {
    Hexahedron(Line),
    Prism(Triangle, Line),
    Dense(Vec<[Pair; 3]>),
    Collapsed(CollapsedPass),
}

/// A matrix and its transpose.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pair {
    forward: Matrix,
    back: Matrix,
}

/// Functions of one coordinate.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Line {
    values: Pair,
    derivatives: Pair,
    /// For each point the value above the derivative, `[2, modes]`.
    at: Vec<Pair>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Triangle {
    values: Pair,
    derivatives: [Pair; 2],
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct CollapsedPass {
    matrix: Pair,
    first: Line,
    second: Vec<Line>,
    third: Vec<Line>,
    /// For each r, `[s, t]` with t fastest: what takes derivatives by (s, t, r) to those by (u, v, w).
    metrics: Vec<Vec<Metric>>,
}

/// ∂_u = a ∂_s, ∂_v = s a ∂_s + b ∂_t, ∂_w = s a ∂_s + t b ∂_t + ∂_r, with b = 1/(1−r) and a = b/(1−t).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Metric {
    a: f64,
    sa: f64,
    b: f64,
    tb: f64,
}

impl Scratch {
    /// Arrays of some lengths; what is in them is left from before.
    fn parts<const N: usize>(&mut self, lengths: [usize; N]) -> [&mut [Node]; N] {
        let total = lengths.iter().sum();
        if self.0.len() < total {
            self.0.resize(total, ZERO);
        }
        let mut rest = self.0.as_mut_slice();
        lengths.map(|length| {
            let (part, others) = std::mem::take(&mut rest).split_at_mut(length);
            rest = others;
            part
        })
    }
}

impl Pair {
    fn new(columns: usize, entries: &[f64]) -> Self {
        Self {
            forward: Matrix::from_rows(columns, entries),
            back: Matrix::transposed(columns, entries),
        }
    }
}

impl Line {
    fn new(samples: &Samples) -> Self {
        let n = samples.modes;
        let (values, derivatives) = (&samples.values, &samples.derivatives[0]);
        let rows = values.chunks_exact(n).zip(derivatives.chunks_exact(n));
        Self {
            values: Pair::new(n, values),
            derivatives: Pair::new(n, derivatives),
            at: rows
                .map(|(value, slope)| Pair::new(n, &[value, slope].concat()))
                .collect(),
        }
    }

    fn points(&self) -> usize {
        self.at.len()
    }

    fn modes(&self) -> usize {
        self.values.back.rows()
    }
}

impl Pass {
    pub(super) fn new(factors: &Factors) -> Self {
        match factors {
            Factors::Hexahedron(line) => Self::Hexahedron(Line::new(line)),
            Factors::Prism(triangle, line) => {
                let pair = |entries| Pair::new(triangle.modes, entries);
                let triangle = Triangle {
                    values: pair(&triangle.values),
                    derivatives: [0, 1].map(|k| pair(&triangle.derivatives[k])),
                };
                Self::Prism(triangle, Line::new(line))
            }
            Factors::Dense(samples) => {
                let n = samples.modes;
                let slab = DENSE_SLAB * n;
                let [u, v, w] = [0, 1, 2].map(|k| samples.derivatives[k].chunks(slab));
                let slabs = u.zip(v).zip(w);
                Self::Dense(
                    slabs
                        .map(|((u, v), w)| [u, v, w].map(|entries| Pair::new(n, entries)))
                        .collect(),
                )
            }
            Factors::Collapsed(collapsed) => Self::Collapsed(CollapsedPass::new(collapsed)),
        }
    }

    pub(super) fn traverse(
        &self,
        coefficients: &[Node],
        mut gradient: Option<&mut [Node]>,
        scratch: &mut Scratch,
        visit: &mut Visitor<'_>,
    ) {
        match self {
            Self::Hexahedron(line) => hexahedron(line, coefficients, gradient, scratch, visit),
            Self::Prism(triangle, line) => {
                prism(triangle, line, coefficients, gradient, scratch, visit);
            }
            Self::Dense(slabs) => {
                for (k, slab) in slabs.iter().enumerate() {
                    let points = slab[0].forward.rows();
                    let mut derivatives = scratch.parts([points; 3]);
                    for (pair, derivative) in slab.iter().zip(&mut derivatives) {
                        pair.forward.apply(coefficients, 1, derivative);
                    }
                    visit(k * DENSE_SLAB, derivatives.each_mut().map(|d| &mut **d));
                    if let Some(gradient) = &mut gradient {
                        for (pair, derivative) in slab.iter().zip(&derivatives) {
                            pair.back.add(derivative, 1, gradient);
                        }
                    }
                }
            }
            Self::Collapsed(pass) => pass.traverse(coefficients, gradient, scratch, visit),
        }
    }
}

fn hexahedron(
    line: &Line,
    coefficients: &[Node],
    mut gradient: Option<&mut [Node]>,
    scratch: &mut Scratch,
    visit: &mut Visitor<'_>,
) {
    let (n, q) = (line.modes(), line.points());
    let (values, slopes) = (&line.values, &line.derivatives);
    // In the names of what follows, a letter for each axis done: the value or the slope along z, along y.
    let [planes, vv, vs, sv, x, y, z] =
        scratch.parts([2 * n * n, q * n, q * n, q * n, q * q, q * q, q * q]);
    for (k, at) in line.at.iter().enumerate() {
        at.forward.apply(coefficients, n * n, planes);
        let (value, slope) = planes.split_at_mut(n * n);
        values.forward.apply(value, n, vv);
        slopes.forward.apply(value, n, vs);
        values.forward.apply(slope, n, sv);
        for row in 0..q {
            let (modes, points) = (row * n, row * q);
            slopes.forward.apply(&vv[modes..], 1, &mut x[points..]);
            values.forward.apply(&vs[modes..], 1, &mut y[points..]);
            values.forward.apply(&sv[modes..], 1, &mut z[points..]);
        }
        visit(k * q * q, [&mut *x, &mut *y, &mut *z]);
        let Some(gradient) = &mut gradient else {
            continue;
        };
        for row in 0..q {
            let (modes, points) = (row * n, row * q);
            slopes.back.apply(&x[points..], 1, &mut vv[modes..]);
            values.back.apply(&y[points..], 1, &mut vs[modes..]);
            values.back.apply(&z[points..], 1, &mut sv[modes..]);
        }
        values.back.apply(vv, n, value);
        slopes.back.add(vs, n, value);
        values.back.apply(sv, n, slope);
        at.back.add(planes, n * n, gradient);
    }
}

fn prism(
    triangle: &Triangle,
    line: &Line,
    coefficients: &[Node],
    mut gradient: Option<&mut [Node]>,
    scratch: &mut Scratch,
    visit: &mut Visitor<'_>,
) {
    let (n, q) = (triangle.values.back.rows(), triangle.values.forward.rows());
    let [du, dv] = &triangle.derivatives;
    let [planes, u, v, w] = scratch.parts([2 * n, q, q, q]);
    for (k, at) in line.at.iter().enumerate() {
        at.forward.apply(coefficients, n, planes);
        let (value, slope) = planes.split_at_mut(n);
        du.forward.apply(value, 1, u);
        dv.forward.apply(value, 1, v);
        triangle.values.forward.apply(slope, 1, w);
        visit(k * q, [&mut *u, &mut *v, &mut *w]);
        if let Some(gradient) = &mut gradient {
            du.back.apply(u, 1, value);
            dv.back.add(v, 1, value);
            triangle.values.back.apply(w, 1, slope);
            at.back.add(planes, n, gradient);
        }
    }
}

impl CollapsedPass {
    fn new(collapsed: &Collapsed) -> Self {
        let [s, t, r] = &collapsed.axes;
        let lines = |family: &[Samples]| family.iter().map(Line::new).collect();
        let metric = |s: f64, t: f64, r: f64| {
            let b = 1.0 / (1.0 - r);
            let a = b / (1.0 - t);
            Metric {
                a,
                sa: s * a,
                b,
                tb: t * b,
            }
        };
        let slab = |&r: &f64| {
            s.iter()
                .flat_map(|&s| t.iter().map(move |&t| metric(s, t, r)))
                .collect()
        };
        let count = collapsed.first.modes;
        Self {
            matrix: Pair::new(count * (count + 1) * (count + 2) / 6, &collapsed.matrix),
            first: Line::new(&collapsed.first),
            second: lines(&collapsed.second),
            third: lines(&collapsed.third),
            metrics: r.iter().map(slab).collect(),
        }
    }

    /// Points of a slab have t fastest.
    fn traverse(
        &self,
        coefficients: &[Node],
        gradient: Option<&mut [Node]>,
        scratch: &mut Scratch,
        visit: &mut Visitor<'_>,
    ) {
        let count = self.first.modes();
        let (points_s, points_t) = (self.first.points(), self.second[0].points());
        let (total, pairs) = (self.matrix.forward.rows(), count * (count + 1) / 2);
        let (rows, slab) = (count * points_t, points_s * points_t);
        let lengths = [
            total, total, 2, pairs, pairs, rows, rows, rows, slab, slab, slab,
        ];
        let [psi, back, both, value, slope, vv, vs, sv, u, v, w] = scratch.parts(lengths);
        self.matrix.forward.apply(coefficients, 1, psi);
        back.fill(ZERO);
        for (k, metrics) in self.metrics.iter().enumerate() {
            for (pair, (line, modes)) in self.columns().enumerate() {
                line.at[k].forward.apply(&psi[modes..], 1, both);
                (value[pair], slope[pair]) = (both[0], both[1]);
            }
            for (i, line, first) in self.rows() {
                let points = i * points_t;
                line.values
                    .forward
                    .apply(&value[first..], 1, &mut vv[points..]);
                line.derivatives
                    .forward
                    .apply(&value[first..], 1, &mut vs[points..]);
                line.values
                    .forward
                    .apply(&slope[first..], 1, &mut sv[points..]);
            }
            self.first.derivatives.forward.apply(vv, points_t, u);
            self.first.values.forward.apply(vs, points_t, v);
            self.first.values.forward.apply(sv, points_t, w);
            for (p, metric) in metrics.iter().enumerate() {
                metric.forward(&mut u[p], &mut v[p], &mut w[p]);
            }
            visit(k * slab, [&mut *u, &mut *v, &mut *w]);
            if gradient.is_none() {
                continue;
            }
            for (p, metric) in metrics.iter().enumerate() {
                metric.back(&mut u[p], &mut v[p], &mut w[p]);
            }
            self.first.derivatives.back.apply(u, points_t, vv);
            self.first.values.back.apply(v, points_t, vs);
            self.first.values.back.apply(w, points_t, sv);
            for (i, line, first) in self.rows() {
                let points = i * points_t;
                line.values
                    .back
                    .apply(&vv[points..], 1, &mut value[first..]);
                line.derivatives
                    .back
                    .add(&vs[points..], 1, &mut value[first..]);
                line.values
                    .back
                    .apply(&sv[points..], 1, &mut slope[first..]);
            }
            for (pair, (line, modes)) in self.columns().enumerate() {
                (both[0], both[1]) = (value[pair], slope[pair]);
                line.at[k].back.add(both, 1, &mut back[modes..]);
            }
        }
        if let Some(gradient) = gradient {
            self.matrix.back.add(back, 1, gradient);
        }
    }

    /// For each pair (i, j) the functions of r and the first of their coefficients.
    fn columns(&self) -> impl Iterator<Item = (&Line, usize)> {
        let count = self.first.modes();
        let mut first = 0;
        (0..count).flat_map(move |i| i..count).map(move |l| {
            let at = first;
            first += count - l;
            (&self.third[l], at)
        })
    }

    /// For each i: i, the functions of t, and the first of its pairs.
    fn rows(&self) -> impl Iterator<Item = (usize, &Line, usize)> {
        let count = self.first.modes();
        (0..count)
            .zip(&self.second)
            .map(move |(i, line)| (i, line, i * count - i * i.saturating_sub(1) / 2))
    }
}

impl Metric {
    fn forward(self, u: &mut Node, v: &mut Node, w: &mut Node) {
        for ((u, v), w) in u.iter_mut().zip(v).zip(w) {
            let (s, t, r) = (*u, *v, *w);
            *u = self.a * s;
            *v = self.sa * s + self.b * t;
            *w = self.sa * s + self.tb * t + r;
        }
    }

    /// Its transpose.
    fn back(self, u: &mut Node, v: &mut Node, w: &mut Node) {
        for ((u, v), w) in u.iter_mut().zip(v).zip(w) {
            *u = self.a * *u + self.sa * (*v + *w);
            *v = self.b * *v + self.tb * *w;
        }
    }
}
