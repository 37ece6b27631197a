//! Roughness that varies within a segment: worn tracks, wet spots, a polished patch, a tiled wall among painted ones.
//!
//! A segment has one finish, or two. It is cut into square blocks of the atlas; with two finishes, a block has the one that
//! explains the pixels of it and of those near it better. Near are those around it, as on a floor with a worn track, or
//! those of its whole face, as where one wall of a room is tiled. Two are believed as far as they explain the segment better
//! than one, and as the views agree on which block has which: blocks that are free to take any value follow whatever else
//! is wrong with their pixels, and that goes with the view.

use std::collections::BTreeMap;
use std::iter::repeat_n;

use rayon::prelude::*;

use super::scan::{Evidence, Tally, minimum};
use crate::fit::adjacency::NONE;
use crate::fit::settings::LocalSettings;
use crate::specular_table::NODES;

/// Where the texels are, what they belong to, and which pixels see them.
pub struct Surface<'a> {
    /// Columns of the atlas.
    pub width: usize,
    /// Atlas index of each texel.
    pub texels: &'a [u32],
    /// Segment of each texel.
    pub segment: &'a [u32],
    /// The flat piece of it that each texel is in.
    pub face: &'a [u32],
    /// The texel that each pixel sees most of, or [`NONE`].
    pub heaviest: &'a [u32],
    /// Half of the views that each pixel belongs to ([`Evidence::halves`]).
    pub half: &'a [u8],
    /// Edge of a block, texels.
    pub block: f32,
}

/// Segment, face, column and row of a block.
pub type Place = (u32, u32, i32, i32);

/// What the pixels of a block say, by half of the views.
pub type Halves = [Tally; 2];

impl Surface<'_> {
    /// The blocks that pixels see, in the order of their places.
    pub fn blocks(&self, evidence: &Evidence) -> Vec<(Place, Halves)> {
        let mut blocks: BTreeMap<Place, Halves> = BTreeMap::new();
        for (pixel, &t) in self.heaviest.iter().enumerate().filter(|(_, t)| **t != NONE) {
            let t = t as usize;
            let [x, y] = self.column_row(t).map(|at| at as i32);
            let halves = blocks.entry((self.segment[t], self.face[t], x, y)).or_default();
            halves[usize::from(self.half[pixel])].add(evidence, pixel);
        }
        blocks.into_iter().collect()
    }

    /// The four blocks that a texel lies between, and how near each is: what is blended so does not show the blocks.
    pub fn between(&self, t: usize) -> [(Place, f32); 4] {
        let [x, y] = self.column_row(t).map(|at| at - 0.5);
        [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(dx, dy)| {
            let (bx, by) = (x.floor() + dx, y.floor() + dy);
            let near = (1.0 - (x - bx).abs()) * (1.0 - (y - by).abs());
            ((self.segment[t], self.face[t], bx as i32, by as i32), near)
        })
    }

    /// Where a texel is, in blocks.
    fn column_row(&self, t: usize) -> [f32; 2] {
        let texel = self.texels[t] as usize;
        [(texel % self.width) as f32 / self.block, (texel / self.width) as f32 / self.block]
    }
}

/// Roughness of every texel from what it is by its segment and colour. `whole` is that of each segment, `blocks` what
/// [`Surface::blocks`] holds.
pub fn refine(
    surface: &Surface<'_>,
    blocks: &[(Place, Halves)],
    whole: &[f32],
    roughness: &[f32],
    settings: &LocalSettings,
) -> Vec<f32> {
    let segments: Vec<&[(Place, Halves)]> = blocks.chunk_by(|a, b| a.0.0 == b.0.0).collect();
    let changes: BTreeMap<Place, f32> =
        segments.into_par_iter().flat_map_iter(|blocks| two_finishes(blocks, whole, settings)).collect();
    let blended = |t: usize| {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (place, near) in surface.between(t) {
            if let Some(change) = changes.get(&place) {
                sum += near * change;
                weight += near;
            }
        }
        roughness[t] * if weight > 0.0 { (sum / weight).exp() } else { 1.0 }
    };
    (0..roughness.len()).into_par_iter().map(blended).collect()
}

