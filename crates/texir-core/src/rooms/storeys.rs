//! Storeys: where one floor of a building ends and the next begins.
//!
//! Cameras tell. Between those of two storeys lies a floor that the upper ones stand on; between those of one storey,
//! held high and low, lie at most tables. A storey that no camera stands in is none.

use std::ops::Range;

use glam::Vec3;

use super::{HEAD_ROOM, HORIZONTAL};
use crate::mesh::cross;

/// Height of a bin when floors and ceilings are looked for, metres.
pub(super) const LEVEL_BIN: f32 = 0.02;
/// Bins at most: a tower 2 km high.
const MAX_BINS: f32 = 1e5;
/// Floors are uneven by this many bins to either side.
const UNEVEN: usize = 2;
/// A level may be another storey's floor if it has at least this share of the largest level's area: galleries are
/// small.
const FLOOR_SHARE: f32 = 0.15;
/// Floors of two storeys are at least this far apart, metres.
const STOREY: f32 = 2.1;
/// Surfaces above a storey's ceilings (a beam, the dust of a scan) have at most this share of what lies above eye
/// height: rooms differ in height.
const ABOVE_CEILING: f32 = 0.01;
/// A level is main with at least this share of the largest one's area. Levels are told by the side that they face, up
/// or down, where that side has a main one; otherwise the mesh's sides mean nothing, or a sheet is floor and ceiling at
/// once.
const MAIN: f32 = 0.5;

/// The heights between which a storey lies, plan coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Storey {
    /// Height of the floor.
    pub floor: f32,
    /// Height of the highest ceiling.
    pub top: f32,
}

/// The storeys in which cameras stand, the lowest first; without cameras, the one at half the mesh's height. Triangles
/// and cameras are in plan coordinates. There is always one.
pub(super) fn find(triangles: impl Iterator<Item = [Vec3; 3]> + Clone, cameras: &[Vec3]) -> Vec<Storey> {
    let levels = Levels::new(triangles);
    let (lo, hi) = (levels.lo, levels.height(levels.count()));
    let mut eyes: Vec<f32> = cameras.iter().map(|c| c.z).filter(|&z| z > lo && z < hi).collect();
    eyes.sort_by(f32::total_cmp);
    if eyes.is_empty() {
        eyes.push(0.5 * (lo + hi));
    }
    let mut starts = levels.starts(&eyes);
    loop {
        let storeys = levels.storeys(&eyes, &starts);
        // Where one could not stand upright, cameras were held above a shelf.
        match storeys.iter().skip(1).position(|s| s.top - s.floor < HEAD_ROOM) {
            Some(k) => _ = starts.remove(k + 1),
            None => return storeys,
        }
    }
}

/// How much horizontal area lies at which height, by the side that it faces.
struct Levels {
    /// Height of the lower end of the first bin.
    lo: f32,
    up: Areas,
    down: Areas,
    /// Up and down together.
    any: Areas,
}

impl Levels {
    fn new(triangles: impl Iterator<Item = [Vec3; 3]> + Clone) -> Self {
        let heights = triangles.clone().flatten().map(|p| p.z).filter(|z| z.is_finite());
        let (lo, hi) = heights.fold((f32::INFINITY, f32::NEG_INFINITY), |(lo, hi), z| (lo.min(z), hi.max(z)));
        let none = Areas(vec![0.0; ((hi - lo) / LEVEL_BIN).clamp(0.0, MAX_BINS) as usize + 1]);
        let mut levels = Self { lo, up: none.clone(), down: none.clone(), any: none };
        for corners in triangles {
            let normal = cross(corners);
            if !(normal.is_finite() && normal.z.abs() > HORIZONTAL * normal.length()) {
                continue;
            }
            // A sloped ceiling is spread over its heights.
            let [a, b, c] = corners.map(|p| p.z);
            let (from, to) = (a.min(b).min(c), a.max(b).max(c));
            let bins = levels.bin(from)..levels.bin(to) + 1;
            let share = normal.length() / 2.0 / bins.len() as f32;
            let side = if normal.z > 0.0 { &mut levels.up } else { &mut levels.down };
            for areas in [side, &mut levels.any] {
                areas.0[bins.clone()].iter_mut().for_each(|area| *area += share);
            }
        }
        levels
    }

    fn count(&self) -> usize {
        self.any.0.len()
    }

    fn bin(&self, z: f32) -> usize {
        (((z - self.lo) / LEVEL_BIN).max(0.0) as usize).min(self.count() - 1)
    }

    fn height(&self, bin: usize) -> f32 {
        self.lo + bin as f32 * LEVEL_BIN
    }

