//! vorofit fits subdivision surfaces, and volume meshes of curved high-order elements, to 3D scans.
//!
//! **What a fit is.** A *model*, control points P with a constant sparse matrix M to the vertices X = M P of a fine mesh S, is
//! deformed until S and the *target* T agree, by minimizing a sum of energies over P. Gradients come back as Mᵀ.
//!
//! **The path of the data.** A file becomes a mesh that is checked at the door ([`files`], [`mesh::check`]); the target goes to the
//! unit frame, diagonal 1 about the origin, in f64 ([`fit::Target`]); a template says where the model starts ([`fit::Start`]); L-BFGS on the
//! host asks for value and gradient, which kernels on the CPU or a GPU compute ([`kernel::vsdm`]); between phases the control mesh is
//! subdivided; least squares finish; results go back to the input's frame, into files and a [`report`]. Two more recipes go the same way:
//! [`fit::geometric`] follows closest points on the exact limit surface ([`model::limit_surface`]) and adds control points where a tolerance
//! asks for them; [`fit::fit_volume`] deforms curved elements ([`model::volume`]) until their boundary is the target.
//!
//! ```no_run
//! use vorofit::device::Device;
//! use vorofit::files::{SurfaceToWrite, read_surface, write_surface};
//! use vorofit::fit::{Options, Start, Target, Template, fit};
//! use vorofit::progress::Silent;
//! use vorofit::template::Genus;
//!
//! # fn main() -> vorofit::Result<()> {
//! let scan = read_surface("scan.ply".as_ref())?.mesh.triangulate();
//! let target = Target::new(&Device::Cpu, &scan)?;
//! let options = Options::default();
//! let template = Template::Automatic { control_points: 1500, genus: Genus::default() };
//! let start = Start::new(&target, &template, options.scheme)?;
//! let mut fitted = fit(&Device::Cpu, &target, start, &options, &Silent)?;
//! for p in &mut fitted.control.mesh.positions {
//!     *p = target.frame.to_input(*p);
//! }
//! write_surface("control.obj".as_ref(), &SurfaceToWrite::control(&fitted.control, options.scheme))?;
//! # Ok(())
//! # }
//! ```
//!
//! **The house.** A floor uses only the floors below it:
//!
//! | floor | holds |
//! | --- | --- |
//! | `cli` | one file a command: parse, call, print |
//! | [`report`], [`benchmark`] | the report as JSON and as a page to look at; both twins of every kernel side by side |
//! | [`fit`] | the recipes |
//! | [`template`], [`reconstruction`], [`demo`] | where a model starts; a surface from a cloud of points; the built-in scan |
//! | [`features`] | Monge forms, ridges, umbilics and crossings of a scan |
//! | [`energy`], [`measure`] | terms on the host; distances, by code that no fit uses |
//! | [`untangle`] | volume meshes made valid: inverted cells turned right, the worst made better |
//! | [`model`] | P → X = M P: polygon, Catmull–Clark, Loop; their limit surfaces; curved elements |
//! | [`optimize`] | L-BFGS, which knows nothing but a closure |
//! | [`topology`] | edits of connectivity: simplification, splits, flips, cuts |
//! | [`kernel`] | the heavy operations and their twins |
//! | [`device`] | the only place that names wgpu |
//! | [`picture`] | pictures of surfaces, drawn in software |
//! | [`files`] | one file a format |
//! | [`geometry`], [`mesh`] | scalar f64 geometry; meshes as flat arrays |
//! | [`mod@error`], [`progress`] | messages that say what to do; the events of a run |
//!
//! Lengths are relative to the target's diagonal everywhere between [`fit::Target`] and the results.
#![warn(missing_docs)]

pub mod benchmark;
pub mod demo;
pub mod device;
pub mod energy;
pub mod error;
pub mod features;
pub mod files;
pub mod fit;
pub mod geometry;
pub mod kernel;
pub mod measure;
pub mod mesh;
pub mod model;
pub mod optimize;
pub mod picture;
pub mod progress;
pub mod reconstruction;
pub mod report;
pub mod template;
pub mod topology;
pub mod untangle;

pub use error::{Error, Result};
