//! The texir kernels in WGSL through wgpu, on a device of their own or on a host program's.
//!
//! [`GpuBackend`] implements [`texir_core::backend::Backend`], which is all that the algorithms of `texir-core` need.
//! [`Gpu::headless`] makes a device; [`Gpu::from_device`] borrows one that an engine owns (made with at least
//! [`required_limits`]), and then nothing is set on the device, and no dispatch is much longer than a tenth of a second.
#![cfg_attr(test, allow(clippy::unwrap_used))]

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
pub mod wgsl;

pub use backend::GpuBackend;
pub use batch::GatherShape;
pub use gpu::{Gpu, required_features, required_limits};
pub use scene::Hierarchy;
pub use wgpu;
