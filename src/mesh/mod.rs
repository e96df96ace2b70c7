//! Meshes as flat arrays: polygons, triangles, control meshes, clouds of points; connectivity; door checks; the unit frame; generated shapes.

pub mod check;
pub mod check_volume;
mod cloud;
pub mod connectivity;
pub mod frame;
mod nodal;
mod polygon;
pub mod sample;
pub mod shapes;
pub mod specks;
mod triangle;
mod volume;
pub(crate) mod weld;

pub use cloud::PointCloud;
pub use connectivity::Connectivity;
pub use frame::Frame;
pub use nodal::NodalVolume;
pub use polygon::{ControlMesh, Crease, PolygonMesh, Scheme};
pub use triangle::TriangleMesh;
pub use volume::{CellShape, VolumeMesh};
pub use weld::weld;
