//! Edits of connectivity: cleaning, contraction, simplification, splits, flips. Every edit leaves a valid mesh or none.

mod clean;
mod complex;
mod fill;
pub mod flip;
mod manifold;
mod quadric;
mod queue;
pub mod simplify;
pub mod split;

pub use clean::cleaned;
pub use fill::fill_holes;
pub use flip::{flip_for_angles, flip_for_valence};
pub use manifold::{Manifold, manifold};
pub use simplify::{Simplified, Target, simplify};
pub use split::{Split, split};
