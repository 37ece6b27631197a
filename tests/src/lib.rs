//! What the tests that cross crates share: an adapter, tolerances that report every failing lane, and small scenes made
//! in code.

pub mod compare;
pub mod gltf;
pub mod scenes;

use std::sync::Once;

use texir_gpu::Gpu;

/// The device to test on: `TEXIR_ADAPTER` names one, otherwise the best. Logs which. Having none is a failure.
pub fn gpu() -> Gpu {
    static LOG: Once = Once::new();
    let wanted = std::env::var("TEXIR_ADAPTER").ok();
    match Gpu::headless(wanted.as_deref()) {
        Ok(gpu) => {
            LOG.call_once(|| eprintln!("adapter: {}", gpu.describe()));
            gpu
        }
        Err(e) => panic!("the GPU tests cannot run: {e}"),
    }
}
