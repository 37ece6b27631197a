//! Host side of `denoise.wgsl`.

use bytemuck::{Pod, Zeroable};
use texir_core::cpu;
use texir_core::denoise::{
    CELL, CURVATURE, GUIDE_RADIUS, LOSS_SIGMAS, NOISE_RADIUS, Noisy, RADIUS, RESIDUAL_RADIUS, RESIDUAL_THRESHOLD,
    RIDGE, TOLERANCE,
};
use texir_core::error::Result;
use texir_core::neighbours::{Entry, FAR, MAX_PLANE_DISTANCE, MIN_NORMAL_COSINE, NEAR, Neighbours};
use texir_core::progress::Progress;

use super::WORKGROUP;
use crate::batch::{BATCH_BYTES, Context};

/// The passes, in how many columns of cells each looks at the points, and how many of them take a ray's time.
const PASSES: [(&str, usize, u64); 5] = [
    ("smooth_halves", NEAR, 25),
    ("measure_noise", NEAR, 25),
    ("regress", FAR, 23),
    ("clean", NEAR, 25),
    ("conserve", FAR, 46),
];

/// Points that a thread may look at: a software driver silently ends it after 65,535 iterations of all its loops, and
/// on any device a few threads with many more would take longer than drivers allow.
const MOST_LOOKED_AT: u64 = 65_000;

/// Points of a dispatch at most: each may lie in a cell of its own, whose ranges are uploaded.
const MOST_POINTS: usize = BATCH_BYTES / (FAR * size_of::<[u32; 2]>());

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct DenoiseParams {
    pub first: u32,
    pub end: u32,
    pub first_cell: u32,
    pub texel: f32,
    pub radius: f32,
    pub guide_radius: f32,
    pub noise_radius: f32,
    pub residual_radius: f32,
    pub tolerance: f32,
    pub curvature: f32,
    pub residual_threshold: f32,
    pub loss_sigmas: f32,
    pub ridge: f32,
    pub min_normal_cosine: f32,
    pub max_plane_distance: f32,
    pub tiny: f32,
}

/// Both halves of what was gathered at a point.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct Estimate {
    pub a: [f32; 3],
    pub apart: u32,
    pub b: [f32; 3],
    pub pad: u32,
}

/// See [`texir_core::backend::Backend::denoise`].
pub(crate) fn run(ctx: &mut Context, noisy: Noisy<'_>, progress: &dyn Progress) -> Result<Vec<[f32; 3]>> {
    let count = noisy.points.len();
    let neighbours = Neighbours::<FAR>::new(noisy.points, CELL * noisy.texel);
    if count == 0 || neighbours.most() > MOST_LOOKED_AT {
        return cpu::denoise::denoise(noisy, progress);
    }
    let Neighbours { entries, spans, .. } = &neighbours;
    let estimate = |entry: &Entry| {
        let i = entry.index as usize;
        Estimate { a: noisy.halves[0][i], apart: u32::from(noisy.apart[i]), b: noisy.halves[1][i], pad: 0 }
    };
    let estimates: Vec<Estimate> = entries.iter().map(estimate).collect();
    let (pool, gpu) = (&mut ctx.pool, &ctx.gpu);
    let conserved = pool.reserve(gpu, "denoise conserved", 16 * count as u64)?;
    let on_device = [
        ("entries", pool.upload(gpu, "denoise entries", entries)?),
        ("estimates", pool.upload(gpu, "denoise estimates", &estimates)?),
        ("smoothed", pool.reserve(gpu, "denoise smoothed", 32 * count as u64)?),
        ("noise", pool.reserve(gpu, "denoise noise", 8 * count as u64)?),
        ("fits", pool.reserve(gpu, "denoise fits", 32 * count as u64)?),
        ("cleaned", pool.reserve(gpu, "denoise cleaned", 16 * count as u64)?),
        ("conserved", conserved.clone()),
    ];
    for (entry, columns, points_per_ray) in PASSES {
        let kernel = ctx.kernel("denoise", entry, None)?;
        let cost = |spans: &[[u32; 2]; FAR]| {
            let looked_at: u64 = spans[..columns].iter().map(|[start, end]| u64::from(end - start)).sum();
            1 + looked_at / points_per_ray
        };
        let costs: Vec<u64> = spans.iter().map(cost).collect();
        let mut first = 0;
        while first < count {
            progress.check()?;
            let next = entries[first..].iter().take(MOST_POINTS).map(|entry| costs[entry.cell as usize]);
            let (points, rays) = ctx.items_of(&kernel, next);
            let end = first + points;
            // Points are in the order of their cells.
            let [first_cell, last_cell] = [first, end - 1].map(|i| entries[i].cell);
            let spans = &spans[first_cell as usize..=last_cell as usize];
            let spans = ctx.pool.upload(&ctx.gpu, "denoise spans", spans)?;
            let params = ctx.params(&DenoiseParams {
                first: first as u32,
                end: end as u32,
                first_cell,
                texel: noisy.texel,
                radius: RADIUS,
                guide_radius: GUIDE_RADIUS,
                noise_radius: NOISE_RADIUS,
                residual_radius: RESIDUAL_RADIUS,
                tolerance: TOLERANCE,
                curvature: CURVATURE,
                residual_threshold: RESIDUAL_THRESHOLD,
                loss_sigmas: LOSS_SIGMAS,
                ridge: RIDGE,
                min_normal_cosine: MIN_NORMAL_COSINE,
                max_plane_distance: MAX_PLANE_DISTANCE,
                tiny: f32::MIN_POSITIVE,
            });
            let mut resources = vec![("params", params.binding()), ("spans", spans.binding())];
            resources.extend(on_device.iter().map(|(name, view)| (*name, view.binding())));
            let groups = kernel.bind(ctx.gpu.device(), &resources)?;
            ctx.trace(&kernel, &groups, (end - first).div_ceil(WORKGROUP), rays)?;
            first = end;
        }
    }
    let conserved = ctx.pool.download::<[f32; 4]>(&ctx.gpu, &conserved, count)?;
    let mut out = vec![[0.0; 3]; count];
    entries.iter().zip(conserved).for_each(|(entry, [r, g, b, _])| out[entry.index as usize] = [r, g, b]);
    Ok(out)
}
