//! Whether a part of a segment has a roughness of its own: its joints, a colour.
//!
//! Some roughness always fits a part's pixels better than its segment's, absorbing errors that differ from view to
//! view. Hence two-fold cross-validation: what one half of the views asks for is scored on the other.

use super::evidence::{Tally, minimum};
use crate::fit::settings::AcceptanceSettings;
use crate::specular_table::{NODES, nearest_node, node};

/// What a part's pixels cost.
#[derive(Clone, Copy, Default)]
pub struct PartCosts {
    /// At each node's roughness.
    pub at_nodes: Tally,
    /// Σ of costs at its segment's roughness.
    pub at_parent: f64,
}

/// ln(mean cost) at node `k`, plus the penalty for its distance from the segment's roughness, `parent`.
pub fn objective(costs: &Tally, k: usize, parent: f32, settings: &AcceptanceSettings) -> f32 {
    costs.ln_mean(costs.cost[k]) + settings.prior * (2.0 * (node(k) - parent)).powi(2)
}

/// The one of the `nodes` with the least [`objective`]; `None` without pixels.
pub fn asked(
    costs: &Tally,
    nodes: impl Iterator<Item = usize>,
    parent: f32,
    settings: &AcceptanceSettings,
) -> Option<usize> {
    let objective = |k: usize| objective(costs, k, parent, settings);
    nodes.filter(|_| costs.pixels > 0.0).min_by(|a, b| objective(*a).total_cmp(&objective(*b)))
}

/// Trust, 0 to 1, that a part has a roughness of its own: each half of the views asks for one of the `nodes`, which is
/// scored on the other half.
pub fn trust<N: Iterator<Item = usize>>(
    [first, second]: &[PartCosts; 2],
    nodes: impl Fn() -> N,
    parent: f32,
    settings: &AcceptanceSettings,
) -> f32 {
    let judged = |by: &PartCosts, other: &PartCosts| {
        asked(&other.at_nodes, nodes(), parent, settings).map_or(by.at_parent, |k| by.at_nodes.cost[k])
    };
    let both = Tally::sum([&first.at_nodes, &second.at_nodes].into_iter());
    if both.pixels == 0.0 {
        return 0.0;
    }
    let gain =
        both.ln_mean(first.at_parent + second.at_parent) - both.ln_mean(judged(first, second) + judged(second, first));
    let pixels = both.pixels as f32;
    ramp(settings.gain, gain * pixels / (pixels + settings.half_pixels))
}

/// Roughness of a part by its tallies of both `halves` of the views, in a segment whose roughness is `parent`.
pub fn of_part(halves: &[Tally; 2], parent: f32, settings: &AcceptanceSettings) -> f32 {
    let costs = halves.map(|at_nodes| PartCosts { at_nodes, at_parent: at_nodes.cost[nearest_node(parent)] });
    let trust = trust(&costs, || 0..NODES, parent, settings);
    if trust == 0.0 {
        return parent;
    }
    let both = Tally::sum(halves.iter());
    lerp_ln(parent, minimum(&std::array::from_fn(|k| objective(&both, k, parent, settings))), trust)
}

/// Linear ramp: 0 up to `half`/2, ½ at `half`, 1 from 1.5 `half` on.
pub fn ramp(half: f32, value: f32) -> f32 {
    (value / half - 0.5).clamp(0.0, 1.0)
}

/// Interpolates from `parent` to `own` in ln r, by `trust`.
pub fn lerp_ln(parent: f32, own: f32, trust: f32) -> f32 {
    parent * (own / parent).powf(trust)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_has_a_roughness_of_its_own_where_the_halves_of_the_views_agree() {
        let settings = AcceptanceSettings { prior: 0.1, gain: 0.02, half_pixels: 1000.0 };
        let parent = node(20);
        // Pixels that cost 0.1 at `least`, and by `depth` more at twice or half of that.
        let half = |least: f32, depth: f64, pixels: f64| {
            let cost = |k: usize| pixels * (0.1 + depth * f64::from((node(k) / least).log2().powi(2)));
            Tally { cost: std::array::from_fn(cost), pixels, ..Tally::default() }
        };
        let found = |first, second| of_part(&[first, second], parent, &settings);
        let true_one = 0.6 * parent;
        let clear = half(true_one, 0.02, 5000.0);
        assert!((found(clear, clear) - true_one).abs() < 0.02, "{} for {true_one}", found(clear, clear));
        // As far as they tell, and more of them tell more.
        let by_pixels = [100.0, 200.0, 400.0, 1000.0].map(|pixels| {
            let half = half(true_one, 0.008, pixels);
            found(half, half)
        });
        assert!(by_pixels[0] == parent && by_pixels.is_sorted_by(|a, b| a >= b), "{by_pixels:?}");
        assert!(by_pixels[3] < 0.75 * parent, "{by_pixels:?}");
        // Negative controls: halves that contradict each other, one that says it all, pixels that hardly tell, and no
        // pixels.
        let (other, faint) = (half(1.6 * parent, 0.02, 5000.0), half(true_one, 1e-4, 5000.0));
        for (first, second) in
            [(clear, other), (clear, Tally::default()), (faint, faint), (Tally::default(), Tally::default())]
        {
            assert_eq!(found(first, second), parent);
        }
    }
}
