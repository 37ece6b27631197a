//! Two half-gathers of every texel, whose difference estimates the error; on request in rounds, until it is small
//! enough.
//!
//! Every round but the first doubles a texel's rays. Which texels take part in the next is told by their neighbours:
//! were a texel to stop when its own samples look good, it would stop at lucky values, which are too dark more often
//! than not (Kirk and Arvo, "Unbiased Sampling Techniques for Image Synthesis", SIGGRAPH 1991).

use std::borrow::Cow;

use glam::Vec3;
use rayon::prelude::*;

use super::spatial_blocks::SpatialBlocks;
use super::store::{Items, Store};
use super::texels::{PIECE, Texels};
use super::tiles::{Tiles, is_outside, rays_of};
use crate::backend::{Backend, Gather, Gathered, Sequences};
use crate::checkpoint::Checkpoints;
use crate::error::{Error, Result};
use crate::neighbours::{NEAR, Neighbours};
use crate::progress::{Progress, Task};
use crate::raster::luminance;
use crate::rng::hash;
use crate::surface::SurfacePoint;

/// Samples per half and technique in the first round: few enough to be cheap, and with those of the neighbours enough
/// to tell what the error is.
const FIRST: u32 = 16;
/// How far the neighbours reach that tell a texel's error, texels: about twenty of them.
pub(super) const RADIUS: f32 = 2.5;
/// Errors are relative to the irradiance, but not to less than this share of the mean over all texels: in deep shadow
/// nobody sees a large share of nearly nothing.
const DARK: f32 = 0.05;

/// What was gathered.
pub(super) struct Estimate {
    /// The means of two halves of every point's samples.
    pub halves: [Store<'static, Gathered>; 2],
    /// Rays of every point, both halves together.
    rays: Store<'static, u32>,
    /// What counts as dark: see [`DARK`]. Never 0, so that a point in the dark has no error rather than none that is
    /// defined.
    floor: f32,
}

impl Estimate {
    /// Gathers at texels with `gather.cosine + gather.light` rays each, or fewer where the relative error is below
    /// `error` before.
    pub fn sample(
        backend: &mut dyn Backend,
        surface: &SpatialBlocks<'_>,
        gather: Gather,
        error: Option<f32>,
        checkpoints: &Checkpoints,
        progress: &dyn Progress,
    ) -> Result<Self> {
        if gather.cosine < 2 {
            return Err(Error::invalid(
                "denoising, and the standard error, compare two halves of the rays: at least 2 must be cosine-distributed",
            ));
        }
        let target = error.filter(|error| *error > 0.0);
        let texels = surface.texels;
        let mut estimate =
            Self { halves: [texels.zeroed()?, texels.zeroed()?], rays: texels.zeroed()?, floor: f32::MIN_POSITIVE };
        let mut active = None;
        for (number, round) in rounds(gather, error, texels.size()[0]).into_iter().enumerate() {
            if let (Some(target), true) = (target, number > 0) {
                active = Some(estimate.above(target, surface, progress)?);
            }
            let rays = rays_of(round[0]);
            let tiles = Tiles::new(&texels.points, active.as_ref(), rays);
            let task = Task::start(progress, "irradiance", tiles.points() as u64 * 2 * rays, "rays");
            for (half, gather) in round.into_iter().enumerate() {
                let kept = checkpoints.within(&format!("round-{number}-half-{half}"));
                let all = &mut estimate.halves[half];
                tiles.gather(gather, backend, &kept, progress, |items, found| {
                    let before = all.get(items)?;
                    let joined: Vec<Gathered> =
                        before.iter().zip(found).map(|(before, found)| joined(before, found, number)).collect();
                    all.set(items, &joined)
                })?;
            }
            drop(task);
            for items in tiles.items() {
                let items = items?;
                let so_far: Vec<u32> =
                    estimate.rays.get(&items)?.iter().map(|before| before + 2 * rays as u32).collect();
                estimate.rays.set(&items, &so_far)?;
            }
            estimate.floor = estimate.dark(texels)?;
        }
        Ok(estimate)
    }

