//! The ends of boards, and of tiles and bricks laid in bond: lines across the strips between regular lines.
//!
//! Boards of one floor have one length, and every strip of them begins where it likes. So one length is sought for all strips of a
//! chart, by the likelihood of what they show: at its ends, a strip should be about as dark as the lines beside it are, and
//! nowhere tells as little as where no view shows it. Each strip shifts the length to where it explains it best.

use rayon::prelude::*;

use crate::error::Result;
use crate::progress::Progress;

/// Shifts that are tried per column while the length is sought; lengths are so close that the last end is as exact.
const SEARCHED: f32 = 2.0;
/// Shifts that are tried per column once it is found.
const FOUND: f32 = 4.0;
/// An end is expected to have this share of the contrast that the lines beside the strips have on average: it lies less often at the middle
/// of a texel.
const CONTRAST: f32 = 0.7;
/// The most that a column says for or against an end, in logarithms of likelihoods: noise has tails.
const MOST: f32 = 8.0;
/// Noise that is not believed to be less, in ln a.
const LEAST_NOISE: f32 = 1e-3;
/// What a strip must gain to have its ends, beyond what the best of its shifts gains by chance,
const LEAST_GAIN: f32 = 1.0;
/// what strips must gain on average,
const LEAST_MEAN: f32 = 2.0;
/// and how many times what nine of ten other lengths do.
const STANDS_OUT: f32 = 4.0;
/// The share of a chart that the longest boards may have: of longer ones, too few have both ends in it.
const LONGEST: f32 = 2.0 / 3.0;

/// How much darker than what is beside them, along their strip, the columns of a strip are, in ln a, and whether enough of each is seen.
/// Brighter, where lines are.
pub struct Strip {
    columns: Vec<Option<f32>>,
}

impl Strip {
    /// By the sums and the weights of the columns' contrasts; those of less than `least` say nothing.
    pub fn of(columns: &[[f32; 2]], least: f32) -> Self {
        let mean = |[sum, weight]: &[f32; 2]| (*weight > 0.0 && *weight >= least).then(|| sum / weight);
        Self { columns: columns.iter().map(mean).collect() }
    }

    /// ln of the likelihood that each column is an end over that it is none, where ends have a `contrast`. Noise is told by the median
    /// absolute deviation.
    fn says(&self, contrast: f32) -> Vec<f32> {
        let middle = |mut values: Vec<f32>| {
            let half = values.len() / 2;
            if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(half, f32::total_cmp).1 }
        };
        let seen: Vec<f32> = self.columns.iter().flatten().copied().collect();
        let median = middle(seen.clone());
        let noise = (1.4826 * middle(seen.iter().map(|c| (c - median).abs()).collect())).max(LEAST_NOISE);
        let of_column = |c: f32| ((c * contrast - 0.5 * contrast * contrast) / (noise * noise)).clamp(-MOST, MOST);
        self.columns.iter().map(|column| column.map_or(0.0, of_column)).collect()
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
    /// Those of one length, at least `shortest` columns, that `strips` show, whose lines stand out by `contrast`; none if no length stands
    /// out of the others. For C columns and S strips that is 4 C² S steps for every factor of e between the lengths.
    pub fn find(strips: &[Strip], shortest: f32, contrast: f32, progress: &dyn Progress) -> Result<Option<Self>> {
        let columns = strips.iter().map(|strip| strip.columns.len()).max().unwrap_or(0) as f32;
        let says: Vec<Vec<f32>> = strips.iter().map(|strip| strip.says(CONTRAST * contrast)).collect();
        let longer = move |length: &f32| Some(length * (1.0 + 1.0 / (SEARCHED * columns)));
        let lengths: Vec<f32> =
            std::iter::successors(Some(shortest), longer).take_while(|length| *length <= LONGEST * columns).collect();
        let of_length = |length: &f32| {
            progress.check()?;
            Ok(says.iter().map(|says| shifted(says, *length, SEARCHED).0.max(0.0)).sum::<f32>())
        };
        let gains: Vec<f32> = lengths.par_iter().map(of_length).collect::<Result<_>>()?;
        let Some(best) = (0..gains.len()).max_by(|a, b| gains[*a].total_cmp(&gains[*b])) else { return Ok(None) };
        let mut sorted = gains.clone();
        sorted.sort_unstable_by(f32::total_cmp);
        let others = sorted[9 * sorted.len() / 10];
        if gains[best] < STANDS_OUT * others || gains[best] < LEAST_MEAN * strips.len() as f32 {
            return Ok(None);
        }
        let length = lengths[best];
        let of_strip = |says: &Vec<f32>| {
            let (gain, first) = shifted(says, length, FOUND);
            (gain > LEAST_GAIN).then_some(first)
        };
        Ok(Some(Self { length, first: says.iter().map(of_strip).collect() }))
    }

