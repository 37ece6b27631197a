//! Sums over the pixels that see a texel, without the transpose of their footprints, which would take as much memory as
//! these.
//!
//! The texels are cut into bands, and of each band it is known which pixels see any of it. A band goes through these
//! and adds to its own texels: no two threads write to one texel, and each sum runs in the order of the pixels.

use rayon::prelude::*;

use crate::fit::full::observations::packed_tap::PackedTap;
use crate::texture::SparseRows;

/// Texels of a band: their sums fit in a processor's cache, and few footprints lie across the edge of a band.
const BAND: usize = 1 << 15;

/// The bands of some texels.
#[derive(Default)]
pub struct Bands {
    texels: usize,
    /// Of each, the pixels that see texels of it, ascending.
    pixels: Vec<Vec<u32>>,
}

impl Bands {
    /// The bands of `texels` texels that pixels with the footprints `rows` see.
    pub fn new(rows: &SparseRows<PackedTap>, texels: usize) -> Self {
        let mut pixels = vec![Vec::new(); texels.div_ceil(BAND)];
        for pixel in 0..rows.len() {
            for share in rows.row(pixel) {
                let band: &mut Vec<u32> = &mut pixels[share.texel as usize / BAND];
                if band.last() != Some(&(pixel as u32)) {
                    band.push(pixel as u32);
                }
            }
        }
        pixels.iter_mut().for_each(Vec::shrink_to_fit);
        Self { texels, pixels }
    }

    /// For every texel, from `zero` on, what `add` makes of the shares that pixels see of it and of their pixels'
    /// values.
    pub fn sum<T: Clone + Send + Sync, V>(
        &self,
        rows: &SparseRows<PackedTap>,
        zero: T,
        value: impl Fn(usize) -> V + Sync,
        add: impl Fn(&mut T, &PackedTap, &V) + Sync,
    ) -> Vec<T> {
        let mut sums: Vec<T> = rayon::iter::repeat_n(zero.clone(), self.texels).collect();
        self.sum_into(&mut sums, rows, zero, value, add);
        sums
    }

    /// [`Self::sum`] into a list of as many texels, whatever it holds.
    pub fn sum_into<T: Clone + Send + Sync, V>(
        &self,
        sums: &mut [T],
        rows: &SparseRows<PackedTap>,
        zero: T,
        value: impl Fn(usize) -> V + Sync,
        add: impl Fn(&mut T, &PackedTap, &V) + Sync,
    ) {
        sums.par_chunks_mut(BAND).zip(&self.pixels).enumerate().for_each(|(band, (sums, pixels))| {
            let first = band * BAND;
            sums.fill(zero.clone());
            for &pixel in pixels {
                let value = value(pixel as usize);
                for share in rows.row(pixel as usize) {
                    if let Some(sum) = sums.get_mut((share.texel as usize).wrapping_sub(first)) {
                        add(sum, share, &value);
                    }
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::hash2;
    use crate::texture::Tap;

    #[test]
    fn sums_are_those_over_the_pixels_bit_by_bit() {
        let texels = 2 * BAND + 1000;
        let footprint = |pixel: u32| -> Vec<PackedTap> {
            // Some lie across the edge of a band; the last texel of all is seen, most are not.
            let first = match pixel % 3 {
                0 => BAND as u32 - 3 + pixel % 5,
                1 => 2 * BAND as u32 - 2,
                _ => texels as u32 - 6,
            };
            let taps = |s: u32| {
                (0..6).map(move |k| Tap { texel: first + k, weight: hash2(pixel, 6 * s + k) as f32 / u32::MAX as f32 })
            };
            PackedTap::of(std::array::from_fn(|s| taps(s as u32).collect()))
        };
        let rows = SparseRows::from_lists((0..500).map(footprint));
        let value = |pixel: usize| 0.1 + pixel as f32;
        let sums =
            Bands::new(&rows, texels).sum(&rows, 0.0f32, value, |sum, share, value| *sum += share.weight() * value);
        let mut expected = vec![0.0f32; texels];
        for pixel in 0..rows.len() {
            rows.row(pixel).iter().for_each(|share| expected[share.texel as usize] += share.weight() * value(pixel));
        }
        assert_eq!(sums.len(), texels);
        for (t, (sum, expected)) in sums.iter().zip(expected).enumerate() {
            assert_eq!(sum.to_bits(), expected.to_bits(), "texel {t}");
        }
        assert!(sums[texels - 1] > 0.0 && sums[0] == 0.0);
    }
}
