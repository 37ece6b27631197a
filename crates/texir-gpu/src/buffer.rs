//! Device memory: named buffers that are kept and only grow, uploads, and reading back.

use std::collections::HashMap;
use std::num::NonZeroU64;

use bytemuck::Pod;
use texir_core::bytesize::ByteSize;
use texir_core::error::{Error, Result};

use crate::gpu::Gpu;

/// Largest staging buffer: larger ones are slower per byte, and cost memory twice.
const STAGING_BYTES: usize = 64 << 20;

/// Uploads below this size go through the queue's own staging memory.
const SMALL_BYTES: usize = 64 << 10;

/// The first bytes of a buffer, as much as is in use.
#[derive(Clone)]
pub(crate) struct View {
    buffer: wgpu::Buffer,
    bytes: u64,
}

impl View {
    /// For binding.
    pub fn binding(&self) -> wgpu::BindingResource<'_> {
        wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: &self.buffer,
            offset: 0,
            size: NonZeroU64::new(self.bytes),
        })
    }

    /// Size in bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Overwrites the start of the buffer.
    pub fn write<T: Pod>(&self, gpu: &Gpu, data: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        let whole = bytes.len() - bytes.len() % 4;
        for (piece, bytes) in bytes[..whole].chunks(STAGING_BYTES).enumerate() {
            if piece > 0 {
                // Lets the queue's copy of the last piece go.
                gpu.queue().submit([]);
            }
            gpu.queue().write_buffer(&self.buffer, (piece * STAGING_BYTES) as u64, bytes);
        }
        if whole < bytes.len() {
            let mut last = [0; 4];
            last[..bytes.len() - whole].copy_from_slice(&bytes[whole..]);
            gpu.queue().write_buffer(&self.buffer, whole as u64, &last);
        }
    }

    /// Fills the buffer with zeros, after everything submitted before.
    pub fn clear(&self, gpu: &Gpu) {
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        encoder.clear_buffer(&self.buffer, 0, Some(self.bytes));
        gpu.queue().submit([encoder.finish()]);
    }
}

/// Buffers by name, and the staging buffers.
#[derive(Default)]
pub(crate) struct Pool {
    buffers: HashMap<&'static str, wgpu::Buffer>,
    up: Option<wgpu::Buffer>,
    down: Option<wgpu::Buffer>,
}

impl Pool {
    /// The buffer `name` with room for `bytes`; what it held before is undefined.
    pub fn reserve(&mut self, gpu: &Gpu, name: &'static str, bytes: u64) -> Result<View> {
        let bytes = padded(bytes);
        if let Some(buffer) = self.buffers.get(name).filter(|b| b.size() >= bytes) {
            return Ok(View { buffer: buffer.clone(), bytes });
        }
        let limit = largest_binding(gpu);
        // A third more, so that slowly growing uses do not allocate each time.
        let view = create(gpu, name, (bytes + bytes / 3).min(limit).max(bytes))?;
        self.buffers.insert(name, view.buffer.clone());
        Ok(View { bytes, ..view })
    }

    /// Copies `data` into the buffer `name`.
    pub fn upload<T: Pod>(&mut self, gpu: &Gpu, name: &'static str, data: &[T]) -> Result<View> {
        let view = self.reserve(gpu, name, size_of_val(data) as u64)?;
        self.write(gpu, &view, data)?;
        Ok(view)
    }

    /// Overwrites the start of a buffer.
    pub fn write<T: Pod>(&mut self, gpu: &Gpu, view: &View, data: &[T]) -> Result<()> {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        if bytes.len() < SMALL_BYTES {
            view.write(gpu, data);
            return Ok(());
        }
        for (piece, bytes) in bytes.chunks(STAGING_BYTES).enumerate() {
            let size = padded(bytes.len() as u64);
            let usage = wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC;
            let staging = staging(gpu, &mut self.up, size, usage);
            map(gpu, &staging, wgpu::MapMode::Write, size)?;
            let mut range = staging.get_mapped_range_mut(0..size).map_err(|e| failed(gpu, e))?;
            range.slice(..bytes.len()).copy_from_slice(bytes);
            drop(range);
            staging.unmap();
            let mut encoder = gpu.device().create_command_encoder(&Default::default());
            let first = (piece * STAGING_BYTES) as u64;
            encoder.copy_buffer_to_buffer(&staging, 0, &view.buffer, first, Some(size.min(view.bytes - first)));
            gpu.queue().submit([encoder.finish()]);
        }
        Ok(())
    }

