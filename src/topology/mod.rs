//! Edits of connectivity: cleaning, contraction, simplification, splits, flips. Every edit leaves a valid mesh or none.

mod clean;
mod complex;
mod fill;
pub mod flip;
mod handles;
mod manifold;
mod orient;
mod quadric;
mod queue;
pub mod simplify;
pub mod split;

pub use clean::cleaned;
pub use fill::{Holes, fill_holes};
pub use flip::{Flip, flip_for_angles, flip_for_colors, flip_for_valence};
pub use handles::cut_handles;
pub use manifold::{Manifold, manifold};
pub use orient::oriented;
pub use simplify::{Simplified, Target, simplify, simplify_evenly};
pub use split::{Split, split};
