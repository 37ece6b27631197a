//! A device to run on: owned (headless) or borrowed from a host program.

use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use texir_core::error::{Error, Result};

use crate::kernel::{Kernel, KernelKey, Kernels};

/// A wgpu device with its queue, and the pipelines that were made for it. Clones share them.
#[derive(Clone)]
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    info: Arc<wgpu::AdapterInfo>,
    rejected_adapters: Arc<[String]>,
    kernels: Arc<Mutex<Kernels>>,
    /// Why the device was lost: of devices of our own.
    lost: Arc<OnceLock<String>>,
}

impl fmt::Debug for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut gpu = f.debug_struct("Gpu");
        gpu.field("info", &self.info).field("rejected_adapters", &self.rejected_adapters).finish_non_exhaustive()
    }
}

// Programs keep it beside their own device, which threads share.
const _: () = {
    const fn is_shared<T: Send + Sync>() {}
    is_shared::<Gpu>();
};

/// The longest time between two questions whether the device is done.
const MAX_POLL_INTERVAL: Duration = Duration::from_millis(1);

/// A hundred times what a dispatch should take: a wait as long as that may be one for a device that was lost.
const TOO_LONG: Duration = Duration::from_secs(10);

/// What failed where a poll did.
const WAITING: &str = "waiting for the device failed";

/// The instance of [`Gpu::headless`], which makes one device at a time: drivers have crashed where several threads did
/// so at once (NVIDIA's: gfx-rs/wgpu#5930 and #10234).
fn instance() -> &'static Mutex<wgpu::Instance> {
    static INSTANCE: OnceLock<Mutex<wgpu::Instance>> = OnceLock::new();
    INSTANCE.get_or_init(|| {
        Mutex::new(wgpu::Instance::new(wgpu::InstanceDescriptor {
            flags: wgpu::InstanceFlags::empty(),
            ..wgpu::InstanceDescriptor::new_without_display_handle()
        }))
    })
}

/// The optional features that the kernels need: none.
pub fn required_features() -> wgpu::Features {
    wgpu::Features::empty()
}

/// The limits to request for a device that runs the kernels on as large a scene as the adapter takes: wgpu's defaults,
/// with those that bound the size of a scene and its textures raised to what the adapter has (the default of 128 MiB
/// per storage binding is too small for scans), and lowered to that where it has less, as small GPUs do of what only
/// drawing needs. A device with wgpu's defaults is enough for small scenes.
pub fn required_limits(adapter: &wgpu::Adapter) -> wgpu::Limits {
    limits_for(adapter.limits())
}

fn limits_for(best: wgpu::Limits) -> wgpu::Limits {
    wgpu::Limits {
        max_buffer_size: best.max_buffer_size,
        max_storage_buffer_binding_size: best.max_storage_buffer_binding_size,
        max_texture_dimension_2d: best.max_texture_dimension_2d,
        ..wgpu::Limits::default().or_worse_values_from(&best)
    }
}

