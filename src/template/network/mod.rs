//! Networks: control meshes of triangles whose points are chosen on the target, of the target's own topology \[MKJK15: X. Ma, S. Keates, Y. Jiang,
//! J. Kosinka, *Subdivision surface fitting to a dense mesh using ridges and umbilics*, 2015\].
//!
//! **Theory.** Every vertex of the target goes to the site that is nearest along its edges (`fire`); where three cells meet is a triangle (`dual`). More sites
//! are added until that makes a manifold with the target's genus and boundaries: the paper takes it for one.
//!
//! **Practice.** [`ridges`] takes the paper's sites, features of the surface. [`adaptive`] spreads sites in a metric that follows curvature and then sets them where the
//! surface through them is off, in exchange for those that are missed least: at equal numbers, the better network but on parts with real edges.

mod adaptive;
mod dual;
mod errors;
mod fire;
mod ground;
mod ridges;

pub use adaptive::adaptive;
pub(super) use ground::halve_long_edges;
pub use ridges::ridges;
