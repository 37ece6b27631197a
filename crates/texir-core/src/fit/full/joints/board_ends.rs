//! The ends of boards, and of tiles and bricks laid in bond: lines across the strips between regular lines.
//!
//! Boards of one floor have one length, and every strip of them its own offset. So one length is sought for all strips
//! of a chart, by the log-likelihood ratio of ends to no ends, each strip at its best offset: ends should be about as
//! dark as the lines beside the strip, and what no view shows counts 0.

use rayon::prelude::*;

use crate::error::Result;
use crate::progress::Progress;
use crate::stats::median;

/// Shifts that are tried per column while the length is sought; lengths are so close that the last end is as exact.
const SEARCHED: f32 = 2.0;
/// Shifts that are tried per column once it is found.
const FOUND: f32 = 4.0;
/// Columns among which the length is sought: of a wider chart, several count as one at first.
const COLUMNS: usize = 2048;
/// An end is expected to have this share of the contrast that the lines beside the strips have on average: it lies less
/// often at the middle of a texel.
const CONTRAST: f32 = 0.7;
/// The most that a column says for or against an end, in logarithms of likelihoods: noise has tails.
const MOST: f32 = 8.0;
/// Noise that is not believed to be less, in ln a.
const LEAST_NOISE: f32 = 1e-3;
/// What a strip must gain to have its ends, beyond what the best of its shifts gains by chance.
const LEAST_GAIN: f32 = 1.0;
/// What strips must gain on average.
const LEAST_MEAN: f32 = 2.0;
/// How many times what nine of ten other lengths gain.
const STANDS_OUT: f32 = 4.0;
/// The share of a chart that the longest boards may have: of longer ones, few strips have two ends.
const LONGEST: f32 = 0.5;

/// How much darker than what is beside them, along their strip, the columns of a strip are, in ln a; `None` where too
/// little is seen. Brighter, where lines are.
#[derive(Clone)]
pub struct Strip(Vec<Option<f32>>);

impl Strip {
    /// By the sums and the weights of the columns' contrasts; those of less than `least` say nothing.
    pub fn of(columns: &[[f32; 2]], least: f32) -> Self {
        let mean = |[sum, weight]: &[f32; 2]| (*weight > 0.0 && *weight >= least).then(|| sum / weight);
        Self(columns.iter().map(mean).collect())
    }

    /// With so many columns as one.
    fn binned(&self, columns: usize) -> Self {
        let mean = |bin: &[Option<f32>]| {
            let seen = bin.iter().flatten();
            let count = seen.clone().count();
            (2 * count >= columns).then(|| seen.sum::<f32>() / count as f32)
        };
        Self(self.0.chunks(columns).map(mean).collect())
    }

    fn is_seen(&self) -> bool {
        self.0.iter().any(Option::is_some)
    }

    /// ln of the likelihood that each column is an end over that it is none, where ends have a `contrast`. Noise is
    /// told by the median absolute deviation.
    fn says(&self, contrast: f32) -> Vec<f32> {
        let mut seen: Vec<f32> = self.0.iter().flatten().copied().collect();
        let middle = median(&mut seen).unwrap_or(0.0);
        seen.iter_mut().for_each(|c| *c = (*c - middle).abs());
        let noise = (1.4826 * median(&mut seen).unwrap_or(0.0)).max(LEAST_NOISE);
        let of_column = |c: f32| ((c * contrast - 0.5 * contrast * contrast) / (noise * noise)).clamp(-MOST, MOST);
        self.0.iter().map(|column| column.map_or(0.0, of_column)).collect()
    }
}

/// The ends of all strips of a chart.
pub struct Ends {
    /// How long boards are, columns.
    length: f32,
    /// Where each strip has its first end; `None` where it is not known.
    first: Vec<Option<f32>>,
}

