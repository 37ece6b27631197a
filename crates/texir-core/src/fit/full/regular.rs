//! Lines at equal distances, as boards of one width and tiles are laid.
//!
//! Where they are follows from all of them together, also of those that hardly stand out and of those that no view shows: the mean
//! contrast of the rows of a chart, or of its columns, is averaged over every period and phase, and those lines are believed that stand
//! out of the rest by far more than chance brings about.

use rayon::prelude::*;

use super::ends::{Ends, Strip};
use super::lines::{AXES, Covered, Line, Paint};
use crate::error::Result;
use crate::progress::Progress;

/// Lines must be so far apart, rows: closer ones are not told from what albedo is wrong by between neighbours.
const CLOSEST: f32 = 5.0;
/// So many of them must be seen.
const LEAST_LINES: f32 = 3.5;
/// Phases that are tried, per row; periods are so close that the last line is as exact.
const STEPS: f32 = 4.0;
/// How many standard errors their mean contrast must be, by what the rows between them have. Of thousands of periods and phases, the
/// best has four to six by chance.
const LEAST_EVIDENCE: f32 = 6.0;
/// The mean contrast that lines must have, in ln a,
const LEAST_CONTRAST: f32 = 0.05;
/// and the share of them that must have some of it.
const LEAST_ALIKE: f32 = 0.8;
/// A line is as wide as it has this share of its contrast,
const WIDE: f32 = 2.0 / 3.0;
/// and half as wide as this at least, rows: what is narrower cannot be told from a fainter one of this width.
const NARROWEST: f32 = 0.5;
/// How much of a row must be seen, metres.
const SEEN: f32 = 0.25;

/// Texels of a segment that lie in one chart, with their column and row.
type Piece = Vec<(u32, [i32; 2])>;

impl Paint<'_> {
    /// What texels, seen or not, have of lines along the rows or the columns of the atlas that are at equal distances in their
    /// chart, and of the ends of what these divide. None where texels are wider than lines may be (`width`, metres).
    pub fn regular(&self, width: f32, progress: &dyn Progress) -> Result<Vec<Option<Covered>>> {
        let mut lines = vec![None; self.ln.len()];
        if self.texel > width {
            return Ok(lines);
        }
        let away = (width / self.texel).round().max(2.0) as usize;
        let least = (SEEN / self.texel).max(1.0);
        let contrast = AXES.map(|across| self.contrast(across, away));
        let of_piece = |piece: &Piece| {
            let chart = Chart { piece, contrast: &contrast };
            let regular = match [0, 1].map(|axis| chart.regular(axis, (away as f32, least), progress)) {
                [Ok(rows), Ok(columns)] => [rows, columns],
                [Err(e), _] | [_, Err(e)] => return Err(e),
            };
            let mut on: Vec<(u32, Covered)> = Vec::new();
            for (axis, found) in regular.iter().enumerate() {
                found.iter().for_each(|found| on.extend(chart.on(axis, found)));
            }
            // Lines one way only divide boards, which end somewhere.
            match &regular {
                [Some(found), None] => on.extend(chart.ends(0, found, progress)?),
                [None, Some(found)] => on.extend(chart.ends(1, found, progress)?),
                _ => {}
            }
            Ok(on)
        };
        for (t, covered) in self.pieces().par_iter().map(of_piece).collect::<Result<Vec<_>>>()?.into_iter().flatten() {
            let most: &mut Option<Covered> = &mut lines[t as usize];
            *most = (*most).max(Some(covered));
        }
        Ok(lines)
    }

    /// The texels of each segment in each chart.
    fn pieces(&self) -> Vec<Piece> {
        /// What a step to each side of [`Adjacency::beside`](crate::fit::adjacency::Adjacency::beside) changes.
        const STEPS: [[i32; 2]; 4] = [[-1, 0], [1, 0], [0, -1], [0, 1]];
        let mut reached = vec![false; self.ln.len()];
        let mut pieces = Vec::new();
        for start in 0..self.ln.len() {
            if std::mem::replace(&mut reached[start], true) {
                continue;
            }
            let mut piece = vec![(start as u32, [0; 2])];
            let mut at = 0;
            while let Some(&(t, [x, y])) = piece.get(at) {
                at += 1;
                for (side, [dx, dy]) in STEPS.iter().enumerate() {
                    let next = self.step(t as usize, side).filter(|n| !std::mem::replace(&mut reached[*n], true));
                    piece.extend(next.map(|n| (n as u32, [x + dx, y + dy])));
                }
            }
            pieces.push(piece);
        }
        pieces
    }
}

/// A piece and, for both axes, the contrasts of all texels ([`Paint::contrast`]).
struct Chart<'a> {
    piece: &'a Piece,
    contrast: &'a [Vec<[f32; 3]>; 2],
}

