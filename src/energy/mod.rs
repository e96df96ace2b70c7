//! Terms of the objective on the host. (The two Voronoi terms are one kernel: [`crate::kernel::vsdm`].)

mod barrier;
mod element_tables;
mod smoothness;

pub use barrier::{BernsteinBarrier, FLOOR, THRESHOLD};
pub use element_tables::element_tables;
pub use smoothness::{Smoothness, laplacian};
