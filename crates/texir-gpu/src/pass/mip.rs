//! Host side of `mip.wgsl`.

use bytemuck::{Pod, Zeroable};
use texir_core::error::Result;
use texir_core::texture::Pyramid;

use super::WORKGROUP;
use crate::batch::Context;
use crate::buffer::View;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct MipParams {
    pub fine_offset: u32,
    pub fine_width: u32,
    pub fine_height: u32,
    pub coarse_offset: u32,
    pub coarse_width: u32,
    pub coarse_height: u32,
    pub channels: u32,
}

/// Which way through the pyramid.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Direction {
    /// Values, fine to coarse.
    Reduce,
    /// Cotangents, coarse to fine.
    ReduceVjp,
}

/// A dispatch to record: bind groups and workgroups.
pub(crate) struct Step {
    groups: Vec<wgpu::BindGroup>,
    workgroups: usize,
}

/// All levels of a pyramid in one direction, ready to be recorded.
pub(crate) struct Levels {
    kernel: std::sync::Arc<crate::kernel::Kernel>,
    steps: Vec<Step>,
}

impl Levels {
    /// Prepares the passes over `data` (`channels` interleaved numbers per pyramid texel).
    pub fn new(
        ctx: &mut Context,
        pyramid: &Pyramid,
        coverage: &View,
        data: &View,
        channels: usize,
        direction: Direction,
    ) -> Result<Self> {
        let entry = if direction == Direction::Reduce { "reduce" } else { "reduce_vjp" };
        let kernel = ctx.kernel("mip", entry, None)?;
        let mut steps = Vec::with_capacity(pyramid.levels.len());
        for pair in pyramid.levels.windows(2) {
            let (fine, coarse) = (pair[0], pair[1]);
            let params = ctx.params(&MipParams {
                fine_offset: fine.offset as u32,
                fine_width: fine.width as u32,
                fine_height: fine.height as u32,
                coarse_offset: coarse.offset as u32,
                coarse_width: coarse.width as u32,
                coarse_height: coarse.height as u32,
                channels: channels as u32,
            });
            let groups = kernel.bind(
                ctx.gpu.device(),
                &[("params", params.binding()), ("coverage", coverage.binding()), ("pyramid", data.binding())],
            )?;
            let workgroups = (coarse.width * coarse.height * channels).div_ceil(WORKGROUP);
            steps.push(Step { groups, workgroups });
        }
        if direction == Direction::ReduceVjp {
            steps.reverse();
        }
        Ok(Self { kernel, steps })
    }

    /// Records every level, one dispatch each.
    pub fn record(&self, pass: &mut wgpu::ComputePass) {
        for step in &self.steps {
            self.kernel.record(pass, &step.groups, step.workgroups);
        }
    }
}
