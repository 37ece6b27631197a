//! Groups whose roughness is drawn to that of larger ones.

use rayon::prelude::*;

use super::scan::{Tally, minimum};
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

/// Roughness of every group, by what its pixels say, each drawn to its parents. A group without evidence takes the mean
/// of its parents by the pixels that they count as, or else by their pulls.
pub fn settle<const N: usize>(groups: &[Tally], parents: &[[Parent; N]]) -> Vec<f32> {
    groups
        .par_iter()
        .zip(parents)
        .map(|(tally, parents)| {
            if tally.pixels == 0.0 {
                return mean(parents);
            }
            let against = tally.against();
            let drawn = |k: usize| -> f32 {
                let by =
                    |p: &Parent| (p.pull + p.pixels / tally.pixels as f32) * (2.0 * (node(k) - p.roughness)).powi(2);
                parents.iter().map(by).sum()
            };
            minimum(&std::array::from_fn(|k| against[k] + drawn(k)))
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
