//! What an element's functions are at its quadrature points, factored as its shape allows, and the passes over all points.
//!
//! From coefficients to derivatives and back by one small matrix after the other: along z, y and x on a hexahedron, along the axis and over
//! the triangle on a prism, along the collapsed axes on a tetrahedron whose modes span the polynomials; one large matrix on a tetrahedron
//! otherwise. Points are visited slab by slab (the points of one z, of one w, of one r), so that what lies between the two ends fits in
//! the cache, or in the workgroup memory of a GPU.

use super::contraction::Node;
use super::pass::{Pass, Scratch, Visitor};
use crate::error::{Error, Result};

/// Functions and their derivatives at points.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// The number of functions.
    pub modes: usize,
    /// `[points, modes]`.
    pub values: Vec<f64>,
    /// By each coordinate, each `[points, modes]`.
    pub derivatives: Vec<Vec<f64>>,
}

/// Functions ψ_ijk = A_i(s) B_ij(t) C_(i+j)k(r), i + j + k ≤ p, of the collapsed coordinates (s, t, r) of a tetrahedron:
/// u = (1−r)(1−t)s, v = (1−r)t, w = r.
#[derive(Debug, Clone, PartialEq)]
pub struct Collapsed {
    /// The points of the axes.
    pub axes: [Vec<f64>; 3],
    /// A, `[points of s, p + 1]`.
    pub first: Samples,
    /// For each i: B_ij, `[points of t, p + 1 − i]`.
    pub second: Vec<Samples>,
    /// For each l = i + j: C_lk, `[points of r, p + 1 − l]`.
    pub third: Vec<Samples>,
    /// `[ψ, modes]`, ψ with k fastest and i slowest: the coefficients of the ψ from those of the element's modes.
    pub matrix: Vec<f64>,
}

/// How the modes of an element factor over a product of point sets.
#[derive(Debug, Clone, PartialEq)]
pub enum Factors {
    /// Products of the same functions along x, y and z; x is fastest among modes and points.
    Hexahedron(Samples),
    /// Functions of (u, v) times functions of w; those of (u, v) are fastest among modes and points.
    Prism(Samples, Samples),
    /// Nothing factors.
    Dense(Samples),
    /// Through an equivalent basis that factors; points have s fastest and r slowest.
    Collapsed(Collapsed),
}

/// A quadrature rule and the modes of one kind of element at its points.
#[derive(Debug, Clone, PartialEq)]
pub struct ElementTables {
    pub(super) factors: Factors,
    /// In the order of visits.
    pub(super) weights: Vec<f64>,
    pub(super) checks: Option<Box<ElementTables>>,
    modes: usize,
    pass: Pass,
}

impl ElementTables {
    /// From functions at points, `weights` `[points]` in the order of the points, which sum to the volume of the reference cell.
    /// `checks` are the same functions at further points where det J has to be positive; their weights are not used.
    ///
    /// # Errors
    /// Where the lengths of the arrays do not fit together.
    pub fn new(factors: Factors, weights: Vec<f64>, checks: Option<Self>) -> Result<Self> {
        let misfit = |what: &str| {
            Err(Error::input(
                format!("element tables: {what}"),
                "give arrays of the documented shapes",
            ))
        };
        let Some((modes, points)) = factors.size() else {
            return misfit("values and derivatives differ in number");
        };
        if weights.len() != points {
            return misfit("there must be a weight for each point");
        }
        if checks.as_ref().is_some_and(|c| c.modes != modes) {
            return misfit("the check points have other modes");
        }
        Ok(Self {
            pass: Pass::new(&factors),
            weights: factors.in_order_of_visits(weights),
            factors,
            checks: checks.map(Box::new),
            modes,
        })
    }

    /// The number of modes of an element.
    pub fn modes(&self) -> usize {
        self.modes
    }

    /// The number of points.
    pub fn points(&self) -> usize {
        self.weights.len()
    }

    /// ∇h of every lane, slab by slab: `visit` is given the first point of a slab and the derivatives by u, v and w at its points, each
    /// `[points of the slab]`. What it leaves in them is multiplied by the transpose and added to `gradient`, if there is one.
    pub(crate) fn traverse(
        &self,
        coefficients: &[Node],
        gradient: Option<&mut [Node]>,
        scratch: &mut Scratch,
        visit: &mut Visitor<'_>,
    ) {
        self.pass.traverse(coefficients, gradient, scratch, visit);
    }
}

impl Samples {
    /// The number of points.
    pub fn points(&self) -> usize {
        self.values.len() / self.modes.max(1)
    }

    /// Whether it has `dimensions` derivatives of the right length.
    fn is_whole(&self, dimensions: usize) -> bool {
        self.modes > 0
            && self.derivatives.len() == dimensions
            && self.values.len().is_multiple_of(self.modes)
            && self
                .derivatives
                .iter()
                .all(|d| d.len() == self.values.len())
    }
}

impl Factors {
    /// The numbers of modes and points, if all arrays fit together.
    fn size(&self) -> Option<(usize, usize)> {
        match self {
            Self::Hexahedron(line) => line
                .is_whole(1)
                .then(|| (line.modes.pow(3), line.points().pow(3))),
            Self::Prism(triangle, line) => (triangle.is_whole(2) && line.is_whole(1)).then(|| {
                (
                    triangle.modes * line.modes,
                    triangle.points() * line.points(),
                )
            }),
            Self::Dense(samples) => samples
                .is_whole(3)
                .then(|| (samples.modes, samples.points())),
            Self::Collapsed(collapsed) => collapsed.size(),
        }
    }
}

impl Factors {
    /// Whether a mode is that of a corner; these sum to 1, and the rest are displacements.
    pub(super) fn is_vertex(&self, mode: usize) -> bool {
        match self {
            Self::Hexahedron(line) => {
                let n = line.modes;
                mode % n < 2 && mode / n % n < 2 && mode / (n * n) < 2
            }
            Self::Prism(triangle, _) => mode % triangle.modes < 3 && mode / triangle.modes < 2,
            Self::Dense(_) | Self::Collapsed(_) => mode < 4,
        }
    }

    /// Weights in the order in which points are visited: with t fastest in collapsed coordinates.
    fn in_order_of_visits(&self, weights: Vec<f64>) -> Vec<f64> {
        let Self::Collapsed(collapsed) = self else {
            return weights;
        };
        let [s, t, _] = collapsed.axes.each_ref().map(Vec::len);
        let place = |k: usize| k / (s * t) * (s * t) + k % t * s + k / t % s;
        (0..weights.len()).map(|k| weights[place(k)]).collect()
    }
}

impl Collapsed {
    fn size(&self) -> Option<(usize, usize)> {
        let count = self.first.modes;
        let family = |members: &[Samples], points: usize| {
            members.len() == count
                && (0..count)
                    .zip(members)
                    .all(|(l, m)| m.is_whole(1) && m.modes == count - l && m.points() == points)
        };
        let modes = count * (count + 1) * (count + 2) / 6;
        let [s, t, r] = self.axes.each_ref().map(Vec::len);
        let whole = self.first.is_whole(1)
            && self.first.points() == s
            && family(&self.second, t)
            && family(&self.third, r)
            && self.matrix.len() == modes * modes;
        whole.then_some((modes, s * t * r))
    }
}
