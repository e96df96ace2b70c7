//! A list of dispatches that runs as one submission with one readback.

use super::{Binding, Buffer, Gpu, Pipeline, WORKGROUP_SIZE};
use crate::error::{Error, Result};
use bytemuck::Pod;
use std::marker::PhantomData;

/// Parameters lie at multiples of this in their uniform buffer: the strictest alignment under wgpu's default limits.
const UNIFORM_ALIGNMENT: usize = 256;

/// A list of dispatches and readbacks. Each dispatch sees what the earlier ones wrote.
///
/// Every shader has its parameters at binding 0 (uniform) and its buffers from binding 1 on, all in group 0.
#[derive(Debug)]
pub struct Batch {
    gpu: Gpu,
    uniforms: Vec<u8>,
    clears: Vec<Binding>,
    dispatches: Vec<Dispatch>,
    reads: Vec<Binding>,
    read_bytes: u64,
}

#[derive(Debug)]
struct Dispatch {
    pipeline: Pipeline,
    params: usize,
    params_bytes: usize,
    buffers: Vec<Binding>,
    groups: [u32; 2],
}

/// A claim on a part of a batch's results.
#[derive(Debug)]
pub struct Readback<T> {
    offset: usize,
    len: usize,
    element: PhantomData<T>,
}

/// What a batch read back.
#[derive(Debug)]
pub struct Results(Vec<u8>);

impl Batch {
    pub(super) fn new(gpu: &Gpu) -> Self {
        Self {
            gpu: gpu.clone(),
            uniforms: Vec::new(),
            clears: Vec::new(),
            dispatches: Vec::new(),
            reads: Vec::new(),
            read_bytes: 0,
        }
    }

    /// Adds `threads` threads of a pipeline. Zero threads are no dispatch.
    ///
    /// # Errors
    /// Where a buffer passes the largest binding or the threads pass what a grid can count.
    pub fn dispatch<P: Pod>(
        &mut self,
        pipeline: &Pipeline,
        threads: usize,
        params: &P,
        buffers: &[&Binding],
    ) -> Result<()> {
        if threads == 0 {
            return Ok(());
        }
        let limits = self.gpu.device().limits();
        let groups = grid(threads, limits.max_compute_workgroups_per_dimension)?;
        let limit = limits.max_storage_buffer_binding_size;
        if let Some(large) = buffers.iter().find(|b| b.bytes > limit) {
            return Err(Error::device(
                format!(
                    "kernel {}: an array of {} MiB passes the limit of {} MiB",
                    pipeline.name,
                    large.bytes >> 20,
                    limit >> 20
                ),
                "use a smaller mesh, or run on the CPU",
            ));
        }
        let offset = self.uniforms.len();
        self.uniforms.extend(bytemuck::bytes_of(params));
        self.uniforms
            .resize(self.uniforms.len().next_multiple_of(UNIFORM_ALIGNMENT), 0);
        self.dispatches.push(Dispatch {
            pipeline: pipeline.clone(),
            params: offset,
            params_bytes: size_of::<P>(),
            buffers: buffers.iter().map(|&b| b.clone()).collect(),
            groups,
        });
        Ok(())
    }

    /// Zeroes a buffer before the first dispatch.
    pub fn clear<T: Pod>(&mut self, buffer: &Buffer<T>) {
        self.clears.push(buffer.binding());
    }

    /// Reads a buffer back after the last dispatch.
    pub fn read<T: Pod>(&mut self, buffer: &Buffer<T>) -> Readback<T> {
        let binding = buffer.binding();
        let readback = Readback {
            offset: self.read_bytes as usize,
            len: buffer.len(),
            element: PhantomData,
        };
        self.read_bytes += binding.bytes;
        self.reads.push(binding);
        readback
    }

