//! The recipes: how energies, models and minimizers are put together into a fit.
//!
//! [`fit`] runs Voronoi squared distance minimization from coarse to fine (`voronoi`), then a least-squares polish
//! (`polish`, on `least_squares`), and judges the result with code that the fit does not use ([`crate::measure`]).

mod least_squares;
mod polish;
mod start;
mod target;
mod voronoi;

pub use start::Template;
pub use target::{Place, Samples, Target, TargetPoint};
pub use voronoi::{Fit, Iteration, Options, Start, StopReason, fit};
