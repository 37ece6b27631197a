//! Roughness that varies within a surface: worn tracks, wet spots, a polished patch.
//!
//! A segment has one finish, or two. It is cut into square blocks of the atlas; with two finishes, a block has the one that
//! explains the pixels of it and of those around it better. Two are believed where they explain the segment clearly better
//! than one, and where the views agree on which block has which: blocks that are free to take any value follow whatever else
//! is wrong with their pixels, and that goes with the view.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::scan::{Evidence, Tally, minimum};
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
    /// Half of the views that each pixel belongs to ([`Evidence::halves`]).
    pub half: &'a [u8],
    /// Edge of a typical texel, metres.
    pub texel_size: f32,
}

/// Segment, column and row of a block.
type Place = (u32, i32, i32);

/// What the pixels of a block say, by half of the views.
type Halves = [Tally; 2];

/// Roughness of every texel from what it is by its segment and colour.
pub fn refine(surface: &Surface<'_>, evidence: &Evidence, roughness: &[f32], settings: &LocalSettings) -> Vec<f32> {
    let side = (settings.block / surface.texel_size).round().max(2.0);
    let column_row = |t: usize| {
        let texel = surface.texels[t] as usize;
        [(texel % surface.width) as f32 / side, (texel / surface.width) as f32 / side]
    };
    let mut blocks: BTreeMap<Place, Halves> = BTreeMap::new();
    for (pixel, &t) in surface.heaviest.iter().enumerate().filter(|(_, t)| **t != NONE) {
        let [x, y] = column_row(t as usize).map(|at| at as i32);
        let halves = blocks.entry((surface.segment[t as usize], x, y)).or_default();
        halves[usize::from(surface.half[pixel])].add(evidence, pixel);
    }
    let blocks: Vec<(Place, Halves)> = blocks.into_iter().collect();
    let segments: Vec<&[(Place, Halves)]> = blocks.chunk_by(|a, b| a.0.0 == b.0.0).collect();
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
///
/// Two finishes always explain a segment better than one when each block takes what suits it, as noise has two sides. What
/// counts is therefore how well a block is explained by the finish that others ask for: the blocks around it, itself left
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
    let better = |tally: &Tally| if tally.cost[pair[0]] < tally.cost[pair[1]] { pair[0] } else { pair[1] };
    let around: Vec<Vec<usize>> = blocks.iter().map(|(place, _)| around(blocks, *place)).collect();

    let one = all.cost.iter().copied().fold(f64::INFINITY, f64::min);
    let near = |i: usize| Tally::sum(around[i].iter().map(|&n| &own[n]));
    let predicted: f64 = own.iter().enumerate().map(|(i, block)| block.cost[better(&near(i))]).sum();
    if all.ln_mean(one) - all.ln_mean(predicted) < settings.gain
        || agreement(blocks, &around, &better) < settings.agreement
    {
        return Vec::new();
    }
    let chosen: Vec<usize> =
        own.iter().enumerate().map(|(i, block)| better(&Tally::sum([block, &near(i)].into_iter()))).collect();
    let of = |node: usize| Tally::sum(own.iter().zip(&chosen).filter(|(_, c)| **c == node).map(|(block, _)| block));
    let finishes = pair.map(of);
    if finishes.iter().any(|finish| finish.pixels < f64::from(settings.pixels)) {
        return Vec::new();
    }
    let change = |finish: &Tally| (minimum(&finish.misfit()) / whole[blocks[0].0.0 as usize]).ln();
    let [smooth, rough] = [change(&finishes[0]), change(&finishes[1])];
    let changes = chosen.iter().map(|node| if *node == pair[0] { smooth } else { rough });
    blocks.iter().map(|(place, _)| *place).zip(changes).collect()
}

/// By how much the logarithm of the mean cost falls when each half of the views is explained by the finishes that the other
/// half asks for around a block, instead of by the one that the other half asks for; 0 where no block is seen by both.
fn agreement(blocks: &[(Place, Halves)], around: &[Vec<usize>], better: &impl Fn(&Tally) -> usize) -> f32 {
    let (mut judged, mut one, mut two) = (Tally::default(), 0.0, 0.0);
    for (mine, other) in [(0, 1), (1, 0)] {
        let all = Tally::sum(blocks.iter().map(|(_, halves)| &halves[other]));
        let single = (0..NODES).min_by(|a, b| all.cost[*a].total_cmp(&all.cost[*b])).unwrap_or(0);
        for (i, (_, halves)) in blocks.iter().enumerate() {
            let near = Tally::sum(around[i].iter().chain([&i]).map(|&n| &blocks[n].1[other]));
            let block = &halves[mine];
            if near.pixels > 0.0 && block.pixels > 0.0 {
                judged = Tally::sum([&judged, block].into_iter());
                one += block.cost[single];
                two += block.cost[better(&near)];
            }
        }
    }
    if judged.pixels > 0.0 { judged.ln_mean(one) - judged.ln_mean(two) } else { 0.0 }
}

/// The up to eight blocks beside one.
fn around(blocks: &[(Place, Halves)], (segment, x, y): Place) -> Vec<usize> {
    let sides = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))).filter(|side| *side != (0, 0));
    let at = |(dx, dy): (i32, i32)| blocks.binary_search_by_key(&(segment, x + dx, y + dy), |(place, _)| *place).ok();
    sides.filter_map(at).collect()
}