impl Ends {
    /// Those of one length, at least `shortest` columns, that `strips` show, if their contrast and width are those of
    /// the lines between the strips; none if no length stands out of the others. For S strips of C columns, 2,048 at
    /// most, that is 4 C² S steps for every factor of e between the lengths.
    pub fn find(
        strips: &[Strip],
        shortest: f32,
        (contrast, width): (f32, f32),
        progress: &dyn Progress,
    ) -> Result<Option<Self>> {
        let columns = strips.iter().map(|strip| strip.0.len()).max().unwrap_or(0);
        let bin = columns.div_ceil(COLUMNS).max(1);
        let binned: Vec<Vec<f32>> = {
            let contrast = CONTRAST * contrast * (width / bin as f32).min(1.0);
            strips.iter().map(|strip| strip.binned(bin).says(contrast)).collect()
        };
        let bins = columns as f32 / bin as f32;
        let longer = |length: &f32| Some(length * (1.0 + 1.0 / (SEARCHED * bins)));
        let lengths: Vec<f32> = std::iter::successors(Some(shortest / bin as f32), longer)
            .take_while(|length| *length <= LONGEST * bins)
            .collect();
        let gains = gains(&binned, &lengths, progress)?;
        let Some(best) = most(&gains) else { return Ok(None) };
        let mut sorted = gains.clone();
        sorted.sort_unstable_by(f32::total_cmp);
        let others = sorted[9 * sorted.len() / 10];
        let seen = strips.iter().filter(|strip| strip.is_seen()).count();
        if gains[best] <= STANDS_OUT * others || gains[best] < LEAST_MEAN * seen as f32 {
            return Ok(None);
        }
        let says: Vec<Vec<f32>> = strips.iter().map(|strip| strip.says(CONTRAST * contrast)).collect();
        let near = |step: i32| bin as f32 * lengths[best] * (1.0 + step as f32 / (SEARCHED * columns as f32));
        let lengths: Vec<f32> = (-(bin as i32)..=bin as i32).map(near).collect();
        let Some(best) = most(&self::gains(&says, &lengths, progress)?) else { return Ok(None) };
        let of_strip = |says: &Vec<f32>| {
            let shifted = shifted(says, lengths[best], FOUND);
            (shifted.gain > LEAST_GAIN).then_some(shifted.first)
        };
        Ok(Some(Self { length: lengths[best], first: says.iter().map(of_strip).collect() }))
    }

    /// How far a column of a strip is from its nearest end; infinite where none is known.
    pub fn distance(&self, strip: usize, column: f32) -> f32 {
        let Some(first) = self.first[strip] else { return f32::INFINITY };
        let offset = (column - first).rem_euclid(self.length);
        offset.min(self.length - offset)
    }
}

/// What all strips together gain by each length. A single end tells none.
fn gains(says: &[Vec<f32>], lengths: &[f32], progress: &dyn Progress) -> Result<Vec<f32>> {
    let of_length = |length: &f32| {
        progress.check()?;
        let shifted = says.iter().map(|says| shifted(says, *length, SEARCHED));
        Ok(shifted.filter(|strip| strip.ends > 1).map(|strip| strip.gain.max(0.0)).sum())
    };
    lengths.par_iter().map(of_length).collect()
}

/// Where the greatest value is.
fn most(values: &[f32]) -> Option<usize> {
    (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b]))
}

/// A strip whose ends are where it likes them best.
struct Shifted {
    /// What that gains, beyond what the best of so many shifts gains by chance.
    gain: f32,
    /// Where the first end is.
    first: f32,
    /// How many ends speak for it.
    ends: usize,
}