    /// Runs everything as one submission and waits for it.
    ///
    /// # Errors
    /// Where the device fails or runs out of memory.
    pub fn submit(self) -> Result<Results> {
        let staging = self.gpu.take_staging(self.read_bytes.max(4))?;
        self.gpu.guarded(|| {
            let commands = self.encode(&staging);
            self.gpu.queue().submit([commands]);
            // A failure to map shows in the mapped range.
            staging.map_async(wgpu::MapMode::Read, .., |_| ());
        })?;
        self.gpu.wait()?;
        let bytes = staging
            .get_mapped_range(..)
            .map_err(|e| Error::device(e.to_string(), "run on the CPU"))?
            [..self.read_bytes as usize]
            .to_vec();
        staging.unmap();
        self.gpu.store_staging(staging);
        Ok(Results(bytes))
    }

    fn encode(&self, staging: &wgpu::Buffer) -> wgpu::CommandBuffer {
        let device = self.gpu.device();
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for clear in &self.clears {
            encoder.clear_buffer(&clear.raw, 0, Some(clear.bytes));
        }
        if !self.dispatches.is_empty() {
            let uniforms = device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("parameters"),
                size: self.uniforms.len() as u64,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            self.gpu.queue().write_buffer(&uniforms, 0, &self.uniforms);
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            for dispatch in &self.dispatches {
                pass.set_pipeline(&dispatch.pipeline.raw);
                pass.set_bind_group(0, &dispatch.bind_group(device, &uniforms), &[]);
                pass.dispatch_workgroups(dispatch.groups[0], dispatch.groups[1], 1);
            }
        }
        let mut offset = 0;
        for read in &self.reads {
            encoder.copy_buffer_to_buffer(&read.raw, 0, staging, offset, read.bytes);
            offset += read.bytes;
        }
        encoder.finish()
    }
}

impl Dispatch {
    fn bind_group(&self, device: &wgpu::Device, uniforms: &wgpu::Buffer) -> wgpu::BindGroup {
        let params = (uniforms, self.params as u64, self.params_bytes as u64);
        let buffers = self.buffers.iter().map(|b| (&b.raw, 0, b.bytes));
        let entries: Vec<_> = std::iter::once(params)
            .chain(buffers)
            .zip(0..)
            .map(|((buffer, offset, bytes), binding)| wgpu::BindGroupEntry {
                binding,
                resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                    buffer,
                    offset,
                    size: std::num::NonZeroU64::new(bytes),
                }),
            })
            .collect();
        device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.pipeline.name),
            layout: &self.pipeline.raw.get_bind_group_layout(0),
            entries: &entries,
        })
    }
}

impl Results {
    /// The elements of a readback of this batch.
    pub fn get<T: Pod>(&self, readback: &Readback<T>) -> Vec<T> {
        let bytes = readback.offset..readback.offset + readback.len * size_of::<T>();
        bytemuck::pod_collect_to_vec(&self.0[bytes])
    }
}

/// The workgroups for a number of threads: one row where they fit, else rows of equal length. Shaders undo it with
/// `linear_index` of `shared/grid.wgsl`.
fn grid(threads: usize, limit: u32) -> Result<[u32; 2]> {
    let groups = threads.div_ceil(WORKGROUP_SIZE as usize);
    let rows = groups.div_ceil(limit as usize);
    let columns = groups.div_ceil(rows);
    if rows > limit as usize || rows * columns > (u32::MAX / WORKGROUP_SIZE) as usize {
        return Err(Error::device(
            format!("{threads} threads pass what one dispatch can count"),
            "use a smaller mesh, or run on the CPU",
        ));
    }
    Ok([columns as u32, rows as u32])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_cover_every_thread_within_the_limit() {
        for threads in [1, 63, 64, 65, 4_194_240, 4_194_241, 100_000_000] {
            let [columns, rows] = grid(threads, 65_535).unwrap();
            assert!(columns <= 65_535 && rows <= 65_535);
            let covered = columns as usize * rows as usize * WORKGROUP_SIZE as usize;
            assert!(covered >= threads && covered - threads < (rows as usize) * 64 + 64);
        }
        assert!(grid(usize::MAX / 2, 65_535).is_err());
        assert!(grid(5_000_000_000, 65_535).is_err());
    }
}
