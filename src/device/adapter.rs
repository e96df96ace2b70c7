//! The adapters that the machine's drivers offer.

use crate::error::{Error, Result};
use serde::{Serialize, Serializer};
use std::fmt;

/// The sort of hardware behind an adapter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AdapterKind {
    /// A GPU with memory of its own.
    Discrete,
    /// A GPU that shares the machine's memory.
    Integrated,
    /// A GPU seen through a virtual machine.
    Virtual,
    /// A driver that computes on the CPU (Mesa lavapipe, WARP).
    Software,
    /// The driver does not say.
    Other,
}

impl fmt::Display for AdapterKind {
    /// One word, in small letters.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Discrete => "discrete",
            Self::Integrated => "integrated",
            Self::Virtual => "virtual",
            Self::Software => "software",
            Self::Other => "other",
        })
    }
}

impl Serialize for AdapterKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The limits of an adapter that bear on this program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AdapterLimits {
    /// The largest buffer, in bytes.
    pub buffer_bytes: u64,
    /// The largest part of a buffer that a shader sees at once, in bytes.
    pub binding_bytes: u64,
    /// Storage buffers a shader.
    pub storage_bindings: u32,
    /// Workgroups in each dimension of a dispatch.
    pub workgroups: u32,
    /// Workgroup memory, in bytes.
    pub workgroup_bytes: u32,
}

/// An adapter: a device as a driver presents it.
#[derive(Debug, Clone, Serialize)]
pub struct Adapter {
    /// As the driver calls it.
    pub name: String,
    /// Vulkan, Metal or DX12.
    pub backend: String,
    /// The driver and its version.
    pub driver: String,
    /// The sort of hardware.
    pub kind: AdapterKind,
    /// What it allows. The program itself asks for wgpu's default limits only.
    pub limits: AdapterLimits,
    #[serde(skip)]
    pub(super) raw: wgpu::Adapter,
}

/// Every adapter of the native backends, in the drivers' order; empty where there is no driver.
///
/// OpenGL is left out: its software adapter would stand beside Vulkan's and do less.
pub fn adapters() -> Vec<Adapter> {
    let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    pollster::block_on(instance.enumerate_adapters(backends))
        .into_iter()
        .map(Adapter::describe)
        .collect()
}

impl Adapter {
    /// The first adapter whose name contains `name` (case ignored); without a name the first of hardware, else the first.
    ///
    /// # Errors
    /// Where there is none; says how to get one.
    pub fn select(name: Option<&str>) -> Result<Self> {
        let mut all = adapters();
        if all.is_empty() {
            return Err(Error::device(
                "no GPU adapter found",
                "install a Vulkan driver (the software one on Debian and Ubuntu: apt install mesa-vulkan-drivers), or run on the CPU",
            ));
        }
        let position = match name {
            Some(name) => {
                let wanted = name.to_lowercase();
                all.iter()
                    .position(|a| a.name.to_lowercase().contains(&wanted))
            }
            None => Some(
                all.iter()
                    .position(|a| a.kind != AdapterKind::Software)
                    .unwrap_or(0),
            ),
        };
        position.map(|p| all.swap_remove(p)).ok_or_else(|| {
            let names: Vec<_> = all.iter().map(|a| a.name.as_str()).collect();
            Error::device(
                format!("no adapter is called '{}'", name.unwrap_or_default()),
                format!("choose one of: {}", names.join(", ")),
            )
        })
    }

    fn describe(raw: wgpu::Adapter) -> Self {
        let info = raw.get_info();
        let limits = raw.limits();
        Self {
            name: info.name,
            backend: format!("{:?}", info.backend),
            driver: format!("{} {}", info.driver, info.driver_info)
                .trim()
                .to_owned(),
            kind: match info.device_type {
                wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
                wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
                wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
                wgpu::DeviceType::Cpu => AdapterKind::Software,
                wgpu::DeviceType::Other => AdapterKind::Other,
            },
            limits: AdapterLimits {
                buffer_bytes: limits.max_buffer_size,
                binding_bytes: limits.max_storage_buffer_binding_size,
                storage_bindings: limits.max_storage_buffers_per_shader_stage,
                workgroups: limits.max_compute_workgroups_per_dimension,
                workgroup_bytes: limits.max_compute_workgroup_storage_size,
            },
            raw,
        }
    }
}
