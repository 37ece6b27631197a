//! Roughness that varies within a surface: worn tracks, wet spots, a polished patch.
//!
//! The hierarchy goes on below colours with square blocks of the atlas that halve from level to level. Where the views say
//! clearly that a block differs from the whole, it does; where they say little, the pull of the parent decides.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::hierarchy::{Level, settle};
use super::scan::Evidence;
use crate::fit::adjacency::NONE;
use crate::fit::settings::LocalSettings;

/// Where the texels are, and what they belong to.
pub struct Surface<'a> {
    /// Columns of the atlas.
    pub width: usize,
    /// Atlas index of each texel.
    pub texels: &'a [u32],
    /// Group of each texel that blocks do not cross: colours of segments.
    pub group: &'a [u32],
    /// The texel that each pixel sees most of, or [`NONE`].
    pub heaviest: &'a [u32],
    /// Edge of a typical texel, metres.
    pub texel_size: f32,
}

/// Roughness of every texel from that of its group.
pub fn refine(surface: &Surface<'_>, evidence: &Evidence, roughness: Vec<f32>, settings: &LocalSettings) -> Vec<f32> {
    let mut roughness = roughness;
    let mut edge = settings.largest;
    while edge >= settings.smallest {
        let side = (edge / surface.texel_size).round().max(2.0) as usize;
        roughness = one_level(surface, evidence, &roughness, side, settings);
        edge *= 0.5;
    }
    roughness
}

fn one_level(
    surface: &Surface<'_>,
    evidence: &Evidence,
    roughness: &[f32],
    side: usize,
    settings: &LocalSettings,
) -> Vec<f32> {
    let place = |t: usize| {
        let texel = surface.texels[t] as usize;
        ((texel % surface.width / side) as i32, (texel / surface.width / side) as i32, surface.group[t])
    };
    // Mean ln r of the texels of each block: the parent.
    let mut blocks: BTreeMap<(i32, i32, u32), (f64, u32)> = BTreeMap::new();
    for (t, r) in roughness.iter().enumerate() {
        let (sum, count) = blocks.entry(place(t)).or_default();
        *sum += f64::from(r.ln());
        *count += 1;
    }
    let parent: Vec<f32> = blocks.values().map(|(sum, count)| (sum / f64::from(*count)).exp() as f32).collect();
    let number: BTreeMap<(i32, i32, u32), u32> = blocks.keys().enumerate().map(|(i, k)| (*k, i as u32)).collect();
    let group: Vec<u32> =
        surface.heaviest.par_iter().map(|&t| if t == NONE { NONE } else { number[&place(t as usize)] }).collect();
    let level = Level { group: &group, parent: &parent, pull: settings.pull, half_believed: settings.pixels };
    let settled = settle(evidence, &level);
    let change: Vec<f32> = settled.iter().zip(&parent).map(|(r, p)| (r / p).ln()).collect();
    // The change is blended between block centres, so that blocks are not seen.
    (0..roughness.len())
        .into_par_iter()
        .map(|t| {
            let texel = surface.texels[t] as usize;
            let centre = |x: usize| (x as f32 + 0.5) / side as f32 - 0.5;
            let (x, y) = (centre(texel % surface.width), centre(texel / surface.width));
            let (bx, by) = (x.floor(), y.floor());
            let (mut sum, mut weight) = (0.0, 0.0);
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let w = (1.0 - (x - bx - dx as f32).abs()) * (1.0 - (y - by - dy as f32).abs());
                if let Some(&i) = number.get(&(bx as i32 + dx, by as i32 + dy, surface.group[t])) {
                    sum += w * change[i as usize];
                    weight += w;
                }
            }
            roughness[t] * if weight > 0.0 { (sum / weight).exp() } else { 1.0 }
        })
        .collect()
}
