//! Weighted sums over the shots.
//!
//! A shot's estimate of radiance is light / exposure; its weight is the inverse of that estimate's variance (shot and
//! read noise, quantisation): the least noisy unbiased sum (Granados et al., "Optimal HDR Reconstruction with Linear
//! Digital Cameras", CVPR 2010). Variances are taken at the radiance of the pixel's anchor, not of the shot itself: a
//! weight that knows its own noise is biased. The anchor is the first usable shot, in an order that starts with the
//! reference; shots that disagree with it saw something that moved and are left out.

use rayon::prelude::*;

use super::{BLACK, CLIPPED, Response, sensor_variance};
use crate::image_io::Encoded;
use crate::raster::{Raster, Rgb};

/// A shot that differs from the anchor by more standard deviations than this shows something else.
const GHOST_DEVIATIONS: f32 = 5.0;
/// Relative difference between shots that is forgiven beside noise: response and exposure times are not exact.
const GHOST_TOLERANCE: f32 = 0.08;

/// The order in which shots are merged: the one with the most usable pixels first, then by how near their exposures are
/// to that one's.
pub(super) fn order(samples: &[Vec<[f32; 3]>], exposures: &[f64]) -> Vec<usize> {
    let usable = |shot: usize| {
        let well = |v: &[f32; 3]| v.iter().all(|v| *v > BLACK && *v < CLIPPED);
        samples.iter().filter(|sample| sample.get(shot).is_some_and(well)).count()
    };
    let reference = (0..exposures.len()).max_by_key(|shot| usable(*shot)).unwrap_or_default();
    let mut order: Vec<usize> = (0..exposures.len()).collect();
    let stops = |shot: usize| (exposures[shot] / exposures[reference]).log2().abs();
    order.sort_by(|a, b| stops(*a).total_cmp(&stops(*b)));
    order
}

/// What is known of a pixel so far.
#[derive(Clone, Copy, Default)]
struct PixelSums {
    /// Radiance and its variance in the first usable shot.
    anchor: Option<[(f32, f32); 3]>,
    weighted: [f32; 3],
    weights: [f32; 3],
    ghost: bool,
    /// The smallest exposure in which the pixel is clipped, and the radiance that it shows there.
    ceiling: Option<(f32, [f32; 3])>,
}

/// Sums over the shots seen so far.
pub(super) struct Sums {
    width: usize,
    height: usize,
    pixels: Vec<PixelSums>,
}

impl Sums {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![PixelSums::default(); width * height] }
    }

    /// Adds a shot.
    pub(super) fn add(&mut self, shot: &Encoded, exposure: f64, response: &Response) {
        let step = 1.0 / ((1_u32 << shot.bits) - 1) as f32;
        self.pixels.par_iter_mut().zip(&shot.values.data).for_each(|(pixel, values)| {
            pixel.add(*values, exposure as f32, step, response);
        });
    }

    /// Radiance, the number of pixels that every shot clips, and the number of pixels with ghosts.
    pub(super) fn finish(self) -> (Rgb, usize, usize) {
        let clipped = self.pixels.iter().filter(|p| p.anchor.is_none()).count();
        let ghosts = self.pixels.iter().filter(|p| p.ghost).count();
        let radiance =
            Raster { width: self.width, height: self.height, data: self.pixels.iter().map(|p| p.radiance()).collect() };
        (radiance, clipped, ghosts)
    }
}

impl PixelSums {
    fn add(&mut self, values: [f32; 3], exposure: f32, step: f32, response: &Response) {
        let seen: [(f32, f32); 3] = std::array::from_fn(|c| response.light(c, values[c]));
        // All channels or none: a lamp that clips in red alone must not change its colour.
        if values.iter().any(|v| *v >= CLIPPED) {
            if self.ceiling.is_none_or(|(smallest, _)| exposure < smallest) {
                self.ceiling = Some((exposure, seen.map(|(light, _)| light / exposure)));
            }
            return;
        }
        let variance = |light: f32, slope: f32| {
            let quantisation = (slope * step).powi(2) / 12.0;
            (sensor_variance(f64::from(light)) as f32 + quantisation) / (exposure * exposure)
        };
        let own = seen.map(|(light, slope)| (light / exposure, variance(light, slope)));
        let anchor = *self.anchor.get_or_insert(own);
        let agrees = own.iter().zip(&anchor).all(|((radiance, v), (anchor, anchor_v))| {
            let tolerance = GHOST_DEVIATIONS * (v + anchor_v).sqrt() + GHOST_TOLERANCE * anchor.max(*radiance);
            (radiance - anchor).abs() <= tolerance
        });
        if !agrees {
            self.ghost = true;
            return;
        }
        for c in 0..3 {
            let weight = 1.0 / variance(anchor[c].0 * exposure, seen[c].1);
            self.weighted[c] += weight * own[c].0;
            self.weights[c] += weight;
        }
    }

    /// The weighted mean; where every shot clips, at least what the shortest shows.
    fn radiance(&self) -> [f32; 3] {
        match (self.anchor, self.ceiling) {
            (Some(_), _) => std::array::from_fn(|c| self.weighted[c] / self.weights[c]),
            (None, Some((_, ceiling))) => ceiling,
            (None, None) => [0.0; 3],
        }
    }
}