/// Storage buffers that a kernel binds at most: as many as wgpu's defaults and WebGPU grant.
pub(crate) const STORAGE_BUFFERS: u32 = 8;
/// Threads of a workgroup at most.
pub(crate) const THREADS: u32 = 256;

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
    /// software; `adapter` keeps only those whose name contains it (case does not matter). A program needs one, and
    /// clones of it: NVIDIA's driver can hang where one of several devices is dropped while others work.
    pub fn headless(adapter: Option<&str>) -> Result<Self> {
        // Without one, wgpu panics.
        if wgpu::Instance::enabled_backend_features().is_empty() {
            return Err(Error::device(
                "no graphics API was compiled in: build texir-gpu with its feature vulkan, metal or dx12, or wgpu with another",
            ));
        }
        let instance = instance().lock().unwrap_or_else(PoisonError::into_inner);
        let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
        let found: Vec<String> = adapters.iter().map(|a| a.get_info().name).collect();
        if let Some(name) = adapter {
            let name = name.to_lowercase();
            adapters.retain(|a| a.get_info().name.to_lowercase().contains(&name));
        }
        adapters.sort_by_key(|a| preference(a.get_info().device_type));
        // The first that serves: an old card beside a new one, or one API of two for the same card, may not.
        let mut failures = Vec::new();
        for chosen in &adapters {
            match Self::on(chosen) {
                Ok(gpu) => {
                    let rejected_adapters = failures.iter().map(Error::to_string).collect();
                    return Ok(Self { rejected_adapters, ..gpu });
                }
                Err(error) => failures.push(error),
            }
        }
        Err(failures.into_iter().next().unwrap_or_else(|| no_adapter(adapter, &found)))
    }

    fn on(adapter: &wgpu::Adapter) -> Result<Self> {
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("texir"),
            required_features: required_features(),
            required_limits: required_limits(adapter),
            ..Default::default()
        }))
        .map_err(|e| Error::device(format!("cannot create a device on adapter {:?}: {e}", adapter.get_info().name)))?;
        let gpu = Self::from_device(device, queue)?;
        let lost = gpu.lost.clone();
        gpu.device.set_device_lost_callback(move |reason, message| {
            // The first reason is the one that counts.
            let _ = lost.set(format!("{reason:?}: {message}"));
        });
        Ok(gpu)
    }

    /// Borrows a host program's device and queue (both are handles). Make the device with [`required_limits`]; one that
    /// the kernels do not run on is an error that names the limits. While a backend works, poll the device and wait for
    /// it as you like, but not with a time limit: wgpu up to 30.0.2 panics where another thread polls meanwhile
    /// (gfx-rs/wgpu#9958). Callbacks of yours may be called by the thread of the backend.
    ///
    /// Where the device is lost, passes are errors. wgpu panics then where it is polled, which is caught (but not where
    /// panics abort) after its message has gone to your panic hook; why the device was lost only your own callback is
    /// told, as none is set here.
    pub fn from_device(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self> {
        let info = Arc::new(device.adapter_info());
        match missing(&device.limits()) {
            None => Ok(Self {
                device,
                queue,
                info,
                rejected_adapters: Arc::default(),
                kernels: Arc::default(),
                lost: Arc::default(),
            }),
            Some(what) => Err(Error::device(format!(
                "the limits of device {:?} are too low: {what}; request texir_gpu::required_limits",
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

    /// Why [`Gpu::headless`] did not take the adapters that it prefers to this one.
    pub fn rejected_adapters(&self) -> &[String] {
        &self.rejected_adapters
    }

    /// Whether a processor plays the GPU, where other choices are faster.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// A kernel, compiled when it is first asked for.
    pub(crate) fn kernel(&self, spec: KernelKey) -> Result<Arc<Kernel>> {
        self.kernels().get(&self.device, spec)
    }

    fn kernels(&self) -> std::sync::MutexGuard<'_, Kernels> {
        // Kernels are added whole: one that panicked on the way was not.
        self.kernels.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs `work` and turns everything that the device reports meanwhile into an error, so that nothing reaches the
    /// device's uncaptured-error handler, which is the host program's.
    pub(crate) fn with_error_scopes<T>(&self, what: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let scopes = [wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Validation]
            .map(|filter| self.device.push_error_scope(filter));
        let result = work();
        // Scopes close in the opposite order of their opening.
        let mut reported = None;
        for scope in scopes.into_iter().rev() {
            reported = reported.or(pollster::block_on(scope.pop()));
        }
        match reported {
            Some(error) => {
                // One of them may have failed to be made, and would fail wherever it is used from now on.
                *self.kernels() = Kernels::default();
                // What is wrong may be that the device was lost, of which a poll tells.
                let _ = self.poll(wgpu::PollType::Poll);
                Err(self.failed(what, error))
            }
            // wgpu reports no loss to scopes: what was asked for on the way may be nothing at all.
            None => match self.lost.get() {
                Some(_) => result.and(Err(self.failed(what, "nothing can be done on it any more"))),
                None => result,
            },
        }
    }

    /// An error of the device's, with the reason where it was lost.
    fn failed(&self, what: &str, error: impl std::fmt::Display) -> Error {
        let lost = self.lost.get().map_or(String::new(), |why| format!(" (the device was lost: {why})"));
        Error::device(format!("{}: {what}: {error}{lost}", self.info.name))
    }

    /// Waits until all that was submitted is done.
    pub(crate) fn finish(&self) -> Result<()> {
        let (sender, done) = channel();
        self.queue.on_submitted_work_done(move || {
            // Nobody listens any more where waiting failed, which is reported instead.
            let _ = sender.send(());
        });
        self.wait_for(&done)
    }

    /// Waits for what a callback of the device's sends.
    pub(crate) fn wait_for<T>(&self, from: &Receiver<T>) -> Result<T> {
        let start = Instant::now();
        loop {
            // No wait of wgpu's serves: one without a limit keeps the host program from presenting, and one with a
            // limit panics where another thread polls the same device (gfx-rs/wgpu#9958). But only waits are sure to
            // end where a device is lost.
            let ask = match start.elapsed() < TOO_LONG {
                true => wgpu::PollType::Poll,
                false => wgpu::PollType::Wait { submission_index: None, timeout: None },
            };
            self.poll(ask)?;
            match from.try_recv() {
                Ok(answer) => return Ok(answer),
                Err(TryRecvError::Empty) => pause(start.elapsed()),
                Err(TryRecvError::Disconnected) => return Err(self.failed(WAITING, "its callback was dropped")),
            }
        }
    }

    /// Asks the device what is done. An error where wgpu panics, as it does where it finds the device lost: it is in the
    /// midst of nothing of ours then.
    fn poll(&self, ask: wgpu::PollType) -> Result<()> {
        match catch_unwind(AssertUnwindSafe(|| self.device.poll(ask))) {
            Ok(polled) => polled.map(drop).map_err(|error| self.failed(WAITING, error)),
            Err(panic) => {
                let said = panic.downcast_ref::<String>().map(String::as_str);
                let said = said.or(panic.downcast_ref().copied()).unwrap_or("a panic");
                Err(self.failed(WAITING, said))
            }
        }
    }
}

/// Lets others run before the device is asked again, after so long a wait: short waits are not made much longer, and
/// long ones take no processor time.
fn pause(waited: Duration) {
    if waited < MAX_POLL_INTERVAL / 8 {
        std::thread::yield_now();
    } else {
        std::thread::sleep((waited / 8).min(MAX_POLL_INTERVAL));
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
            Error::device(format!("no graphics adapter matches {name:?}; available: {}", found.join(", ")))
        }
        _ => Error::device("no graphics adapter was found"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_while_the_device_is_polled_is_an_error() {
        // As wgpu's own where it finds the device lost, which no call can bring about.
        let gpu = Gpu::headless(std::env::var("TEXIR_ADAPTER").ok().as_deref()).unwrap();
        gpu.queue.on_submitted_work_done(|| panic!("Parent device is lost"));
        let error = gpu.finish().unwrap_err();
        assert!(matches!(&error, Error::Device(what) if what.contains("Parent device is lost")), "{error}");
        gpu.finish().unwrap();
    }

    #[test]
    fn adapters_are_asked_for_no_more_than_they_have_nor_for_less_than_large_scenes_need() {
        // A small GPU, short of what only drawing needs; a large one.
        let small = wgpu::Limits { max_color_attachments: 4, max_texture_dimension_2d: 4096, ..Default::default() };
        assert_eq!(limits_for(small.clone()), small);
        let large = wgpu::Limits { max_buffer_size: 1 << 40, max_storage_buffer_binding_size: 1 << 40, ..small };
        assert_eq!(limits_for(large.clone()).max_storage_buffer_binding_size, 1 << 40);
        // One that the kernels do not run on is given as it is, and refused by name.
        let poor = wgpu::Limits { max_storage_buffers_per_shader_stage: 4, ..Default::default() };
        let what = missing(&limits_for(poor)).unwrap();
        assert!(what.contains("max_storage_buffers_per_shader_stage is 4; expected 8"), "{what}");
    }
}
