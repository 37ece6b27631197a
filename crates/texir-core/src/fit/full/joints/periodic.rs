//! Lines at equal distances, as boards of one width and tiles are laid, and the ends of the boards.
//!
//! Where they are follows from all of them together, also of those that hardly stand out and of those that no view
//! shows ([`super::comb`], [`super::board_ends`]).

use rayon::prelude::*;

use crate::error::Result;
use crate::fit::full::joints::board_ends::{Ends, Strip};
use crate::fit::full::joints::comb::{Profile, Regular};
use crate::fit::full::joints::lines::{AXES, LineCoverage, LogAlbedo, Polarity};
use crate::progress::Progress;

/// How much of a row must be seen, metres.
const SEEN: f32 = 0.25;

/// Texels of a segment that lie in one chart, with their column and row.
type Piece = Vec<(u32, [i32; 2])>;

impl LogAlbedo<'_> {
    /// What texels, seen or not, have of lines along the rows or the columns of the atlas that are at equal distances
    /// in their chart, and of the ends of what these divide. None where texels are wider than lines may be (`width`,
    /// metres).
    pub fn regular(&self, width: f32, progress: &dyn Progress) -> Result<Vec<Option<LineCoverage>>> {
        let mut lines = vec![None; self.ln.len()];
        if self.texel > width {
            return Ok(lines);
        }
        let away = (width / self.texel).round().max(2.0) as usize;
        let least = (SEEN / self.texel).max(1.0);
        let contrast = AXES.map(|across| self.contrast(across, away));
        let of_piece = |piece: &Piece| {
            let chart = Chart { piece, contrast: &contrast };
            let on_axis = |axis: usize| chart.regular(axis, (away as f32, least), progress);
            let regular = [on_axis(0)?, on_axis(1)?];
            let mut on: Vec<(u32, LineCoverage)> = Vec::new();
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
            let most: &mut Option<LineCoverage> = &mut lines[t as usize];
            *most = Some(most.map_or(covered, |most| most.or(covered)));
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

/// A piece and, for both axes, the contrasts of all texels ([`LogAlbedo::contrast`]).
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

    /// The lines at equal distances along an axis, of contrasts with what is `away` rows, where rows of fewer than
    /// `least` texels say nothing.
    fn regular(&self, axis: usize, (away, least): (f32, f32), progress: &dyn Progress) -> Result<Option<Regular>> {
        let texels = self.rows(axis).map(|(t, row)| (row, self.contrast[axis][t as usize]));
        Profile::of(texels, least).lines(away, progress)
    }

    /// What texels have of these lines.
    fn on(&self, axis: usize, found: &Regular) -> impl Iterator<Item = (u32, LineCoverage)> {
        let Regular { line, comb, .. } = *found;
        let covered = move |row: usize| LineCoverage::of(line, comb.distance(row as f32), comb.half_width);
        self.rows(axis).filter_map(move |(t, row)| Some((t, covered(row)?)))
    }

    /// What texels have of the ends of what these lines divide, which are as wide as they are.
    fn ends(&self, axis: usize, found: &Regular, progress: &dyn Progress) -> Result<Vec<(u32, LineCoverage)>> {
        let Regular { line, comb, contrast } = *found;
        let sign = if line == Polarity::Darker { -1.0 } else { 1.0 };
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
        let strips: Vec<Strip> = strips.into_iter().map(|columns| Strip::of(&columns, least)).collect();
        let Some(ends) = Ends::find(&strips, comb.period, (contrast, 2.0 * comb.half_width), progress)? else {
            return Ok(Vec::new());
        };
        let covered = |strip: usize, column: usize| {
            Some(LineCoverage::of(line, ends.distance(strip, column as f32), comb.half_width)?.at_end())
        };
        Ok(laid().filter_map(|(t, strip, column)| Some((t, covered(strip, column)?))).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::full::joints::lines::tests::{EDGES, grid};
    use crate::progress::Silent;
    use crate::rng::hash2;

    /// Edge of a texel, metres, and how wide lines may be.
    const TEXEL: f32 = 0.01;
    const WIDTH: f32 = 0.03;

    /// A floor whose joints are darker by `contrast` than boards that are up to `uneven` brighter or darker, under
    /// noise of ±0.3. A third of it is not seen. Of the texels that are counted: the share of joints that is found, and
    /// the share of what is found that is one. Columns and rows tell which board a texel is of, whether it is on a
    /// joint, and whether it is counted.
    fn found_of(
        board: impl Fn([usize; 2]) -> usize,
        is_joint: impl Fn([usize; 2]) -> bool,
        is_counted: impl Fn([usize; 2]) -> bool,
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
        let paint = LogAlbedo { ln: &ln, is_seen: &is_seen, segment: &segment, adjacency: &adjacency, texel: TEXEL };
        let lines = paint.regular(WIDTH, &Silent).unwrap();
        let dark =
            |t: usize| lines[t].is_some_and(|covered| covered.line == Polarity::Darker && covered.share() >= 0.5);
        assert!((0..ln.len()).all(|t| lines[t].is_none_or(|covered| covered.line == Polarity::Darker)));
        let count =
            |what: &dyn Fn(usize) -> bool| (0..ln.len()).filter(|t| is_counted(at(*t)) && what(*t)).count() as f32;
        let both = count(&|t| dark(t) && is_joint(at(t)));
        [both / count(&|t| is_joint(at(t))), both / count(&dark).max(1.0)]
    }

    /// The same, of boards as long as the floor, with joints along columns.
    fn found(is_joint: impl Fn(usize) -> bool, uneven: f32, contrast: f32) -> [f32; 2] {
        let board = |[column, _]: [usize; 2]| (0..=column).filter(|c| is_joint(*c)).count();
        found_of(board, |[column, _]| is_joint(column), |_| true, uneven, contrast)
    }

    #[test]
    fn boards_end_where_their_strip_says_if_they_are_of_one_length() {
        const LENGTH: usize = 53;
        let beside = |[column, _]: [usize; 2]| column % 12 == 5;
        let strip = |column: usize| (column + 6) / 12;
        let along = |[column, row]: [usize; 2]| row + strip(column) * 31 % LENGTH;
        let board = |at: [usize; 2]| 1000 * strip(at[0]) + along(at) / LENGTH;
        let ends = |at: [usize; 2]| along(at) % LENGTH == 0;
        // Of strips that are wholly seen, and of ends alone.
        let strips = |at: [usize; 2]| at[0] < 53 && !beside(at);
        let [recall, precision] = found_of(board, |at| beside(at) || ends(at), strips, 0.1, 0.25);
        assert!(recall > 0.8 && precision > 0.9, "{recall} {precision}");
        // Negative control: of boards that do not end, no ends are found.
        let [_, precision] = found_of(board, beside, |_| true, 0.0, 0.25);
        assert!(precision > 0.98, "{precision}");
    }

    #[test]
    fn lines_at_equal_distances_go_on_where_nothing_is_seen() {
        // Distances of 9.4 texels, which no row but those of all lines together tells, and lines three texels wide.
        let narrow = |column: usize| (column as f32 + 0.5 - 4.0).rem_euclid(9.4) < 1.0;
        let wide = |column: usize| (6..9).contains(&(column % 15));
        // Between boards of uneven paint, and where few are seen, periods are less exact, and some of those that are
        // not seen come out beside where they are.
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
