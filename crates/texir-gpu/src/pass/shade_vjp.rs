//! Host side of `shade_vjp.wgsl`.

use bytemuck::{Pod, Zeroable};
use texir_core::backend::{Material, MaterialGrad, ShadePoint, Shaded};
use texir_core::error::Result;

use super::WORKGROUP;
use super::device::{self, laid_out};
use crate::batch::Context;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct ShadeVjpParams {
    pub count: u32,
}

/// See [`texir_core::backend::Backend::shade_vjp`].
pub(crate) fn run(
    ctx: &mut Context,
    points: &[ShadePoint],
    materials: &[Material],
    shaded: &[Shaded],
    d_radiance: &[[f32; 3]],
) -> Result<Vec<MaterialGrad>> {
    let kernel = ctx.kernel("shade_vjp", "shade_vjp", None)?;
    let count = points.len();
    let params = ctx.params(&ShadeVjpParams { count: count as u32 });
    let (pool, gpu) = (&mut ctx.pool, &ctx.gpu);
    let points = pool.upload(gpu, "shade points", &laid_out::<_, device::ShadePoint>(points))?;
    let materials = pool.upload(gpu, "materials", &laid_out::<_, device::Material>(materials))?;
    let shaded = pool.upload(gpu, "shaded", &laid_out::<_, device::Shaded>(shaded))?;
    let d_radiance = pool.upload(gpu, "d_radiance", d_radiance)?;
    let d_materials = pool.reserve(gpu, "d_materials", (count * size_of::<device::MaterialGrad>()) as u64)?;
    let groups = kernel.bind(
        gpu.device(),
        &[
            ("params", params.binding()),
            ("points", points.binding()),
            ("materials", materials.binding()),
            ("shaded", shaded.binding()),
            ("d_radiance", d_radiance.binding()),
            ("d_materials", d_materials.binding()),
        ],
    )?;
    ctx.submit(|pass| kernel.record(pass, &groups, count.div_ceil(WORKGROUP)))?;
    let gradients = ctx.pool.download::<device::MaterialGrad>(&ctx.gpu, &d_materials, count)?;
    Ok(gradients.into_iter().map(MaterialGrad::from).collect())
}