impl Chart<'_> {
    /// The texels, with the row that each lies in along an axis, from 0.
    fn rows(&self, axis: usize) -> impl Iterator<Item = (u32, usize)> {
        let first = self.piece.iter().map(|(_, at)| at[axis]).min().unwrap_or(0);
        self.piece.iter().map(move |(t, at)| (*t, (at[axis] - first) as usize))
    }

    /// The lines at equal distances along an axis, of contrasts with what is `away` rows, where rows of fewer than `least` texels say nothing.
    fn regular(&self, axis: usize, (away, least): (f32, f32), progress: &dyn Progress) -> Result<Option<Regular>> {
        let texels = self.rows(axis).map(|(t, row)| (row, self.contrast[axis][t as usize]));
        Profile::of(texels, least).lines(away, progress)
    }

    /// What texels have of these lines.
    fn on(&self, axis: usize, found: &Regular) -> impl Iterator<Item = (u32, Covered)> {
        let Regular { line, comb, .. } = *found;
        let covered = move |row: usize| Covered::of(line, comb.distance(row as f32), comb.half_width);
        self.rows(axis).filter_map(move |(t, row)| Some((t, covered(row)?)))
    }

    /// What texels have of the ends of what these lines divide, which are as wide as they are.
    fn ends(&self, axis: usize, found: &Regular, progress: &dyn Progress) -> Result<Vec<(u32, Covered)>> {
        let Regular { line, comb, contrast } = *found;
        let sign = if line == Line::Darker { -1.0 } else { 1.0 };
        let laid = || {
            self.rows(axis)
                .zip(self.rows(1 - axis))
                .filter_map(|((t, row), (_, column))| Some((t, comb.strip(row as f32)?, column)))
        };
        let mut strips: Vec<Vec<[f32; 2]>> = Vec::new();
        for (t, strip, column) in laid() {
            strips.resize_with(strips.len().max(strip + 1), Vec::new);
            let columns = &mut strips[strip];
            columns.resize(columns.len().max(column + 1), [0.0; 2]);
            let [contrast, _, weight] = self.contrast[1 - axis][t as usize];
            columns[column][0] += sign * contrast * weight;
            columns[column][1] += weight;
        }
        let least = 0.5 * (comb.period - 2.0 * comb.half_width);
        let strips: Vec<Strip> = strips.iter().map(|columns| Strip::of(columns, least)).collect();
        let Some(ends) = Ends::find(&strips, comb.period, contrast, progress)? else { return Ok(Vec::new()) };
        let covered = |strip: usize, column: usize| {
            Some(Covered::of(line, ends.distance(strip, column as f32), comb.half_width)?.at_end())
        };
        Ok(laid().filter_map(|(t, strip, column)| Some((t, covered(strip, column)?))).collect())
    }
}

/// Lines at equal distances that are believed.
#[derive(Clone, Copy, Debug)]
struct Regular {
    line: Line,
    comb: Comb,
    /// How much they stand out, ln a.
    contrast: f32,
}

/// Lines at equal distances, all in rows.
#[derive(Clone, Copy, Debug)]
struct Comb {
    period: f32,
    phase: f32,
    half_width: f32,
}

impl Comb {
    /// Where its lines are, up to the row `last`.
    fn lines(self, last: f32) -> impl Iterator<Item = f32> {
        (0..).map(move |k| self.phase + k as f32 * self.period).take_while(move |row| *row <= last)
    }

    /// Number of the strip between two lines that a row lies in; `None` on a line.
    fn strip(self, row: f32) -> Option<usize> {
        (self.distance(row) >= self.half_width).then(|| ((row - self.phase) / self.period + 1.0).max(0.0) as usize)
    }

