//! Free space into rooms: a watershed of the distance to the walls that breaks only where a doorway narrows it.

use std::collections::BTreeMap;

use super::RoomOptions;
use super::distance::{between, nearest};
use crate::disjoint_sets::DisjointSets;
use crate::raster::{Labels, Mask};

/// A room is wide enough for a disc of this radius, metres; the hollow inside a wall is not.
const MIN_RADIUS: f32 = 0.4;

/// Room ids of the free cells, 1 for the largest; 0 where there is none.
pub(super) fn rooms(free: &Mask, cell: f32, options: &RoomOptions) -> Labels {
    let [w, h] = free.size();
    let mut basins = Basins::flood(free, cell, options);
    basins.absorb_small(w, cell, options);
    let mut roots: Vec<u32> = basins.roots().filter(|&root| basins.is_room(root, cell, options)).collect();
    roots.sort_by_key(|&root| (std::cmp::Reverse(basins.basins[root as usize].area), root));
    let ids: BTreeMap<u32, u16> = roots.into_iter().zip(1..=u16::MAX).collect();
    let data = (0..w * h).map(|c| basins.label(c).and_then(|root| ids.get(&root).copied()).unwrap_or(0)).collect();
    Labels { width: w, height: h, data }
}

/// The cells of each 4-connected part of a mask.
pub(super) fn components(mask: &Mask) -> Vec<Vec<usize>> {
    let [w, h] = mask.size();
    let mut seen = vec![false; w * h];
    let mut parts = Vec::new();
    for start in 0..w * h {
        if !mask.data[start] || seen[start] {
            continue;
        }
        seen[start] = true;
        let mut part = vec![start];
        let mut next = 0;
        while next < part.len() {
            for n in neighbours4(part[next], w, h) {
                if mask.data[n] && !seen[n] {
                    seen[n] = true;
                    part.push(n);
                }
            }
            next += 1;
        }
        parts.push(part);
    }
    parts
}

/// The cells that share an edge with a cell.
pub(super) fn neighbours4(cell: usize, w: usize, h: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (cell % w, cell / w);
    [
        (x > 0).then(|| cell - 1),
        (x + 1 < w).then_some(cell + 1),
        (y > 0).then(|| cell - w),
        (y + 1 < h).then_some(cell + w),
    ]
    .into_iter()
    .flatten()
}

/// The cells that share an edge or a corner with a cell.
pub(super) fn neighbours8(cell: usize, w: usize, h: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (cell % w, cell / w);
    (y.saturating_sub(1)..(y + 2).min(h))
        .flat_map(move |ny| (x.saturating_sub(1)..(x + 2).min(w)).map(move |nx| ny * w + nx))
        .filter(move |&n| n != cell)
}

/// A basin of the watershed.
#[derive(Clone, Debug, Default)]
struct Basin {
    /// Distance to the walls at its deepest cell, in cells.
    peak: f32,
    /// Cells.
    area: usize,
}

/// Basins, of which some are joined.
struct Basins {
    joined: DisjointSets,
    /// A root holds what all that are joined with it are together.
    basins: Vec<Basin>,
    /// Basin of every cell, [`Basins::NONE`] outside free space.
    of_cell: Vec<u32>,
}

impl Basins {
    const NONE: u32 = u32::MAX;

