//! Meshes as flat arrays: polygons, triangles, control meshes; connectivity; door checks; the unit frame; generated shapes.

pub mod check;
pub mod connectivity;
pub mod frame;
mod polygon;
pub mod sample;
pub mod shapes;
mod triangle;
pub(crate) mod weld;

pub use connectivity::Connectivity;
pub use frame::Frame;
pub use polygon::{ControlMesh, Crease, PolygonMesh, Scheme};
pub use triangle::TriangleMesh;
pub use weld::weld;
