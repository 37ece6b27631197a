//! Host side of `punctual.wgsl`.

use bytemuck::{Pod, Zeroable};
use texir_core::cpu::project::CLEAR_SHARE;
use texir_core::error::Result;
use texir_core::progress::Progress;
use texir_core::punctual::PunctualLight;
use texir_core::surface::SurfacePoint;

use super::{WORKGROUP, device};
use crate::batch::Context;
use crate::buffer::View;
use crate::scene::Geometry;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct PunctualParams {
    pub count: u32,
    pub clear_share: f32,
}

/// See [`texir_core::backend::Backend::punctual`].
pub(crate) fn run(
    ctx: &mut Context,
    geometry: &Geometry,
    points: &[SurfacePoint],
    lights: &[PunctualLight],
    progress: &dyn Progress,
) -> Result<Vec<[f32; 3]>> {
    let kernel = ctx.kernel("punctual", "punctual", None)?;
    let lights: Vec<View> = lights.iter().map(|light| ctx.params(&device::PunctualLight::from(light))).collect();
    let mut sums = vec![[0.0; 3]; points.len()];
    ctx.one_ray_each(&kernel, points.len(), |ctx, range| {
        let count = range.len();
        let params = ctx.params(&PunctualParams { count: count as u32, clear_share: CLEAR_SHARE as f32 });
        let batch = ctx.pool.upload(&ctx.gpu, "points", &points[range.clone()])?;
        let irradiance = ctx.pool.reserve(&ctx.gpu, "irradiance", (count * size_of::<[f32; 4]>()) as u64)?;
        irradiance.clear(&ctx.gpu);
        for light in &lights {
            progress.check()?;
            let own = [
                ("light", light.binding()),
                ("params", params.binding()),
                ("points", batch.binding()),
                ("irradiance", irradiance.binding()),
            ];
            let groups = kernel.bind(ctx.gpu.device(), &[&geometry.bindings()[..], &own].concat())?;
            ctx.trace(&kernel, &groups, count.div_ceil(WORKGROUP), count as u64)?;
            progress.advance(count as u64);
        }
        for (sum, e) in sums[range].iter_mut().zip(ctx.pool.download::<[f32; 4]>(&ctx.gpu, &irradiance, count)?) {
            *sum = [e[0], e[1], e[2]];
        }
        Ok(())
    })?;
    Ok(sums)
}
