//! The heavy operations, each as one call with two implementations: f64 on the CPU (rayon), f32 in WGSL on the GPU.

pub mod sparse;
