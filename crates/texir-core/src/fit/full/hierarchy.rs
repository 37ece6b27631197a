//! From evidence per pixel to roughness per texel: shrinkage along a hierarchy of ever smaller groups.
//!
//! Each group takes the roughness that explains its pixels best, drawn to its parent's: the minimum over r of
//! n/(n + n_half) · ln(mean cost(r)) + pull · (ln r − ln r_parent)². The logarithm makes it the likelihood of residuals
//! whose size is not known beforehand: what is explained badly at any roughness says little about it. And it does not grow
//! with the number of pixels n without bound: what goes wrong here (irradiance, the BRDF model) is systematic and does not
//! average out.

use rayon::prelude::*;

use super::scan::{Evidence, minimum};
use crate::fit::adjacency::NONE;
use crate::specular_table::{NODES, node};

/// Cost below which no group counts as explained better: images and models are not that exact.
pub const FLOOR: f64 = 2e-3;

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
    let sums = sums(evidence, level.group, level.parent.len());
    sums.par_iter()
        .zip(level.parent)
        .map(|((sum, count), parent)| {
            if *count == 0 {
                return *parent;
            }
            let believed = *count as f32 / (*count as f32 + level.half_believed);
            let cost: [f32; NODES] = std::array::from_fn(|k| {
                let mean = sum[k] / f64::from(*count);
                believed * (mean + FLOOR).ln() as f32 + level.pull * (node(k) / parent).ln().powi(2)
            });
            minimum(&cost)
        })
        .collect()
}

/// How well the evidence knows each group's roughness: the share of all roughnesses that explain its pixels clearly worse
/// than the best, 0 without pixels.
pub fn confidence(evidence: &Evidence, group: &[u32], groups: usize, half_believed: f32) -> Vec<f32> {
    let width: f32 = (0..NODES).map(node).sum();
    let of_group = |(sum, count): &([f64; NODES], u32)| {
        let cost = |k: usize| (sum[k] / f64::from(*count) + FLOOR).ln() as f32;
        let least = (0..NODES).map(cost).fold(f32::INFINITY, f32::min);
        // Nodes are evenly spaced in ln r: each stands for a range of r as wide as r.
        let excluded: f32 = (0..NODES).filter(|&k| cost(k) > least + CLEARLY_WORSE).map(node).sum();
        if *count == 0 { 0.0 } else { excluded / width * *count as f32 / (*count as f32 + half_believed) }
    };
    sums(evidence, group, groups).par_iter().map(of_group).collect()
}

/// Σ cost at each node, and the number of pixels, of every group.
fn sums(evidence: &Evidence, group: &[u32], groups: usize) -> Vec<([f64; NODES], u32)> {
    let mut sums = vec![([0.0f64; NODES], 0u32); groups];
    for (cost, group) in evidence.cost.iter().zip(group) {
        if *group != NONE {
            let (sum, count) = &mut sums[*group as usize];
            sum.iter_mut().zip(cost).for_each(|(sum, c)| *sum += c.to_f64());
            *count += 1;
        }
    }
    sums
}