    /// How far a row is from the nearest line.
    fn distance(&self, row: f32) -> f32 {
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

/// How dark, on average, the rows of a chart are beside what is around them, in ln a, times how many of their texels say so; and these.
#[derive(Clone)]
struct Profile(Vec<[f32; 2]>);

impl Profile {
    /// By the row and the contrast of each texel ([`Paint::contrast`]); rows of fewer than `least` say nothing.
    fn of(texels: impl Iterator<Item = (usize, [f32; 3])>, least: f32) -> Self {
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
    fn lines(self, away: f32, progress: &dyn Progress) -> Result<Option<Regular>> {
        let best = self.best(progress)?;
        let brighter = Self(self.0.iter().map(|[c, w]| [-c, *w]).collect());
        let found = [(Line::Darker, self), (Line::Brighter, brighter)].into_iter().zip(best);
        let found = found.filter_map(|((line, rows), best)| {
            let (evidence, comb) = rows.believed(best?, away)?;
            let [contrast, _] = rows.mean(comb);
            Some((evidence, Regular { line, comb, contrast }))
        });
        Ok(found.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, found)| found))
    }

    /// By how many standard errors lines stand out, and they with the width that they have; if that is enough.
    fn believed(&self, (stands_out, comb): StandsOut, away: f32) -> Option<(f32, Comb)> {
        // A line as wide as `away` is what rows are compared with up to half more from its middle.
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
        let believed = evidence > LEAST_EVIDENCE && contrast > LEAST_CONTRAST && alike >= LEAST_ALIKE;
        believed.then(|| (evidence, self.as_wide_as_seen(comb)))
    }

    /// The darker and the brighter lines that stand out most, of all periods and phases: 16 R² ln (R / 18) steps for R rows.
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

#[cfg(test)]
mod tests {
    use super::super::lines::tests::{EDGES, grid};
    use super::*;
    use crate::progress::Silent;
    use crate::rng::hash2;

    /// Edge of a texel, metres, and how wide lines may be.
    const TEXEL: f32 = 0.01;
    const WIDTH: f32 = 0.03;

    /// A floor whose joints are darker by `contrast` than boards that are up to `uneven` brighter or darker, under noise of ±0.3. A third of
    /// it is not seen. Of all texels: the share of joints that is found, and the share of what is found that is one. Columns and rows tell
    /// which board a texel is of, and whether it is on a joint.
    fn found_of(
        board: impl Fn([usize; 2]) -> usize,
        is_joint: impl Fn([usize; 2]) -> bool,
        uneven: f32,
        contrast: f32,
    ) -> [f32; 2] {
        let [columns, rows] = EDGES;
        let at = |t: usize| [t % columns, t / columns];
        let random = |a: usize, b: u32| hash2(a as u32, b) as f32 / u32::MAX as f32 - 0.5;
        let of_texel = |t: usize| {
            let paint = 2.0 * uneven * random(board(at(t)), 1) + 0.6 * random(t, 2);
            paint - if is_joint(at(t)) { contrast } else { 0.0 }
        };
        let ln: Vec<f32> = (0..columns * rows).map(of_texel).collect();
        let is_seen: Vec<bool> = (0..ln.len()).map(|t| t % columns < 64).collect();
        let (adjacency, segment) = (grid(), vec![0; ln.len()]);
        let paint = Paint { ln: &ln, is_seen: &is_seen, segment: &segment, adjacency: &adjacency, texel: TEXEL };
        let lines = paint.regular(WIDTH, &Silent).unwrap();
        let dark = |t: usize| lines[t].is_some_and(|covered| covered.line == Line::Darker && covered.share() >= 0.5);
        assert!((0..ln.len()).all(|t| lines[t].is_none_or(|covered| covered.line == Line::Darker)));
        let count = |what: &dyn Fn(usize) -> bool| (0..ln.len()).filter(|t| what(*t)).count() as f32;
        let both = count(&|t| dark(t) && is_joint(at(t)));
        [both / count(&|t| is_joint(at(t))), both / count(&dark).max(1.0)]
    }

    /// The same, of boards as long as the floor, with joints along columns.
    fn found(is_joint: impl Fn(usize) -> bool, uneven: f32, contrast: f32) -> [f32; 2] {
        let board = |[column, _]: [usize; 2]| (0..=column).filter(|c| is_joint(*c)).count();
        found_of(board, |[column, _]| is_joint(column), uneven, contrast)
    }

    #[test]
    fn boards_end_where_their_strip_says_if_they_are_of_one_length() {
        const LENGTH: usize = 53;
        let beside = |[column, _]: [usize; 2]| column % 12 == 5;
        let strip = |column: usize| (column + 6) / 12;
        let along = |[column, row]: [usize; 2]| row + strip(column) * 31 % LENGTH;
        let board = |at: [usize; 2]| 1000 * strip(at[0]) + along(at) / LENGTH;
        let ends = |at: [usize; 2]| along(at) % LENGTH == 0;
        let [recall, precision] = found_of(board, |at| beside(at) || ends(at), 0.1, 0.25);
        assert!(recall > 0.75 && precision > 0.9, "{recall} {precision}");
        // Negative control: of boards that do not end, no ends are found.
        let [_, precision] = found_of(board, beside, 0.0, 0.25);
        assert!(precision > 0.98, "{precision}");
    }

    #[test]
    fn lines_at_equal_distances_go_on_where_nothing_is_seen() {
        // Distances of 9.4 texels, which no row but those of all lines together tells, and lines three texels wide.
        let narrow = |column: usize| (column as f32 + 0.5 - 4.0).rem_euclid(9.4) < 1.0;
        let wide = |column: usize| (6..9).contains(&(column % 15));
        // Between boards of uneven paint, and where few are seen, periods are less exact, and some of those that are not seen come out
        // beside where they are.
        let cases = [
            ([0.9, 0.8], found(narrow, 0.0, 0.15)),
            ([0.7, 0.7], found(narrow, 0.1, 0.15)),
            ([0.6, 0.8], found(wide, 0.0, 0.25)),
        ];
        for (least, [recall, precision]) in cases {
            assert!(recall > least[0] && precision > least[1], "{recall} {precision}, at least {least:?}");
        }
    }

    #[test]
    fn what_is_not_at_equal_distances_is_no_such_line() {
        let regular = |column: usize| column % 10 == 4;
        let irregular = |column: usize| [3, 14, 22, 36, 43, 59, 64, 81].contains(&column);
        assert_eq!(found(irregular, 0.0, 0.15), [0.0; 2]);
        // Nor are boards of uneven paint, or noise.
        for uneven in [0.0, 0.1, 0.2] {
            assert_eq!(found(regular, uneven, 0.0), [0.0; 2], "{uneven}");
        }
        // Negative control.
        assert!(found(regular, 0.0, 0.15)[0] > 0.9);
    }
}
