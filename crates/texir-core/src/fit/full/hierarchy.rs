//! From evidence per pixel to roughness per texel: shrinkage along a hierarchy of ever smaller groups.
//!
//! Each group takes the roughness that explains its pixels best, drawn to its parent's: the minimum over r of
//! mean cost(r) + pull · (ln r − ln r_parent)². The pull is per pixel, not a number of pseudo-observations: what goes wrong
//! here (irradiance, the BRDF model) is systematic and does not average out over many pixels.

use rayon::prelude::*;

use super::neighbours::NONE;
use super::scan::{Evidence, minimum};
use crate::specular_table::{NODES, node};

/// Cost below which no group counts as explained better: images and models are not that exact.
const FLOOR: f32 = 2e-3;

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
    let mut sums = vec![([0.0f64; NODES], 0u32); level.parent.len()];
    for (cost, group) in evidence.cost.iter().zip(level.group) {
        if *group != NONE {
            let (sum, count) = &mut sums[*group as usize];
            sum.iter_mut().zip(cost).for_each(|(sum, c)| *sum += c.to_f64());
            *count += 1;
        }
    }
    sums.par_iter()
        .zip(level.parent)
        .map(|((sum, count), parent)| {
            if *count == 0 {
                return *parent;
            }
            let believed = *count as f32 / (*count as f32 + level.half_believed);
            let cost: [f32; NODES] = std::array::from_fn(|k| {
                let mean = sum[k] as f32 / *count as f32;
                believed * (mean + FLOOR).ln() + level.pull * (node(k) / parent).ln().powi(2)
            });
            minimum(&cost)
        })
        .collect()
}
