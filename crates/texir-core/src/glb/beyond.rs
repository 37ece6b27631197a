//! What images hold beyond the charts: engines make mips of them, and these would darken towards an empty atlas.

use crate::raster::Raster;

/// One level of a pyramid, of which some texels are known.
struct Level<const N: usize> {
    width: usize,
    height: usize,
    values: Vec<Option<[f32; N]>>,
}

impl<const N: usize> Level<N> {
    /// The next one: the mean of those of every 2 × 2 texels that are known.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mean = |k: usize| {
            let (x, y) = (2 * (k % width), 2 * (k / width));
            let (mut sum, mut count) = ([0.0; N], 0.0);
            for (x, y) in [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)] {
                if x < self.width
                    && y < self.height
                    && let Some(value) = self.values[y * self.width + x]
                {
                    (0..N).for_each(|c| sum[c] += value[c]);
                    count += 1.0;
                }
            }
            (count > 0.0).then(|| sum.map(|sum| sum / count))
        };
        Self { width, height, values: (0..width * height).map(mean).collect() }
    }

    /// Gives what is not known the value of the texel of the next level that it is part of.
    fn fill(&mut self, next: &Self) {
        for (k, value) in self.values.iter_mut().enumerate().filter(|(_, value)| value.is_none()) {
            *value = next.values[k / self.width / 2 * next.width + k % self.width / 2];
        }
    }
}

/// A map of which texels that are not `known` have the mean of those in the smallest square of 2ᵏ texels around them that are.
/// Every mip of it, by averaging 2 × 2 texels, is then the mean of what is known alone. Black where nothing is.
pub(super) fn filled<const N: usize>(map: &Raster<[f32; N]>, known: &[bool]) -> Raster<[f32; N]> {
    let values = map.data.iter().zip(known).map(|(value, known)| known.then_some(*value)).collect();
    let mut levels = vec![Level { width: map.width, height: map.height, values }];
    while let Some(last) = levels.last().filter(|last| last.values.len() > 1) {
        levels.push(last.halved());
    }
    for k in (1..levels.len()).rev() {
        let (fine, coarse) = levels.split_at_mut(k);
        fine[k - 1].fill(&coarse[0]);
    }
    let data = levels.swap_remove(0).values.into_iter().map(|value| value.unwrap_or([0.0; N])).collect();
    Raster { data, ..*map }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mips_are_those_of_what_is_known() {
        // A chart of 3 × 2 texels of an atlas of 6 × 5, and one of a single texel.
        let (width, height) = (6, 5);
        let value = |k: usize| match (k % width, k / width) {
            (0..3, 1..3) => Some([0.2 + 0.1 * (k % width) as f32, 0.8]),
            (5, 4) => Some([0.9, 0.1]),
            _ => None,
        };
        let known: Vec<bool> = (0..width * height).map(|k| value(k).is_some()).collect();
        let data = (0..width * height).map(|k| value(k).unwrap_or_default()).collect();
        let map = filled(&Raster::new(width, height, data).unwrap(), &known);
        for k in 0..width * height {
            if let Some(value) = value(k) {
                assert_eq!(map.data[k], value);
            }
        }
        let near = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs() < 1e-6 && (a[1] - b[1]).abs() < 1e-6;
        // Beside a texel; in its square of four; in that of sixteen, by means of both rows of the chart.
        assert!(near(map.data[0], [0.25, 0.8]) && near(map.data[3], [0.4, 0.8]), "{:?} {:?}", map.data[0], map.data[3]);
        assert!(near(map.data[3 * width], [0.25, 0.8]) && near(map.data[4], map.data[5]));
        assert!(near(map.data[4 * width + 4], [0.9, 0.1]));
        // A mip in which the chart is one of two texels that are known.
        let level = |map: &Raster<[f32; 2]>, known: bool| Level {
            width,
            height,
            values: map.data.iter().enumerate().map(|(k, v)| (!known || value(k).is_some()).then_some(*v)).collect(),
        };
        let (all, charts) = (level(&map, false).halved(), level(&map, true).halved());
        for (mip, chart) in all.values.iter().zip(&charts.values).filter(|(_, chart)| chart.is_some()) {
            assert!(near(mip.unwrap(), chart.unwrap()), "{mip:?} {chart:?}");
        }
        // Nothing is known.
        assert!(filled(&map, &vec![false; width * height]).data.iter().all(|v| *v == [0.0; 2]));
    }
}
