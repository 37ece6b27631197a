//! One radiance from the observations of several views.

use super::TblOptions;
use super::sample::Observation;
use crate::raster::mean_of_channels;
use crate::stats;

/// Darker than the median by this much of the views' spread (median absolute deviation) is an outlier: somebody walked
/// through the picture, or another surface is in the way. Twice that of a normal distribution's three standard
/// deviations.
const DARKER: f32 = 9.0;
/// And darker by this much in logarithmic luminance: views of nearly the same luminance differ by noise.
const CLEARLY_DARKER: f32 = 0.1;

/// The best observations of one texel, by weight.
#[derive(Clone, Debug, Default)]
pub(super) struct Best {
    seen: [Option<Observation>; Best::KEPT],
    /// The best of those that the views' masks exclude.
    masked: Option<Observation>,
    /// How many of all observations masks exclude, less how many they do not.
    excluded: i32,
}

/// One observation as the blend sees it.
#[derive(Clone, Copy)]
struct Weighed {
    /// ln of the mean of the channels.
    log_mean: f32,
    /// Views are blended in proportion to it.
    weight: f32,
    radiance: [f32; 3],
}

impl Best {
    /// Views that are blended per texel at most; the rest are further away or see the texel more obliquely.
    const KEPT: usize = 12;

    /// Keeps `new`, if it is among the best.
    pub fn add(&mut self, new: Observation) {
        let slots = if new.masked { std::slice::from_mut(&mut self.masked) } else { &mut self.seen[..] };
        self.excluded += if new.masked { 1 } else { -1 };
        let worst =
            slots.iter_mut().min_by(|a, b| weight(a).total_cmp(&weight(b))).filter(|slot| weight(slot) < new.weight);
        if let Some(slot) = worst {
            *slot = Some(new);
        }
    }

    /// The blend; `None` for a texel that no view sees.
    ///
    /// What most views exclude is a light source (see [`super::Photo`]), and taken from the view that resolves it best.
    ///
    /// What is reflected changes with the view, what is diffuse does not, and reflections only ever add light: a low
    /// quantile of the logarithmic luminance is taken for the diffuse part, once what is much darker than most is left
    /// out. The observations count less the further their logarithms are from it (Cauchy weights), so that a highlight,
    /// a passer-by or a misprojected edge that few views show does not enter.
    pub fn blend(&self, options: &TblOptions) -> Option<[f32; 3]> {
        if let Some(masked) = self.masked.filter(|_| self.excluded > 0) {
            return Some(masked.radiance);
        }
        let mut seen: Vec<Weighed> = self
            .seen
            .iter()
            .flatten()
            .map(|o| Weighed {
                log_mean: log(mean_of_channels(o.radiance)),
                weight: o.weight.powf(options.sharpness),
                radiance: o.radiance,
            })
            .collect();
        seen.sort_by(|a, b| a.log_mean.total_cmp(&b.log_mean));
        // Whoever is close sees more highlights: here, views count alike.
        let median = seen.get(seen.len() / 2)?.log_mean;
        let mut spread: Vec<f32> = seen.iter().map(|s| (s.log_mean - median).abs()).collect();
        let allowed = (DARKER * stats::median(&mut spread)?).max(CLEARLY_DARKER);
        seen.retain(|s| s.log_mean >= median - allowed);
        let diffuse = quantile(&seen, options.quantile)?;
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for Weighed { weight, radiance, .. } in seen {
            let off = |c: usize| (log(radiance[c]) - log(diffuse.radiance[c])) / options.tolerance;
            let weight = weight / (1.0 + (0..3).map(|c| off(c).powi(2)).sum::<f32>() / 3.0);
            for (s, r) in sum.iter_mut().zip(radiance) {
                *s += weight * r;
            }
            total += weight;
        }
        (total > 0.0).then(|| sum.map(|s| s / total))
    }
}

fn weight(observation: &Option<Observation>) -> f32 {
    observation.as_ref().map_or(f32::NEG_INFINITY, |o| o.weight)
}

/// The first of `sorted` (by `log_mean`) at which the sum of the weights reaches this share of all.
fn quantile(sorted: &[Weighed], share: f32) -> Option<Weighed> {
    let least = share * sorted.iter().map(|s| s.weight).sum::<f32>();
    let mut below = 0.0;
    sorted.iter().copied().find(|s| {
        below += s.weight;
        below >= least
    })
}

/// The natural logarithm, finite for black.
fn log(radiance: f32) -> f32 {
    radiance.max(1e-6).ln()
}
