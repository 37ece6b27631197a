//! Host side of `irradiance.wgsl`.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use texir_core::backend::Sampling;
use texir_core::error::Result;
use texir_core::progress::Progress;
use texir_core::surface::SurfacePoint;

use super::WORKGROUP;
use crate::batch::{Context, Gather, GatherShape};
use crate::buffer::View;
use crate::kernel::Kernel;
use crate::scene::Geometry;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct IrradianceParams {
    pub count: u32,
    pub first_point: u32,
    pub first_sample: u32,
    pub end_sample: u32,
    pub samples: u32,
    pub seed: u32,
}

struct Irradiance<'a> {
    kernel: Arc<Kernel>,
    geometry: &'a Geometry,
    tbl: &'a wgpu::TextureView,
    points: &'a [SurfacePoint],
    sampling: Sampling,
    lanes: u32,
    out: Vec<[f32; 3]>,
}

/// Points and running sums of a batch.
struct Batch {
    points: View,
    sums: View,
}

impl Gather for Irradiance<'_> {
    type Prepared = Batch;

    fn upload(&mut self, ctx: &mut Context, items: Range<usize>) -> Result<Batch> {
        let sums = ctx.pool.reserve(&ctx.gpu, "irradiance sums", (items.len() * size_of::<[f32; 3]>()) as u64)?;
        Ok(Batch { points: ctx.pool.upload(&ctx.gpu, "points", &self.points[items])?, sums })
    }

    fn dispatch(&mut self, ctx: &mut Context, batch: &Batch, items: Range<usize>, samples: Range<u32>) -> Result<()> {
        let params = ctx.params(&IrradianceParams {
            count: items.len() as u32,
            first_point: items.start as u32,
            first_sample: samples.start,
            end_sample: samples.end,
            samples: self.sampling.samples,
            seed: self.sampling.seed,
        });
        let own = [
            ("params", params.binding()),
            ("points", batch.points.binding()),
            ("irradiance_sums", batch.sums.binding()),
        ];
        let groups = self.kernel.bind(&ctx.gpu, &[&self.geometry.lighting_bindings(self.tbl)[..], &own].concat())?;
        let workgroups = items.len().div_ceil(WORKGROUP / self.lanes as usize);
        let rays = items.len() as u64 * samples.len() as u64;
        ctx.submit_rays(rays, |pass| self.kernel.record(pass, &groups, workgroups))
    }

    fn collect(&mut self, ctx: &mut Context, batch: Batch, count: usize) -> Result<()> {
        self.out.extend(ctx.pool.download::<[f32; 3]>(&ctx.gpu, &batch.sums, count)?);
        Ok(())
    }
}

/// See [`texir_core::backend::Backend::irradiance`].
pub(crate) fn run(
    ctx: &mut Context,
    (geometry, tbl): (&Geometry, &wgpu::TextureView),
    points: &[SurfacePoint],
    sampling: Sampling,
    shape: GatherShape,
    progress: &dyn Progress,
) -> Result<Vec<[f32; 3]>> {
    let kernel = ctx.kernel("irradiance", "irradiance", Some(("LANES", shape.lanes)))?;
    let out = Vec::with_capacity(points.len());
    let mut pass = Irradiance { kernel, geometry, tbl, points, sampling, lanes: shape.lanes, out };
    ctx.gather(points.len(), sampling, shape, progress, &mut pass)?;
    Ok(pass.out)
}
