//! Values for texels that no view sees (radiance, albedo, roughness), from texels nearby in space that belong with
//! them.
//!
//! Seen texels are averaged in cells of a sparse grid, apart for each group (those that face the same way, or a
//! segment), at doubling cell sizes. An unseen texel takes the finest level on which cells around it know anything.
//! Averages are geometric.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, DefaultHasher};

use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

use crate::raster::mean_of_channels;
use crate::stats::median;
use crate::surface::{SurfacePoint, facing};

/// Sizes of cells that are tried: from the finest, each twice the one before.
const LEVELS: usize = 12;
/// Cells on the finest level are this many texels wide.
const FINEST: f32 = 4.0;
/// Texels are not taken for smaller than this, metres: degenerate triangles have none.
const SMALLEST_TEXEL: f32 = 1e-4;
/// A texel this many times brighter than the median is taken for a light source.
const SOURCE: f32 = 8.0;
/// Keeps the logarithm of black finite; far below any radiance that matters.
const BLACK: f32 = 1e-6;

/// The radiance of all points, where `known` as it is, else that of what is near and faces the same way; black if
/// nothing is known at all. Light sources are left out of the averages: light is not invented. `texel` is the edge of a
/// typical texel, metres.
pub(crate) fn fill(points: &[SurfacePoint], known: &[Option<[f32; 3]>], texel: f32) -> Vec<[f32; 3]> {
    let limit = source_limit(known);
    let group: Vec<u32> = points.par_iter().map(|p| facing(p.normal.into()) as u32).collect();
    fill_groups(points, &group, known, |value| mean_of_channels(value) <= limit, texel)
}

/// The values of all points, non-negative, where `known` as they are, else those near in the point's group that are
/// `usual`; the average of all groups where a group knows nothing.
pub(crate) fn fill_groups(
    points: &[SurfacePoint],
    group: &[u32],
    known: &[Option<[f32; 3]>],
    usual: impl Fn([f32; 3]) -> bool,
    texel: f32,
) -> Vec<[f32; 3]> {
    let seen = (0..points.len()).filter_map(|i| known[i].filter(|&v| usual(v)).map(|v| (&points[i], group[i], v)));
    let grid = NestedGrids::new(seen, texel);
    let value = |i: usize| known[i].unwrap_or_else(|| grid.value(&points[i], group[i]));
    (0..points.len()).into_par_iter().map(value).collect()
}

/// The mean over the channels above which a texel is taken for a light source; 0 without texels.
pub(crate) fn source_limit(known: &[Option<[f32; 3]>]) -> f32 {
    let mut means: Vec<f32> = known.iter().flatten().map(|&radiance| mean_of_channels(radiance)).collect();
    median(&mut means).map_or(0.0, |median| SOURCE * median)
}

/// Weighted sum of logarithms.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    sum: DVec3,
    weight: f64,
}

impl Mean {
    fn add(&mut self, sum: DVec3, weight: f64) {
        self.sum += sum;
        self.weight += weight;
    }
}

/// Cells of one size. The hasher is fixed, so that sums over cells run in the same order every time.
type Cells = HashMap<(IVec3, u32), Mean, BuildHasherDefault<DefaultHasher>>;

/// What the seen texels know, at all sizes.
struct NestedGrids {
    /// Edge of a cell on the finest level, metres.
    cell: f32,
    levels: Vec<Cells>,
    all: Mean,
}

impl NestedGrids {
    fn new<'a>(seen: impl Iterator<Item = (&'a SurfacePoint, u32, [f32; 3])>, texel: f32) -> Self {
        let cell = FINEST * texel.max(SMALLEST_TEXEL);
        let mut finest = Cells::default();
        let mut all = Mean::default();
        for (point, group, value) in seen {
            let log = (Vec3::from(value) + BLACK).map(f32::ln);
            let cell = (Vec3::from(point.position) / cell).floor().as_ivec3();
            finest.entry((cell, group)).or_default().add(log.as_dvec3(), 1.0);
            all.add(log.as_dvec3(), 1.0);
        }
        let mut levels = vec![finest];
        for level in 1..LEVELS {
            let mut coarse = Cells::default();
            for ((cell, group), mean) in &levels[level - 1] {
                coarse.entry((*cell >> 1, *group)).or_default().add(mean.sum, mean.weight);
            }
            levels.push(coarse);
        }
        Self { cell, levels, all }
    }

    /// The value at a point of a group that is not known.
    fn value(&self, point: &SurfacePoint, group: u32) -> [f32; 3] {
        let mean = (0..self.levels.len()).find_map(|level| self.around(point, group, level)).unwrap_or(self.all);
        if mean.weight > 0.0 {
            ((mean.sum / mean.weight).as_vec3().map(f32::exp) - BLACK).max(Vec3::ZERO).to_array()
        } else {
            [0.0; 3]
        }
    }

    /// Trilinear blend of the cells around a point on one level.
    fn around(&self, point: &SurfacePoint, group: u32, level: usize) -> Option<Mean> {
        let cells = &self.levels[level];
        let p = Vec3::from(point.position) / (self.cell * (1u32 << level) as f32) - 0.5;
        let (base, f) = (p.floor().as_ivec3(), p - p.floor());
        let mut blend = Mean::default();
        for corner in 0..8 {
            let offset = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let tent = f64::from((Vec3::ONE - (f - offset.as_vec3()).abs()).element_product());
            if let Some(mean) = cells.get(&(base + offset, group)) {
                blend.add(mean.sum / mean.weight * tent, tent);
            }
        }
        // A sliver of a far cell is no basis.
        (blend.weight > 0.05).then_some(blend)
    }
}
