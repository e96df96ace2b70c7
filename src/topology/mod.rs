//! Edits of connectivity: cleaning, contraction, simplification. Every edit leaves a valid mesh or none.

mod clean;
mod complex;
mod fill;
mod quadric;
mod queue;
pub mod simplify;

pub use clean::cleaned;
pub use fill::fill_holes;
pub use simplify::{Simplified, Target, simplify};
