//! Host side of `project.wgsl`.

use bytemuck::{Pod, Zeroable};
use texir_core::backend::Projected;
use texir_core::camera::Camera;
use texir_core::cpu::project::CLEAR_SHARE;
use texir_core::error::Result;
use texir_core::surface::SurfacePoint;

use super::WORKGROUP;
use super::primary::CameraUniform;
use crate::batch::Context;
use crate::scene::Geometry;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct ProjectParams {
    pub count: u32,
    pub clear_share: f32,
}

/// See [`texir_core::backend::Backend::project`].
pub(crate) fn run(
    ctx: &mut Context,
    geometry: &Geometry,
    points: &[SurfacePoint],
    camera: &Camera,
) -> Result<Vec<Projected>> {
    let kernel = ctx.kernel("project", "project", None)?;
    let view = ctx.params(&CameraUniform::from(camera));
    let mut out = Vec::with_capacity(points.len());
    ctx.one_ray_each(&kernel, points.len(), |ctx, range| {
        let count = range.len();
        let params = ctx.params(&ProjectParams { count: count as u32, clear_share: CLEAR_SHARE as f32 });
        let points = ctx.pool.upload(&ctx.gpu, "points", &points[range])?;
        let projected = ctx.pool.reserve(&ctx.gpu, "projected", (count * size_of::<Projected>()) as u64)?;
        let own = [
            ("camera", view.binding()),
            ("params", params.binding()),
            ("points", points.binding()),
            ("projected", projected.binding()),
        ];
        let groups = kernel.bind(ctx.gpu.device(), &[&geometry.bindings()[..], &own].concat())?;
        ctx.trace(&kernel, &groups, count.div_ceil(WORKGROUP), count as u64)?;
        out.extend(ctx.pool.download::<Projected>(&ctx.gpu, &projected, count)?);
        Ok(())
    })?;
    Ok(out)
}
