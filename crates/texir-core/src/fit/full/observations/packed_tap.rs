//! What a pixel sees of which texels, stratum by stratum, in eight bytes a texel.
//!
//! Textures are interpolated: what lies between a smooth texel and a rough one has the mean of their roughness, and
//! reflects far less of a lamp than the mean of what they reflect. So the shares of a pixel are kept as those of its
//! strata, each of which shows one place.

use crate::specular_table::STRATA;
use crate::texture::Tap;

/// Units that the weights of a pixel have in all. Fewer would show: what albedo explains to a thousandth tells
/// roughness.
const OF_PIXEL: u16 = u16::MAX;
/// Bits of a weight: all weights of a stratum sum to 2^BITS − 1.
const BITS: usize = 4;
/// Sum of the weights of a stratum.
const OF_STRATUM: u16 = (1 << BITS) - 1;
const _: () = assert!(STRATA * BITS <= u16::BITS as usize, "strata do not fit");

/// What a pixel, and each of its strata, sees of a texel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PackedTap {
    /// Index into [`Atlas::texels`](crate::atlas::Atlas::texels).
    pub texel: u32,
    of_pixel: u16,
    of_strata: u16,
}

impl PackedTap {
    /// The shares of a pixel whose strata see these texels, in any unit; ascending, each texel once, 1 in all. A
    /// stratum that sees none is stood in for by the first that does; nothing if none does.
    pub fn of(strata: [Vec<Tap>; STRATA]) -> Vec<Self> {
        let Some(first) = strata.iter().find(|taps| !taps.is_empty()) else { return Vec::new() };
        let strata = strata.each_ref().map(|taps| if taps.is_empty() { first } else { taps });
        let mut texels: Vec<u32> = strata.iter().flat_map(|taps| taps.iter().map(|tap| tap.texel)).collect();
        texels.sort_unstable();
        texels.dedup();
        let of_stratum = |taps: &Vec<Tap>| -> Vec<f32> {
            let all: f32 = taps.iter().map(|tap| tap.weight).sum();
            let of = |texel: &u32| taps.iter().filter(|tap| tap.texel == *texel).map(|tap| tap.weight).sum::<f32>();
            texels.iter().map(|texel| of(texel) / all).collect()
        };
        let strata = strata.map(of_stratum);
        let mean: Vec<f32> =
            (0..texels.len()).map(|i| strata.iter().map(|weights| weights[i]).sum::<f32>() / STRATA as f32).collect();
        let (of_pixel, of_strata) = (units(&mean, OF_PIXEL), strata.map(|weights| units(&weights, OF_STRATUM)));
        let share = |(i, texel): (usize, &u32)| Self {
            texel: *texel,
            of_pixel: of_pixel[i],
            of_strata: of_strata.iter().fold(0, |packed, units| packed << BITS | units[i]),
        };
        texels.iter().enumerate().map(share).filter(|share| share.of_pixel > 0).collect()
    }

    /// That of the whole pixel.
    pub fn weight(&self) -> f32 {
        /// What a unit weighs.
        const UNIT: f32 = 1.0 / OF_PIXEL as f32;
        f32::from(self.of_pixel) * UNIT
    }
}

/// What each stratum of a pixel shows of a value that texels have, interpolated to a fifteenth.
pub fn of_strata(shares: &[PackedTap], value: impl Fn(u32) -> f32) -> [f32; STRATA] {
    let mut sums = [0.0; STRATA];
    for share in shares {
        let value = value(share.texel);
        for (stratum, sum) in sums.iter_mut().rev().enumerate() {
            *sum += f32::from(share.of_strata >> (stratum * BITS) & OF_STRATUM) * value;
        }
    }
    sums.map(|sum| sum / f32::from(OF_STRATUM))
}

/// Weights, which sum to 1, in whole units, `all` together: what rounding is off by goes to the heaviest.
fn units(weights: &[f32], all: u16) -> Vec<u16> {
    let mut units: Vec<u16> = weights.iter().map(|weight| (weight * f32::from(all)).round() as u16).collect();
    let off = i32::from(all) - units.iter().map(|units| i32::from(*units)).sum::<i32>();
    if let Some(heaviest) = units.iter_mut().max() {
        *heaviest = (i32::from(*heaviest) + off) as u16;
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
            let shares = PackedTap::of(strata.clone());
            assert!(shares.is_sorted_by(|a, b| a.texel < b.texel));
            let sum: f32 = shares.iter().map(PackedTap::weight).sum();
            assert!((sum - 1.0).abs() < 1e-6, "{sum}");
            // Of values from 0 to 1, over six texels.
            let value = |texel: u32| 0.2 * texel as f32;
            let exact = strata.each_ref().map(|taps| {
                let sum: f32 = taps.iter().map(|tap| tap.weight * value(tap.texel)).sum();
                sum / taps.iter().map(|tap| tap.weight).sum::<f32>()
            });
            for (found, exact) in of_strata(&shares, value).into_iter().zip(exact) {
                assert!((found - exact).abs() < 0.06, "{found} {exact}");
            }
            let weighed: f32 = shares.iter().map(|share| share.weight() * value(share.texel)).sum();
            assert!((weighed - exact.iter().sum::<f32>() / STRATA as f32).abs() < 5e-5);
        }
    }

    #[test]
    fn strata_that_see_nothing_are_stood_in_for() {
        let sees = |texel| vec![tap(texel, 0.3)];
        let shares = PackedTap::of([vec![], sees(7), sees(3), vec![]]);
        assert_eq!(of_strata(&shares, |texel| texel as f32), [7.0, 7.0, 3.0, 7.0]);
        assert_eq!(shares.iter().map(|share| (share.weight() * STRATA as f32).round()).collect::<Vec<_>>(), [1.0, 3.0]);
        assert_eq!(PackedTap::of(Default::default()), []);
    }
}
