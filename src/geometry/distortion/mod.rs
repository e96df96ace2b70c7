//! Densities ε(J) of distortion: how far the Jacobian matrix J of a map is from an ideal one.
//!
//! A density is a function of J alone; what integrates it (`kernel::element_energy`) knows only [`Distortion`]. Each is one short file that
//! gives ε and ∂ε/∂J for one matrix or a block of them, written without branches and closures so that blocks vectorize, and one short file
//! `shaders/shared/distortion_*.wgsl` that does the same in f32. A new one is those two and a line in [`Distortion`].
//!
//! All are infinite in the limit det J → 0⁺ (barriers); callers test the determinant, which a block reports, and take ε as infinite
//! where it is not positive: what stands in ε and its gradient there is of no use. None changes under rotations of J from either side.

mod condition_number;
mod dirichlet;
mod mean_ratio;
pub mod strain;
#[cfg(test)]
mod tests;

use super::vector::{Arithmetic, Work, fastest};
use glam::DMat3;

/// A density of distortion. Values are 0 at rotations; the rigid ones agree with [`Strain`](Self::Strain) to second order there, so that one
/// weight suits both.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum Distortion {
    /// ½ ‖½ ln JᵀJ‖², the logarithmic (Hencky) strain \[PPL13, section 3.1\]: rigid. The default.
    #[default]
    Strain,
    /// ½ ‖dev ½ ln JᵀJ‖²: the same without its part of a uniform scale, so conformal. \[PPL13, figure 2\] shows what such metrics do.
    Conformal,
    /// (‖J‖² + ‖J⁻¹‖² − 6)/8, the symmetric Dirichlet energy: rigid.
    SymmetricDirichlet,
    /// ‖J‖ ‖J⁻¹‖/3 − 1, the condition number \[FK99\]: conformal.
    ConditionNumber,
    /// ‖J‖²/(3 det^⅔ J) − 1, the inverse mean ratio \[TRBS98\]: conformal.
    MeanRatio,
}

/// A density at one matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pointwise {
    /// ε.
    pub value: f64,
    /// ∂ε/∂J.
    pub gradient: DMat3,
    /// det J; value and gradient hold only where it is positive.
    pub determinant: f64,
}

/// Matrices side by side. Entry `3 column + row` of the k-th one is at `[3 column + row][k]`.
#[derive(Debug, Clone)]
pub struct Block<const N: usize> {
    /// J.
    pub jacobian: [[f64; N]; 9],
    /// ε(J).
    pub value: [f64; N],
    /// ∂ε/∂J.
    pub gradient: [[f64; N]; 9],
    /// det J.
    pub determinant: [f64; N],
}

/// Three columns.
type Matrix = [[f64; 3]; 3];

impl Distortion {
    /// All of them, the default first.
    pub const ALL: [Self; 5] = [
        Self::Strain,
        Self::Conformal,
        Self::SymmetricDirichlet,
        Self::ConditionNumber,
        Self::MeanRatio,
    ];

    /// The name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Strain => "strain",
            Self::Conformal => "conformal",
            Self::SymmetricDirichlet => "symmetric-dirichlet",
            Self::ConditionNumber => "condition-number",
            Self::MeanRatio => "mean-ratio",
        }
    }

    /// ε and ∂ε/∂J.
    pub fn evaluate(self, jacobian: DMat3) -> Pointwise {
        let mut block = Block::<1> {
            jacobian: jacobian.to_cols_array().map(|x| [x]),
            ..Block::default()
        };
        self.evaluate_block(&mut block);
        Pointwise {
            value: block.value[0],
            gradient: DMat3::from_cols_array(&block.gradient.map(|[x]| x)),
            determinant: block.determinant[0],
        }
    }

    /// Fills in all that follows from the matrices of a block.
    pub fn evaluate_block<const N: usize>(self, block: &mut Block<N>) {
        fastest(Evaluation {
            distortion: self,
            block,
        });
    }

    /// The same, inlined into a loop that is itself [`Work`].
    #[inline(always)]
    pub fn evaluate_with<A: Arithmetic, const N: usize>(self, block: &mut Block<N>) {
        block.determinants::<A>();
        match self {
            Self::Strain => strain::evaluate::<A, N>(block, strain::Part::Whole),
            Self::Conformal => strain::evaluate::<A, N>(block, strain::Part::Deviatoric),
            Self::SymmetricDirichlet => block.each(dirichlet::evaluate::<A>),
            Self::ConditionNumber => block.each(condition_number::evaluate::<A>),
            Self::MeanRatio => block.each(mean_ratio::evaluate::<A>),
        }
    }
}

