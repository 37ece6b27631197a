//! Host side of `shade.wgsl`.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use texir_core::backend::{Material, RoughnessGradient, Sampling, ShadePoint, Shaded};
use texir_core::error::Result;
use texir_core::progress::Progress;

use super::device::{self, laid_out};
use crate::batch::{BatchedPass, Context, GatherShape};
use crate::buffer::View;
use crate::kernel::Kernel;
use crate::scene::{Geometry, Lighting};

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct ShadeParams {
    pub first_item: u32,
    pub end_item: u32,
    pub first_sample: u32,
    pub end_sample: u32,
    pub samples: u32,
    pub seed: u32,
}

struct Shade<'a> {
    kernel: Arc<Kernel>,
    geometry: &'a Geometry,
    lighting: &'a Lighting,
    points: &'a [ShadePoint],
    materials: &'a [Material],
    sampling: Sampling,
    shape: GatherShape,
    out: Vec<Shaded>,
}

/// Pixels, materials and running sums of a batch.
struct Batch {
    points: View,
    materials: View,
    shaded: View,
}

impl BatchedPass for Shade<'_> {
    const ITEM_BYTES: usize = size_of::<device::ShadePoint>();
    type Batch = Batch;

    fn kernel(&self, _: usize) -> &Kernel {
        &self.kernel
    }

    fn upload(&mut self, ctx: &mut Context, items: Range<usize>) -> Result<Batch> {
        Ok(Batch {
            points: ctx.pool.upload(
                &ctx.gpu,
                "shade points",
                &laid_out::<_, device::ShadePoint>(&self.points[items.clone()]),
            )?,
            materials: ctx.pool.upload(
                &ctx.gpu,
                "materials",
                &laid_out::<_, device::Material>(&self.materials[items.clone()]),
            )?,
            shaded: ctx.pool.reserve(&ctx.gpu, "shaded", (items.len() * size_of::<device::Shaded>()) as u64)?,
        })
    }

    fn dispatch(
        &mut self,
        ctx: &mut Context,
        batch: &Batch,
        _: usize,
        items: Range<usize>,
        samples: Range<u32>,
    ) -> Result<()> {
        let params = ctx.params(&ShadeParams {
            first_item: items.start as u32,
            end_item: items.end as u32,
            first_sample: samples.start,
            end_sample: samples.end,
            samples: self.sampling.samples,
            seed: self.sampling.seed,
        });
        let own = [
            ("params", params.binding()),
            ("points", batch.points.binding()),
            ("materials", batch.materials.binding()),
            ("shaded", batch.shaded.binding()),
        ];
        let groups = self.kernel.bind(ctx.gpu.device(), &[&self.geometry.lit_by(self.lighting)[..], &own].concat())?;
        let workgroups = items.len().div_ceil(self.shape.items_per_workgroup());
        let rays = items.len() as u64 * samples.len() as u64;
        ctx.trace(&self.kernel, &groups, workgroups, rays)
    }

    fn collect(&mut self, ctx: &mut Context, batch: Batch, count: usize) -> Result<()> {
        let shaded = ctx.pool.download::<device::Shaded>(&ctx.gpu, &batch.shaded, count)?;
        self.out.extend(shaded.into_iter().map(Shaded::from));
        Ok(())
    }
}

/// See [`texir_core::backend::Backend::shade`].
pub(crate) fn run(
    ctx: &mut Context,
    (geometry, lighting): (&Geometry, &Lighting),
    (points, materials): (&[ShadePoint], &[Material]),
    (sampling, gradient): (Sampling, RoughnessGradient),
    shape: GatherShape,
    progress: &dyn Progress,
) -> Result<Vec<Shaded>> {
    let kernel = ctx.kernel_with("shade", "shade", Some(("LANES", shape.threads_per_item)), gradient)?;
    let out = Vec::with_capacity(points.len());
    let mut pass = Shade { kernel, geometry, lighting, points, materials, sampling, shape, out };
    ctx.gather(points.len(), [sampling.samples], shape, progress, &mut pass)?;
    Ok(pass.out)
}