    /// Indices of the lowest camera of each storey.
    fn starts(&self, eyes: &[f32]) -> Vec<usize> {
        let enough = FLOOR_SHARE * self.any.most(0..self.count());
        let mut starts = vec![0];
        let mut floor = self.floor(0..self.bin(eyes[0])).unwrap_or(0);
        for i in 1..eyes.len() {
            let above = self.bin(eyes[i - 1]).max(floor + (STOREY / LEVEL_BIN) as usize);
            if let Some(next) = self.floor(above..self.bin(eyes[i])).filter(|&level| self.any.at(level) >= enough) {
                starts.push(i);
                floor = next;
            }
        }
        starts
    }

    /// The storeys of cameras at `eyes`, in groups that begin at `starts`.
    fn storeys(&self, eyes: &[f32], starts: &[usize]) -> Vec<Storey> {
        let group = |k: usize| starts[k]..starts.get(k + 1).copied().unwrap_or(eyes.len());
        let eye = |k: usize| self.bin(eyes[(group(k).start + group(k).end) / 2]);
        let floors: Vec<usize> = (0..starts.len())
            .map(|k| self.floor(starts[k].checked_sub(1).map_or(0, |below| self.bin(eyes[below]))..eye(k)).unwrap_or(0))
            .collect();
        let storey = |k: usize| {
            let next = floors.get(k + 1).copied().or_else(|| self.floor_above(eye(k), floors[k]));
            let ceiling = self.top(eye(k)..next.map_or(self.count(), |next| self.under(eye(k), next)));
            let floor = self.height(floors[k]);
            Storey { floor, top: (self.height(ceiling) + LEVEL_BIN).max(floor + LEVEL_BIN) }
        };
        (0..starts.len()).map(storey).collect()
    }

    /// The highest main level: under it lies another storey's, perhaps, or a hollow.
    fn floor(&self, bins: Range<usize>) -> Option<usize> {
        let areas = self.facing(&self.up, &bins);
        areas.main(bins.clone(), areas.most(bins)).next_back()
    }

    /// A floor that no camera stands on, or a roof: the lowest main level above a storey, if it is told by its side.
    fn floor_above(&self, eye: usize, floor: usize) -> Option<usize> {
        let from = eye.max(floor + (STOREY / LEVEL_BIN) as usize);
        let most = self.up.most(0..self.count());
        self.up.main(from..self.count(), most).next().filter(|_| self.told(&self.down, &(eye..self.count())))
    }

    /// The end of the levels between eye height and the floor above that may be ceilings: the floor is none, unless it
    /// is the only thing there, one sheet.
    fn under(&self, eye: usize, floor: usize) -> usize {
        let clear = floor.saturating_sub(2 * UNEVEN + 1);
        if self.any.most(eye..clear) >= MAIN * self.any.most(eye..floor + 1) { clear } else { floor + 1 }
    }

    /// The highest level with a ceiling; the end of `bins` where there is none.
    fn top(&self, bins: Range<usize>) -> usize {
        let areas = &self.facing(&self.down, &bins).0;
        let stray = ABOVE_CEILING * areas.get(bins.clone()).map_or(0.0, |areas| areas.iter().sum());
        let mut above = 0.0;
        let reached = |&bin: &usize| {
            above += areas[bin];
            above > stray
        };
        bins.clone().rev().find(reached).unwrap_or(bins.end)
    }

    /// The areas of a side where that tells: see [`MAIN`].
    fn facing<'a>(&'a self, side: &'a Areas, bins: &Range<usize>) -> &'a Areas {
        if self.told(side, bins) { side } else { &self.any }
    }

    fn told(&self, side: &Areas, bins: &Range<usize>) -> bool {
        side.most(bins.clone()) >= MAIN * self.any.most(bins.clone())
    }
}

/// m² per bin.
#[derive(Clone)]
struct Areas(Vec<f32>);

impl Areas {
    /// The area of an uneven level, m².
    fn at(&self, level: usize) -> f32 {
        self.around(level).map(|bin| self.0[bin]).sum()
    }

    /// The bins that an uneven level reaches over.
    fn around(&self, level: usize) -> Range<usize> {
        level.saturating_sub(UNEVEN)..(level + UNEVEN + 1).min(self.0.len())
    }

    /// The area of the largest level.
    fn most(&self, bins: Range<usize>) -> f32 {
        bins.map(|bin| self.at(bin)).fold(0.0, f32::max)
    }

    /// The levels that are main where the largest has the area `most`, each at the bin with most of it.
    fn main(&self, bins: Range<usize>, most: f32) -> impl DoubleEndedIterator<Item = usize> {
        let peak = |level: usize| self.around(level).max_by(|&a, &b| self.0[a].total_cmp(&self.0[b])).unwrap_or(level);
        bins.filter(move |&bin| most > 0.0 && self.at(bin) >= MAIN * most).map(peak)
    }
}
