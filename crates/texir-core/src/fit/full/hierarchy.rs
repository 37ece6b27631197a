//! From evidence per pixel to roughness per texel: shrinkage along a hierarchy of ever smaller groups.
//!
//! Each group takes the roughness that explains its pixels best, drawn to its parent's: the minimum over r of
//! n/(n + n_half) · ln(mean cost(r)) + pull · (2 (r − r_parent))². The logarithm makes it the likelihood of residuals whose
//! size is not known beforehand: what is explained badly at any roughness says little about it. And it does not grow with
//! the number of pixels n without bound: what goes wrong here (irradiance, the BRDF model) is systematic and does not average
//! out. Distances are those of r itself, in which steps look alike: by ln r, a mirror would be further from what lies between
//! it and chalk than chalk is.

use rayon::prelude::*;

use super::scan::{Evidence, Tally, minimum};
use crate::fit::adjacency::NONE;
use crate::specular_table::{NODES, node};

/// By how much ln cost must rise for a roughness to count as clearly worse.
const CLEARLY_WORSE: f32 = 0.1;

/// One level of the hierarchy.
pub struct Level<'a> {
    /// Group of each pixel, or [`NONE`].
    pub group: &'a [u32],
    /// Roughness of each group's parent.
    pub parent: &'a [f32],
    /// Weight of the parent's value, per pixel of evidence.
    pub pull: f32,
    /// Pixels that a group must have to be believed half.
    pub half_believed: f32,
}

/// Roughness of every group of a level; a group without evidence takes its parent's.
pub fn settle(evidence: &Evidence, level: &Level<'_>) -> Vec<f32> {
    tallies(evidence, level.group, level.parent.len())
        .par_iter()
        .zip(level.parent)
        .map(|(tally, parent)| {
            if tally.pixels == 0.0 {
                return *parent;
            }
            let misfit = tally.misfit();
            let believed = tally.pixels as f32 / (tally.pixels as f32 + level.half_believed);
            let pull = |k: usize| level.pull * (2.0 * (node(k) - parent)).powi(2);
            minimum(&std::array::from_fn(|k| believed * misfit[k] + pull(k)))
        })
        .collect()
}

/// How well the evidence knows each group's roughness: the share of all roughnesses that explain its pixels clearly worse
/// than the best, 0 without pixels.
pub fn confidence(evidence: &Evidence, group: &[u32], groups: usize, half_believed: f32) -> Vec<f32> {
    let width: f32 = (0..NODES).map(node).sum();
    let of_group = |tally: &Tally| {
        if tally.pixels == 0.0 {
            return 0.0;
        }
        let misfit = tally.misfit();
        let least = misfit.iter().copied().fold(f32::INFINITY, f32::min);
        // Nodes are evenly spaced in ln r: each stands for a range of r as wide as r.
        let excluded: f32 = (0..NODES).filter(|&k| misfit[k] > least + CLEARLY_WORSE).map(node).sum();
        excluded / width * tally.pixels as f32 / (tally.pixels as f32 + half_believed)
    };
    tallies(evidence, group, groups).par_iter().map(of_group).collect()
}

/// What the pixels of every group say.
pub(super) fn tallies(evidence: &Evidence, group: &[u32], groups: usize) -> Vec<Tally> {
    let mut tallies = vec![Tally::default(); groups];
    for (pixel, group) in group.iter().enumerate().filter(|(_, group)| **group != NONE) {
        tallies[*group as usize].add(evidence, pixel);
    }
    tallies
}
