//! What a model says about a crop, and what several crops say together.

use glam::Vec2;

use crate::raster::Raster;

/// A model's answer about one crop, at the model's resolution.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum CropVotes {
    /// The share of each class in each pixel, class by class within the pixel.
    Shares {
        width: usize,
        height: usize,
        /// `height · width · classes` values.
        shares: Vec<f32>,
    },
    /// Each pixel's class.
    Classes(Raster<u16>),
}

impl CropVotes {
    /// The softmax of scores that are stored class after class.
    pub(super) fn of_scores(width: usize, height: usize, scores: &[f32]) -> Self {
        let pixels = width * height;
        let mut shares = vec![0.0; scores.len()];
        for (pixel, shares) in shares.chunks_exact_mut(scores.len() / pixels).enumerate() {
            let scores = || scores[pixel..].iter().step_by(pixels);
            let largest = scores().copied().fold(f32::NEG_INFINITY, f32::max);
            for (share, score) in shares.iter_mut().zip(scores()) {
                *share = (score - largest).exp();
            }
            let sum: f32 = shares.iter().sum();
            // Scores that are not numbers say nothing.
            let scale = if sum.is_finite() { 1.0 / sum } else { 0.0 };
            shares.iter_mut().for_each(|share| *share = if scale > 0.0 { *share * scale } else { 0.0 });
        }
        Self::Shares { width, height, shares }
    }

    /// Adds what is said about a place of the crop, both coordinates in [0, 1], to the sums of the classes.
    pub(super) fn add(&self, at: Vec2, weight: f32, sums: &mut [f32]) {
        let [width, height] = match self {
            Self::Shares { width, height, .. } => [*width, *height],
            Self::Classes(classes) => classes.size(),
        };
        let place = at * Vec2::new(width as f32, height as f32) - 0.5;
        let (corner, t) = (place.floor(), place - place.floor());
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let share = |d: i64, t: f32| if d == 0 { 1.0 - t } else { t };
            let weight = weight * share(dx, t.x) * share(dy, t.y);
            let inside = |v: f32, d: i64, size: usize| (v as i64 + d).clamp(0, size as i64 - 1) as usize;
            let pixel = inside(corner.y, dy, height) * width + inside(corner.x, dx, width);
            match self {
                Self::Shares { shares, .. } => {
                    let shares = &shares[pixel * sums.len()..];
                    sums.iter_mut().zip(shares).for_each(|(sum, share)| *sum += weight * share);
                }
                Self::Classes(classes) => sums[usize::from(classes.data[pixel])] += weight,
            }
        }
    }
}

/// The class with the largest sum, the first of several; `None` where all are zero.
pub(super) fn winner(sums: &[f32]) -> Option<usize> {
    let best = |best: Option<usize>, (i, sum): (usize, &f32)| {
        let before = best.map_or(0.0, |best| sums[best]);
        if *sum > before { Some(i) } else { best }
    };
    sums.iter().enumerate().fold(None, best)
}
