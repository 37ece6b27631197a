//! How sure full mode is of the roughness of each texel.
//!
//! What the pixels of a texel's block say, and those of its segment, are likelihoods of roughness
//! ([`Tally::ln_likelihood`]). With every roughness as likely beforehand, that gives how far the truth may be from what
//! the texel got.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::blocks::{Block, BlockGrid, BlockKey};
use super::evidence::Tally;
use crate::specular_table::{NODES, node};

/// Variance of a roughness drawn by chance.
const BY_CHANCE: f32 = 1.0 / 12.0;

/// Mean and mean square of roughness.
#[derive(Clone, Copy, Debug)]
struct Moments {
    mean: f32,
    square: f32,
}

/// The confidence in `roughness`, of every texel: 1 where nothing else explains what is seen, 0 where the root mean
/// square of its distance from the truth is expected to be that of a roughness drawn by chance, √(1/12), or more. In
/// between it falls with that distance. `blocks` are those of [`BlockGrid::blocks`], `segments` the segments' tallies.
pub fn confidence(grid: &BlockGrid<'_>, blocks: &[Block], segments: &[Tally], roughness: &[f32]) -> Vec<f32> {
    let segments: Vec<[f32; NODES]> = segments.iter().map(Tally::ln_likelihood).collect();
    let of_block = |block: &Block| {
        let (own, segment) = (block.all().ln_likelihood(), &segments[block.key.segment as usize]);
        (block.key, moments(&std::array::from_fn(|k| own[k] + segment[k])))
    };
    let blocks: BTreeMap<BlockKey, Moments> = blocks.par_iter().map(of_block).collect();
    let unseen: Vec<Moments> = segments.iter().map(moments).collect();
    let of_texel = |(t, r): (usize, &f32)| {
        let squared_distance: f32 = grid
            .between(t)
            .iter()
            .map(|(key, near)| {
                let Moments { mean, square } = blocks.get(key).unwrap_or(&unseen[key.segment as usize]);
                near * (square - 2.0 * mean * r + r * r)
            })
            .sum();
        (1.0 - (squared_distance / BY_CHANCE).max(0.0).sqrt()).max(0.0)
    };
    roughness.par_iter().enumerate().map(of_texel).collect()
}

/// The moments of roughness by the logarithm of its likelihood.
fn moments(ln_likelihood: &[f32; NODES]) -> Moments {
    let most = ln_likelihood.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let (mut weight, mut mean, mut square) = (0.0, 0.0, 0.0);
    for (k, ln) in ln_likelihood.iter().enumerate() {
        // Nodes are evenly spaced in ln r: each stands for a range of r as wide as r.
        let (r, share) = (node(k), node(k) * (ln - most).exp());
        weight += share;
        mean += share * r;
        square += share * r * r;
    }
    Moments { mean: mean / weight, square: square / weight }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::full::roughness::evidence::Evidence;
    use crate::fit::index::NONE;

    const COLUMNS: usize = 24;
    const SEGMENTS: u32 = 4;

    /// Rows of texels, each a segment, of which the right half is not seen; `depth` says how clearly the pixels of a
    /// segment ask for 0.3.
    fn rows(depth: [Option<f32>; SEGMENTS as usize], roughness: f32) -> Vec<f32> {
        let texels: Vec<u32> = (0..SEGMENTS * COLUMNS as u32).collect();
        let segment: Vec<u32> = texels.iter().map(|t| t / COLUMNS as u32).collect();
        let pixels = || (0..400 * SEGMENTS).map(|p| (p / 400, p % (COLUMNS as u32 / 2)));
        let says = |s: u32| depth[s as usize];
        let cost = |(s, _): (u32, u32)| {
            let rise = |k: usize| says(s).unwrap_or(0.0) * (node(k) / 0.3).ln().powi(2);
            std::array::from_fn(|k| half::f16::from_f32(0.01 + rise(k)))
        };
        let counts = |s: u32, other: u32| if says(s).is_some() { other } else { NONE };
        let evidence = Evidence {
            segment: pixels().map(|(s, _)| counts(s, s)).collect(),
            cost: pixels().map(cost).collect(),
            weight: pixels().map(|_| 1.0).collect(),
            slope: vec![[0.0; NODES]; SEGMENTS as usize],
            variation: vec![],
        };
        let dominant: Vec<u32> = pixels().map(|(s, column)| counts(s, s * COLUMNS as u32 + column)).collect();
        let grid = BlockGrid { width: COLUMNS, texels: &texels, segment: &segment, face: &segment, block: 4.0 };
        let blocks = grid.blocks(&evidence, &dominant, &vec![0; dominant.len()]);
        confidence(&grid, &blocks, &evidence.by_segment(), &vec![roughness; texels.len()])
    }

    /// Of a texel in the middle of what is seen, and of one far from it.
    fn seen_and_unseen(of_texels: &[f32], segment: usize) -> [f32; 2] {
        [COLUMNS / 4, COLUMNS - 2].map(|column| of_texels[segment * COLUMNS + column])
    }

    #[test]
    fn what_costs_tell_apart_is_known_and_what_is_not_seen_less() {
        let known = rows([Some(1.0), Some(0.01), Some(1e-4), None], 0.3);
        let [clear, vague, nothing, none] = [0, 1, 2, 3].map(|s| seen_and_unseen(&known, s));
        assert!(clear[0] > 0.9 && clear[0] > clear[1] && clear[1] > 0.8, "{clear:?}");
        assert!(vague[0] < clear[0] - 0.1 && vague[0] > vague[1] + 0.02 && vague[1] > 0.2, "{vague:?}");
        // Flat costs say as little as no pixel: 0.3 is a guess.
        assert!(nothing[0] < 0.05 && none == [0.0; 2], "{nothing:?} {none:?}");
    }

    #[test]
    fn a_roughness_that_pixels_do_not_ask_for_is_not_known() {
        let right = rows([Some(1.0); 4], 0.3);
        let wrong = rows([Some(1.0); 4], 0.5);
        let [right, wrong] = [right, wrong].map(|of_texels| seen_and_unseen(&of_texels, 0)[0]);
        // Off by 0.2 where chance is off by 0.289.
        assert!(right > 0.9 && (wrong - 0.31).abs() < 0.03, "{right} {wrong}");
    }
}
