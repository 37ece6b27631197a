//! Lines at equal distances among the rows of a chart.
//!
//! The mean contrast of the rows is averaged over every period and phase, and those lines are believed that stand out
//! of the rest by far more than chance brings about.

use rayon::prelude::*;

use crate::error::Result;
use crate::fit::full::joints::lines::Polarity;
use crate::progress::Progress;

/// Lines must be so far apart, rows: closer ones are not told from what albedo is wrong by between neighbours.
const CLOSEST: f32 = 5.0;
/// So many of them must be seen.
const LEAST_LINES: f32 = 3.5;
/// Phases that are tried, per row; periods are so close that the last line is as exact.
const STEPS: f32 = 4.0;
/// How many standard errors their mean contrast must be, by what the rows between them have. Of thousands of periods
/// and phases, the best has four to six by chance.
const LEAST_EVIDENCE: f32 = 6.0;
/// The mean contrast that lines must have, in ln a.
const LEAST_CONTRAST: f32 = 0.05;
/// Share of the lines that must have some contrast.
const LEAST_ALIKE: f32 = 0.8;
/// A line is as wide as it has this share of its contrast.
const WIDE: f32 = 2.0 / 3.0;
/// Half-width of a line at least, rows: a narrower one cannot be told from a fainter one of this width.
const NARROWEST: f32 = 0.5;

/// Lines at equal distances that are believed.
#[derive(Clone, Copy, Debug)]
pub struct Regular {
    /// What they are beside the rest.
    pub line: Polarity,
    /// Where they are.
    pub comb: Comb,
    /// How much they stand out, ln a.
    pub contrast: f32,
}

/// Lines at equal distances, all in rows.
#[derive(Clone, Copy, Debug)]
pub struct Comb {
    /// Rows from one to the next.
    pub period: f32,
    phase: f32,
    /// Half of how wide they are, rows.
    pub half_width: f32,
}

impl Comb {
    /// Where its lines are, up to the row `last`.
    fn lines(self, last: f32) -> impl Iterator<Item = f32> {
        (0..).map(move |k| self.phase + k as f32 * self.period).take_while(move |row| *row <= last)
    }

    /// Number of the strip between two lines that a row lies in; `None` on a line.
    pub fn strip(self, row: f32) -> Option<usize> {
        (self.distance(row) >= self.half_width).then(|| ((row - self.phase) / self.period + 1.0).max(0.0) as usize)
    }

    /// How far a row is from the nearest line.
    pub fn distance(&self, row: f32) -> f32 {
        let offset = (row - self.phase).rem_euclid(self.period);
        offset.min(self.period - offset)
    }
}

/// Lines, and how much they stand out: their mean contrast by the square root of their number.
type StandsOut = (f32, Comb);

/// Of two lines of each kind, those that stand out more; of equal ones, the later.
fn more(a: [Option<StandsOut>; 2], b: [Option<StandsOut>; 2]) -> [Option<StandsOut>; 2] {
    std::array::from_fn(|kind| match (a[kind], b[kind]) {
        (Some(a), Some(b)) if a.0.total_cmp(&b.0).is_gt() => Some(a),
        (a, b) => b.or(a),
    })
}

/// Per row of a chart: the sum of how much darker its texels are than what is around them, in ln a, and their number.
#[derive(Clone)]
pub struct Profile(Vec<[f32; 2]>);

impl Profile {
    /// By the row and the contrast of each texel (`LogAlbedo::contrast`); rows of fewer than `least` say nothing.
    pub fn of(texels: impl Iterator<Item = (usize, [f32; 3])>, least: f32) -> Self {
        let mut rows: Vec<[f32; 2]> = Vec::new();
        for (row, [contrast, _, weight]) in texels {
            rows.resize(rows.len().max(row + 1), [0.0; 2]);
            rows[row][0] -= contrast * weight;
            rows[row][1] += weight;
        }
        rows.iter_mut().filter(|[_, weight]| *weight < least).for_each(|row| *row = [0.0; 2]);
        Self(rows)
    }

    /// The last one.
    fn last(&self) -> f32 {
        self.0.len() as f32 - 1.0
    }

    /// What lies between two rows.
    fn at(&self, row: f32) -> [f32; 2] {
        let (i, share) = (row as usize, row.fract());
        let [a, b] = [i, i + 1].map(|i| self.0.get(i).copied().unwrap_or_default());
        [0, 1].map(|k| (1.0 - share) * a[k] + share * b[k])
    }

