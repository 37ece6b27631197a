//! Sums over the pixels that see a texel, without the transpose of their footprints, which would take as much memory as these.
//!
//! The texels are cut into bands, and of each band it is known which pixels see any of it. A band goes through these and
//! adds to its own texels: no two threads write to one texel, and each sum runs in the order of the pixels.

use rayon::prelude::*;

use crate::texture::{Rows, Tap};

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
    pub fn new(rows: &Rows, texels: usize) -> Self {
        let mut pixels = vec![Vec::new(); texels.div_ceil(BAND)];
        for pixel in 0..rows.len() {
            for tap in rows.row(pixel) {
                let band: &mut Vec<u32> = &mut pixels[tap.texel as usize / BAND];
                if band.last() != Some(&(pixel as u32)) {
                    band.push(pixel as u32);
                }
            }
        }
        pixels.iter_mut().for_each(Vec::shrink_to_fit);
        Self { texels, pixels }
    }

    /// For every texel, from `zero` on, what `add` makes of the taps that see it and of their pixels' values.
    pub fn sum<T: Clone + Send + Sync, V>(
        &self,
        rows: &Rows,
        zero: T,
        value: impl Fn(usize) -> V + Sync,
        add: impl Fn(&mut T, &Tap, &V) + Sync,
    ) -> Vec<T> {
        let mut sums = vec![zero; self.texels];
        sums.par_chunks_mut(BAND).zip(&self.pixels).enumerate().for_each(|(band, (sums, pixels))| {
            let first = band * BAND;
            for &pixel in pixels {
                let value = value(pixel as usize);
                for tap in rows.row(pixel as usize) {
                    if let Some(sum) = sums.get_mut((tap.texel as usize).wrapping_sub(first)) {
                        add(sum, tap, &value);
                    }
                }
            }
        });
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::hash2;

    #[test]
    fn sums_are_those_of_the_transpose_bit_by_bit() {
        let texels = 2 * BAND + 1000;
        let footprint = |pixel: u32| -> Vec<Tap> {
            // Some lie across the edge of a band; the last texel of all is seen, most are not.
            let first = match pixel % 3 {
                0 => BAND as u32 - 3 + pixel % 5,
                1 => 2 * BAND as u32 - 2,
                _ => texels as u32 - 6,
            };
            (0..6).map(|k| Tap { texel: first + k, weight: hash2(pixel, k) as f32 / u32::MAX as f32 }).collect()
        };
        let rows = Rows::from_lists((0..500).map(footprint));
        let value = |pixel: usize| 0.1 + pixel as f32;
        let sums = Bands::new(&rows, texels).sum(&rows, 0.0f32, value, |sum, tap, value| *sum += tap.weight * value);
        let columns = rows.transposed(texels);
        assert_eq!(sums.len(), texels);
        for (t, sum) in sums.iter().enumerate() {
            let expected = columns.row(t).iter().fold(0.0, |sum, tap| sum + tap.weight * value(tap.texel as usize));
            assert_eq!(sum.to_bits(), expected.to_bits(), "texel {t}");
        }
        assert!(sums[texels - 1] > 0.0 && sums[0] == 0.0);
    }
}
