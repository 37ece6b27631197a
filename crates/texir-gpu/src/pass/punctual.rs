//! Host side of `punctual.wgsl`.

use bytemuck::{Pod, Zeroable};
use texir_core::cpu::project::CLEAR_SHARE;
use texir_core::error::Result;
use texir_core::progress::Progress;
use texir_core::punctual::PunctualLight;
use texir_core::surface::SurfacePoint;

use super::WORKGROUP;
use crate::batch::Context;
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
    let mut sums = vec![[0.0; 3]; points.len()];
    for light in lights {
        let light = ctx.params(light);
        ctx.one_ray_each(points.len(), |ctx, range| {
            progress.check()?;
            let count = range.len();
            let params = ctx.params(&PunctualParams { count: count as u32, clear_share: CLEAR_SHARE as f32 });
            let batch = ctx.pool.upload(&ctx.gpu, "points", &points[range.clone()])?;
            let irradiance = ctx.pool.reserve(&ctx.gpu, "irradiance", (count * size_of::<[f32; 4]>()) as u64)?;
            let own = [
                ("light", light.binding()),
                ("params", params.binding()),
                ("points", batch.binding()),
                ("irradiance", irradiance.binding()),
            ];
            let groups = kernel.bind(&ctx.gpu, &[&geometry.bindings()[..], &own].concat())?;
            ctx.submit_rays(count as u64, |pass| kernel.record(pass, &groups, count.div_ceil(WORKGROUP)))?;
            for (sum, e) in sums[range].iter_mut().zip(ctx.pool.download::<[f32; 4]>(&ctx.gpu, &irradiance, count)?) {
                *sum = [sum[0] + e[0], sum[1] + e[1], sum[2] + e[2]];
            }
            progress.advance(count as u64);
            Ok(())
        })?;
    }
    Ok(sums)
}
