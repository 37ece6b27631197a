//! From evidence per pixel to roughness per texel: shrinkage along a hierarchy of ever smaller groups.
//!
//! Each group takes the roughness that explains its n pixels best, drawn to its parent's: the minimum over r of
//! ln(mean cost(r)) + (pull + n_parent/n) · (2 (r − r_parent))². The logarithm makes it the likelihood of residuals whose
//! size is not known beforehand: what is explained badly at any roughness says little about it. It does not grow with the number
//! of pixels; what grows with that is how little the parent counts beside it, unless its pull is for good: what goes wrong here
//! (irradiance, the BRDF model) is systematic and does not average out. Distances are those of r itself, in which steps look
//! alike: by ln r, a mirror would be further from what lies between it and chalk than chalk is.

use rayon::prelude::*;

use super::scan::{Evidence, Tally, minimum};
use crate::fit::adjacency::NONE;
use crate::specular_table::node;

/// What a group is drawn to.
#[derive(Clone, Copy, Debug)]
pub struct Parent {
    /// Its roughness,
    pub roughness: f32,
    /// which counts as that of so many pixels.
    pub pixels: f32,
}

/// One level of the hierarchy.
pub struct Level<'a> {
    /// Group of each pixel, or [`NONE`].
    pub group: &'a [u32],
    /// Parent of each group.
    pub parent: &'a [Parent],
    /// Weight of the parent's roughness however many pixels there are.
    pub pull: f32,
}

/// Roughness of every group of a level; a group without evidence takes its parent's.
pub fn settle(evidence: &Evidence, level: &Level<'_>) -> Vec<f32> {
    tallies(evidence, level.group, level.parent.len())
        .par_iter()
        .zip(level.parent)
        .map(|(tally, parent)| {
            if tally.pixels == 0.0 {
                return parent.roughness;
            }
            let misfit = tally.misfit();
            let pull = level.pull + parent.pixels / tally.pixels as f32;
            minimum(&std::array::from_fn(|k| misfit[k] + pull * (2.0 * (node(k) - parent.roughness)).powi(2)))
        })
        .collect()
}

/// What the pixels of every group say.
pub(super) fn tallies(evidence: &Evidence, group: &[u32], groups: usize) -> Vec<Tally> {
    let mut tallies = vec![Tally::default(); groups];
    for (pixel, group) in group.iter().enumerate().filter(|(_, group)| **group != NONE) {
        tallies[*group as usize].add(evidence, pixel);
    }
    tallies
}
