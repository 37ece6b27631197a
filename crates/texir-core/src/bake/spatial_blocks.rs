//! The texels of a bake by where they are in space, and by how large they are.

use std::borrow::Cow;

use super::blocks::{self, Block, Blocks};
use super::texels::Texels;
use crate::atlas::texel_area;
use crate::checkpoint::Checkpoints;
use crate::error::Result;
use crate::mesh::Mesh;
use crate::progress::{Progress, Task};
use crate::surface::SurfacePoint;

/// What blocks hold around their texels, as a multiple of how far neighbours reach: coordinates are rounded.
const SLACK: f32 = 1.06;
/// Texels of one size class differ in their edges by this factor: sixteen times as many lie around a small one as
/// around a large one, at most.
const SPREAD: f32 = 4.0;
/// Size classes at most: the last has all that are smaller.
const SIZE_CLASSES: u32 = 8;

/// Texels, and the blocks of space that they are in.
pub(super) struct SpatialBlocks<'a> {
    pub texels: &'a Texels<'a>,
    mesh: &'a Mesh,
    blocks: Blocks,
    /// Edge of a typical texel, metres.
    pub texel: f32,
}

/// A block's texels of similar size. Neighbourhood radii are multiples of it: in multiples of the map's median texel,
/// all texels of a small, finely mapped object would be neighbours of each other.
pub(super) struct SizeClass {
    /// Edge of a typical one, metres.
    pub texel: f32,
    /// Their places in the block; none where all of its texels are alike.
    among: Option<Vec<usize>>,
}

impl SizeClass {
    /// Of values for the texels of the block, theirs.
    pub fn gather<'v, T: Copy>(&self, values: &'v [T]) -> Cow<'v, [T]> {
        match &self.among {
            None => Cow::Borrowed(values),
            Some(among) => among.iter().map(|&i| values[i]).collect::<Vec<_>>().into(),
        }
    }

    /// Puts their values where they belong among those of the block.
    pub fn scatter<T>(&self, values: Vec<T>, all: &mut Vec<T>) {
        match &self.among {
            None => *all = values,
            Some(among) => among.iter().zip(values).for_each(|(&i, value)| all[i] = value),
        }
    }
}

impl<'a> SpatialBlocks<'a> {
    /// Of neighbours that reach `reach` texels.
    pub fn new(texels: &'a Texels<'a>, mesh: &'a Mesh, reach: f32) -> Result<Self> {
        let texel = texels.typical(mesh)?;
        let blocks = Blocks::new(&texels.points, SLACK * reach * texel, &texels.workspace)?;
        Ok(Self { texels, mesh, blocks, texel })
    }

    /// The texels with these points by their size. Those that are larger than the typical one, or have up to a quarter
    /// of its edge, are of one class; beyond that, there is one for every factor of four.
    pub fn size_classes(&self, points: &[SurfacePoint]) -> Vec<SizeClass> {
        let class = |point: &SurfacePoint| {
            let edge = texel_area(self.mesh, self.texels.size(), point.triangle).sqrt();
            // Texels without a size are beside nothing, in whichever class.
            if edge > 0.0 { (self.texel / edge).log(SPREAD).clamp(0.0, (SIZE_CLASSES - 1) as f32) as u32 } else { 0 }
        };
        let classes: Vec<u32> = points.iter().map(class).collect();
        let typical = |class: u32| match class {
            0 => self.texel,
            // In the middle of the edges that are its.
            _ => self.texel / SPREAD.powi(class as i32) / SPREAD.sqrt(),
        };
        let of_class = |class: u32| {
            let among: Vec<usize> = (0..points.len()).filter(|&i| classes[i] == class).collect();
            let all = among.len() == points.len();
            (!among.is_empty()).then(|| SizeClass { texel: typical(class), among: (!all).then_some(among) })
        };
        (0..SIZE_CLASSES).filter_map(of_class).collect()
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
