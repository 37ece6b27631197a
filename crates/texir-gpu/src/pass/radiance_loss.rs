//! Host side of `radiance_loss.wgsl`.

use bytemuck::{Pod, Zeroable};
use texir_core::backend::Loss;
use texir_core::error::Result;

use super::WORKGROUP;
use crate::batch::Context;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct RadianceLossParams {
    pub count: u32,
    pub share: f32,
}

/// See [`texir_core::backend::Backend::radiance_loss`].
pub(crate) fn run(ctx: &mut Context, rendered: &[[f32; 3]], target: &[[f32; 3]]) -> Result<Loss<[f32; 3]>> {
    let kernel = ctx.kernel("radiance_loss", "radiance_loss", None)?;
    let (count, workgroups) = (rendered.len(), rendered.len().div_ceil(WORKGROUP));
    let share = (1.0 / (3.0 * count as f64)) as f32;
    let params = ctx.params(&RadianceLossParams { count: count as u32, share });
    let (pool, gpu) = (&mut ctx.pool, &ctx.gpu);
    let rendered = pool.upload(gpu, "rendered", rendered)?;
    let target = pool.upload(gpu, "target radiance", target)?;
    let d_rendered = pool.reserve(gpu, "d_radiance", (count * size_of::<[f32; 3]>()) as u64)?;
    let losses = pool.reserve(gpu, "losses", (workgroups * size_of::<f32>()) as u64)?;
    let groups = kernel.bind(
        gpu.device(),
        &[
            ("params", params.binding()),
            ("rendered", rendered.binding()),
            ("target_radiance", target.binding()),
            ("d_rendered", d_rendered.binding()),
            ("losses", losses.binding()),
        ],
    )?;
    ctx.submit(|pass| kernel.record(pass, &groups, workgroups))?;
    let value: f64 = ctx.pool.download::<f32>(&ctx.gpu, &losses, workgroups)?.into_iter().map(f64::from).sum();
    Ok(Loss { value: value as f32, gradient: ctx.pool.download(&ctx.gpu, &d_rendered, count)? })
}
