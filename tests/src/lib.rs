//! What the tests that cross crates share: an adapter, tolerances that report every failing lane, and small scenes made
//! in code.

pub mod compare;
pub mod gltf;
pub mod scenes;

use std::sync::OnceLock;

use texir_gpu::Gpu;

/// The device to test on: `TEXIR_ADAPTER` names it, otherwise the best. Logs which. Having none is a failure. All tests
/// of a program share it: NVIDIA's driver can hang where one of several devices is destroyed while others work.
pub fn gpu() -> Gpu {
    static SHARED: OnceLock<Gpu> = OnceLock::new();
    let open = || {
        let wanted = std::env::var("TEXIR_ADAPTER").ok();
        let gpu = Gpu::headless(wanted.as_deref()).unwrap_or_else(|e| panic!("the GPU tests cannot run: {e}"));
        eprintln!("adapter: {}", gpu.describe());
        gpu
    };
    SHARED.get_or_init(open).clone()
}
