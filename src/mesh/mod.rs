//! Meshes as flat arrays: polygons, triangles, control meshes; connectivity; door checks; the unit frame; generated shapes.

pub mod frame;
mod polygon;
mod triangle;

pub use frame::Frame;
pub use polygon::{ControlMesh, Crease, PolygonMesh};
pub use triangle::TriangleMesh;
