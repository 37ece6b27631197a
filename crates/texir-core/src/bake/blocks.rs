//! Blocks of space that hold as many texels as are worked on at a time, for what looks at neighbours on the surface.
//!
//! A block has the texels that lie in it, its own, and those around it that theirs depend on. As a texel's neighbours
//! are gone through by their place in space and then in atlas order ([`crate::neighbours`]), its own come out alike in
//! any block.

use std::collections::HashMap;

use glam::{IVec3, Vec3};

use super::memory::too_dense;
use super::store::{Items, Store, Workspace};
use super::texels::PIECE;
use crate::error::Result;
use crate::neighbours::cell_of;
use crate::surface::SurfacePoint;

/// Edge of the cells that space is cut along, as a multiple of how far neighbours reach.
const CELL: f32 = 4.0;

/// Points of a block, where there is memory for more: some seconds' work on a processor, and arrays that any device
/// binds.
const MOST: usize = 1 << 20;

/// A partition of the texels.
pub(super) struct Blocks {
    /// Edge of the cells, metres.
    edge: f32,
    /// One block of all texels, where it is empty.
    regions: Vec<Region>,
    /// Texels, block by block, each ascending.
    members: Store<'static, u32>,
    /// How many texels there are.
    all: usize,
}

/// A box of cells, with what is around it.
struct Region {
    /// The first and the last cell.
    cells: [IVec3; 2],
    /// Where its texels begin in `members`, and how many there are.
    start: usize,
    len: usize,
}

/// One block's texels.
pub(super) struct Block {
    /// Its own and those around.
    pub items: Items,
    /// Its first and its last cell, and their edge; without, all texels are its own.
    cells: Option<([IVec3; 2], f32)>,
}

impl Block {
    /// Whether a texel of the block is its own.
    pub fn owns(&self, point: &SurfacePoint) -> bool {
        self.cells.is_none_or(|(cells, edge)| contains(cells, cell_of(point.position.into(), edge)))
    }
}

impl Blocks {
    /// Cuts space so that no block has more texels than the workspace allows, those within `reach` metres around it
    /// included.
    pub fn new(points: &Store<'_, SurfacePoint>, reach: f32, workspace: &Workspace) -> Result<Self> {
        let (all, most, edge) = (points.len(), most(workspace), CELL * reach);
        if all <= most {
            return Ok(Self { edge, regions: Vec::new(), members: Workspace::Memory.empty()?, all });
        }
        let mut counts: HashMap<IVec3, usize> = HashMap::new();
        for points in points.pieces(PIECE) {
            points?.iter().for_each(|p| *counts.entry(cell_of(p.position.into(), edge)).or_default() += 1);
        }
        let mut regions = Vec::new();
        let cells = counts.iter().map(|(cell, count)| (*cell, *count)).collect();
        cut(cells, &counts, [most, workspace.points()], &mut regions)?;
        // By cell, the blocks that may have texels of it.
        let mut near: HashMap<IVec3, Vec<usize>> = HashMap::new();
        for &cell in counts.keys() {
            let around = |region: &Region| contains([region.cells[0] - 1, region.cells[1] + 1], cell);
            near.insert(cell, (0..regions.len()).filter(|&k| around(&regions[k])).collect());
        }
        let room = regions.iter_mut().fold(0, |start, region| {
            region.start = start;
            start + std::mem::take(&mut region.len)
        });
        let mut members = workspace.zeroed::<u32>(room)?;
        let mut first = 0;
        for points in points.pieces(PIECE) {
            let points = points?;
            let mut found: Vec<Vec<u32>> = vec![Vec::new(); regions.len()];
            for (point, i) in points.iter().zip(first..) {
                let position = Vec3::from(point.position);
                let cell = cell_of(position, edge);
                let near = &near[&cell];
                let within = |k: &usize| near.len() == 1 || regions[*k].reaches(position, cell, reach, edge);
                near.iter().filter(|k| within(k)).for_each(|&k| found[k].push(i));
            }
            for (region, found) in regions.iter_mut().zip(found).filter(|(_, found)| !found.is_empty()) {
                let end = region.start + region.len;
                members.set(&Items::Range(end..end + found.len()), &found)?;
                region.len += found.len();
            }
            first += points.len() as u32;
        }
        Ok(Self { edge, regions, members, all })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.regions.len().max(1)
    }

    /// One of them.
    pub fn block(&self, k: usize) -> Result<Block> {
        let Some(region) = self.regions.get(k) else {
            return Ok(Block { items: Items::Range(0..self.all), cells: None });
        };
        let members = self.members.get(&Items::Range(region.start..region.start + region.len))?;
        Ok(Block { items: Items::Listed(members.into_owned()), cells: Some((region.cells, self.edge)) })
    }
}

impl Region {
    /// Whether a place is in the box, by its cell, or within `reach` of it.
    fn reaches(&self, position: Vec3, cell: IVec3, reach: f32, edge: f32) -> bool {
        let [low, high] = [self.cells[0].as_vec3() * edge, (self.cells[1] + 1).as_vec3() * edge];
        contains(self.cells, cell) || (position - position.clamp(low, high)).abs().max_element() <= reach
    }
}

/// Points that a block should have at most.
pub(super) fn most(workspace: &Workspace) -> usize {
    workspace.points().min(MOST)
}

/// Cuts the box of some cells, with their numbers of texels, in two until all that is in it or in a cell around is at
/// most `most`, or as far as it can be cut if that is within what is `allowed`. For now a region's `len` is that
/// number: no block will have more.
fn cut(
    mut cells: Vec<(IVec3, usize)>,
    counts: &HashMap<IVec3, usize>,
    [most, allowed]: [usize; 2],
    regions: &mut Vec<Region>,
) -> Result<()> {
    let bounds = cells.iter().fold([IVec3::MAX, IVec3::MIN], |[low, high], (c, _)| [low.min(*c), high.max(*c)]);
    let around = [bounds[0] - 1, bounds[1] + 1];
    let len = counts.iter().filter(|(cell, _)| contains(around, **cell)).map(|(_, count)| count).sum();
    let extent = bounds[1] - bounds[0];
    let axis = (0..3).max_by_key(|&axis| extent[axis]).unwrap_or(0);
    let whole = extent[axis] == 0;
    if whole && len > allowed {
        // The most that will be asked for, so that who follows the advice is not told of the next.
        let around = |cell: &IVec3| -> usize {
            let beside = (0..27).map(|k| *cell + IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1));
            beside.filter_map(|cell| counts.get(&cell)).sum()
        };
        return Err(too_dense(counts.keys().map(around).max().unwrap_or(len), allowed));
    }
    if whole || len <= most {
        regions.push(Region { cells: bounds, start: 0, len });
        return Ok(());
    }
    cells.sort_unstable_by_key(|(cell, _)| cell[axis]);
    // In the middle of the texels, between two layers of cells.
    let half = cells.iter().map(|(_, count)| count).sum::<usize>() / 2;
    let mut before = 0;
    let middle = cells.iter().find(|(_, count)| {
        before += count;
        before > half
    });
    let middle = middle.map_or(bounds[1][axis], |(cell, _)| cell[axis]).max(bounds[0][axis] + 1);
    let upper = cells.split_off(cells.partition_point(|(cell, _)| cell[axis] < middle));
    cut(cells, counts, [most, allowed], regions)?;
    cut(upper, counts, [most, allowed], regions)
}

fn contains([low, high]: [IVec3; 2], cell: IVec3) -> bool {
    cell.cmpge(low).all() && cell.cmple(high).all()
}
