//! L-BFGS and its line search. Knows nothing but a closure that returns a value and a gradient.

mod lbfgs;
mod line_search;

pub use lbfgs::{Iterate, Lbfgs, Minimum, Stop};
