//! Terms of the objective on the host. (The two Voronoi terms are one kernel: [`crate::kernel::vsdm`].)

mod smoothness;

pub use smoothness::{Smoothness, laplacian};
