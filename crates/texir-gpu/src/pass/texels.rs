//! Host side of `texels.wgsl`.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use texir_core::cpu::texels::{REACH, TILE, TileBins};
use texir_core::error::Result;
use texir_core::mesh::Mesh;
use texir_core::surface::{Hit, TexelHit};

use crate::batch::Context;

/// Triangles that a thread looks through in one dispatch: far below the loop iterations that software drivers allow.
const CANDIDATES: u32 = 8192;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct TexelsParams {
    pub width: u32,
    pub height: u32,
    pub first_row: u32,
    pub rows_begin: u32,
    pub rows_end: u32,
    pub first_candidate: u32,
    pub candidates: u32,
    pub reach: f32,
}

/// See [`texir_core::backend::Backend::texels`].
pub(crate) fn run(
    ctx: &mut Context,
    mesh: &Mesh,
    size: [usize; 2],
    rows: Range<usize>,
) -> Result<Vec<Option<TexelHit>>> {
    let kernel = ctx.kernel("texels", "texels", Some(("TILE", TILE as u32)))?;
    let ([width, height], count) = (size, size[0] * rows.len());
    let bins = TileBins::new(mesh, size, rows.clone())?;
    let most = bins.offsets.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0);
    let tile_rows = (bins.offsets.len() - 1) / bins.columns;
    let uvs: Vec<[glam::Vec2; 3]> = (0..mesh.triangles.len() as u32).map(|t| mesh.corner_uvs(t)).collect();
    let (pool, gpu) = (&mut ctx.pool, &ctx.gpu);
    let offsets = pool.upload(gpu, "bin offsets", &bins.offsets)?;
    let lists = pool.upload(gpu, "bins", &bins.triangles)?;
    let uvs = pool.upload(gpu, "corner coordinates", &uvs)?;
    let hits = pool.reserve(gpu, "hits", (count * size_of::<Hit>()) as u64)?;
    for first_candidate in (0..most.max(1)).step_by(CANDIDATES as usize) {
        let mut row = 0;
        while row < tile_rows {
            // Candidates are counted like rays.
            let tests = |row: usize| {
                let tiles = bins.offsets[row * bins.columns..=(row + 1) * bins.columns].windows(2);
                let candidates = tiles.map(|w| (w[1] - w[0]).saturating_sub(first_candidate).clamp(1, CANDIDATES));
                candidates.map(|n| u64::from(n) * (TILE * TILE) as u64).sum()
            };
            let (rows_of_tiles, tests) = ctx.items_of(&kernel, (row..tile_rows).map(tests));
            let end = row + rows_of_tiles;
            let params = ctx.params(&TexelsParams {
                width: width as u32,
                height: height as u32,
                first_row: row as u32,
                rows_begin: rows.start as u32,
                rows_end: rows.end as u32,
                first_candidate,
                candidates: CANDIDATES,
                reach: REACH as f32,
            });
            let groups = kernel.bind(
                ctx.gpu.device(),
                &[
                    ("params", params.binding()),
                    ("bin_offsets", offsets.binding()),
                    ("bins", lists.binding()),
                    ("corner_uvs", uvs.binding()),
                    ("hits", hits.binding()),
                ],
            )?;
            let (columns, tiles) = (bins.columns as u32, (end - row) as u32);
            ctx.timed(&kernel, tests, |pass| kernel.record_grid(pass, &groups, columns, tiles))?;
            row = end;
        }
    }
    // The device's `t` is the squared distance of the centre, which is 0 inside.
    let on_mesh = |Hit { triangle, u, v, t }: Hit| TexelHit { triangle, u, v, inside: t == 0.0 };
    let hits: Vec<Hit> = ctx.pool.download(&ctx.gpu, &hits, count)?;
    Ok(hits.into_iter().map(|hit| hit.is_hit().then(|| on_mesh(hit))).collect())
}
