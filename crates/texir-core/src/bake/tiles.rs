//! Gathers, a tile of points after another, each of which is kept.

use super::store::{Items, Store};
use crate::backend::{Backend, Gather, Gathered};
use crate::checkpoint::Checkpoints;
use crate::error::Result;
use crate::progress::Progress;
use crate::surface::SurfacePoint;

/// Rays of a tile: some seconds' work on a processor.
const RAYS: usize = 1 << 23;

/// Points of a tile at most, for the memory that they take.
const POINTS: usize = 1 << 18;

/// A texel lies inside an object when this share of its rays meets the backs of triangles.
const BURIED: f32 = 0.5;

/// Points to gather at. How they are cut into tiles changes nothing, as a point's samples depend on it alone.
pub(super) struct Tiles<'a> {
    points: &'a Store<'a, SurfacePoint>,
    /// Some of the points, or all.
    chosen: Option<&'a Store<'a, u32>>,
    /// Points of a tile.
    len: usize,
}

impl<'a> Tiles<'a> {
    /// All points, or those that are `chosen`, for gathers of so many `rays` each.
    pub fn new(points: &'a Store<'a, SurfacePoint>, chosen: Option<&'a Store<'a, u32>>, rays: u64) -> Self {
        let len = (RAYS / (rays as usize).max(1)).clamp(1, POINTS);
        Self { points, chosen, len }
    }

    /// The same with so many points in a tile.
    #[cfg(test)]
    pub fn of(self, len: usize) -> Self {
        Self { len, ..self }
    }

    /// How many points there are.
    pub fn points(&self) -> usize {
        self.chosen.map_or(self.points.len(), Store::len)
    }

    /// The tiles.
    pub fn items(&self) -> impl Iterator<Item = Result<Items>> {
        (0..self.points()).step_by(self.len).map(|start| {
            let range = Items::Range(start..(start + self.len).min(self.points()));
            let Some(chosen) = self.chosen else { return Ok(range) };
            Ok(Items::Listed(chosen.get(&range)?.into_owned()))
        })
    }

    /// Gathers, and hands on what was found at the points of every tile.
    pub fn gather(
        &self,
        gather: Gather,
        backend: &mut dyn Backend,
        checkpoints: &Checkpoints,
        progress: &dyn Progress,
        mut take: impl FnMut(&Items, &[Gathered]) -> Result<()>,
    ) -> Result<()> {
        for (number, items) in self.items().enumerate() {
            let items = items?;
            let mut known = true;
            let found = checkpoints.array(&format!("tile-{number}"), items.len(), || {
                known = false;
                backend.irradiance(&self.points.get(&items)?, gather, progress)
            })?;
            if known {
                progress.check()?;
                progress.advance(items.len() as u64 * rays_of(gather));
            }
            take(&items, &found)?;
        }
        Ok(())
    }
}

/// Rays of one point.
pub(super) fn rays_of(gather: Gather) -> u64 {
    u64::from(gather.cosine) + u64::from(gather.light)
}

/// 0 for a point inside other geometry (see [`BURIED`]), else 1.
pub(super) fn is_outside(back_faces: f32) -> u8 {
    u8::from(back_faces < BURIED)
}