    /// E of every point, the mean of both halves, and 0 for points inside other geometry, else 1.
    pub fn means(&self, texels: &Texels<'_>) -> Result<(Store<'static, [f32; 3]>, Store<'static, u8>)> {
        let (mut means, mut outside) = (texels.zeroed()?, texels.zeroed()?);
        for items in texels.pieces() {
            let known = self.known(&items)?;
            let [a, b] = &known.halves;
            means.set(&items, &(0..items.len()).map(|i| known.mean(i).to_array()).collect::<Vec<_>>())?;
            let back_faces = a.iter().zip(b.iter()).map(|(a, b)| (a.back_faces + b.back_faces) / 2.0);
            outside.set(&items, &back_faces.map(is_outside).collect::<Vec<_>>())?;
        }
        Ok((means, outside))
    }

    /// Rays of all points.
    pub fn rays(&self) -> Result<u64> {
        self.rays.pieces(PIECE).map(|rays| Ok(rays?.iter().map(|&n| u64::from(n)).sum::<u64>())).sum()
    }

    /// Standard error of the luminance of every point's mean.
    pub fn standard_errors(&self, surface: &SpatialBlocks<'_>, progress: &dyn Progress) -> Result<Store<'static, f32>> {
        let mut errors = surface.texels.zeroed()?;
        surface.each("errors", progress, |_, block, points| {
            let known = self.known(&block.items)?;
            let own = |i: usize| block.owns(&points[i]);
            let relative = known.relative_errors(surface, points);
            let error = |i: usize| relative[i].unwrap_or(known.difference(i)) * known.luminance(i).max(known.floor);
            let found: Vec<f32> = (0..points.len()).filter(|&i| own(i)).map(error).collect();
            errors.set(&block.items.filter(own), &found)
        })?;
        Ok(errors)
    }

    /// The points, in atlas order, that took part in the last round and whose relative error is above `target` even so.
    fn above(&self, target: f32, surface: &SpatialBlocks<'_>, progress: &dyn Progress) -> Result<Store<'static, u32>> {
        let most = self.rays.pieces(PIECE).try_fold(0, |most, rays| Ok(rays?.iter().fold(most, |a, b| a.max(*b))))?;
        let mut above = surface.texels.zeroed::<u8>()?;
        surface.each("errors", progress, |_, block, points| {
            let known = self.known(&block.items)?;
            let errors = known.relative_errors(surface, points);
            let open = |i: usize| known.rays[i] == most && errors[i].is_none_or(|error| error > target);
            let own = |i: usize| block.owns(&points[i]);
            let found: Vec<u8> = (0..points.len()).filter(|&i| own(i)).map(|i| u8::from(open(i))).collect();
            above.set(&block.items.filter(own), &found)
        })?;
        let mut list = surface.texels.workspace.empty()?;
        for items in surface.texels.pieces() {
            let Items::Range(range) = &items else { continue };
            let above = above.get(&items)?;
            let open = range.clone().zip(above.iter()).filter(|(_, above)| **above != 0);
            list.extend(&open.map(|(i, _)| i as u32).collect::<Vec<_>>())?;
        }
        Ok(list)
    }

    /// See `floor`.
    fn dark(&self, texels: &Texels<'_>) -> Result<f32> {
        let mut sum = 0.0;
        for items in texels.pieces() {
            let known = self.known(&items)?;
            (0..items.len()).for_each(|i| sum += f64::from(known.luminance(i)));
        }
        Ok((DARK * (sum / self.rays.len().max(1) as f64) as f32).max(f32::MIN_POSITIVE))
    }

    fn known(&self, items: &Items) -> Result<EstimateAt<'_>> {
        let [a, b] = &self.halves;
        Ok(EstimateAt { halves: [a.get(items)?, b.get(items)?], rays: self.rays.get(items)?, floor: self.floor })
    }
}

/// What was gathered at some points; functions take their places among these.
struct EstimateAt<'a> {
    halves: [Cow<'a, [Gathered]>; 2],
    rays: Cow<'a, [u32]>,
    floor: f32,
}

impl EstimateAt<'_> {
    /// E of a point: the mean of both halves.
    fn mean(&self, i: usize) -> Vec3 {
        (Vec3::from(self.halves[0][i].irradiance) + Vec3::from(self.halves[1][i].irradiance)) / 2.0
    }

