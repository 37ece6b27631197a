//! Host side of `lookup.wgsl`: the gather over footprint rows forward, over columns backward, with the pyramid's passes
//! (`mip.wgsl`) before and after.

use bytemuck::{Pod, Zeroable};
use texir_core::error::Result;
use texir_core::texture::{Footprints, Pyramid, SparseRows, Tap};

use super::WORKGROUP;
use super::mip::{Direction, Levels};
use crate::batch::Context;
use crate::buffer::View;
use crate::cache::Cache;

/// Taps that a thread adds in one dispatch: far below the loop iterations that software drivers allow.
const MAX_TAPS: u32 = 16_384;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct LookupParams {
    pub rows: u32,
    pub channels: u32,
    pub first_tap: u32,
    pub taps: u32,
}

/// What stays on the device between calls: footprints and pyramids are fixed for a whole fit.
#[derive(Default)]
pub(crate) struct LookupCache {
    coverage: Cache<f32>,
    offsets: Cache<u32>,
    taps: Cache<Tap>,
    touched: Cache<u32>,
}

/// One gather, ready to be recorded: its kernel, bind groups per range of taps, and workgroups.
struct Dispatches {
    kernel: std::sync::Arc<crate::kernel::Kernel>,
    steps: Vec<Vec<wgpu::BindGroup>>,
    workgroups: usize,
}

impl Dispatches {
    fn record(&self, pass: &mut wgpu::ComputePass) {
        for groups in &self.steps {
            self.kernel.record(pass, groups, self.workgroups);
        }
    }
}

/// Prepares `destination = rows · source`; with `touched`, row i is stored at item `touched[i]`.
fn gathering(
    ctx: &mut Context,
    cache: &mut LookupCache,
    rows: &SparseRows,
    channels: usize,
    (source, destination): (&View, &View),
    touched: Option<&[u32]>,
) -> Result<Dispatches> {
    let kernel = ctx.kernel("lookup", if touched.is_some() { "lookup_vjp" } else { "lookup" }, None)?;
    let offsets = cache.offsets.get(&ctx.gpu, "footprint offsets", &rows.offsets)?;
    let taps = cache.taps.get(&ctx.gpu, "footprint taps", &rows.taps)?;
    let touched = touched.map(|t| cache.touched.get(&ctx.gpu, "touched texels", t)).transpose()?;
    let longest = rows.offsets.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0);
    let mut steps = Vec::new();
    for first_tap in (0..longest.max(1)).step_by(MAX_TAPS as usize) {
        let (rows, channels) = (rows.len() as u32, channels as u32);
        let params = ctx.params(&LookupParams { rows, channels, first_tap, taps: MAX_TAPS });
        let mut resources = vec![
            ("params", params.binding()),
            ("offsets", offsets.binding()),
            ("taps", taps.binding()),
            ("source", source.binding()),
            ("destination", destination.binding()),
        ];
        resources.extend(touched.as_ref().map(|t| ("touched", t.binding())));
        steps.push(kernel.bind(ctx.gpu.device(), &resources)?);
    }
    Ok(Dispatches { kernel, steps, workgroups: (rows.len() * channels).div_ceil(WORKGROUP) })
}

fn coverage(ctx: &Context, cache: &mut LookupCache, pyramid: &Pyramid) -> Result<View> {
    cache.coverage.get(&ctx.gpu, "pyramid coverage", &pyramid.coverage)
}

/// See [`texir_core::backend::Backend::lookup`].
pub(crate) fn run(
    ctx: &mut Context,
    cache: &mut LookupCache,
    pyramid: &Pyramid,
    texture: &[f32],
    channels: usize,
    footprints: &SparseRows,
) -> Result<Vec<f32>> {
    let count = footprints.len() * channels;
    let coverage = coverage(ctx, cache, pyramid)?;
    let texels = ctx.pool.reserve(&ctx.gpu, "pyramid", (pyramid.len() * channels * 4) as u64)?;
    ctx.pool.write(&ctx.gpu, &texels, texture)?;
    let values = ctx.pool.reserve(&ctx.gpu, "looked-up values", (count * 4) as u64)?;
    let levels = Levels::new(ctx, pyramid, &coverage, &texels, channels, Direction::Reduce)?;
    let gathering = gathering(ctx, cache, footprints, channels, (&texels, &values), None)?;
    ctx.submit(|pass| {
        levels.record(pass);
        gathering.record(pass);
    })?;
    ctx.pool.download(&ctx.gpu, &values, count)
}

/// See [`texir_core::backend::Backend::lookup_vjp`].
pub(crate) fn run_vjp(
    ctx: &mut Context,
    cache: &mut LookupCache,
    pyramid: &Pyramid,
    d_values: &[f32],
    channels: usize,
    footprints: &Footprints,
) -> Result<Vec<f32>> {
    let coverage = coverage(ctx, cache, pyramid)?;
    let d_values = ctx.pool.upload(&ctx.gpu, "looked-up values", d_values)?;
    let d_texels = ctx.pool.reserve(&ctx.gpu, "pyramid", (pyramid.len() * channels * 4) as u64)?;
    d_texels.clear(&ctx.gpu);
    let source = (&d_values, &d_texels);
    let gathering = gathering(ctx, cache, &footprints.columns, channels, source, Some(&footprints.touched))?;
    let levels = Levels::new(ctx, pyramid, &coverage, &d_texels, channels, Direction::ReduceVjp)?;
    ctx.submit(|pass| {
        gathering.record(pass);
        levels.record(pass);
    })?;
    let atlas = pyramid.levels.first().map_or(0, |l| l.width * l.height);
    ctx.pool.download(&ctx.gpu, &d_texels, atlas * channels)
}
