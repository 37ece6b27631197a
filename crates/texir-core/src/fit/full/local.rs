//! Roughness that varies within a surface: worn tracks, wet spots, a polished patch.
//!
//! A segment has one finish, or two. It is cut into square blocks of the atlas; with two finishes, a block has the one that
//! explains its pixels better. Two are believed where they explain the segment clearly better than one: blocks that are free to
//! take any value follow whatever else is wrong with their pixels.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::hierarchy::FLOOR;
use super::scan::{Evidence, minimum};
use crate::fit::adjacency::NONE;
use crate::fit::settings::LocalSettings;
use crate::specular_table::NODES;

/// Where the texels are, and what they belong to.
pub struct Surface<'a> {
    /// Columns of the atlas.
    pub width: usize,
    /// Atlas index of each texel.
    pub texels: &'a [u32],
    /// Segment of each texel.
    pub segment: &'a [u32],
    /// Roughness of each segment as a whole.
    pub whole: &'a [f32],
    /// The texel that each pixel sees most of, or [`NONE`].
    pub heaviest: &'a [u32],
    /// Edge of a typical texel, metres.
    pub texel_size: f32,
}

/// Segment, column and row of a block.
type Place = (u32, i32, i32);

/// What the pixels of a block say: Σ cost at each node, and how many they are.
#[derive(Clone, Copy, Default)]
struct Block {
    cost: [f64; NODES],
    pixels: u32,
}

impl Block {
    fn add(&mut self, cost: impl Fn(usize) -> f64, pixels: u32) {
        self.cost.iter_mut().enumerate().for_each(|(k, sum)| *sum += cost(k));
        self.pixels += pixels;
    }

    fn sum<'a>(blocks: impl Iterator<Item = &'a Block>) -> Self {
        let mut sum = Self::default();
        blocks.for_each(|block| sum.add(|k| block.cost[k], block.pixels));
        sum
    }

    /// The roughness that explains the pixels best.
    fn roughness(&self) -> f32 {
        minimum(&self.cost.map(|cost| (cost / f64::from(self.pixels) + FLOOR) as f32))
    }
}

/// Roughness of every texel from what it is by its segment and colour.
pub fn refine(surface: &Surface<'_>, evidence: &Evidence, roughness: &[f32], settings: &LocalSettings) -> Vec<f32> {
    let side = (settings.block / surface.texel_size).round().max(2.0);
    let column_row = |t: usize| {
        let texel = surface.texels[t] as usize;
        [(texel % surface.width) as f32 / side, (texel / surface.width) as f32 / side]
    };
    let mut blocks: BTreeMap<Place, Block> = BTreeMap::new();
    for (&t, cost) in surface.heaviest.iter().zip(&evidence.cost).filter(|(t, _)| **t != NONE) {
        let [x, y] = column_row(t as usize).map(|at| at as i32);
        blocks.entry((surface.segment[t as usize], x, y)).or_default().add(|k| cost[k].to_f64(), 1);
    }
    let blocks: Vec<(Place, Block)> = blocks.into_iter().collect();
    let segments: Vec<&[(Place, Block)]> = blocks.chunk_by(|a, b| a.0.0 == b.0.0).collect();
    let changes: BTreeMap<Place, f32> =
        segments.into_par_iter().flat_map_iter(|blocks| two_finishes(blocks, surface.whole, settings)).collect();
    // The change is blended between block centres, so that blocks are not seen.
    let blended = |t: usize| {
        let [x, y] = column_row(t).map(|at| at - 0.5);
        let (mut sum, mut weight) = (0.0, 0.0);
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let (bx, by) = (x.floor() + dx, y.floor() + dy);
            if let Some(change) = changes.get(&(surface.segment[t], bx as i32, by as i32)) {
                let near = (1.0 - (x - bx).abs()) * (1.0 - (y - by).abs());
                sum += near * change;
                weight += near;
            }
        }
        roughness[t] * if weight > 0.0 { (sum / weight).exp() } else { 1.0 }
    };
    (0..roughness.len()).into_par_iter().map(blended).collect()
}

/// By how much the blocks of a segment differ from it, in ln r; nothing where one finish is as good.
fn two_finishes(blocks: &[(Place, Block)], whole: &[f32], settings: &LocalSettings) -> Vec<(Place, f32)> {
    let all = Block::sum(blocks.iter().map(|(_, block)| block));
    let mean = |cost: f64| cost / f64::from(all.pixels) + FLOOR;
    let pairs = (0..NODES).flat_map(|smooth| (smooth + 1..NODES).map(move |rough| (smooth, rough)));
    let of_pair = |(smooth, rough): (usize, usize)| -> f64 {
        blocks.iter().map(|(_, block)| block.cost[smooth].min(block.cost[rough])).sum()
    };
    let one = all.cost.iter().copied().fold(f64::INFINITY, f64::min);
    let best = pairs.map(|pair| (of_pair(pair), pair)).min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((two, (smooth, rough))) = best else { return Vec::new() };
    if (mean(one) / mean(two)).ln() < f64::from(settings.gain) {
        return Vec::new();
    }
    let is_smooth = |block: &Block| block.cost[smooth] < block.cost[rough];
    let finish = |smooth| Block::sum(blocks.iter().map(|(_, block)| block).filter(|block| is_smooth(block) == smooth));
    let [rough, smooth] = [false, true].map(finish);
    if rough.pixels.min(smooth.pixels) < settings.pixels {
        return Vec::new();
    }
    let change = |finish: &Block| {
        let segment = blocks[0].0.0 as usize;
        (finish.roughness() / whole[segment]).ln()
    };
    let [rough, smooth] = [change(&rough), change(&smooth)];
    blocks.iter().map(|(place, block)| (*place, if is_smooth(block) { smooth } else { rough })).collect()
}
