//! From evidence per pixel to roughness per texel: shrinkage along a hierarchy of ever smaller groups.
//!
//! Each group takes the roughness that explains its n pixels best, drawn to its parents': the minimum over r of
//! ln(mean cost(r)) + Σ (pull + n_parent/n) · (2 (r − r_parent))². The logarithm makes it the likelihood of residuals whose
//! size is not known beforehand: what is explained badly at any roughness says little about it. It does not grow with the number
//! of pixels; what grows with that is how little a parent counts beside it, unless its pull is for good: what goes wrong here
//! (irradiance, the BRDF model) is systematic and does not average out. Distances are those of r itself, in which steps look
//! alike: by ln r, a mirror would be further from what lies between it and chalk than chalk is.

use rayon::prelude::*;

use super::scan::{Evidence, Tally, minimum};
use crate::fit::adjacency::NONE;
use crate::specular_table::node;

/// What a group is drawn to.
#[derive(Clone, Copy, Debug)]
pub struct Parent {
    /// Its roughness.
    pub roughness: f32,
    /// How much that weighs however many pixels the group has,
    pub pull: f32,
    /// and besides, as so many pixels.
    pub pixels: f32,
}

impl Parent {
    /// One that draws every group alike.
    pub fn pulling(roughness: f32, pull: f32) -> Self {
        Self { roughness, pull, pixels: 0.0 }
    }

    /// One whose roughness counts as that of so many pixels.
    pub fn of_pixels(roughness: f32, pixels: f32) -> Self {
        Self { roughness, pull: 0.0, pixels }
    }
}

/// Roughness of every group, each drawn to its parents; [`NONE`] is a pixel of none. A group without evidence takes the mean of its
/// parents by the pixels that they count as, or else by their pulls.
pub fn settle<const N: usize>(evidence: &Evidence, group: &[u32], parents: &[[Parent; N]]) -> Vec<f32> {
    tallies(evidence, group, parents.len())
        .par_iter()
        .zip(parents)
        .map(|(tally, parents)| {
            if tally.pixels == 0.0 {
                return mean(parents);
            }
            let misfit = tally.misfit();
            let drawn = |k: usize| -> f32 {
                let by =
                    |p: &Parent| (p.pull + p.pixels / tally.pixels as f32) * (2.0 * (node(k) - p.roughness)).powi(2);
                parents.iter().map(by).sum()
            };
            minimum(&std::array::from_fn(|k| misfit[k] + drawn(k)))
        })
        .collect()
}

/// What parents say by themselves.
fn mean(parents: &[Parent]) -> f32 {
    let by = |weight: fn(&Parent) -> f32| {
        parents.iter().fold((0.0, 0.0), |(sum, all), p| (sum + weight(p) * p.roughness, all + weight(p)))
    };
    let (sum, all) = match by(|p| p.pixels) {
        (_, 0.0) => by(|p| p.pull),
        said => said,
    };
    if all > 0.0 { sum / all } else { parents.iter().map(|p| p.roughness).sum::<f32>() / parents.len().max(1) as f32 }
}

/// What the pixels of every group say.
pub(super) fn tallies(evidence: &Evidence, group: &[u32], groups: usize) -> Vec<Tally> {
    let mut tallies = vec![Tally::default(); groups];
    for (pixel, group) in group.iter().enumerate().filter(|(_, group)| **group != NONE) {
        tallies[*group as usize].add(evidence, pixel);
    }
    tallies
}
