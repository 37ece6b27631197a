//! Whether a part of a segment has a roughness of its own: its joints, a colour.
//!
//! Some roughness always explains a part's pixels better than its segment's does; what else is wrong with them asks for
//! it as well, but goes with the view. So each half of the views judges what the other half asks for.

use super::scan::{Tally, minimum};
use crate::fit::settings::OwnSettings;
use crate::specular_table::{NODES, nearest_node, node};

/// What pixels say of a part.
#[derive(Clone, Copy, Default)]
pub struct Said {
    /// If it had the roughness of a node,
    pub other: Tally,
    /// and Σ of their costs where it has its segment's.
    pub same: f64,
}

/// What speaks against a node's roughness of a part, of which this is said, where its segment's is `parent`.
pub fn against(said: &Tally, k: usize, parent: f32, settings: &OwnSettings) -> f32 {
    said.ln_mean(said.cost[k]) + settings.pull * (2.0 * (node(k) - parent)).powi(2)
}

/// The one of the `nodes` that speaks least against itself.
pub fn asked(said: &Tally, nodes: impl Iterator<Item = usize>, parent: f32, settings: &OwnSettings) -> Option<usize> {
    let against = |k: usize| against(said, k, parent, settings);
    nodes.filter(|_| said.pixels > 0.0).min_by(|a, b| against(*a).total_cmp(&against(*b)))
}

/// How far it is believed, 0 to 1, that a part has a roughness of its own, by the halves of the views, either of which
/// asks for one of the `nodes`.
pub fn believed<N: Iterator<Item = usize>>(
    [first, second]: &[Said; 2],
    nodes: impl Fn() -> N,
    parent: f32,
    settings: &OwnSettings,
) -> f32 {
    let judged =
        |by: &Said, other: &Said| asked(&other.other, nodes(), parent, settings).map_or(by.same, |k| by.other.cost[k]);
    let both = Tally::sum([&first.other, &second.other].into_iter());
    if both.pixels == 0.0 {
        return 0.0;
    }
    let gain = both.ln_mean(first.same + second.same) - both.ln_mean(judged(first, second) + judged(second, first));
    let pixels = both.pixels as f32;
    half_at(settings.agreement, gain * pixels / (pixels + settings.half_pixels))
}

/// Roughness of a part, of which the halves of the views say this, in a segment whose roughness is `parent`.
pub fn of_part(halves: &[Tally; 2], parent: f32, settings: &OwnSettings) -> f32 {
    let said = halves.map(|other| Said { other, same: other.cost[nearest_node(parent)] });
    let believed = believed(&said, || 0..NODES, parent, settings);
    if believed == 0.0 {
        return parent;
    }
    let both = Tally::sum(halves.iter());
    towards(parent, minimum(&std::array::from_fn(|k| against(&both, k, parent, settings))), believed)
}

/// How far something is believed that is believed half at `half`: not at all at half of that, and fully at half more.
pub fn half_at(half: f32, value: f32) -> f32 {
    (value / half - 0.5).clamp(0.0, 1.0)
}

/// A roughness that is believed so far beside another; half believed, it is half as far by the logarithm.
pub fn towards(parent: f32, own: f32, believed: f32) -> f32 {
    parent * (own / parent).powf(believed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_has_a_roughness_of_its_own_where_the_halves_of_the_views_agree() {
        let settings = OwnSettings { pull: 0.1, agreement: 0.02, half_pixels: 1000.0 };
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
