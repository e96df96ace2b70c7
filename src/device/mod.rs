//! Where the arithmetic runs: the CPU, or a GPU through wgpu. The only place that names wgpu.
//!
//! **Choosing.** [`adapters`] lists what the drivers offer, [`Device::choose`] applies the user's wish once, and the handle is
//! passed down; nothing above `kernel` asks which one it has.
//!
//! **Running.** A [`Gpu`] compiles [`Shader`]s into pipelines (once each), holds data in typed [`Buffer`]s that stay resident,
//! and runs a [`Batch`]: any number of dispatches as one submission with one readback. Only wgpu's default limits are asked
//! for, and no optional feature, so that what runs on one adapter runs on all.
//!
//! **Failing.** A lost device, memory that runs out, a shader that does not compile: each is an [`Error::Device`] that says
//! what to try; nothing here panics.

mod adapter;
mod batch;
mod buffer;
mod gpu;
mod shader;

pub use adapter::{Adapter, AdapterKind, AdapterLimits, adapters};
pub use batch::{Batch, Readback, Results};
pub use buffer::{Binding, Buffer};
pub use gpu::{Gpu, Pipeline};
pub use shader::{Assembled, Constants, Field, Layout, Shader, Source, WORKGROUP_SIZE, WgslType};
pub(crate) use shader::{shared_struct, source};

use crate::error::{Error, Result};

/// The most iterations that a thread may run, of all its loops together. Mesa's llvmpipe ends every loop silently after 65,535, so a kernel
/// that could need more must split its work or give it up for the host to do.
pub const MAX_ITERATIONS: usize = 60_000;

/// What the user asks for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// A hardware GPU where there is one, else the CPU. A software adapter is never taken: it is the same silicon as the CPU
    /// twin, and slower.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// A GPU; a software adapter will do.
    Gpu,
}

/// Where kernels run. Cheap to clone; chosen once and passed down.
#[derive(Debug, Clone)]
pub enum Device {
    /// f64 with rayon.
    Cpu,
    /// f32 in WGSL.
    Gpu(Gpu),
}

impl Device {
    /// The device for a wish, with an adapter whose name contains `adapter` (case ignored) where one is named.
    ///
    /// `Auto` falls back to the CPU, with a warning in the log, where the only fitting adapter cannot be opened. A named
    /// adapter is taken by `Auto` even if it is software.
    ///
    /// # Errors
    /// Where a GPU or a named adapter was asked for and cannot be had.
    pub fn choose(choice: DeviceChoice, adapter: Option<&str>) -> Result<Self> {
        match (choice, adapter) {
            (DeviceChoice::Cpu, None) => Ok(Self::Cpu),
            (DeviceChoice::Cpu, Some(name)) => Err(Error::input(
                format!("adapter '{name}' was named, but the device is the CPU"),
                "leave the adapter out, or ask for the GPU",
            )),
            (DeviceChoice::Auto, None) => {
                let hardware = adapters()
                    .into_iter()
                    .find(|a| a.kind != AdapterKind::Software);
                let Some(adapter) = hardware else {
                    return Ok(Self::Cpu);
                };
                Ok(Gpu::open(&adapter).map_or_else(
                    |error| {
                        log::warn!("{}: {error}; running on the CPU", adapter.name);
                        Self::Cpu
                    },
                    Self::Gpu,
                ))
            }
            (DeviceChoice::Auto | DeviceChoice::Gpu, name) => {
                Gpu::open(&Adapter::select(name)?).map(Self::Gpu)
            }
        }
    }
}
