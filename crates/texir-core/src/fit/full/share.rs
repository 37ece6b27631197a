//! What a pixel sees of which texels, stratum by stratum, in eight bytes a texel.
//!
//! Textures are interpolated: what lies between a smooth texel and a rough one has the mean of their roughness, and reflects far less
//! of a lamp than the mean of what they reflect. So the shares of a pixel are kept as those of its strata, each of which shows one
//! place.

use crate::specular_table::STRATA;
use crate::texture::Tap;

/// All that a stratum sees, in units of a share.
const ALL: u8 = u8::MAX;

/// What the strata of a pixel see of a texel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Share {
    /// Index into [`Atlas::texels`](crate::atlas::Atlas::texels).
    pub texel: u32,
    of_strata: [u8; STRATA],
}

impl Share {
    /// The shares of a pixel whose strata see these texels, in any unit; ascending, each texel once, 1 in all. A stratum that sees none
    /// is stood in for by the first that does; nothing if none does.
    pub fn of(strata: [Vec<Tap>; STRATA]) -> Vec<Self> {
        let Some(first) = strata.iter().find(|taps| !taps.is_empty()) else { return Vec::new() };
        let mut shares = Vec::new();
        for (stratum, own) in strata.iter().enumerate() {
            let taps = if own.is_empty() { first } else { own };
            for (tap, units) in taps.iter().zip(units(taps)) {
                let mut share = Self { texel: tap.texel, ..Self::default() };
                share.of_strata[stratum] = units;
                shares.push(share);
            }
        }
        shares.sort_unstable_by_key(|share| share.texel);
        shares.dedup_by(|next, kept| {
            let same = next.texel == kept.texel;
            if same {
                kept.of_strata.iter_mut().zip(next.of_strata).for_each(|(kept, next)| *kept += next);
            }
            same
        });
        shares.retain(|share| share.of_strata != [0; STRATA]);
        shares
    }

    /// That of the whole pixel.
    pub fn weight(&self) -> f32 {
        let units: u16 = self.of_strata.iter().map(|units| u16::from(*units)).sum();
        f32::from(units) / f32::from(STRATA as u16 * u16::from(ALL))
    }
}

/// What each stratum of a pixel shows of a value that texels have, interpolated.
pub fn of_strata(shares: &[Share], value: impl Fn(u32) -> f32) -> [f32; STRATA] {
    let mut sums = [0.0; STRATA];
    for share in shares {
        let value = value(share.texel);
        sums.iter_mut().zip(share.of_strata).for_each(|(sum, units)| *sum += f32::from(units) * value);
    }
    sums.map(|sum| sum / f32::from(ALL))
}

/// The weights of taps in whole units, [`ALL`] together: what rounding is off by goes to the heaviest.
fn units(taps: &[Tap]) -> Vec<u8> {
    let all: f32 = taps.iter().map(|tap| tap.weight).sum();
    let mut units: Vec<u8> = taps.iter().map(|tap| (tap.weight / all * f32::from(ALL)).round() as u8).collect();
    let off = i32::from(ALL) - units.iter().map(|units| i32::from(*units)).sum::<i32>();
    if let Some(heaviest) = units.iter_mut().max() {
        *heaviest = (i32::from(*heaviest) + off) as u8;
    }
    units
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::hash2;

    fn tap(texel: u32, weight: f32) -> Tap {
        Tap { texel, weight }
    }

    #[test]
    fn shares_are_those_of_the_taps_and_one_in_all() {
        for pixel in 0..200 {
            let random = |k: u32| hash2(pixel, k) as f32 / u32::MAX as f32;
            let strata: [Vec<Tap>; STRATA] =
                std::array::from_fn(|s| (0..4).map(|k| tap(s as u32 / 2 + k, random(4 * s as u32 + k))).collect());
            let shares = Share::of(strata.clone());
            assert!(shares.is_sorted_by(|a, b| a.texel < b.texel));
            assert_eq!(shares.iter().map(Share::weight).sum::<f32>(), 1.0);
            let value = |texel: u32| 1.0 + texel as f32;
            for (found, taps) in of_strata(&shares, value).into_iter().zip(&strata) {
                let [sum, all] = taps
                    .iter()
                    .fold([0.0; 2], |[sum, all], tap| [sum + tap.weight * value(tap.texel), all + tap.weight]);
                assert!((found - sum / all).abs() < 0.02, "{found} {}", sum / all);
            }
            let mean = of_strata(&shares, value).iter().sum::<f32>() / STRATA as f32;
            let weighed: f32 = shares.iter().map(|share| share.weight() * value(share.texel)).sum();
            assert!((mean - weighed).abs() < 1e-5);
        }
    }

    #[test]
    fn strata_that_see_nothing_are_stood_in_for() {
        let sees = |texel| vec![tap(texel, 0.3)];
        let shares = Share::of([vec![], sees(7), sees(3), vec![]]);
        assert_eq!(of_strata(&shares, |texel| texel as f32), [7.0, 7.0, 3.0, 7.0]);
        assert_eq!(Share::of(Default::default()), []);
    }
}
