//! The recipes: how energies, models and minimizers are put together into a fit.
//!
//! [`fit`] runs Voronoi squared distance minimization from coarse to fine (`voronoi`), then a least-squares polish
//! (`polish`, on `least_squares`, with its end in `peaks`). [`geometric`] fits Loop surfaces by closest points on the exact limit
//! surface, [`interpolate`] takes one through given points, [`fit_volume`] fits curved volumes. Results are judged with code that no fit uses ([`crate::measure`]).

mod checkpoint;
pub mod geometric;
mod interpolate;
mod least_squares;
mod normal_equations;
mod outliers;
mod peaks;
mod polish;
mod record;
mod start;
mod symmetric;
mod target;
mod volume;
mod voronoi;

pub use checkpoint::{Checkpoint, Checkpoints};
pub use interpolate::{Interpolation, interpolate};
pub use record::{Fit, Iteration, StopReason, Terms};
pub use start::{Proximity, Start, Template};
pub use target::{Place, Samples, Target, TargetPoint};
pub use volume::{
    Adaptive, PointTarget, SubdivisionFit, SubdivisionLevel, VolumeFit, VolumeOptions, VolumeStart,
    VolumeTarget, VolumeTemplate, fit_subdivision, fit_volume,
};
pub use voronoi::{Options, fit, fit_with_checkpoints};
