//! vorofit fits subdivision and polygon surfaces to 3D scans by Voronoi squared distance minimization.
#![warn(missing_docs)]

pub mod error;
pub mod kernel;
pub mod mesh;
pub mod progress;

pub use error::{Error, Result};
