//! Lines that stand out in albedo, as joints of boards and tiles do.

use std::iter::successors;

use rayon::prelude::*;

use crate::fit::adjacency::Adjacency;
use crate::fit::index::NONE;
use crate::fit::settings::{JointSettings, Straight};

/// What a line is beside what is around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Polarity {
    /// Darker.
    Darker,
    /// Brighter.
    Brighter,
}

/// A texel on a line, or in part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineCoverage {
    /// In 255ths, not 0.
    share: u8,
    /// What covers it.
    pub line: Polarity,
    /// Whether that is the end of a board, whose place follows from those of others.
    pub is_end: bool,
}

impl LineCoverage {
    /// All of it.
    pub fn full(line: Polarity) -> Self {
        Self { share: u8::MAX, line, is_end: false }
    }

    /// A texel so far from the middle of a line that is half as wide as this, in texels; `None` beside it.
    pub fn of(line: Polarity, distance: f32, half_width: f32) -> Option<Self> {
        let share = (half_width + 0.5 - distance).clamp(0.0, 1.0);
        let share = (share * f32::from(u8::MAX)).round() as u8;
        (share > 0).then_some(Self { share, line, is_end: false })
    }

    /// What covers more of a texel; as much, a darker line.
    pub fn or(self, other: Self) -> Self {
        let by = |covered: &Self| (covered.share, covered.line == Polarity::Darker);
        if by(&other) > by(&self) { other } else { self }
    }

    /// By the end of a board.
    pub fn at_end(self) -> Self {
        Self { is_end: true, ..self }
    }

    /// The share of the texel, in (0, 1].
    pub fn share(self) -> f32 {
        f32::from(self.share) / f32::from(u8::MAX)
    }
}

/// The logarithm of albedo, and what it takes to look for lines in it. Lists are per texel.
pub struct LogAlbedo<'a> {
    /// The logarithm of albedo, mean of the channels.
    pub ln: &'a [f32],
    /// Whether a view sees it.
    pub is_seen: &'a [bool],
    /// Segment of each texel; lines do not leave it.
    pub segment: &'a [u32],
    /// Who is beside whom.
    pub adjacency: &'a Adjacency,
    /// Edge of a typical texel, metres.
    pub texel: f32,
}

/// Left and right, up and down: the sides of [`Adjacency::beside`], of which the first lie before a texel in the order
/// of the atlas.
pub(super) const AXES: [[usize; 2]; 2] = [[0, 1], [2, 3]];

