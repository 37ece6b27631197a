//! Host side of `specular_table.wgsl`.

use std::array::from_fn;
use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use texir_core::backend::ShadePoint;
use texir_core::error::Result;
use texir_core::progress::Progress;
use texir_core::specular_table::{Curve, LOBES, NODES, STRATA, TableSampling, node};

use super::device::{self, laid_out};
use crate::batch::{BatchedPass, Context, GatherShape};
use crate::buffer::View;
use crate::kernel::Kernel;
use crate::scene::{Geometry, Lighting};

/// How samples are dealt to threads; the shader has the same number of lanes.
pub(crate) const SHAPE: GatherShape = GatherShape { threads_per_item: 8, rays_per_thread: 32 };

/// Values of the shader's constant `TECHNIQUE`.
pub(crate) const FROM_LOBES: u32 = 0;
pub(crate) const FROM_COSINE: u32 = 1;
pub(crate) const FROM_LIGHTS: u32 = 2;
const TECHNIQUES: [u32; 3] = [FROM_LOBES, FROM_COSINE, FROM_LIGHTS];

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct SpecularTableParams {
    pub first_item: u32,
    pub end_item: u32,
    pub first_sample: u32,
    pub end_sample: u32,
    pub lobe_samples: u32,
    pub cosine_samples: u32,
    pub light_samples: u32,
    pub seed: u32,
    pub f0: f32,
    pub masking: u32,
    pub padding: [u32; 2],
    pub lobes: [f32; 8],
    pub nodes: [f32; NODES],
}

/// Sums over samples at the nodes of a pixel.
type Sums = [[f32; 3]; NODES];

struct SpecularTable<'a> {
    kernels: [Arc<Kernel>; TECHNIQUES.len()],
    geometry: &'a Geometry,
    lighting: &'a Lighting,
    pixels: &'a [[ShadePoint; STRATA]],
    f0: f32,
    sampling: TableSampling,
    out: Vec<Curve>,
}

/// Pixels and running sums of a batch.
struct Batch {
    pixels: View,
    tables: View,
}

impl BatchedPass for SpecularTable<'_> {
    const ITEM_BYTES: usize = size_of::<Sums>();
    type Batch = Batch;

    fn kernel(&self, technique: usize) -> &Kernel {
        &self.kernels[technique]
    }

    fn upload(&mut self, ctx: &mut Context, items: Range<usize>) -> Result<Batch> {
        let tables = ctx.pool.reserve(&ctx.gpu, "specular tables", (items.len() * size_of::<Sums>()) as u64)?;
        tables.clear(&ctx.gpu);
        let strata = laid_out::<_, device::ShadePoint>(self.pixels[items].as_flattened());
        Ok(Batch { pixels: ctx.pool.upload(&ctx.gpu, "strata", &strata)?, tables })
    }

    fn dispatch(
        &mut self,
        ctx: &mut Context,
        batch: &Batch,
        technique: usize,
        items: Range<usize>,
        samples: Range<u32>,
    ) -> Result<()> {
        let params = ctx.params(&SpecularTableParams {
            first_item: items.start as u32,
            end_item: items.end as u32,
            first_sample: samples.start,
            end_sample: samples.end,
            lobe_samples: self.sampling.lobe,
            cosine_samples: self.sampling.cosine,
            light_samples: self.sampling.light,
            seed: self.sampling.seed,
            f0: self.f0,
            masking: self.sampling.masking as u32,
            padding: [0; 2],
            lobes: from_fn(|lobe| LOBES.get(lobe).copied().unwrap_or(0.0)),
            nodes: from_fn(node),
        });
        let own =
            [("params", params.binding()), ("pixels", batch.pixels.binding()), ("tables", batch.tables.binding())];
        let kernel = &self.kernels[technique];
        let groups = kernel.bind(
            ctx.gpu.device(),
            &[&self.geometry.lit_by(self.lighting)[..], &self.lighting.lights(), &own].concat(),
        )?;
        let workgroups = items.len().div_ceil(SHAPE.items_per_workgroup());
        let rays = items.len() as u64 * samples.len() as u64;
        ctx.trace(kernel, &groups, workgroups, rays)
    }

    fn collect(&mut self, ctx: &mut Context, batch: Batch, count: usize) -> Result<()> {
        let mean = |sums: Sums| Curve::new(sums.map(|sum| sum.map(|c| c / STRATA as f32)));
        self.out.extend(ctx.pool.download::<Sums>(&ctx.gpu, &batch.tables, count)?.into_iter().map(mean));
        Ok(())
    }
}

/// See [`texir_core::backend::Backend::specular_tables`].
pub(crate) fn run(
    ctx: &mut Context,
    (geometry, lighting): (&Geometry, &Lighting),
    (pixels, f0): (&[[ShadePoint; STRATA]], f32),
    sampling: TableSampling,
    progress: &dyn Progress,
) -> Result<Vec<Curve>> {
    // Without lights there is nothing to aim at, and the heuristic must not count samples that are not drawn.
    let asked = sampling.rays();
    let sampling = TableSampling { light: if lighting.clusters == 0 { 0 } else { sampling.light }, ..sampling };
    let [lobes, cosine, lights] =
        TECHNIQUES.map(|t| ctx.kernel("specular_table", "specular_table", Some(("TECHNIQUE", t))));
    let samples = [LOBES.len() as u32 * sampling.lobe, sampling.cosine, sampling.light].map(|n| STRATA as u32 * n);
    let out = Vec::with_capacity(pixels.len());
    let mut pass = SpecularTable { kernels: [lobes?, cosine?, lights?], geometry, lighting, pixels, f0, sampling, out };
    ctx.gather(pixels.len(), samples, SHAPE, progress, &mut pass)?;
    progress.advance(pixels.len() as u64 * u64::from(asked - sampling.rays()));
    Ok(pass.out)
}