struct Evaluation<'a, const N: usize> {
    distortion: Distortion,
    block: &'a mut Block<N>,
}

impl<const N: usize> Work for Evaluation<'_, N> {
    #[inline(always)]
    fn run<A: Arithmetic>(self) {
        self.distortion.evaluate_with::<A, N>(self.block);
    }
}

impl<const N: usize> Default for Block<N> {
    fn default() -> Self {
        Self {
            jacobian: [[0.0; N]; 9],
            value: [0.0; N],
            gradient: [[0.0; N]; 9],
            determinant: [0.0; N],
        }
    }
}

impl<const N: usize> Block<N> {
    /// Fills in the determinants only.
    #[inline(always)]
    pub fn determinants<A: Arithmetic>(&mut self) {
        for k in 0..N {
            let [a, b, c] = matrix(&self.jacobian, k);
            self.determinant[k] = dot::<A>(cross::<A>(a, b), c);
        }
    }

    /// Applies a density that needs no more than a matrix, its cofactors ∂det J/∂J and its determinant.
    #[inline(always)]
    fn each(&mut self, density: impl Fn(Matrix, Matrix, f64) -> (f64, Matrix)) {
        for k in 0..N {
            let j = matrix(&self.jacobian, k);
            let (value, gradient) = density(j, cofactors(j), self.determinant[k]);
            self.value[k] = value;
            set_matrix(&mut self.gradient, k, gradient);
        }
    }
}

/// ∂det J/∂J = det J · J⁻ᵀ.
#[inline(always)]
pub fn cofactors([a, b, c]: Matrix) -> Matrix {
    use super::vector::Separate;
    [
        cross::<Separate>(b, c),
        cross::<Separate>(c, a),
        cross::<Separate>(a, b),
    ]
}

#[inline(always)]
fn matrix<const N: usize>(entries: &[[f64; N]; 9], k: usize) -> Matrix {
    let column = |c: usize| [entries[c][k], entries[c + 1][k], entries[c + 2][k]];
    [column(0), column(3), column(6)]
}

#[inline(always)]
fn set_matrix<const N: usize>(entries: &mut [[f64; N]; 9], k: usize, m: Matrix) {
    for (c, column) in m.into_iter().enumerate() {
        for (r, x) in column.into_iter().enumerate() {
            entries[3 * c + r][k] = x;
        }
    }
}

#[inline(always)]
fn dot<A: Arithmetic>(a: [f64; 3], b: [f64; 3]) -> f64 {
    A::mul_add(a[0], b[0], A::mul_add(a[1], b[1], a[2] * b[2]))
}

#[inline(always)]
fn cross<A: Arithmetic>(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        A::mul_add(a[1], b[2], -(a[2] * b[1])),
        A::mul_add(a[2], b[0], -(a[0] * b[2])),
        A::mul_add(a[0], b[1], -(a[1] * b[0])),
    ]
}

/// ‖m‖².
#[inline(always)]
fn norm_squared<A: Arithmetic>(m: Matrix) -> f64 {
    dot::<A>(m[0], m[0]) + dot::<A>(m[1], m[1]) + dot::<A>(m[2], m[2])
}

/// x a + y b.
#[inline(always)]
fn combine<A: Arithmetic>(x: f64, a: Matrix, y: f64, b: Matrix) -> Matrix {
    let mut sum = b;
    for c in 0..3 {
        for r in 0..3 {
            sum[c][r] = A::mul_add(x, a[c][r], y * b[c][r]);
        }
    }
    sum
}

/// From C = cof J: C CᵀC = det³ J⁻ᵀ J⁻¹ J⁻ᵀ, the gradient of ‖J⁻¹‖² up to the factor −2/det³.
#[inline(always)]
fn cube<A: Arithmetic>(c: Matrix) -> Matrix {
    // Column j of C (CᵀC) is Σ_i c_i (c_i · c_j).
    let mut product = [[0.0; 3]; 3];
    for (j, column) in product.iter_mut().enumerate() {
        for column_of_c in c {
            let weight = dot::<A>(column_of_c, c[j]);
            for r in 0..3 {
                column[r] = A::mul_add(weight, column_of_c[r], column[r]);
            }
        }
    }
    product
}