    /// Floods free space from the cells furthest from the walls to the nearest. Where two basins meet, they stay apart
    /// if the passage is no wider than a doorway and narrow against the smaller one; otherwise they are one room.
    fn flood(free: &Mask, cell: f32, options: &RoomOptions) -> Self {
        let [w, h] = free.size();
        let mut flooded =
            Self { joined: DisjointSets::default(), basins: Vec::new(), of_cell: vec![Self::NONE; w * h] };
        let Some(wall) = nearest(&free.map(|f| !f)) else { return flooded };
        let depth: Vec<f32> = (0..w * h).map(|c| between(w, c, wall[c] as usize)).collect();
        let mut order: Vec<usize> = (0..w * h).filter(|&c| free.data[c]).collect();
        order.sort_unstable_by(|&a, &b| depth[b].total_cmp(&depth[a]).then(a.cmp(&b)));
        for c in order {
            let around = neighbours8(c, w, h).filter(|&n| flooded.of_cell[n] != Self::NONE);
            let Some(deepest) = around.max_by(|&a, &b| depth[a].total_cmp(&depth[b])) else {
                flooded.of_cell[c] = flooded.add(depth[c]);
                continue;
            };
            // The walls' own half cells do not belong to the passage.
            let passage = (2.0 * depth[c] - 1.0) * cell;
            for n in neighbours8(c, w, h) {
                if flooded.of_cell[n] == Self::NONE {
                    continue;
                }
                let (a, b) = (flooded.root(flooded.of_cell[deepest]), flooded.root(flooded.of_cell[n]));
                let smaller = flooded.basins[a as usize].peak.min(flooded.basins[b as usize].peak);
                let doorway = passage <= options.door_width && depth[c] <= options.constriction * smaller;
                if a != b && !doorway {
                    flooded.join(a, b);
                }
            }
            let root = flooded.root(flooded.of_cell[deepest]);
            flooded.of_cell[c] = root;
            flooded.basins[root as usize].area += 1;
        }
        flooded
    }

    /// A new basin of one cell.
    fn add(&mut self, peak: f32) -> u32 {
        self.basins.push(Basin { peak, area: 1 });
        self.joined.add()
    }

    /// The basin that `id` was joined into.
    fn root(&mut self, id: u32) -> u32 {
        self.joined.root(id)
    }

    /// The basins that were not joined into another.
    fn roots(&self) -> impl Iterator<Item = u32> {
        self.joined.roots()
    }

    /// Joins two roots that are not the same; the lower id stays.
    fn join(&mut self, a: u32, b: u32) -> u32 {
        let [keep, gone] = self.joined.join(a, b);
        let lost = std::mem::take(&mut self.basins[gone as usize]);
        let kept = &mut self.basins[keep as usize];
        kept.peak = kept.peak.max(lost.peak);
        kept.area += lost.area;
        keep
    }

    /// Whether a root is large enough for a room.
    fn is_room(&self, root: u32, cell: f32, options: &RoomOptions) -> bool {
        let Basin { peak, area } = self.basins[root as usize];
        area as f32 * cell * cell >= options.min_area && peak * cell >= MIN_RADIUS
    }

    /// Joins niches that are no rooms to the neighbour they touch most, the smallest first.
    fn absorb_small(&mut self, w: usize, cell: f32, options: &RoomOptions) {
        let mut contacts: Vec<BTreeMap<u32, usize>> = vec![BTreeMap::new(); self.basins.len()];
        for c in 0..self.of_cell.len() {
            let Some(a) = self.label(c) else { continue };
            let right = (c % w + 1 < w).then_some(c + 1);
            let below = (c + w < self.of_cell.len()).then_some(c + w);
            for n in [right, below].into_iter().flatten() {
                if let Some(b) = self.label(n).filter(|&b| b != a) {
                    *contacts[a as usize].entry(b).or_default() += 1;
                    *contacts[b as usize].entry(a).or_default() += 1;
                }
            }
        }
        let mut roots: Vec<u32> = self.roots().collect();
        roots.sort_by_key(|&root| (self.basins[root as usize].area, root));
        for start in roots {
            // Absorbing may make a room of two niches, or need another step.
            let mut root = self.root(start);
            while !self.is_room(root, cell, options) {
                let mut touched: BTreeMap<u32, usize> = BTreeMap::new();
                for (other, count) in std::mem::take(&mut contacts[root as usize]) {
                    let other = self.root(other);
                    if other != root {
                        *touched.entry(other).or_default() += count;
                    }
                }
                let Some((&most, _)) = touched.iter().max_by_key(|&(&other, &count)| (count, std::cmp::Reverse(other)))
                else {
                    break;
                };
                let joined = self.join(root, most);
                let gone = if joined == root { most } else { root };
                let mut both = std::mem::take(&mut contacts[gone as usize]);
                both.append(&mut touched);
                for (other, count) in both {
                    *contacts[joined as usize].entry(other).or_default() += count;
                }
                root = joined;
            }
        }
    }

    /// The joined basin of a cell.
    fn label(&mut self, cell: usize) -> Option<u32> {
        match self.of_cell[cell] {
            Self::NONE => None,
            id => Some(self.root(id)),
        }
    }
}
