//! Typed storage buffers that stay on the device.

use super::Gpu;
use crate::error::{Error, Result};
use bytemuck::Pod;
use std::marker::PhantomData;

/// An array of plain data on the device. Grows where more is written to it than it holds, and keeps its room.
#[derive(Debug)]
pub struct Buffer<T> {
    gpu: Gpu,
    raw: wgpu::Buffer,
    len: usize,
    element: PhantomData<T>,
}

impl<T: Pod> Buffer<T> {
    /// `len` elements, all bits zero.
    ///
    /// # Errors
    /// Where the device has no room, or `len` elements pass its largest buffer.
    pub fn zeroed(gpu: &Gpu, len: usize) -> Result<Self> {
        Ok(Self {
            gpu: gpu.clone(),
            raw: allocate::<T>(gpu, len)?,
            len,
            element: PhantomData,
        })
    }

    /// A copy of `data`.
    ///
    /// # Errors
    /// As [`zeroed`](Self::zeroed).
    pub fn from_slice(gpu: &Gpu, data: &[T]) -> Result<Self> {
        let mut buffer = Self::zeroed(gpu, data.len())?;
        buffer.write(data)?;
        Ok(buffer)
    }

    /// Replaces the whole content. Takes effect before any batch that is submitted later.
    ///
    /// # Errors
    /// As [`zeroed`](Self::zeroed), where the buffer must grow.
    pub fn write(&mut self, data: &[T]) -> Result<()> {
        self.resize(data.len())?;
        let gpu = &self.gpu;
        gpu.guarded(|| {
            gpu.queue()
                .write_buffer(&self.raw, 0, bytemuck::cast_slice(data))
        })
    }

    /// Sets the number of elements. The content is lost where the buffer must grow.
    ///
    /// # Errors
    /// As [`zeroed`](Self::zeroed).
    pub fn resize(&mut self, len: usize) -> Result<()> {
        if byte_size::<T>(len) > u128::from(self.raw.size()) {
            self.raw = allocate::<T>(&self.gpu, len)?;
        }
        self.len = len;
        Ok(())
    }

    /// The number of elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether it has no elements.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Its elements as a shader sees them.
    pub fn binding(&self) -> Binding {
        Binding {
            raw: self.raw.clone(),
            bytes: byte_size::<T>(self.len) as u64,
        }
    }
}

/// The elements of a buffer as a shader sees them, whatever their type on the host.
#[derive(Debug, Clone)]
pub struct Binding {
    pub(super) raw: wgpu::Buffer,
    pub(super) bytes: u64,
}

/// A shader's array has at least one element, so every buffer has room for one.
fn byte_size<T>(len: usize) -> u128 {
    len.max(1) as u128 * size_of::<T>() as u128
}

fn allocate<T>(gpu: &Gpu, len: usize) -> Result<wgpu::Buffer> {
    let bytes = byte_size::<T>(len);
    let limit = gpu.largest_buffer();
    if bytes > u128::from(limit) {
        return Err(Error::device(
            format!(
                "a buffer of {} MiB passes the limit of {} MiB",
                bytes >> 20,
                limit >> 20
            ),
            "use a smaller mesh, or run on the CPU",
        ));
    }
    gpu.guarded(|| {
        gpu.device().create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: bytes as u64,
            usage: wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::COPY_SRC
                | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    })
}