    /// Reads `count` values from the start of a buffer, after everything submitted before.
    pub fn download<T: Pod>(&mut self, gpu: &Gpu, view: &View, count: usize) -> Result<Vec<T>> {
        let mut out: Vec<T> = Vec::with_capacity(count);
        // Whole values in every piece, and pieces aligned to the four bytes that copies need.
        let piece = (STAGING_BYTES / (4 * size_of::<T>())) * 4;
        while out.len() < count {
            let values = piece.min(count - out.len());
            let first = (out.len() * size_of::<T>()) as u64;
            let size = padded((values * size_of::<T>()) as u64).min(view.bytes - first);
            let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
            let staging = staging(gpu, &mut self.down, size, usage);
            let mut encoder = gpu.device().create_command_encoder(&Default::default());
            encoder.copy_buffer_to_buffer(&view.buffer, first, &staging, 0, Some(size));
            gpu.queue().submit([encoder.finish()]);
            map(gpu, &staging, wgpu::MapMode::Read, size)?;
            let range = staging.get_mapped_range(0..size).map_err(|e| failed(gpu, e))?;
            let bytes = &range[..values * size_of::<T>()];
            match bytemuck::try_cast_slice(bytes) {
                Ok(values) => out.extend_from_slice(values),
                Err(_) => out.extend(bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>)),
            }
            drop(range);
            staging.unmap();
        }
        Ok(out)
    }
}

/// The staging buffer in `slot`, made anew when it is too small. Kept, as fresh pages cost more than the copy.
fn staging(gpu: &Gpu, slot: &mut Option<wgpu::Buffer>, bytes: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
    if let Some(buffer) = slot.as_ref().filter(|b| b.size() >= bytes) {
        return buffer.clone();
    }
    let size = bytes.next_power_of_two();
    let descriptor = wgpu::BufferDescriptor { label: Some("texir staging"), size, usage, mapped_at_creation: false };
    slot.insert(gpu.device().create_buffer(&descriptor)).clone()
}

/// Maps the first bytes of a staging buffer, once the device no longer uses it.
fn map(gpu: &Gpu, buffer: &wgpu::Buffer, mode: wgpu::MapMode, bytes: u64) -> Result<()> {
    let (sender, mapped) = std::sync::mpsc::channel();
    buffer.map_async(mode, 0..bytes, move |result| {
        // Nobody listens any more where waiting failed, which is reported instead.
        let _ = sender.send(result);
    });
    gpu.wait_for(&mapped)?.map_err(|e| failed(gpu, e))
}

fn failed(gpu: &Gpu, e: impl std::fmt::Display) -> Error {
    Error::device(format!("{}: copying to or from the device failed: {e}", gpu.info().name))
}

/// A buffer of its own that holds `data`, for as long as the view lives.
pub(crate) fn keep<T: Pod>(gpu: &Gpu, name: &str, data: &[T]) -> Result<View> {
    let view = create(gpu, name, padded(size_of_val(data) as u64))?;
    view.write(gpu, data);
    Ok(view)
}

/// A uniform buffer that holds `value`.
pub(crate) fn uniform<T: Pod>(gpu: &Gpu, value: &T) -> View {
    let bytes = size_of::<T>().next_multiple_of(16) as u64;
    let buffer = gpu.device().create_buffer(&wgpu::BufferDescriptor {
        label: Some("texir parameters"),
        size: bytes,
        usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let view = View { buffer, bytes };
    view.write(gpu, std::slice::from_ref(value));
    view
}

/// Copies are in multiples of four bytes, bindings are not empty, and arrays of 16-byte items have room for one.
fn padded(bytes: u64) -> u64 {
    bytes.next_multiple_of(4).max(64)
}

fn largest_binding(gpu: &Gpu) -> u64 {
    let limits = gpu.device().limits();
    limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
}

fn create(gpu: &Gpu, name: &str, bytes: u64) -> Result<View> {
    let limit = largest_binding(gpu);
    if bytes > limit {
        return Err(Error::device(format!(
            "{}: {name} needs {} in one buffer, and this device binds at most {}: use a smaller atlas or mesh, \
             another adapter, or the CPU backend",
            gpu.info().name,
            ByteSize(bytes),
            ByteSize(limit),
        )));
    }
    let buffer = gpu.device().create_buffer(&wgpu::BufferDescriptor {
        label: Some(name),
        size: bytes,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    Ok(View { buffer, bytes })
}
