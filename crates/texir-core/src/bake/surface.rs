//! The texels of a bake by where they are in space.

use super::blocks::{self, Block, Blocks};
use super::texels::Texels;
use crate::checkpoint::Checkpoints;
use crate::error::Result;
use crate::mesh::Mesh;
use crate::progress::{Progress, Task};
use crate::surface::SurfacePoint;

/// What blocks hold around their texels, as a multiple of how far neighbours reach: coordinates are rounded.
const SLACK: f32 = 1.06;

/// Texels, and the blocks of space that they are in.
pub(super) struct Surface<'a> {
    pub texels: &'a Texels<'a>,
    blocks: Blocks,
    /// Edge of a typical texel, metres.
    pub texel: f32,
}

impl<'a> Surface<'a> {
    /// Of neighbours that reach `reach` texels.
    pub fn new(texels: &'a Texels<'a>, mesh: &Mesh, reach: f32) -> Result<Self> {
        let texel = texels.typical(mesh)?;
        let blocks = Blocks::new(&texels.points, SLACK * reach * texel, &texels.workspace)?;
        Ok(Self { texels, blocks, texel })
    }

    /// Goes through the blocks: their numbers, and their texels with the points of these.
    pub fn each(
        &self,
        task: &str,
        progress: &dyn Progress,
        mut act: impl FnMut(usize, &Block, &[SurfacePoint]) -> Result<()>,
    ) -> Result<()> {
        let _task = Task::start(progress, task, self.texels.valid() as u64, "texels");
        for k in 0..self.blocks.len() {
            progress.check()?;
            let block = self.blocks.block(k)?;
            let points = self.texels.points.get(&block.items)?;
            act(k, &block, &points)?;
            progress.advance(points.iter().filter(|point| block.owns(point)).count() as u64);
        }
        Ok(())
    }

    /// Where results by block are kept: nowhere if there is but one, after which all is done.
    pub fn kept(&self, checkpoints: &Checkpoints) -> Checkpoints {
        match self.blocks.len() {
            1 => Checkpoints::none(),
            // Other blocks for another budget.
            _ => checkpoints.within(&format!("blocks-of-{}", blocks::most(&self.texels.workspace))),
        }
    }
}
