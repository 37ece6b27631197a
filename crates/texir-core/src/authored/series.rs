//! How far the series of bounces has come, as a whole and where it has come least far.
//!
//! A lamp-lit room beside a sunlit yard has a thousandth of the light, and needs all of its bounces: the sum over the
//! map would end them after the yard's first. So the series is looked at square by square of the map as well, each by
//! its own light.

use crate::bake::{BakedTexels, Texels};
use crate::error::Result;

/// What is left out of a square's light may be this many times the share that may be left out of all light.
const SLACK: f64 = 4.0;

/// The share of the squares that have no say: light seeps into closed cupboards for dozens of bounces.
const IGNORED: f64 = 0.01;

/// Below this share of the mean irradiance there is as good as no light to have a share of.
const NIGHT: f64 = 1e-4;

/// Light dies away at least this fast: noise hides whether it does.
const SLOWEST: f64 = 0.99;

/// Estimated shares of light that bounces which were left out would add.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Remainder {
    /// Of all light; infinite where that cannot be told.
    pub total: f64,
    /// Fraction of the local light in the worst square of the map, the worst 1 % of squares excluded.
    pub worst_region: f64,
}

impl Remainder {
    /// Whether it is below a tolerance ([`Bounces::tolerance`](super::Bounces::tolerance)).
    pub fn is_within(&self, tolerance: f32) -> bool {
        let tolerance = f64::from(tolerance);
        self.total <= tolerance && self.worst_region <= SLACK * tolerance
    }
}

/// The members of a series, E_0 first.
#[derive(Default)]
pub(super) struct Series {
    /// Mean of each over texels and channels.
    pub means: Vec<f64>,
    /// The share that the last two had of all light until then, by square of the map; `None` where that is of few
    /// texels.
    shares: [Vec<Option<f64>>; 2],
}

impl Series {
    /// Takes the next member, of which `total` is the sum with all before.
    pub fn push(&mut self, texels: &Texels<'_>, member: &BakedTexels, total: &BakedTexels) -> Result<()> {
        self.means.push(member.mean(texels)?);
        let night = NIGHT * self.means.iter().sum::<f64>();
        let [before, last] = &mut self.shares;
        *before = std::mem::replace(last, member.shares(texels, total, night as f32)?);
        Ok(())
    }

    /// What further members would add if the series goes on like its last ones, geometrically.
    pub fn remainder(&self) -> Remainder {
        Remainder { total: self.total(), worst_region: self.worst_region() }
    }

    /// Light that goes back and forth between dark and bright surfaces falls by much and by little in turn. With
    /// *b* and *a* the last two ratios, the next being *b* again, further members add b + b a + b a b + … =
    /// b (1 + a)/(1 − a b) of the last.
    fn total(&self) -> f64 {
        let sum: f64 = self.means.iter().sum();
        let (b, a, last) = match self.means[..] {
            [.., 0.0] => return 0.0,
            [.., first, second, last] => (second / first, last / second, last),
            [first, last] => (last / first, last / first, last),
            _ => return f64::INFINITY,
        };
        if !(a * b < 1.0) {
            return f64::INFINITY;
        }
        let left_out = last * b * (1.0 + a) / (1.0 - a * b);
        left_out / (sum + left_out)
    }

    fn worst_region(&self) -> f64 {
        let of_square = |(before, last): (&Option<f64>, &Option<f64>)| {
            let (before, last) = ((*before)?, (*last)?);
            let ratio = (last / before.max(f64::MIN_POSITIVE)).min(SLOWEST);
            Some(last * ratio / (1.0 - ratio))
        };
        let [before, last] = &self.shares;
        let mut left: Vec<f64> = before.iter().zip(last).filter_map(of_square).collect();
        let ignored = (IGNORED * left.len() as f64) as usize;
        if left.is_empty() { 0.0 } else { *left.select_nth_unstable_by(ignored, |a, b| b.total_cmp(a)).1 }
    }

    /// How much light the last member brings, of what the first did: as a whole, or where it is much of what there is.
    pub fn share(&self) -> f64 {
        let [first, .., last] = self.means[..] else { return 1.0 };
        let largest = self.shares[1].iter().flatten().copied().fold(0.0, f64::max);
        (last / first).max(largest / SLACK)
    }
}

#[cfg(test)]
mod tests {
    use super::Series;

    fn series(means: &[f64], before: &[Option<f64>], last: &[Option<f64>]) -> Series {
        Series { means: means.to_vec(), shares: [before.to_vec(), last.to_vec()] }
    }

    #[test]
    fn what_is_left_out_is_a_share_of_all_light() {
        let total = |means: &[f64]| series(means, &[], &[]).remainder().total;
        // Halves of halves come to 2.
        assert_eq!(total(&[1.0, 0.5]), 0.25);
        assert_eq!(total(&[1.0, 0.5, 0.25]), 0.125);
        assert_eq!(total(&[1.0, 0.0]), 0.0);
        assert!(total(&[1.0]).is_infinite() && total(&[1.0, 1.0]).is_infinite());
        // A white floor (.8) below a dark ceiling (.1): each bounce brings a tenth of the one before, or eight.
        let series = [1.0, 0.8, 0.08, 0.064, 0.0064];
        let left = |k: usize| {
            let all = 1.8 / (1.0 - 0.08);
            1.0 - series[..=k].iter().sum::<f64>() / all
        };
        assert!((2..5).all(|k| (total(&series[..=k]) - left(k)).abs() < 1e-9));
    }

    #[test]
    fn a_dim_room_beside_a_bright_yard_has_all_of_its_bounces() {
        // The yard is done; in the room, what comes next is so much less than the last.
        let means = [100.0, 0.1];
        let beside = |before: f64, last: f64| series(&means, &[Some(1.0), Some(before)], &[Some(1e-4), Some(last)]);
        let early = beside(0.5, 0.4);
        let left = early.remainder();
        assert!(left.total < 1e-3 && (left.worst_region - 1.6).abs() < 1e-9 && !left.is_within(5e-3), "{left:?}");
        assert_eq!(early.share(), 0.1);
        assert!(beside(5e-3, 4e-3).remainder().is_within(5e-3));
        // What noise lets grow is not endless, and squares of few texels have no say.
        assert!(beside(1e-4, 1.1e-4).remainder().is_within(5e-3));
        assert!(series(&means, &[Some(1.0), None], &[Some(1e-4), Some(0.4)]).remainder().is_within(5e-3));
    }
}
