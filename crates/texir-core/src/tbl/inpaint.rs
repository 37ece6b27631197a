//! Radiance for texels that no view sees, from texels nearby in space that face the same way.
//!
//! Seen texels are averaged in cells of a sparse grid, apart for each of six facing directions, at doubling cell sizes. An
//! unseen texel takes the finest level on which cells around it know anything. Averages are geometric: a lamp must not
//! outshine the wall beside it.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use rayon::prelude::*;

/// Sizes of cells that are tried: from the finest, each twice the one before.
const LEVELS: u32 = 12;
/// Cells on the finest level are this many texels wide.
const FINEST: f32 = 4.0;
/// Keeps the logarithm of black finite; far below any radiance that matters.
const BLACK: f32 = 1e-6;

/// A place on a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// World position.
    pub position: Vec3,
    /// Unit normal.
    pub normal: Vec3,
}

/// Weighted sum of logarithmic radiance.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    sum: Vec3,
    weight: f32,
}

type Level = HashMap<(IVec3, u8), Mean>;

/// What the seen texels know, at all sizes.
pub(super) struct Known {
    /// Edge of a cell on the finest level, metres.
    cell: f32,
    levels: Vec<Level>,
    all: Mean,
}

impl Known {
    /// Gathers the seen texels; `texel` is the edge of a typical texel, metres.
    pub fn new(seen: impl Iterator<Item = (Place, [f32; 3])>, texel: f32) -> Self {
        let cell = FINEST * texel;
        let mut finest = Level::new();
        let mut all = Mean::default();
        for (place, radiance) in seen {
            let log = (Vec3::from(radiance) + BLACK).map(f32::ln);
            let key = ((place.position / cell).floor().as_ivec3(), facing(place.normal));
            for mean in [finest.entry(key).or_default(), &mut all] {
                mean.sum += log;
                mean.weight += 1.0;
            }
        }
        let mut levels = vec![finest];
        while levels.len() < LEVELS as usize {
            let mut coarse = Level::new();
            for ((cell, facing), mean) in levels.last().into_iter().flatten() {
                let parent = coarse.entry((*cell >> 1, *facing)).or_default();
                parent.sum += mean.sum;
                parent.weight += mean.weight;
            }
            levels.push(coarse);
        }
        Self { cell, levels, all }
    }

    /// Radiance at each place; black if nothing is known at all.
    pub fn fill(&self, places: &[Place]) -> Vec<[f32; 3]> {
        places
            .par_iter()
            .map(|place| {
                let mean = (0..self.levels.len()).find_map(|level| self.around(place, level)).unwrap_or(self.all);
                if mean.weight > 0.0 {
                    ((mean.sum / mean.weight).map(f32::exp) - BLACK).max(Vec3::ZERO).into()
                } else {
                    [0.0; 3]
                }
            })
            .collect()
    }

    /// Trilinear blend of the cells around a place on one level.
    fn around(&self, place: &Place, level: usize) -> Option<Mean> {
        let cells = &self.levels[level];
        let p = place.position / (self.cell * (1u32 << level) as f32) - 0.5;
        let (base, f) = (p.floor().as_ivec3(), p - p.floor());
        let facing = facing(place.normal);
        let mut blend = Mean::default();
        for corner in 0..8 {
            let offset = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let tent = (Vec3::ONE - (f - offset.as_vec3()).abs()).element_product();
            if let Some(mean) = cells.get(&(base + offset, facing)) {
                blend.sum += mean.sum / mean.weight * tent;
                blend.weight += tent;
            }
        }
        // A sliver of a far cell is no basis.
        (blend.weight > 0.05).then_some(blend)
    }
}

/// Which of the six axis directions a normal is closest to.
fn facing(normal: Vec3) -> u8 {
    let axis = normal.abs().max_position() as u8;
    2 * axis + u8::from(normal[usize::from(axis)] < 0.0)
}
