//! Scalar geometry in f64: triangles, clipped cells, and the trees that find what is near. Knows no GPU.

pub mod bvh;
pub mod clip;
pub mod crossing;
pub mod distortion;
pub mod eigen;
pub mod morton;
pub mod random;
pub mod triangle;
pub mod triangle_tree;
pub mod vector;
pub mod winding;

pub use bvh::{Bvh, ClosestPoint};
