//! What to tell the user where bounces ended too early, and where no light arrived.

use super::{Model, Remainder, Solved};
use crate::error::listed;

/// A bounce that brings this share of the light of the one before is as bright as that: noise hides the rest.
const STEADY: f64 = 0.99;

/// Materials that reflect this much are named where bounces do not end.
const NEARLY_WHITE: f32 = 0.95;

/// What [`Bounces::max_bounces`](super::Bounces::max_bounces) is to whoever set it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BounceLimit {
    /// As many bounces as are wanted: that light is left at their end is no news.
    Wanted,
    /// A bound that light should have died away before.
    Bound,
}

impl Solved {
    /// What to tell the user where bounces ended before less than a `tolerance` of all light was left; where as many
    /// were had as are wanted, only that more of them would not help.
    pub fn unfinished(&self, model: &Model, tolerance: f32, limit: BounceLimit) -> Option<String> {
        let asked = limit == BounceLimit::Wanted;
        let steady = is_steady(&self.series);
        // No tolerance at all asks for as many bounces as are allowed.
        if self.remainder.is_within(tolerance) || (!steady && (asked || tolerance == 0.0)) {
            return None;
        }
        let (bounces, white) = (self.series.len() - 1, model.reflecting(NEARLY_WHITE));
        if steady {
            // Light that stays for a while, and would die away after more bounces than were asked for.
            return (!asked || !white.is_empty()).then(|| {
                format!(
                    "bounces do not converge: after {bounces}, each still brings about as much light as the one before, and the \
                     map depends on where they end; {}",
                    darken(&white)
                )
            });
        }
        let Remainder { total, worst_region } = self.remainder;
        let share = match total.is_finite() {
            true => format!(
                "about {:.2} % of all light, and {:.1} % where they lack most",
                100.0 * total,
                100.0 * worst_region
            ),
            false => "an unknown share of all light".to_owned(),
        };
        let reason = if white.is_empty() { String::new() } else { format!("; {}", darken(&white)) };
        Some(format!(
            "{bounces} bounces leave out {share}, where the tolerance (--tolerance) is {tolerance}: allow more bounces (--bounces){reason}"
        ))
    }

    /// What to tell the user where all is black.
    pub fn unlit(&self) -> Option<String> {
        self.series.iter().all(|mean| *mean == 0.0).then(|| {
            "no light arrives at any surface, and the map is black: only the front of a face is lit, from where its corners run \
             counter-clockwise, unless its material is doubleSided; turn faces that are seen from behind around, and check where the \
             lights are"
                .to_owned()
        })
    }
}

/// What to do about materials by their names.
fn darken(white: &[String]) -> String {
    let these = if white.is_empty() { "what reflects nearly all light".to_owned() } else { listed(white) };
    format!("give {these} a darker base colour: white paint reflects 0.8")
}

/// Whether the last two bounces brought no less light than those before them.
fn is_steady(series: &[f64]) -> bool {
    match series {
        [.., a, b, c] => *c > 0.0 && *b >= STEADY * a && *c >= STEADY * b,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::is_steady;

    #[test]
    fn light_that_stays_is_told_from_light_that_dies_away() {
        assert!(is_steady(&[5.0, 1.0, 1.0, 0.999]) && is_steady(&[1.0, 1.1, 1.2]));
        assert!(!is_steady(&[1.0, 0.9, 0.81]) && !is_steady(&[1.0, 1.0, 0.5]) && !is_steady(&[0.0, 0.0, 0.0]));
        // Light that finds its way around a corner first: two are too few to tell.
        assert!(!is_steady(&[1.0, 2.0]) && !is_steady(&[1.0, 2.0, 1.5]));
    }
}