/// By how much the blocks of a segment differ from it, in ln r; nothing where one finish is as good.
///
/// Two finishes always explain a segment better than one when each block takes what suits it, as noise has two sides. What
/// counts is therefore how well a block is explained by the finish that others ask for: the blocks near it, itself left
/// out, and the other half of the views.
fn two_finishes(blocks: &[(Place, Halves)], whole: &[f32], settings: &LocalSettings) -> Vec<(Place, f32)> {
    let own: Vec<Tally> = blocks.iter().map(|(_, halves)| Tally::sum(halves.iter())).collect();
    let all = Tally::sum(own.iter());
    let pairs = (0..NODES).flat_map(|smooth| (smooth + 1..NODES).map(move |rough| [smooth, rough]));
    let of_pair = |[smooth, rough]: [usize; 2]| -> f64 {
        own.iter().map(|block| block.cost[smooth].min(block.cost[rough])).sum()
    };
    let best = pairs.map(|pair| (of_pair(pair), pair)).min_by(|a, b| a.0.total_cmp(&b.0));
    let (Some((_, pair)), true) = (best, all.pixels > 0.0) else { return Vec::new() };
    let at = |tally: &Tally| pair.map(|node| tally.cost[node]);
    let better = |[smooth, rough]: [f64; 2]| if smooth < rough { pair[0] } else { pair[1] };

    let judged = [around(blocks), of_faces(blocks)].map(|near| {
        let asked = |i: usize, half: usize| better(at(&near[i][half]));
        (agreement(blocks, &near, &asked), near)
    });
    let Some((agreement, near)) = judged.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)) else { return Vec::new() };
    let near: Vec<[f64; 2]> = near.iter().map(|halves| at(&Tally::sum(halves.iter()))).collect();
    let others = |i: usize| -> [f64; 2] { std::array::from_fn(|k| near[i][k] - at(&own[i])[k]) };
    let predicted: f64 = own.iter().enumerate().map(|(i, block)| block.cost[better(others(i))]).sum();
    let one = all.cost.iter().copied().fold(f64::INFINITY, f64::min);
    let gain = all.ln_mean(one) - all.ln_mean(predicted);
    let pixels = all.pixels as f32;
    let known = gain * pixels / (pixels + settings.segment_pixels);
    let believed = half_at(settings.gain, known).min(half_at(settings.agreement, agreement));

    let chosen: Vec<usize> = near.iter().map(|near| better(*near)).collect();
    let of = |node: usize| Tally::sum(own.iter().zip(&chosen).filter(|(_, c)| **c == node).map(|(block, _)| block));
    let finishes = pair.map(of);
    if believed == 0.0 || finishes.iter().any(|finish| finish.pixels < f64::from(settings.pixels)) {
        return Vec::new();
    }
    let whole = whole[blocks[0].0.0 as usize];
    let [smooth, rough] = finishes.map(|finish| believed * (minimum(&finish.misfit()) / whole).ln());
    let changes = chosen.iter().map(|node| if *node == pair[0] { smooth } else { rough });
    blocks.iter().map(|(place, _)| *place).zip(changes).collect()
}

/// How far something is believed that is believed half at `half`: not at all at half of that, and fully at half more.
fn half_at(half: f32, value: f32) -> f32 {
    (value / half - 0.5).clamp(0.0, 1.0)
}

/// By how much the logarithm of the mean cost falls when each half of the views is explained by the finishes that the other
/// half asks for near a block, instead of by the one that the other half asks for; 0 where no block is seen by both. `asked` says
/// which finish half of the views asks for near a block.
fn agreement(blocks: &[(Place, Halves)], near: &[Halves], asked: &impl Fn(usize, usize) -> usize) -> f32 {
    let (mut judged, mut one, mut two) = (Tally::default(), 0.0, 0.0);
    for (mine, other) in [(0, 1), (1, 0)] {
        let all = Tally::sum(blocks.iter().map(|(_, halves)| &halves[other]));
        let single = (0..NODES).min_by(|a, b| all.cost[*a].total_cmp(&all.cost[*b])).unwrap_or(0);
        for (i, (_, halves)) in blocks.iter().enumerate() {
            let block = &halves[mine];
            if near[i][other].pixels > 0.0 && block.pixels > 0.0 {
                judged = Tally::sum([&judged, block].into_iter());
                one += block.cost[single];
                two += block.cost[asked(i, other)];
            }
        }
    }
    if judged.pixels > 0.0 { judged.ln_mean(one) - judged.ln_mean(two) } else { 0.0 }
}

/// What each block and the up to eight around it say.
fn around(blocks: &[(Place, Halves)]) -> Vec<Halves> {
    let block = |place: Place| blocks.binary_search_by_key(&place, |(place, _)| *place).ok();
    let of = |(segment, face, x, y): Place| {
        let near = (-1..=1).flat_map(move |dy| (-1..=1).map(move |dx| (segment, face, x + dx, y + dy)));
        sum(near.filter_map(block).map(|i| &blocks[i].1))
    };
    blocks.iter().map(|(place, _)| of(*place)).collect()
}

/// What all blocks of each block's face say.
fn of_faces(blocks: &[(Place, Halves)]) -> Vec<Halves> {
    let faces = blocks.chunk_by(|a, b| a.0.1 == b.0.1);
    faces.flat_map(|face| repeat_n(sum(face.iter().map(|(_, halves)| halves)), face.len())).collect()
}

fn sum<'a>(blocks: impl Iterator<Item = &'a Halves> + Clone) -> Halves {
    [0, 1].map(|half| Tally::sum(blocks.clone().map(|halves| &halves[half])))
}
