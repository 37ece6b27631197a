//! Which backend runs the passes.

use std::sync::Arc;

use texir_core::backend::Backend;
use texir_core::cpu::CpuBackend;
use texir_core::scene::Scene;
use texir_gpu::{Gpu, GpuBackend};

use crate::config::{BackendChoice, Config};
use crate::console::Console;
use crate::failure::{Context, Failure};

/// Opens for a scene the backend that the user asked for, or the best there is.
pub fn open(scene: Scene, config: &Config, console: &Console) -> Result<Box<dyn Backend>, Failure> {
    let backend: Box<dyn Backend> = match find_gpu(config, console)? {
        Some(gpu) => Box::new(GpuBackend::new(&gpu, scene).context("the GPU backend could not be set up")?),
        None => Box::new(CpuBackend::new(scene)),
    };
    console.note(&format!("{:>24}  {}", "runs on", backend.name()));
    Ok(backend)
}

/// Opens for a scene every backend that the user lets in, the CPU first: to compare them.
pub fn open_all(scene: &Arc<Scene>, config: &Config, console: &Console) -> Result<Vec<Box<dyn Backend>>, Failure> {
    let mut backends: Vec<Box<dyn Backend>> = Vec::new();
    if config.backend != BackendChoice::Gpu && config.adapter.is_none() {
        backends.push(Box::new(CpuBackend::new(scene.clone())));
    }
    if config.backend != BackendChoice::Cpu {
        match Gpu::headless(config.adapter.as_deref()) {
            Ok(gpu) => backends
                .push(Box::new(GpuBackend::new(&gpu, scene.clone()).context("the GPU backend could not be set up")?)),
            Err(error) if backends.is_empty() => return Err(error.into()),
            Err(error) => console.note(&error.to_string()),
        }
    }
    Ok(backends)
}

fn find_gpu(config: &Config, console: &Console) -> Result<Option<Gpu>, Failure> {
    if config.backend == BackendChoice::Cpu {
        // Not even asked: loading a graphics driver takes time, and some of them talk.
        return Ok(None);
    }
    let adapter = config.adapter.as_deref();
    match (config.backend, Gpu::headless(adapter)) {
        (BackendChoice::Auto, Ok(gpu)) if gpu.is_cpu() && adapter.is_none() => {
            console.detail("the only adapter is a processor playing a GPU: the CPU backend traces faster");
            Ok(None)
        }
        (_, Ok(gpu)) => Ok(Some(gpu)),
        (BackendChoice::Auto, Err(error)) if adapter.is_none() => {
            console.detail(&error.to_string());
            console.note("no GPU adapter was found: the passes run on the CPU, which gives the same results");
            Ok(None)
        }
        (_, Err(error)) if adapter.is_some() => Err(Failure::from(error).help("name one that is there, or leave --adapter out; where there is none, install a Vulkan driver")),
        (_, Err(error)) => Err(Failure::from(error).help(
            "install a Vulkan driver (on Debian and Ubuntu, `apt install mesa-vulkan-drivers` also brings one that needs no \
             graphics card), or use --backend cpu",
        )),
    }
}
