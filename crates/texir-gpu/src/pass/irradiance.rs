//! Host side of `irradiance.wgsl`.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use texir_core::backend::{Gather, Gathered, Sequences};
use texir_core::error::Result;
use texir_core::progress::Progress;
use texir_core::rng::sort_by_hilbert;
use texir_core::surface::SurfacePoint;

use crate::batch::{BatchedPass, Context, GatherShape};
use crate::buffer::View;
use crate::kernel::Kernel;
use crate::scene::{Geometry, Lighting};

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct IrradianceParams {
    pub first_item: u32,
    pub end_item: u32,
    pub first_sample: u32,
    pub end_sample: u32,
    pub cosine_samples: u32,
    pub light_samples: u32,
    pub environment_samples: u32,
    pub seed: u32,
    pub part: u32,
    pub parts: u32,
    pub width: u32,
    pub environment_rows: u32,
}

struct Irradiance<'a> {
    /// By technique: cosine, lights, sky.
    kernels: [Arc<Kernel>; 3],
    /// Samples by technique.
    samples: [u32; 3],
    geometry: &'a Geometry,
    lighting: &'a Lighting,
    points: &'a [SurfacePoint],
    gather: Gather,
    shape: GatherShape,
    out: Vec<Gathered>,
}

/// Points and running sums of a batch.
struct Batch {
    points: View,
    gathered: View,
}

impl BatchedPass for Irradiance<'_> {
    const ITEM_BYTES: usize = size_of::<SurfacePoint>();
    type Batch = Batch;

    fn kernel(&self, technique: usize) -> &Kernel {
        &self.kernels[technique]
    }

    fn upload(&mut self, ctx: &mut Context, items: Range<usize>) -> Result<Batch> {
        let gathered = ctx.pool.reserve(&ctx.gpu, "gathered", (items.len() * size_of::<Gathered>()) as u64)?;
        Ok(Batch { points: ctx.pool.upload(&ctx.gpu, "points", &self.points[items])?, gathered })
    }

    fn dispatch(
        &mut self,
        ctx: &mut Context,
        batch: &Batch,
        technique: usize,
        items: Range<usize>,
        samples: Range<u32>,
    ) -> Result<()> {
        let ([part, parts], width) = match self.gather.sequences {
            Sequences::Own { part } => ([part, 1], 0),
            Sequences::Shared { width, part, parts } => ([part, parts], width.max(1)),
        };
        let params = ctx.params(&IrradianceParams {
            first_item: items.start as u32,
            end_item: items.end as u32,
            first_sample: samples.start,
            end_sample: samples.end,
            cosine_samples: self.samples[0],
            light_samples: self.samples[1],
            environment_samples: self.samples[2],
            seed: self.gather.seed,
            part,
            parts,
            width,
            environment_rows: self.geometry.sky.rows,
        });
        let order = sort_by_hilbert(samples.clone().collect());
        let order = ctx.pool.upload(&ctx.gpu, "sample order", &order)?;
        let own = [
            ("params", params.binding()),
            ("points", batch.points.binding()),
            ("gathered", batch.gathered.binding()),
            ("sample_order", order.binding()),
        ];
        let kernel = &self.kernels[technique];
        let scene =
            [&self.geometry.lit_by(self.lighting)[..], &self.geometry.sky.bindings(), &self.lighting.lights()].concat();
        let groups = kernel.bind(ctx.gpu.device(), &[&scene[..], &own].concat())?;
        let workgroups = items.len().div_ceil(self.shape.items_per_workgroup());
        let rays = items.len() as u64 * samples.len() as u64;
        ctx.trace(kernel, &groups, workgroups, rays)
    }

    fn collect(&mut self, ctx: &mut Context, batch: Batch, count: usize) -> Result<()> {
        self.out.extend(ctx.pool.download::<Gathered>(&ctx.gpu, &batch.gathered, count)?);
        Ok(())
    }
}

/// See [`texir_core::backend::Backend::irradiance`].
pub(crate) fn run(
    ctx: &mut Context,
    (geometry, lighting): (&Geometry, &Lighting),
    points: &[SurfacePoint],
    gather: Gather,
    shape: GatherShape,
    progress: &dyn Progress,
) -> Result<Vec<Gathered>> {
    let lanes = Some(("LANES", shape.threads_per_item));
    let mut kernel = |entry| ctx.kernel("irradiance", entry, lanes);
    let kernels = [kernel("gather_cosine")?, kernel("gather_lights")?, kernel("gather_environment")?];
    // The heuristic must not count samples that are not drawn.
    let [light, sky] = gather.light_and_sky(lighting.clusters > 0, geometry.sky.rows > 0);
    let samples = [gather.cosine, light, sky];
    let out = Vec::with_capacity(points.len());
    let mut pass = Irradiance { kernels, samples, geometry, lighting, points, gather, shape, out };
    ctx.gather(points.len(), samples, shape, progress, &mut pass)?;
    // Rays to what there is not were asked for too.
    progress.advance(points.len() as u64 * u64::from(gather.light - light - sky));
    Ok(pass.out)
}
