//! Mip-mapped texture lookup and its transpose, twin of `lookup.wgsl` and `mip.wgsl`.

use rayon::prelude::*;

use crate::real::Real;
use crate::texture::{Footprints, Pyramid, SparseRows};

/// Items per task of a parallel loop.
const BLOCK: usize = 1024;

/// y = rows · x, with `channels` interleaved numbers per item. Used forward with footprint rows and backward with
/// columns: the same gather. `source` yields the numbers of an item.
fn gather<'a, R: Real>(rows: &SparseRows, channels: usize, source: impl Fn(usize) -> &'a [R] + Sync) -> Vec<R> {
    let mut out = vec![R::of(0.0); rows.len() * channels];
    let sum = |(row, sum): (usize, &mut [R])| {
        for tap in rows.row(row) {
            let weight = R::of(f64::from(tap.weight));
            for (s, &x) in sum.iter_mut().zip(source(tap.texel as usize)) {
                *s = *s + x * weight;
            }
        }
    };
    out.par_chunks_exact_mut(channels).enumerate().with_min_len(BLOCK).for_each(sum);
    out
}

/// The children of texel (x, y) of a level, with the share of each: its coverage over the sum of its siblings'.
fn children(pyramid: &Pyramid, level: usize, x: usize, y: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
    let children = Pyramid::children(&pyramid.levels[level - 1], x, y);
    let sum: f32 = children.iter().flatten().map(|&c| pyramid.coverage[c]).sum();
    children.into_iter().flatten().filter(move |_| sum > 0.0).map(move |c| (c, pyramid.coverage[c] / sum))
}

/// The levels of the pyramid above `texture` (level 0) that come before level `levels`, in one piece: every texel is
/// the coverage-weighted mean of its children.
pub fn reduce<R: Real>(pyramid: &Pyramid, texture: &[R], channels: usize, levels: usize) -> Vec<R> {
    let end = pyramid.levels.get(levels).map_or(pyramid.len(), |level| level.offset);
    let start = |level: usize| pyramid.levels[level].offset * channels - texture.len();
    let mut above = vec![R::of(0.0); (end * channels).saturating_sub(texture.len())];
    for level in 1..levels.min(pyramid.levels.len()) {
        let (fine, coarse) = (pyramid.levels[level - 1], pyramid.levels[level]);
        let (finer, rest) = above.split_at_mut(start(level));
        let finer = if level == 1 { texture } else { &finer[start(level - 1)..] };
        let rows = rest[..coarse.width * coarse.height * channels].par_chunks_exact_mut(coarse.width * channels);
        rows.enumerate().for_each(|(y, row)| {
            for (x, parent) in row.chunks_exact_mut(channels).enumerate() {
                for (child, share) in children(pyramid, level, x, y) {
                    let child = &finer[(child - fine.offset) * channels..][..channels];
                    parent.iter_mut().zip(child).for_each(|(p, c)| *p = *p + *c * R::of(f64::from(share)));
                }
            }
        });
    }
    above
}

/// Transpose of [`reduce`] by all levels: cotangents of all of them down to level 0.
pub fn reduce_vjp<R: Real>(pyramid: &Pyramid, mut d_all: Vec<R>, channels: usize) -> Vec<R> {
    for level in (1..pyramid.levels.len()).rev() {
        let (fine, coarse) = (pyramid.levels[level - 1], pyramid.levels[level]);
        let (finer, d_coarse) = d_all.split_at_mut(coarse.offset * channels);
        // The children of a row of texels are two rows.
        let two_rows = 2 * fine.width;
        finer[fine.offset * channels..].par_chunks_mut(two_rows * channels).enumerate().for_each(|(y, rows)| {
            for x in 0..coarse.width {
                let d_parent = &d_coarse[(y * coarse.width + x) * channels..][..channels];
                for (child, share) in children(pyramid, level, x, y) {
                    let d_child = &mut rows[(child - fine.offset - y * two_rows) * channels..][..channels];
                    d_child.iter_mut().zip(d_parent).for_each(|(c, p)| *c = *c + *p * R::of(f64::from(share)));
                }
            }
        });
    }
    let atlas = pyramid.levels[0];
    d_all.truncate(atlas.width * atlas.height * channels);
    d_all
}

/// Looked-up values, `channels` per footprint; 0 for an empty footprint. Only levels that footprints touch are made.
pub fn lookup<R: Real>(pyramid: &Pyramid, texture: &[R], channels: usize, footprints: &SparseRows) -> Vec<R> {
    let last = footprints.taps.par_iter().map(|tap| tap.texel as usize).max().unwrap_or(0);
    let levels = pyramid.levels.partition_point(|level| level.offset <= last);
    let above = reduce(pyramid, texture, channels, levels);
    gather(footprints, channels, |texel| match (texel * channels).checked_sub(texture.len()) {
        None => &texture[texel * channels..][..channels],
        Some(at) => &above[at..][..channels],
    })
}

/// Cotangents of the looked-up values to every atlas texel.
pub fn lookup_vjp<R: Real>(pyramid: &Pyramid, d_values: &[R], channels: usize, footprints: &Footprints) -> Vec<R> {
    let touched = gather(&footprints.columns, channels, |pixel| &d_values[pixel * channels..][..channels]);
    let mut d_all = vec![R::of(0.0); pyramid.len() * channels];
    for (texel, d) in footprints.touched.iter().zip(touched.chunks_exact(channels)) {
        d_all[*texel as usize * channels..][..channels].copy_from_slice(d);
    }
    reduce_vjp(pyramid, d_all, channels)
}