impl LogAlbedo<'_> {
    /// Which seen texels lie on straight lines along the rows or the columns of the atlas: where the logarithm of
    /// albedo is not what it is on either side, on average over the line as far as it is seen, and more so than beside.
    /// A texel at distance d along it counts e^(−d/`reach`). None where texels are wider than lines may be: they show a
    /// line and what it divides as one.
    pub fn straight(&self, course: &Straight, width: f32) -> Vec<Option<Polarity>> {
        /// At a step edge |contrast| equals half the step between the two sides; at a line it is more. Half the step
        /// must stay below this share of |contrast|.
        const STEP: f32 = 0.75;
        if self.texel > width {
            return vec![None; self.ln.len()];
        }
        let away = (width / self.texel).round().max(2.0) as usize;
        let thickest = (width / self.texel) as usize;
        let keep = (-self.texel / course.reach).exp();
        let mut lines = vec![None; self.ln.len()];
        for (across, along) in [(AXES[0], AXES[1]), (AXES[1], AXES[0])] {
            let [mean, step] = self.followed(&self.contrast(across, away), along, keep);
            let is_line = |t: usize| {
                let contrast = mean[t].abs();
                self.is_seen[t] && contrast > course.contrast && step[t].abs() < STEP * contrast
            };
            // Beside a dark line everything seems bright.
            let most = |t: usize| {
                let beside = |side: usize| successors(self.step(t, side), move |t| self.step(*t, side)).take(away);
                across.iter().all(|side| beside(*side).all(|n| mean[n].abs() <= mean[t].abs()))
            };
            for t in (0..lines.len()).filter(|t| is_line(*t) && most(*t)) {
                let line = if mean[t] < 0.0 { Polarity::Darker } else { Polarity::Brighter };
                self.thick(t, across, thickest, &mean).into_iter().for_each(|t| lines[t] = Some(line));
            }
        }
        lines
    }

    /// The texels across a line from the one where its mean is largest, as long as it is hardly less, at most so many.
    fn thick(&self, peak: usize, across: [usize; 2], most: usize, mean: &[f32]) -> Vec<usize> {
        /// What is less by more is what a line blurs into.
        const ALIKE: f32 = 0.8;
        let mut thick = vec![peak];
        let mut ends = [peak; 2];
        while thick.len() < most {
            let beside = [0, 1].map(|end| self.step(ends[end], across[end]).map(|t| (mean[t] / mean[peak], end, t)));
            let next = beside.into_iter().flatten().filter(|next| next.0 > ALIKE).max_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, end, t)) = next.filter(|(_, _, t)| self.is_seen[*t]) else { break };
            thick.push(t);
            ends[end] = t;
        }
        thick
    }

    /// The texel at a side, of the same segment.
    pub(super) fn step(&self, t: usize, side: usize) -> Option<usize> {
        let next = self.adjacency.beside[t][side];
        (next != NONE && self.segment[next as usize] == self.segment[t]).then_some(next as usize)
    }

    /// [ln a less the mean of the seen texels `away` steps to both sides, half the difference of those two, weight 1];
    /// zeros where one of the three is not seen.
    pub(super) fn contrast(&self, sides: [usize; 2], away: usize) -> Vec<[f32; 3]> {
        /// Larger differences are not paint but, say, the rim of what stands there.
        const MOST: f32 = 0.3;
        let seen = |t: &usize| self.is_seen[*t];
        let of_texel = |t: usize| {
            let beside = sides.map(|side| (0..away).try_fold(t, |t, _| self.step(t, side)).filter(seen));
            match beside {
                [Some(a), Some(b)] if seen(&t) => {
                    let [a, b] = [self.ln[a], self.ln[b]];
                    [(self.ln[t] - 0.5 * (a + b)).clamp(-MOST, MOST), 0.5 * (a - b), 1.0]
                }
                _ => [0.0; 3],
            }
        };
        (0..self.ln.len()).into_par_iter().map(of_texel).collect()
    }

    /// The means of `contrast` and of half steps before and behind each texel, weights falling by `keep` from one to
    /// the next; 0 where too little is seen.
    fn followed(&self, contrast: &[[f32; 3]], [before, behind]: [usize; 2], keep: f32) -> [Vec<f32>; 2] {
        /// Least share of all weights that must be seen.
        const SEEN: f32 = 0.3;
        /// Length, metres, that suffices where it is less.
        const LONG: f32 = 0.25;
        let add = |sums: &mut [[f32; 3]], t: usize, side: usize| {
            if let Some(next) = self.step(t, side) {
                let lent = sums[next].map(|sum| keep * sum);
                sums[t].iter_mut().zip(lent).for_each(|(sum, lent)| *sum += lent);
            }
        };
        let (mut up_to, mut from) = (contrast.to_vec(), contrast.to_vec());
        (0..contrast.len()).for_each(|t| add(&mut up_to, t, before));
        (0..contrast.len()).rev().for_each(|t| add(&mut from, t, behind));
        let least = (SEEN * (1.0 + keep) / (1.0 - keep)).min(LONG / self.texel);
        [0, 1].map(|of| {
            let mean = |t: usize| {
                let [sum, weight] = [of, 2].map(|i| up_to[t][i] + from[t][i] - contrast[t][i]);
                if weight > least { sum / weight } else { 0.0 }
            };
            (0..contrast.len()).into_par_iter().map(mean).collect()
        })
    }

    /// Which seen texels lie on lines of any course, at most [`JointSettings::width`] wide and at least
    /// [`JointSettings::length`] long, by closing and opening the logarithm of albedo within segments (top-hat
    /// transforms; Serra, "Image Analysis and Mathematical Morphology", 1982).
    pub fn narrow(&self, settings: &JointSettings) -> Vec<Option<Polarity>> {
        let rounds = (0.5 * settings.width / self.texel).round().max(1.0) as usize;
        let spread = |values: Vec<f32>, pick: fn(f32, f32) -> f32| {
            (0..rounds).fold(values, |values, _| {
                let around = |t: usize| {
                    let around = self.adjacency.around(t as u32);
                    let within = around.filter(|n| self.segment[*n as usize] == self.segment[t]);
                    within.fold(values[t], |most, n| pick(most, values[n as usize]))
                };
                (0..values.len()).into_par_iter().map(around).collect()
            })
        };
        let closed = spread(spread(self.ln.to_vec(), f32::max), f32::min);
        let opened = spread(spread(self.ln.to_vec(), f32::min), f32::max);
        let line = |t: usize| {
            let (darker, brighter) = (closed[t] - self.ln[t], self.ln[t] - opened[t]);
            match self.is_seen[t] && darker.max(brighter) > settings.contrast {
                true if darker >= brighter => Some(Polarity::Darker),
                true => Some(Polarity::Brighter),
                false => None,
            }
        };
        let lines: Vec<Option<Polarity>> = (0..self.ln.len()).into_par_iter().map(line).collect();
        self.long(&lines, (settings.length / self.texel).round() as usize)
    }

    /// The lines of at least `least` texels that touch: what stands out by itself is noise (an area opening; Vincent,
    /// "Morphological area openings and closings for grey-scale images", 1994).
    fn long(&self, lines: &[Option<Polarity>], least: usize) -> Vec<Option<Polarity>> {
        let mut long = vec![None; lines.len()];
        let mut reached: Vec<bool> = lines.iter().map(Option::is_none).collect();
        for start in 0..lines.len() {
            if std::mem::replace(&mut reached[start], true) {
                continue;
            }
            let mut line = vec![start as u32];
            let mut at = 0;
            while let Some(&t) = line.get(at) {
                at += 1;
                let goes_on = |n: usize| self.segment[n] == self.segment[start] && lines[n] == lines[start];
                let touching = self.adjacency.touching(t).filter(|n| goes_on(*n as usize));
                line.extend(touching.filter(|n| !std::mem::replace(&mut reached[*n as usize], true)));
            }
            if line.len() >= least {
                line.into_iter().for_each(|t| long[t as usize] = lines[start]);
            }
        }
        long
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::rng::hash2;

    /// Columns, 1.2 m of them, and rows, 3 m.
    pub const EDGES: [usize; 2] = [96, 240];
    /// Columns from one joint to the next.
    const BOARD: usize = 12;

    pub fn grid() -> Adjacency {
        let [columns, rows] = EDGES.map(|edge| edge as i32);
        let at = |x: i32, y: i32| {
            let inside = (0..columns).contains(&x) && (0..rows).contains(&y);
            if inside { (y * columns + x) as u32 } else { NONE }
        };
        let beside = |t: i32| [(-1, 0), (1, 0), (0, -1), (0, 1)].map(|(dx, dy)| at(t % columns + dx, t / columns + dy));
        Adjacency::of((0..columns * rows).map(beside).collect(), Vec::new())
    }

    fn is_joint(t: usize) -> bool {
        t % EDGES[0] % BOARD == 5
    }

    /// A floor of boards, of which each is up to `uneven` brighter or darker, joints darker by `contrast` under noise
    /// of ±0.3, of which a rug hides a part. Of the texels that are seen: the share of joints that is found, and the
    /// share of what is found that is one.
    fn found(uneven: f32, contrast: f32, find: impl Fn(&LogAlbedo<'_>) -> Vec<Option<Polarity>>) -> [f32; 2] {
        let [columns, rows] = EDGES;
        let random = |a: usize, b: u32| hash2(a as u32, b) as f32 / u32::MAX as f32 - 0.5;
        let of_texel = |t: usize| {
            let board = 2.0 * uneven * random((t % columns + BOARD - 5) / BOARD, 1);
            board + 0.6 * random(t, 2) - if is_joint(t) { contrast } else { 0.0 }
        };
        let ln: Vec<f32> = (0..columns * rows).map(of_texel).collect();
        let is_seen: Vec<bool> =
            (0..ln.len()).map(|t| t % columns < 60 || !(30..50).contains(&(t / columns))).collect();
        let (adjacency, segment) = (grid(), vec![0; ln.len()]);
        let albedo_map =
            LogAlbedo { ln: &ln, is_seen: &is_seen, segment: &segment, adjacency: &adjacency, texel: 0.0125 };
        let lines = find(&albedo_map);
        let count = |what: &dyn Fn(usize) -> bool| (0..ln.len()).filter(|t| is_seen[*t] && what(*t)).count() as f32;
        let dark = |t: usize| lines[t] == Some(Polarity::Darker);
        let both = count(&|t| dark(t) && is_joint(t));
        [both / count(&is_joint), both / count(&dark).max(1.0)]
    }

    #[test]
    fn lines_cover_as_much_as_they_are_wide() {
        for half_width in [0.5, 0.8, 1.6] {
            for middle in [0.0, 0.2, 0.5, 0.9] {
                let shares =
                    (-5..=5).filter_map(|t| LineCoverage::of(Polarity::Darker, (t as f32 - middle).abs(), half_width));
                let sum: f32 = shares.map(LineCoverage::share).sum();
                assert!((sum - 2.0 * half_width).abs() < 0.01, "{half_width} {middle}: {sum}");
            }
        }
    }

    #[test]
    fn straight_lines_are_followed_through_noise() {
        let settings = JointSettings::default();
        for course in &settings.straight {
            let [recall, precision] = found(0.2, 0.2, |albedo_map| albedo_map.straight(course, settings.width));
            assert!(recall > 0.8 && precision > 0.9, "{recall} {precision}");
        }
        // By themselves, their texels do not stand out of such noise.
        let [_, precision] = found(0.2, 0.2, |albedo_map| albedo_map.narrow(&settings));
        assert!(precision < 0.5, "{precision}");
    }

    #[test]
    fn noise_makes_no_lines() {
        let settings = JointSettings::default();
        let share = |uneven: f32, course: &Straight| {
            found(uneven, 0.0, |albedo_map| albedo_map.straight(course, settings.width))[0]
        };
        for course in &settings.straight {
            // Nor do edges between boards of uneven paint.
            for uneven in [0.0, 0.2] {
                assert!(share(uneven, course) < 0.02, "{course:?} {uneven}");
            }
        }
        // Negative control: hardly followed.
        assert!(share(0.0, &Straight { reach: 0.005, contrast: 0.1 }) > 0.05);
    }
}