    /// The mean of all lines, and how many their weights are worth.
    fn mean(&self, comb: Comb) -> [f32; 2] {
        let sums = comb.lines(self.last()).map(|row| self.at(row));
        let [sum, all, squares] =
            sums.fold([0.0; 3], |[sum, all, squares], [c, w]| [sum + c, all + w, squares + w * w]);
        if all > 0.0 { [sum / all, all * all / squares] } else { [0.0; 2] }
    }

    /// The lines that are believed, of contrasts with what is `away` rows.
    pub fn lines(self, away: f32, progress: &dyn Progress) -> Result<Option<Regular>> {
        let best = self.best(progress)?;
        let brighter = Self(self.0.iter().map(|[c, w]| [-c, *w]).collect());
        let found = [(Polarity::Darker, self), (Polarity::Brighter, brighter)].into_iter().zip(best);
        let found = found.filter_map(|((line, rows), best)| {
            let (evidence, comb) = rows.accepted(best?, away)?;
            let [contrast, _] = rows.mean(comb);
            Some((evidence, Regular { line, comb, contrast }))
        });
        Ok(found.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, found)| found))
    }

    /// By how many standard errors lines stand out, and they with the width that they have; if that is enough.
    fn accepted(&self, (stands_out, comb): StandsOut, away: f32) -> Option<(f32, Comb)> {
        // Rows up to 1.5 `away` from a line's middle may have been compared with the line itself.
        let beside = (1.5 * away).min(comb.period / 3.0);
        let between = (0..self.0.len()).filter(|row| comb.distance(*row as f32) > beside);
        let [squares, all] = between
            .map(|row| self.0[row])
            .filter(|[_, w]| *w > 0.0)
            .fold([0.0; 2], |[squares, all], [c, w]| [squares + c * c / w, all + w]);
        let evidence = stands_out / (squares / all).sqrt();
        let [contrast, _] = self.mean(comb);
        let seen: Vec<[f32; 2]> = comb.lines(self.last()).map(|row| self.at(row)).filter(|[_, w]| *w > 0.0).collect();
        let alike = seen.iter().filter(|[c, w]| *c > 0.3 * contrast * w).count() as f32 / seen.len() as f32;
        let accepted = evidence > LEAST_EVIDENCE && contrast > LEAST_CONTRAST && alike >= LEAST_ALIKE;
        accepted.then(|| (evidence, self.as_wide_as_seen(comb)))
    }

    /// The darker and the brighter lines that stand out most, of all periods and phases: 16 R² ln (R / 18) steps for R
    /// rows.
    fn best(&self, progress: &dyn Progress) -> Result<[Option<StandsOut>; 2]> {
        let rows = self.0.len() as f32;
        let next = move |period: &f32| Some(period + period / (STEPS * rows));
        let periods = std::iter::successors(Some(CLOSEST), next).take_while(move |period| period * LEAST_LINES <= rows);
        let of_period = |period: f32| {
            progress.check()?;
            let of_phase = |step: usize| {
                let comb = Comb { period, phase: step as f32 / STEPS, half_width: NARROWEST };
                let [contrast, lines] = self.mean(comb);
                let by = (lines >= LEAST_LINES).then_some(contrast * lines.sqrt());
                [by.map(|by| (by, comb)), by.map(|by| (-by, comb))]
            };
            Ok((0..(STEPS * period) as usize).map(of_phase).fold([None; 2], more))
        };
        periods.collect::<Vec<_>>().into_par_iter().map(of_period).try_reduce(|| [None; 2], |a, b| Ok(more(a, b)))
    }

    /// With the width that lines have on average.
    fn as_wide_as_seen(&self, comb: Comb) -> Comb {
        let [contrast, _] = self.mean(comb);
        let is_line = |step: &i32| {
            let phase = (comb.phase + *step as f32 / STEPS).rem_euclid(comb.period);
            self.mean(Comb { phase, ..comb })[0] > WIDE * contrast
        };
        let most = (0.5 * STEPS * comb.period) as i32;
        let [before, behind] = [-1, 1].map(|side| (1..most).take_while(|step| is_line(&(side * step))).count() as f32);
        let half_width = (0.5 * (before + behind) / STEPS).max(NARROWEST);
        Comb { phase: comb.phase + 0.5 * (behind - before) / STEPS, half_width, ..comb }
    }
}
