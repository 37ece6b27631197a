//! The texir kernels in WGSL through wgpu, on a device of their own or on a host program's.
//!
//! [`GpuBackend`] implements [`texir_core::backend::Backend`], which is all that the algorithms of `texir-core` need.
//! [`Gpu::headless`] makes a device; [`Gpu::from_device`] borrows one that an engine owns (made with
//! [`required_limits`], or for small scenes with wgpu's default limits), and then nothing is set on the device. Passes
//! that trace, search or denoise do so in dispatches of about a tenth of a second, or of
//! [`GpuBackend::set_dispatch_time`]. Those that go through their arrays once (lookups, losses, `shade_vjp`) are not
//! split: they take as long as that memory does. The engine's wgpu must be the version that is re-exported here as
//! [`wgpu`].
//!
//! The features `vulkan`, `metal` and `dx12`, on by default, are those of wgpu: what devices are found by.
#![cfg_attr(test, allow(clippy::unwrap_used))]

#[cfg(target_arch = "wasm32")]
compile_error!("texir-gpu waits for its device, which a browser does not allow");

mod backend;
mod batch;
mod buffer;
mod cache;
mod gpu;
mod kernel;
#[cfg(test)]
mod layouts;
mod pass;
mod scene;
mod wgsl;

pub use backend::GpuBackend;
pub use batch::GatherShape;
pub use gpu::{Gpu, required_features, required_limits};
pub use scene::BvhStorage;
pub use wgpu;
