//! Device memory: named buffers that are kept and only grow, uploads, and reading back.

use std::collections::HashMap;
use std::num::NonZeroU64;

use bytemuck::Pod;
use texir_core::error::{Error, Result};

use crate::gpu::Gpu;

/// Largest staging buffer: larger ones are slower per byte (fresh pages), and cost memory twice.
const STAGING_BYTES: u64 = 64 << 20;

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
        gpu.queue().write_buffer(&self.buffer, 0, &bytes[..whole]);
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

/// Buffers by name, and the staging buffer.
#[derive(Default)]
pub(crate) struct Pool {
    buffers: HashMap<&'static str, wgpu::Buffer>,
    staging: Option<wgpu::Buffer>,
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
        view.write(gpu, data);
        Ok(view)
    }

    /// Reads `count` values from the start of a buffer, after everything submitted before.
    pub fn download<T: Pod>(&mut self, gpu: &Gpu, view: &View, count: usize) -> Result<Vec<T>> {
        let mut out: Vec<T> = Vec::with_capacity(count);
        // Whole values in every piece, and pieces aligned to the four bytes that copies need.
        let piece = (STAGING_BYTES as usize / (4 * size_of::<T>())) * 4;
        while out.len() < count {
            let values = piece.min(count - out.len());
            let bytes = padded((values * size_of::<T>()) as u64);
            let staging = self.staging(gpu, bytes);
            let mut encoder = gpu.device().create_command_encoder(&Default::default());
            encoder.copy_buffer_to_buffer(
                &view.buffer,
                (out.len() * size_of::<T>()) as u64,
                &staging,
                0,
                Some(bytes.min(view.bytes)),
            );
            let submission = gpu.queue().submit([encoder.finish()]);
            let mapped = std::sync::Arc::new(std::sync::Mutex::new(None));
            let slot = mapped.clone();
            staging.map_async(wgpu::MapMode::Read, 0..bytes, move |result| {
                if let Ok(mut slot) = slot.lock() {
                    *slot = Some(result);
                }
            });
            gpu.wait(submission)?;
            let failed = |e: &dyn std::fmt::Display| Error::device(format!("{}: reading back: {e}", gpu.info().name));
            match mapped.lock().map(|slot| slot.clone()) {
                Ok(Some(Ok(()))) => {}
                Ok(Some(Err(e))) => return Err(failed(&e)),
                Ok(None) | Err(_) => return Err(failed(&"the buffer was not mapped when the device had finished")),
            }
            let range = staging.get_mapped_range(0..bytes).map_err(|e| failed(&e))?;
            let read = &range[..values * size_of::<T>()];
            out.extend(read.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>));
            drop(range);
            staging.unmap();
        }
        Ok(out)
    }

    fn staging(&mut self, gpu: &Gpu, bytes: u64) -> wgpu::Buffer {
        if let Some(buffer) = self.staging.as_ref().filter(|b| b.size() >= bytes) {
            return buffer.clone();
        }
        let buffer = gpu.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some("texir staging"),
            size: bytes.next_power_of_two(),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        self.staging = Some(buffer.clone());
        buffer
    }
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
            "{}: {name} needs {} MiB in one buffer, and this device binds at most {} MiB: use a smaller atlas or mesh, \
             another adapter, or the CPU backend",
            gpu.info().name,
            bytes.div_ceil(1 << 20),
            limit >> 20,
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
