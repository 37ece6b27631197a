//! Which backend runs the passes.

use texir_core::backend::Backend;
use texir_core::cpu::CpuBackend;
use texir_core::scene::Scene;

use crate::args::{BackendChoice, Config};
use crate::console::Console;
use crate::failure::Failure;

/// Opens the backend that the user asked for, or the best there is.
pub fn open<'a>(scene: &'a Scene, config: &Config, console: &Console) -> Result<Box<dyn Backend + 'a>, Failure> {
    if config.backend == BackendChoice::Gpu {
        return Err(Failure::new("this build has no GPU backend").help("use --backend cpu"));
    }
    let backend = Box::new(CpuBackend::new(scene));
    console.note(&format!("{:>24}  {}", "runs on", backend.name()));
    Ok(backend)
}
