//! Host side of `group_loss.wgsl`.

use bytemuck::{Pod, Zeroable};
use texir_core::backend::{GroupTarget, Groups, Loss};
use texir_core::cpu;
use texir_core::error::Result;

use crate::batch::Context;
use crate::cache::Cache;

/// Members of a group at most on a software driver, which silently ends a thread after 65,535 iterations of all its
/// loops: 256 threads go through a group seven times.
const MOST_MEMBERS: u32 = 2_000_000;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct GroupLossParams {
    pub channels: u32,
    pub quantile: f32,
    pub jobs: u32,
    pub share: f32,
}

/// See [`texir_core::backend::Backend::group_loss`]. Groups are fixed for a whole fit: `cache` keeps their arrays.
pub(crate) fn run(
    ctx: &mut Context,
    cache: &mut Cache<u32>,
    values: &[f32],
    channels: usize,
    groups: &Groups,
    target: GroupTarget,
) -> Result<Loss<f32>> {
    let largest = groups.offsets.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0);
    if ctx.gpu.is_software() && largest > MOST_MEMBERS {
        let mut gradient = vec![0.0; values.len()];
        let value = cpu::group_loss::group_loss(values, channels, groups, target, &mut gradient);
        return Ok(Loss { value, gradient });
    }
    let jobs = groups.references.len() * channels;
    let (entry, quantile) = match target {
        GroupTarget::Mean => ("mean_target", 0.0),
        GroupTarget::Quantile(q) => ("quantile_target", q),
    };
    let kernel = ctx.kernel("group_loss", entry, None)?;
    let share = 1.0 / (groups.members.len() * channels).max(1) as f32;
    let params = ctx.params(&GroupLossParams { channels: channels as u32, quantile, jobs: jobs as u32, share });
    let (pool, gpu) = (&mut ctx.pool, &ctx.gpu);
    let offsets = cache.get(gpu, "group offsets", &groups.offsets)?;
    let members = cache.get(gpu, "group members", &groups.members)?;
    let references = cache.get(gpu, "group references", &groups.references)?;
    let gradient = pool.reserve(gpu, "d_values", size_of_val(values) as u64)?;
    let count = values.len();
    let values = pool.upload(gpu, "values", values)?;
    let losses = pool.reserve(gpu, "losses", (jobs * size_of::<f32>()) as u64)?;
    // Pixels of no group, and references, get no gradient.
    gradient.clear(gpu);
    let bound = kernel.bind(
        gpu.device(),
        &[
            ("params", params.binding()),
            ("offsets", offsets.binding()),
            ("members", members.binding()),
            ("references", references.binding()),
            ("values", values.binding()),
            ("d_values", gradient.binding()),
            ("losses", losses.binding()),
        ],
    )?;
    ctx.submit(|pass| kernel.record(pass, &bound, jobs))?;
    let value: f64 = ctx.pool.download::<f32>(&ctx.gpu, &losses, jobs)?.into_iter().map(f64::from).sum();
    Ok(Loss { value: value as f32, gradient: ctx.pool.download(&ctx.gpu, &gradient, count)? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::Gpu;
    use crate::scene::{BvhStorage, SceneOpacity};

    #[test]
    fn groups_stay_on_the_device() {
        let gpu = Gpu::headless(std::env::var("TEXIR_ADAPTER").ok().as_deref()).unwrap();
        let (mut ctx, mut cache) = (Context::new(gpu, BvhStorage::Buffers, SceneOpacity::Opaque), Cache::default());
        let groups =
            |members: [u32; 3]| Groups { offsets: vec![0, 2, 3], members: members.to_vec(), references: vec![1, 0] };
        let mut loss = |groups: &Groups, kept: usize| {
            let loss = run(&mut ctx, &mut cache, &[1.0, 3.0, 7.0], 1, groups, GroupTarget::Mean).unwrap();
            assert_eq!(cache.len(), kept);
            loss
        };
        let first = loss(&groups([0, 1, 2]), 3);
        assert_eq!(loss(&groups([0, 1, 2]), 3), first);
        assert_ne!(loss(&groups([0, 2, 1]), 4), first, "other members");
    }
}
