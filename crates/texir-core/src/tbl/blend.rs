//! One radiance from the observations of several views.

use super::TblOptions;
use super::sample::Observation;

/// The best observations of one texel, by weight.
#[derive(Clone, Debug, Default)]
pub(super) struct Best {
    seen: [Option<Observation>; Best::KEPT],
}

impl Best {
    /// Views that are blended per texel at most; the rest are further away or see the texel more obliquely.
    const KEPT: usize = 12;

    /// Keeps `new`, if it is among the best.
    pub fn add(&mut self, new: Observation) {
        let worst = self
            .seen
            .iter_mut()
            .min_by(|a, b| weight(a).total_cmp(&weight(b)))
            .filter(|slot| weight(slot) < new.weight);
        if let Some(slot) = worst {
            *slot = Some(new);
        }
    }

    /// The blend; `None` for a texel that no view sees.
    ///
    /// What is reflected changes with the view, what is diffuse does not: the weighted median of the logarithmic
    /// luminance is taken for the diffuse part, and observations count less the further they are from it (Cauchy
    /// weights), so that a highlight or a misprojected edge that few views show does not enter.
    pub fn blend(&self, options: &TblOptions) -> Option<[f32; 3]> {
        let mut seen: Vec<(f32, f32, [f32; 3])> = self
            .seen
            .iter()
            .flatten()
            .map(|o| (log_luminance(o.radiance), o.weight.powf(options.sharpness), o.radiance))
            .collect();
        seen.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = options.quantile * seen.iter().map(|s| s.1).sum::<f32>();
        let mut below = 0.0;
        let median = seen.iter().find_map(|s| {
            below += s.1;
            (below >= half).then_some(s.0)
        })?;
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for (log, weight, radiance) in seen {
            let weight = weight / (1.0 + ((log - median) / options.tolerance).powi(2));
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

/// ln of the mean of the channels, finite for black.
fn log_luminance(radiance: [f32; 3]) -> f32 {
    ((radiance[0] + radiance[1] + radiance[2]) / 3.0).max(1e-6).ln()
}
