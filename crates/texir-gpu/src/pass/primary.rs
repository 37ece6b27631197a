//! Host side of `primary.wgsl`.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use texir_core::camera::{Camera, Projection};
use texir_core::error::Result;
use texir_core::surface::Hit;

use super::WORKGROUP;
use crate::batch::Context;
use crate::scene::Geometry;

/// Kinds of cameras, as `camera.wgsl` has them.
pub(crate) const EQUIRECTANGULAR: u32 = 0;
const PINHOLE: u32 = 1;

/// A camera as `camera.wgsl` has it.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct CameraUniform {
    pub right: [f32; 3],
    pub kind: u32,
    pub up: [f32; 3],
    pub width: u32,
    pub back: [f32; 3],
    pub height: u32,
    pub position: [f32; 3],
    pub fx: f32,
    pub fy: f32,
    pub cx: f32,
    pub cy: f32,
    pub pad: f32,
}

impl From<&Camera> for CameraUniform {
    fn from(camera: &Camera) -> Self {
        let (kind, [fx, fy, cx, cy]) = match camera.projection {
            Projection::Equirectangular => (EQUIRECTANGULAR, [1.0, 1.0, 0.0, 0.0]),
            Projection::Pinhole { fx, fy, cx, cy } => (PINHOLE, [fx, fy, cx, cy]),
        };
        let m = camera.world_from_camera;
        let [right, up, back, position] =
            [m.x_axis, m.y_axis, m.z_axis, m.w_axis].map(|column| column.truncate().to_array());
        let (width, height) = (camera.width as u32, camera.height as u32);
        Self { right, kind, up, width, back, height, position, fx, fy, cx, cy, pad: 0.0 }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct PrimaryParams {
    pub first: u32,
    pub count: u32,
}

/// See [`texir_core::backend::Backend::primary`].
pub(crate) fn run(ctx: &mut Context, geometry: &Geometry, camera: &Camera, rows: Range<usize>) -> Result<Vec<Hit>> {
    let kernel = ctx.kernel("primary", "primary", None)?;
    let view = ctx.params(&CameraUniform::from(camera));
    let first = rows.start * camera.width;
    let all = rows.len() * camera.width;
    let mut out = Vec::with_capacity(all);
    ctx.one_ray_each(&kernel, all, |ctx, pixels| {
        let count = pixels.len();
        let params = ctx.params(&PrimaryParams { first: (first + pixels.start) as u32, count: count as u32 });
        let hits = ctx.pool.reserve(&ctx.gpu, "hits", (count * size_of::<Hit>()) as u64)?;
        let [nodes, triangles] = geometry.bindings();
        let own = [("camera", view.binding()), ("params", params.binding()), ("hits", hits.binding())];
        let groups = kernel.bind(ctx.gpu.device(), &[&[nodes, triangles][..], &own].concat())?;
        ctx.trace(&kernel, &groups, count.div_ceil(WORKGROUP), count as u64)?;
        out.extend(ctx.pool.download::<Hit>(&ctx.gpu, &hits, count)?);
        Ok(())
    })?;
    Ok(out)
}
