//! The texels of an atlas in square blocks, each with what its pixels say: where within a segment roughness varies is
//! told block by block.

use std::collections::BTreeMap;

use super::evidence::{Evidence, Tally};
use crate::fit::index::NONE;

/// The texels of an atlas in square blocks.
pub struct BlockGrid<'a> {
    /// Columns of the atlas.
    pub width: usize,
    /// Atlas index of each texel.
    pub texels: &'a [u32],
    /// Segment of each texel.
    pub segment: &'a [u32],
    /// The flat piece of it that each texel is in.
    pub face: &'a [u32],
    /// Edge of a block, texels.
    pub block: f32,
}

/// Which block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct BlockKey {
    /// Segment, and face of it.
    pub segment: u32,
    pub face: u32,
    /// Column and row in the atlas, in blocks.
    pub column: i32,
    pub row: i32,
}

/// A block that pixels see.
#[derive(Clone)]
pub struct Block {
    /// Which.
    pub key: BlockKey,
    /// Tallies of its pixels, by half of the views.
    pub halves: [Tally; 2],
}

impl Block {
    /// The tally of all its pixels.
    pub fn all(&self) -> Tally {
        Tally::sum(self.halves.iter())
    }
}

impl BlockGrid<'_> {
    /// The blocks that pixels see, in the order of their keys. Pixels have a `dominant` texel, the one that they see
    /// most of, or [`NONE`], and belong to a `half` of the views ([`Evidence::halves`]).
    pub fn blocks(&self, evidence: &Evidence, dominant: &[u32], half: &[u8]) -> Vec<Block> {
        let mut blocks: BTreeMap<BlockKey, [Tally; 2]> = BTreeMap::new();
        for (pixel, &t) in dominant.iter().enumerate().filter(|(_, t)| **t != NONE) {
            let t = t as usize;
            let halves = blocks.entry(self.key(t, self.column_row(t))).or_default();
            halves[usize::from(half[pixel])].add(evidence, pixel);
        }
        blocks.into_iter().map(|(key, halves)| Block { key, halves }).collect()
    }

    /// The four blocks around a texel with their bilinear weights.
    pub fn between(&self, t: usize) -> [(BlockKey, f32); 4] {
        let [x, y] = self.column_row(t).map(|at| at - 0.5);
        [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(dx, dy)| {
            let (bx, by) = (x.floor() + dx, y.floor() + dy);
            let near = (1.0 - (x - bx).abs()) * (1.0 - (y - by).abs());
            (self.key(t, [bx, by]), near)
        })
    }

    /// The block of a texel's face at a column and a row.
    fn key(&self, t: usize, [column, row]: [f32; 2]) -> BlockKey {
        BlockKey { segment: self.segment[t], face: self.face[t], column: column as i32, row: row as i32 }
    }

    /// Where a texel is, in blocks.
    fn column_row(&self, t: usize) -> [f32; 2] {
        let texel = self.texels[t] as usize;
        [(texel % self.width) as f32 / self.block, (texel / self.width) as f32 / self.block]
    }
}

/// [`BlockGrid::blocks`] by all pixels, which locate the finishes, and by those that see no joints, which give their
/// roughness (where there are enough).
pub struct BlockTallies {
    pub all: Vec<Block>,
    pub without_joints: Vec<Block>,
}
