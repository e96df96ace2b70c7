//! Pixar's Universal Scene Description, as text: one `UsdGeomMesh` with its subdivision scheme, creases and corners.
//!
//! Points are f32 by USD's schema, so far from the origin they are local to a translation that the mesh carries in double precision.
//! Boundary interpolation is `edgeAndCorner`, as in [`crate::model`]: boundary edges are sharp, and so are boundary vertices of a
//! single face, besides the corners that are listed. The unit of a scan is
//! unknown; the stage says metres and y up, USD's and glTF's customs.
//!
//! Read is what is written here, and what other programs write for one mesh: the rest of the stage is passed over, and what would change the
//! surface (transformations but a translation of the mesh itself, animation, holes, several meshes) is refused.

mod read;
mod write;

pub(super) use read::read;
pub(super) use write::write;
