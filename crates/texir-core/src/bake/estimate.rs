//! Two independent gathers of every texel, whose difference tells their error, in rounds until that is small enough.
//!
//! Every round but the first doubles a texel's rays. Which texels take part in the next is told by their neighbours: were a
//! texel to stop when its own samples look good, it would stop at lucky values, which are too dark more often than not (Kirk
//! and Arvo, "Unbiased Sampling Techniques for Image Synthesis", SIGGRAPH 1991).

use glam::Vec3;
use rayon::prelude::*;

use super::{TILE_RAYS, in_tiles, rays_of};
use crate::backend::{Backend, Gather, Gathered};
use crate::checkpoint::Checkpoints;
use crate::error::{Error, Result};
use crate::neighbours::Neighbours;
use crate::progress::Progress;
use crate::raster::luminance;
use crate::rng::hash;
use crate::surface::SurfacePoint;

/// Samples per half and technique in the first round: few enough to be cheap, and with those of the neighbours enough to tell
/// what the error is.
const FIRST: u32 = 16;
/// How far the neighbours reach that tell a texel's error, texels: about twenty of them.
const RADIUS: f32 = 2.5;
/// Errors are relative to the irradiance, but not to less than this share of the mean over all texels: in deep shadow nobody
/// sees a large share of nearly nothing.
const DARK: f32 = 0.05;

/// What was gathered.
pub(super) struct Estimate {
    /// The means of two halves of every point's samples.
    pub halves: [Vec<Gathered>; 2],
    /// Rays of every point, both halves together.
    rays: Vec<u32>,
}

impl Estimate {
    /// Gathers at points with `gather.cosine + gather.light` rays each, or fewer where the relative error is below `error` before.
    /// `texel` is the edge of a typical texel, metres.
    pub fn sample(
        backend: &mut dyn Backend,
        points: &[SurfacePoint],
        texel: f32,
        gather: Gather,
        error: Option<f32>,
        checkpoints: &Checkpoints,
        progress: &dyn Progress,
    ) -> Result<Self> {
        if gather.cosine < 2 {
            return Err(Error::invalid(
                "an error is told from two halves of the rays: at least 2 must be cosine-distributed",
            ));
        }
        let target = error.filter(|error| *error > 0.0);
        let nothing = Gathered { irradiance: [0.0; 3], back_faces: 0.0 };
        let mut estimate = Self { halves: [(); 2].map(|()| vec![nothing; points.len()]), rays: vec![0; points.len()] };
        let neighbours = target.map(|_| Neighbours::new(points, RADIUS * texel));
        let rounds = rounds(gather, target.is_some());
        let mut active: Vec<u32> = (0..points.len() as u32).collect();
        for (number, &round) in rounds.iter().enumerate() {
            if let (Some(neighbours), Some(target), true) = (&neighbours, target, number > 0) {
                let floor = estimate.floor();
                let error = |i: u32| estimate.relative_error(i as usize, points, neighbours, floor);
                active = active.into_par_iter().filter(|&i| error(i).is_none_or(|error| error > target)).collect();
            }
            progress.start("irradiance", active.len() as u64 * 2 * rays_of(round), "rays");
            let open: Vec<SurfacePoint> = active.iter().map(|&i| points[i as usize]).collect();
            for (half, seed) in [gather.seed, hash(gather.seed)].into_iter().enumerate() {
                let kept = checkpoints.within(&format!("round-{number}-half-{half}"));
                let found = in_tiles(backend, &open, Gather { seed, ..round }, TILE_RAYS, &kept, progress)?;
                let all = &mut estimate.halves[half];
                active
                    .iter()
                    .zip(&found)
                    .for_each(|(&i, found)| all[i as usize] = joined(&all[i as usize], found, round.part));
            }
            progress.finish();
            active.iter().for_each(|&i| estimate.rays[i as usize] += 2 * rays_of(round) as u32);
        }
        Ok(estimate)
    }

    /// E of a point: the mean of both halves.
    pub fn mean(&self, i: usize) -> Vec3 {
        (Vec3::from(self.halves[0][i].irradiance) + Vec3::from(self.halves[1][i].irradiance)) / 2.0
    }

    /// Rays of all points.
    pub fn rays(&self) -> u64 {
        self.rays.iter().map(|&n| u64::from(n)).sum()
    }

    /// Standard error of the luminance of every point's mean.
    pub fn standard_errors(&self, points: &[SurfacePoint], texel: f32) -> Vec<f32> {
        let (neighbours, floor) = (Neighbours::new(points, RADIUS * texel), self.floor());
        let relative = |i| self.relative_error(i, points, &neighbours, floor).unwrap_or(self.difference(i, floor));
        (0..points.len()).into_par_iter().map(|i| relative(i) * self.luminance(i).max(floor)).collect()
    }

    /// Standard error of a point's luminance as a share of it, from its neighbours alone; `None` where there are none.
    /// The variance is taken to fall with the number of rays.
    fn relative_error(&self, i: usize, points: &[SurfacePoint], neighbours: &Neighbours, floor: f32) -> Option<f32> {
        let (mut sum, mut count) = (0.0, 0.0);
        for (j, _) in neighbours.of(&points[i]).filter(|&(j, _)| j != i) {
            sum += self.difference(j, floor).powi(2) * self.rays[j] as f32;
            count += 1.0;
        }
        (count > 0.0).then(|| f32::sqrt(sum / (count * self.rays[i] as f32)))
    }

    /// Half of the difference of both halves as a share of their mean: the standard error, if only on average.
    fn difference(&self, i: usize, floor: f32) -> f32 {
        let [a, b] = [0, 1].map(|half| luminance(&self.halves[half][i].irradiance));
        (a - b).abs() / (2.0 * self.luminance(i).max(floor))
    }

    fn luminance(&self, i: usize) -> f32 {
        luminance(&self.mean(i).to_array())
    }

    /// What counts as dark: see [`DARK`]. Never 0, so that a point in the dark has no error rather than none that is defined.
    fn floor(&self) -> f32 {
        let sum: f64 = (0..self.rays.len()).map(|i| f64::from(self.luminance(i))).sum();
        (DARK * (sum / self.rays.len().max(1) as f64) as f32).max(f32::MIN_POSITIVE)
    }
}

/// The gather of all parts up to `part`, which has as many rays as those before it together.
fn joined(before: &Gathered, last: &Gathered, part: u32) -> Gathered {
    if part == 0 {
        return *last;
    }
    let mean = |c: usize| (before.irradiance[c] + last.irradiance[c]) / 2.0;
    Gathered { irradiance: [mean(0), mean(1), mean(2)], back_faces: (before.back_faces + last.back_faces) / 2.0 }
}

/// The gathers of one half: all at once, or a small one and others that double it until all are drawn.
fn rounds(gather: Gather, adaptive: bool) -> Vec<Gather> {
    let half = Gather { cosine: gather.cosine / 2, light: gather.light / 2, part: 0, ..gather };
    let doublings = if adaptive { (half.cosine / FIRST).checked_ilog2().unwrap_or(0) } else { 0 };
    let first = Gather { cosine: half.cosine >> doublings, light: half.light >> doublings, ..half };
    let doubling =
        (0..doublings).map(|k| Gather { cosine: first.cosine << k, light: first.light << k, part: 1, ..half });
    std::iter::once(first).chain(doubling).collect()
}

#[cfg(test)]
mod tests;
