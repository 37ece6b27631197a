//! A device to run on: owned (headless) or borrowed from a host program.

use std::sync::Arc;

use texir_core::error::{Error, Result};

/// A wgpu device with its queue. Clones share them.
#[derive(Clone)]
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    info: Arc<wgpu::AdapterInfo>,
}

/// The optional features that the kernels need: none.
pub fn required_features() -> wgpu::Features {
    wgpu::Features::empty()
}

/// The limits to request for a device that runs the kernels: wgpu's defaults, with those that bound the size of a scene
/// and its textures raised to what the adapter has (the default of 128 MiB per storage binding is too small for scans), and
/// the number of storage buffers too (gathers that sample the lights bind ten, the default is eight).
pub fn required_limits(adapter: &wgpu::Adapter) -> wgpu::Limits {
    let best = adapter.limits();
    wgpu::Limits {
        max_buffer_size: best.max_buffer_size,
        max_storage_buffer_binding_size: best.max_storage_buffer_binding_size,
        max_texture_dimension_2d: best.max_texture_dimension_2d,
        max_storage_buffers_per_shader_stage: best.max_storage_buffers_per_shader_stage,
        ..wgpu::Limits::default()
    }
}

/// Storage buffers that a kernel binds at most.
const STORAGE_BUFFERS: u32 = 10;
/// Threads of a workgroup at most.
const THREADS: u32 = 256;

/// What a device cannot do that the kernels need.
fn missing(limits: &wgpu::Limits) -> Option<String> {
    let needed = [
        ("max_storage_buffers_per_shader_stage", limits.max_storage_buffers_per_shader_stage, STORAGE_BUFFERS),
        ("max_compute_invocations_per_workgroup", limits.max_compute_invocations_per_workgroup, THREADS),
        ("max_compute_workgroup_size_x", limits.max_compute_workgroup_size_x, THREADS),
    ];
    let short = needed.into_iter().filter(|(_, found, needed)| found < needed);
    let short: Vec<String> =
        short.map(|(name, found, needed)| format!("{name} is {found}; expected {needed}")).collect();
    (!short.is_empty()).then(|| short.join(", "))
}

impl Gpu {
    /// Makes a device without a window. Of several adapters, discrete GPUs come before integrated ones and those before
    /// software; `adapter` keeps only those whose name contains it (case does not matter).
    pub fn headless(adapter: Option<&str>) -> Result<Self> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
            flags: wgpu::InstanceFlags::empty(),
            ..wgpu::InstanceDescriptor::new_without_display_handle()
        });
        let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
        let found: Vec<String> = adapters.iter().map(|a| a.get_info().name).collect();
        if let Some(name) = adapter {
            let name = name.to_lowercase();
            adapters.retain(|a| a.get_info().name.to_lowercase().contains(&name));
        }
        adapters.sort_by_key(|a| preference(a.get_info().device_type));
        let Some(chosen) = adapters.first() else { return Err(no_adapter(adapter, &found)) };
        let info = chosen.get_info();
        let (device, queue) = pollster::block_on(chosen.request_device(&wgpu::DeviceDescriptor {
            label: Some("texir"),
            required_features: required_features(),
            required_limits: required_limits(chosen),
            ..Default::default()
        }))
        .map_err(|e| Error::device(format!("the adapter {:?} gives no device: {e}", info.name)))?;
        Self::from_device(device, queue)
    }

    /// Borrows a host program's device and queue (both are handles). Make the device with [`required_limits`]; one that the
    /// kernels do not run on is an error that names the limits.
    pub fn from_device(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self> {
        let info = Arc::new(device.adapter_info());
        match missing(&device.limits()) {
            None => Ok(Self { device, queue, info }),
            Some(what) => Err(Error::device(format!(
                "the device of {:?} is too small: {what}; ask for texir_gpu::required_limits when it is made",
                info.name
            ))),
        }
    }

    /// The device.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// The device's queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// What the adapter is.
    pub fn info(&self) -> &wgpu::AdapterInfo {
        &self.info
    }

    /// Adapter name, driver and API in one line, for logs.
    pub fn describe(&self) -> String {
        let info = &self.info;
        format!("{} ({}, {:?})", info.name, [&*info.driver, &*info.driver_info].join(" ").trim(), info.backend)
    }

    /// Whether a processor plays the GPU, where other choices are faster.
    pub fn is_cpu(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// Runs `work` and turns everything that the device reports meanwhile into an error, so that nothing reaches the
    /// device's uncaptured-error handler, which is the host program's.
    pub(crate) fn guarded<T>(&self, what: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let scopes = [wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Validation]
            .map(|filter| self.device.push_error_scope(filter));
        let result = work();
        // Scopes close in the opposite order of their opening.
        let mut reported = None;
        for scope in scopes.into_iter().rev() {
            reported = reported.or(pollster::block_on(scope.pop()));
        }
        match reported {
            Some(error) => Err(Error::device(format!("{}: {what}: {error}", self.info.name))),
            None => result,
        }
    }

    /// Waits until a submission is done.
    pub(crate) fn wait(&self, submission: wgpu::SubmissionIndex) -> Result<()> {
        self.poll(Some(submission))
    }

    /// Waits until everything submitted is done, and mappings with it.
    pub(crate) fn wait_for_all(&self) -> Result<()> {
        self.poll(None)
    }

    fn poll(&self, submission_index: Option<wgpu::SubmissionIndex>) -> Result<()> {
        match self.device.poll(wgpu::PollType::Wait { submission_index, timeout: None }) {
            Ok(_) => Ok(()),
            Err(e) => Err(Error::device(format!("{}: waiting for the device failed: {e}", self.info.name))),
        }
    }
}

fn preference(kind: wgpu::DeviceType) -> u8 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

fn no_adapter(wanted: Option<&str>, found: &[String]) -> Error {
    match wanted {
        Some(name) if !found.is_empty() => {
            Error::device(format!("no graphics adapter is named like {name:?}; there are: {}", found.join(", ")))
        }
        _ => Error::device(
            "no graphics adapter found: install a Vulkan driver (without a GPU, mesa's software driver serves: \
             `apt install mesa-vulkan-drivers`), or choose the CPU backend",
        ),
    }
}
