//! Mip-mapped texture lookup and its transpose, twin of `lookup.wgsl` and `mip.wgsl`.

use crate::real::Real;
use crate::texture::{Footprints, Pyramid, Rows};

/// y = rows · x, with `channels` interleaved numbers per item. Used forward with footprint rows and backward with columns:
/// the same gather.
fn gather<R: Real>(rows: &Rows, channels: usize, source: &[R], mut store: impl FnMut(usize, &[R])) {
    let mut sum = vec![R::of(0.0); channels];
    for row in 0..rows.len() {
        sum.fill(R::of(0.0));
        for tap in rows.row(row) {
            let weight = R::of(f64::from(tap.weight));
            let item = &source[tap.texel as usize * channels..][..channels];
            for (s, &x) in sum.iter_mut().zip(item) {
                *s = *s + x * weight;
            }
        }
        store(row, &sum);
    }
}

/// Share of each child in its parent: coverage of the child over the sum of its siblings'.
fn each_parent(pyramid: &Pyramid, level: usize, mut visit: impl FnMut(usize, usize, f32)) {
    let (fine, coarse) = (pyramid.levels[level - 1], pyramid.levels[level]);
    for y in 0..coarse.height {
        for x in 0..coarse.width {
            let children = Pyramid::children(&fine, x, y);
            let sum: f32 = children.iter().flatten().map(|&c| pyramid.coverage[c]).sum();
            if sum > 0.0 {
                for &child in children.iter().flatten() {
                    visit(coarse.offset + y * coarse.width + x, child, pyramid.coverage[child] / sum);
                }
            }
        }
    }
}

/// Fills the pyramid above `texture` (level 0): every coarse texel is the coverage-weighted mean of its children.
pub fn reduce<R: Real>(pyramid: &Pyramid, texture: &[R], channels: usize) -> Vec<R> {
    let mut all = texture.to_vec();
    all.resize(pyramid.len() * channels, R::of(0.0));
    for level in 1..pyramid.levels.len() {
        each_parent(pyramid, level, |parent, child, share| {
            for c in 0..channels {
                all[parent * channels + c] =
                    all[parent * channels + c] + all[child * channels + c] * R::of(f64::from(share));
            }
        });
    }
    all
}

/// Transpose of [`reduce`]: cotangents of all levels down to level 0.
pub fn reduce_vjp<R: Real>(pyramid: &Pyramid, mut d_all: Vec<R>, channels: usize) -> Vec<R> {
    for level in (1..pyramid.levels.len()).rev() {
        each_parent(pyramid, level, |parent, child, share| {
            for c in 0..channels {
                d_all[child * channels + c] =
                    d_all[child * channels + c] + d_all[parent * channels + c] * R::of(f64::from(share));
            }
        });
    }
    let atlas = pyramid.levels[0];
    d_all.truncate(atlas.width * atlas.height * channels);
    d_all
}

/// Looked-up values, `channels` per footprint; 0 for an empty footprint.
pub fn lookup<R: Real>(pyramid: &Pyramid, texture: &[R], channels: usize, footprints: &Footprints) -> Vec<R> {
    let all = reduce(pyramid, texture, channels);
    let mut out = Vec::with_capacity(footprints.len() * channels);
    gather(&footprints.rows, channels, &all, |_, sum| out.extend_from_slice(sum));
    out
}

/// Cotangents of the looked-up values to every atlas texel.
pub fn lookup_vjp<R: Real>(pyramid: &Pyramid, d_values: &[R], channels: usize, footprints: &Footprints) -> Vec<R> {
    let mut d_all = vec![R::of(0.0); pyramid.len() * channels];
    gather(&footprints.columns, channels, d_values, |i, sum| {
        d_all[footprints.touched[i] as usize * channels..][..channels].copy_from_slice(sum);
    });
    reduce_vjp(pyramid, d_all, channels)
}