    /// Standard error of every point's luminance as a share of it, from its neighbours alone; `None` where there are
    /// none. The variance is taken to fall with the number of rays.
    fn relative_errors(&self, surface: &SpatialBlocks<'_>, points: &[SurfacePoint]) -> Vec<Option<f32>> {
        // Of one ray.
        let variances: Vec<f32> = (0..points.len()).map(|i| self.difference(i).powi(2) * self.rays[i] as f32).collect();
        let mut errors = vec![None; points.len()];
        for class in surface.size_classes(points) {
            let (variances, rays, radius) = (class.gather(&variances), class.gather(&self.rays), RADIUS * class.texel);
            let neighbours = Neighbours::<NEAR>::new(&class.gather(points), radius);
            let error = |i: usize| {
                let (mut sum, mut count) = (0.0, 0.0);
                neighbours.each(i, radius, |j, _| {
                    if j != i {
                        sum += variances[j];
                        count += 1.0;
                    }
                });
                (count > 0.0).then(|| f32::sqrt(sum / (count * rays[i] as f32)))
            };
            class.scatter((0..rays.len()).into_par_iter().map(error).collect(), &mut errors);
        }
        errors
    }

    /// Half of the difference of both halves as a share of their mean: the standard error, if only on average.
    fn difference(&self, i: usize) -> f32 {
        let [a, b] = [0, 1].map(|half| luminance(&self.halves[half][i].irradiance));
        (a - b).abs() / (2.0 * self.luminance(i).max(self.floor))
    }

    fn luminance(&self, i: usize) -> f32 {
        luminance(&self.mean(i).to_array())
    }
}

/// The gather of all rounds up to this `round`, which has as many rays as those before it together.
fn joined(before: &Gathered, last: &Gathered, round: usize) -> Gathered {
    if round == 0 {
        return *last;
    }
    let mean = |c: usize| (before.irradiance[c] + last.irradiance[c]) / 2.0;
    Gathered { irradiance: [mean(0), mean(1), mean(2)], back_faces: (before.back_faces + last.back_faces) / 2.0 }
}

/// Both halves' gathers, by rounds. Without `error` there is one round, on sequences that texels of a map `width` wide
/// share; the halves are two parts of a texel's stretch, which have less error than independent ones but overestimate
/// it by a fifth. With `error` the halves are independent; where it is above 0, texels stop at different times and have
/// sequences of their own, a short first round and others that each double the samples so far.
fn rounds(gather: Gather, error: Option<f32>, width: usize) -> Vec<[Gather; 2]> {
    let half = Gather { cosine: gather.cosine / 2, light: gather.light / 2, ..gather };
    let apart = |half: Gather| [half.seed, hash(half.seed)].map(|seed| Gather { seed, ..half });
    match error {
        None => return vec![[0, 1].map(|part| half.shared_in_parts(width, [part, 2]))],
        Some(error) if !(error > 0.0) => return vec![apart(half.shared(width))],
        Some(_) => {}
    }
    // The smallest has lights as well.
    let cosine = (half.cosine / FIRST).checked_ilog2().unwrap_or(0);
    let doublings = half.light.checked_ilog2().map_or(cosine, |light| cosine.min(light));
    let part = |part, double: u32| Gather {
        cosine: (half.cosine >> doublings) << double,
        light: (half.light >> doublings) << double,
        sequences: Sequences::Own { part },
        ..half
    };
    std::iter::once(part(0, 0)).chain((0..doublings).map(|k| part(1, k))).map(apart).collect()
}

#[cfg(test)]
mod tests;