/// The best of all shifts of ends at this distance from each other, of which `steps` are tried per column.
fn shifted(says: &[f32], length: f32, steps: f32) -> Shifted {
    let last = says.len() as f32 - 1.0;
    let at = |column: f32| {
        let (i, share) = (column as usize, column.fract());
        (1.0 - share) * says[i] + share * says.get(i + 1).copied().unwrap_or(0.0)
    };
    let shifts = ((steps * length) as usize).max(1);
    let chance = (shifts as f32).ln();
    let of_shift = |shift: usize| {
        let first = shift as f32 / steps;
        let ends = (0..).map(|k| first + k as f32 * length).take_while(|column| *column <= last).map(at);
        let (sum, ends) = ends.fold((0.0, 0), |(sum, ends), says| (sum + says, ends + usize::from(says > 0.0)));
        Shifted { gain: sum - chance, first, ends }
    };
    let first = of_shift(0);
    (1..shifts).map(of_shift).fold(first, |best, next| if next.gain > best.gain { next } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use crate::rng::hash2;

    const COLUMNS: usize = 200;
    const LINES: (f32, f32) = (CONTRAST, 1.0);
    const STRIPS: usize = 12;
    const CONTRAST: f32 = 0.1;

    fn random(a: usize, b: usize) -> f32 {
        hash2(a as u32, b as u32) as f32 / u32::MAX as f32
    }

    /// Strips of which the ends that `is_end` tells are darker under noise of ±0.04. Of every fourth strip, the second
    /// half is not seen.
    fn strips(is_end: impl Fn(usize, usize) -> bool) -> Vec<Strip> {
        let column = |strip: usize, column: usize| {
            let dark = if is_end(strip, column) { CONTRAST } else { 0.0 };
            let seen = !strip.is_multiple_of(4) || column < COLUMNS / 2;
            [dark + 0.08 * (random(strip, column) - 0.5), f32::from(u8::from(seen))]
        };
        (0..STRIPS).map(|s| Strip::of(&(0..COLUMNS).map(|c| column(s, c)).collect::<Vec<_>>(), 0.5)).collect()
    }

    #[test]
    fn ends_of_boards_of_one_length_are_found_also_where_nothing_is_seen() {
        const LENGTH: f32 = 41.3;
        let shift = |strip: usize| LENGTH * random(strip, 1_000_000);
        let is_end = |strip: usize, column: usize| (column as f32 + 0.5 - shift(strip)).rem_euclid(LENGTH) < 1.0;
        let ends = Ends::find(&strips(is_end), 10.0, LINES, &Silent).unwrap().expect("one length");
        assert!((ends.length - LENGTH).abs() < 0.2, "{}", ends.length);
        let all = || (0..STRIPS).flat_map(|s| (0..COLUMNS).map(move |c| (s, c)));
        let share = |of: &dyn Fn(&(usize, usize)) -> bool, that: &dyn Fn(&(usize, usize)) -> bool| {
            all().filter(of).filter(that).count() as f32 / all().filter(of).count() as f32
        };
        let true_end = |&(s, c): &(usize, usize)| is_end(s, c);
        let near = |&(s, c): &(usize, usize)| ends.distance(s, c as f32) < 1.0;
        let found = |&(s, c): &(usize, usize)| ends.distance(s, c as f32) < 0.5;
        let near_true = |&(s, c): &(usize, usize)| (c.saturating_sub(1)..=c + 1).any(|c| is_end(s, c));
        let (recall, precision) = (share(&true_end, &near), share(&found, &near_true));
        // Of strips that are half seen, not all are told.
        assert!(recall > 0.75 && precision > 0.95, "{recall} {precision}");
    }

    #[test]
    fn of_wide_charts_columns_count_together_at_first() {
        const WIDE: usize = 3 * super::COLUMNS;
        let is_end = |strip: usize, column: usize| (column + 700 * strip) % 1_500 < 4;
        let column =
            |s: usize, c: usize| [0.08 * (random(s, c) - 0.5) + if is_end(s, c) { CONTRAST } else { 0.0 }, 1.0];
        let strip = |s: usize| Strip::of(&(0..WIDE).map(|c| column(s, c)).collect::<Vec<_>>(), 0.5);
        let strips: Vec<Strip> = (0..STRIPS).map(strip).collect();
        let ends = Ends::find(&strips, 400.0, (CONTRAST, 4.0), &Silent).unwrap().expect("one length");
        assert!((ends.length - 1_500.0).abs() < 1.0, "{}", ends.length);
        let far = |s: usize| (0..WIDE).filter(|c| is_end(s, *c) && ends.distance(s, *c as f32) > 4.0).count();
        assert_eq!((0..STRIPS).map(far).sum::<usize>(), 0);
    }

    #[test]
    fn noise_and_boards_of_any_length_have_none() {
        let none = |is_end: &dyn Fn(usize, usize) -> bool| {
            Ends::find(&strips(is_end), 10.0, LINES, &Silent).unwrap().is_none()
        };
        assert!(none(&|_, _| false));
        assert!(none(&|strip, column| random(strip, column + 7_000) < 0.025));
        // Nor has a floor that a shadow crosses, the ends of its strips unseen.
        let crossed: Vec<Strip> = strips(|_, column| column == 80)
            .into_iter()
            .map(|Strip(mut columns)| {
                (0..3).chain(COLUMNS - 3..COLUMNS).for_each(|c| columns[c] = None);
                Strip(
                    columns
                        .into_iter()
                        .map(|c| c.map(|c| 0.25 * c + if c > CONTRAST / 2.0 { 0.07 } else { 0.0 }))
                        .collect(),
                )
            })
            .collect();
        assert!(Ends::find(&crossed, 12.0, LINES, &Silent).unwrap().is_none());
        // Negative control.
        assert!(!none(&|strip, column| (column + 13 * strip).is_multiple_of(40)));
    }
}
