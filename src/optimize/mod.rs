//! L-BFGS and its line search, which know nothing but a closure that returns a value and a gradient; sparse factors for what
//! the caller knows of the curvature.

pub mod cholesky;
mod lbfgs;
mod line_search;
pub(crate) mod vectors;

pub use lbfgs::{Curvature, Iterate, Lbfgs, Minimum, Stop};