    /// How far a column of a strip is from its nearest end; infinite where none is known.
    pub fn distance(&self, strip: usize, column: f32) -> f32 {
        let Some(first) = self.first[strip] else { return f32::INFINITY };
        let offset = (column - first).rem_euclid(self.length);
        offset.min(self.length - offset)
    }
}

/// What ends at this distance from each other gain at the best of all shifts, of which `steps` are tried per column, beyond what that gains
/// by chance; and the first of them.
fn shifted(says: &[f32], length: f32, steps: f32) -> (f32, f32) {
    let last = says.len() as f32 - 1.0;
    let at = |column: f32| {
        let (i, share) = (column as usize, column.fract());
        (1.0 - share) * says[i] + share * says.get(i + 1).copied().unwrap_or(0.0)
    };
    let shifts = (steps * length) as usize;
    let of_shift = |shift: usize| {
        let first = shift as f32 / steps;
        let ends = (0..).map(|k| first + k as f32 * length).take_while(|column| *column <= last);
        (ends.map(at).sum::<f32>() - (shifts as f32).ln(), first)
    };
    (0..shifts).map(of_shift).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use crate::rng::hash2;

    const COLUMNS: usize = 200;
    const STRIPS: usize = 12;
    const CONTRAST: f32 = 0.1;

    fn random(a: usize, b: usize) -> f32 {
        hash2(a as u32, b as u32) as f32 / u32::MAX as f32
    }

    /// Strips of which the ends that `is_end` tells are darker under noise of ±0.04. Of every fourth strip, the second half is not seen.
    fn strips(is_end: impl Fn(usize, usize) -> bool) -> Vec<Strip> {
        let column = |strip: usize, column: usize| {
            let dark = if is_end(strip, column) { CONTRAST } else { 0.0 };
            let seen = strip % 4 != 0 || column < COLUMNS / 2;
            [dark + 0.08 * (random(strip, column) - 0.5), f32::from(u8::from(seen))]
        };
        (0..STRIPS).map(|s| Strip::of(&(0..COLUMNS).map(|c| column(s, c)).collect::<Vec<_>>(), 0.5)).collect()
    }

    #[test]
    fn ends_of_boards_of_one_length_are_found_also_where_nothing_is_seen() {
        const LENGTH: f32 = 41.3;
        let shift = |strip: usize| LENGTH * random(strip, 1_000_000);
        let is_end = |strip: usize, column: usize| (column as f32 + 0.5 - shift(strip)).rem_euclid(LENGTH) < 1.0;
        let ends = Ends::find(&strips(is_end), 10.0, CONTRAST, &Silent).unwrap().expect("one length");
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
    fn noise_and_boards_of_any_length_have_none() {
        let none = |is_end: &dyn Fn(usize, usize) -> bool| {
            Ends::find(&strips(is_end), 10.0, CONTRAST, &Silent).unwrap().is_none()
        };
        assert!(none(&|_, _| false));
        assert!(none(&|strip, column| random(strip, column + 7_000) < 0.025));
        // Negative control.
        assert!(!none(&|strip, column| (column + 13 * strip) % 40 == 0));
    }
}
