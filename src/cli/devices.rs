//! `vorofit devices`: what there is to compute on.

use super::Outcome;
use super::session::Session;
use std::fmt::Write;
use vorofit::Result;
use vorofit::device::{Adapter, adapters};
use vorofit::report::{DeviceReport, Report};

/// List the adapters, their limits, and which one is taken
#[derive(Debug, clap::Args)]
pub struct Args {}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        let adapters = adapters();
        let taken = DeviceReport::of(session.device()?);
        let summary = list(&adapters, &taken, &session.device_options());
        let report = Report {
            device: Some(taken),
            adapters: Some(adapters),
            ..Report::new("devices")
        };
        session.finish(&report, &summary)?;
        Ok(Outcome::Done)
    }
}

fn list(adapters: &[Adapter], taken: &DeviceReport, asked: &str) -> String {
    let mut text = String::new();
    if adapters.is_empty() {
        text += "no adapters: there is no Vulkan, Metal or DX12 driver\n\n";
    }
    for adapter in adapters {
        let limits = &adapter.limits;
        let mebibytes = |bytes: u64| bytes >> 20;
        let _ = writeln!(
            text,
            "{}\n  {}, {}, {}\n  buffers to {} MiB, of which a shader sees {} MiB at once; {} storage bindings; {} workgroups a dimension; {} KiB shared by a workgroup\n",
            adapter.name,
            adapter.kind,
            adapter.backend,
            adapter.driver,
            mebibytes(limits.buffer_bytes),
            mebibytes(limits.binding_bytes),
            limits.storage_bindings,
            limits.workgroups,
            limits.workgroup_bytes >> 10,
        );
    }
    let _ = writeln!(text, "{asked} takes {taken}");
    text
}
