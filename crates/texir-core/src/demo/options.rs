//! What is asked of the path tracer.

/// How much work to put into the images.
#[derive(Clone, Copy, Debug)]
pub struct RenderOptions {
    /// Every sample follows from it.
    pub seed: u64,
    /// Samples per pixel (box filter), each with its own specular paths.
    pub pixel_samples: usize,
    /// Emitter samples per texel for direct light; a quarter as many cosine samples come on top.
    pub light_samples: usize,
    /// Rays per texel of the indirect solution.
    pub gather_rays: usize,
    /// Specular reflections in a row that are followed; 0 makes every surface purely diffuse.
    pub specular_bounces: usize,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { seed: 1, pixel_samples: 16, light_samples: 40, gather_rays: 32, specular_bounces: 2 }
    }
}
