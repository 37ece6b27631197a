//! Which backend runs the passes.

use std::cell::OnceCell;
use std::sync::Arc;

use texir_core::backend::Backend;
use texir_core::cpu::CpuBackend;
use texir_core::scene::Scene;
use texir_gpu::{Gpu, GpuBackend};

use crate::config::{BackendChoice, Config};
use crate::console::Console;
use crate::failure::{Context, Failure};
use crate::session::Session;

/// The GPU of a session once one was sought, which all its steps share: drivers are asked, and kernels compiled, once.
pub type FoundGpu = OnceCell<Option<Gpu>>;

/// Opens for a scene the backend that the user asked for, or the best there is.
pub fn open(scene: Scene, session: &Session<'_>) -> Result<Box<dyn Backend>, Failure> {
    let found = match session.gpu.get() {
        Some(found) => found.clone(),
        None => find_gpu(session.config, session.console)?,
    };
    let backend: Box<dyn Backend> = match session.gpu.get_or_init(|| found) {
        Some(gpu) => on(gpu, scene)?,
        None => Box::new(CpuBackend::new(scene)),
    };
    session.console.note(&format!("{:>24}  {}", "runs on", backend.name()));
    Ok(backend)
}

fn on(gpu: &Gpu, scene: impl Into<Arc<Scene>>) -> Result<Box<dyn Backend>, Failure> {
    Ok(Box::new(GpuBackend::new(gpu, scene).context("the GPU backend could not be set up")?))
}

/// Opens for a scene every backend that the user lets in, the CPU first: to compare them.
pub fn open_all(scene: &Arc<Scene>, session: &Session<'_>) -> Result<Vec<Box<dyn Backend>>, Failure> {
    let Config { backend, adapter, .. } = session.config;
    let mut backends: Vec<Box<dyn Backend>> = Vec::new();
    if *backend != BackendChoice::Gpu && adapter.is_none() {
        backends.push(Box::new(CpuBackend::new(scene.clone())));
    }
    if *backend != BackendChoice::Cpu {
        match headless(adapter.as_deref(), session.console) {
            Ok(gpu) => backends.push(on(&gpu, scene.clone())?),
            Err(error) if backends.is_empty() => return Err(error.into()),
            Err(error) => session.console.note(&error.to_string()),
        }
    }
    Ok(backends)
}

/// [`Gpu::headless`], telling of better adapters that do not serve.
fn headless(adapter: Option<&str>, console: &Console) -> texir_core::error::Result<Gpu> {
    let gpu = Gpu::headless(adapter)?;
    gpu.rejected_adapters().iter().for_each(|why| console.note(why));
    Ok(gpu)
}

fn find_gpu(config: &Config, console: &Console) -> Result<Option<Gpu>, Failure> {
    if config.backend == BackendChoice::Cpu {
        // Not even asked: loading a graphics driver takes time, and some of them talk.
        return Ok(None);
    }
    let adapter = config.adapter.as_deref();
    match (config.backend, headless(adapter, console)) {
        (BackendChoice::Auto, Ok(gpu)) if gpu.is_software() && adapter.is_none() => {
            console.detail("the only adapter is a software GPU; using the CPU backend, which is faster");
            Ok(None)
        }
        (_, Ok(gpu)) => Ok(Some(gpu)),
        (BackendChoice::Auto, Err(error)) if adapter.is_none() => {
            console.note(&format!("{error}; using the CPU backend (same results up to rounding)"));
            Ok(None)
        }
        (_, Err(error)) if adapter.is_some() => Err(Failure::from(error).help("name one that is there, or leave --adapter out; where there is none, install a Vulkan driver")),
        (_, Err(error)) => Err(Failure::from(error).help(
            "install a Vulkan driver (on Debian and Ubuntu, `apt install mesa-vulkan-drivers` also brings one that needs no \
             graphics card), or use --backend cpu",
        )),
    }
}
