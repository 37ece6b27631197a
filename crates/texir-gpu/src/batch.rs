//! Work in pieces that take about a tenth of a second each, whatever the device: a longer dispatch freezes a desktop, and
//! its driver ends it after a few seconds. Between pieces, progress is reported and cancellation honoured. How work is
//! cut never changes a result, as every item's samples depend on the item alone.

use std::ops::Range;
use std::time::{Duration, Instant};

use texir_core::error::{Error, Result};
use texir_core::progress::Progress;

use crate::buffer::{Pool, View, uniform};
use crate::gpu::Gpu;
use crate::kernel::{Kernel, Kernels, Spec};
use crate::pass::WORKGROUP;
use crate::scene::Hierarchy;
use crate::wgsl::{RoughnessVariant, Variant};

/// How long a dispatch should take.
const TARGET: Duration = Duration::from_millis(100);

/// Rays of the first dispatch, before anything was measured: well below a second on a slow processor.
const FIRST_RAYS: f64 = 262_144.0;

/// Rays that any dispatch may hold, however slow the last one was.
const FEWEST_RAYS: f64 = 1024.0;

/// How much more than the last dispatch one may hold: an estimate from a tiny one is a guess.
const GROWTH: f64 = 8.0;

/// Bytes per item of the largest array that passes with one ray per item upload.
const ITEM_BYTES: usize = 64;

/// Memory of a batch's largest array.
const BATCH_BYTES: usize = 64 << 20;

/// How samples are dealt to threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GatherShape {
    /// Threads that share an item: a power of two, at most 64.
    pub lanes: u32,
    /// Rays that a thread traces in one dispatch. At most 64: software drivers silently end a thread after 65,535 loop
    /// iterations, of which a ray takes a few hundred.
    pub rays: u32,
}

impl GatherShape {
    /// The shape for a number of samples: as many threads as there is work for.
    pub const fn for_samples(samples: u32) -> Self {
        let lanes = if samples >= 64 { 64 } else { samples.next_power_of_two() };
        Self { lanes, rays: 32 }
    }

    /// Threads of a workgroup over threads of an item.
    pub(crate) fn items_per_workgroup(self) -> usize {
        WORKGROUP / self.lanes as usize
    }

    /// Checks the bounds of the fields.
    pub(crate) fn check(self) -> Result<Self> {
        if self.lanes.is_power_of_two() && self.lanes <= 64 && (1..=64).contains(&self.rays) {
            return Ok(self);
        }
        Err(Error::invalid(format!(
            "gather shape {self:?}: lanes must be a power of two up to 64, and rays between 1 and 64"
        )))
    }
}

/// How many rays the next dispatch may hold.
struct Pace(f64);

impl Pace {
    /// Learns from a dispatch of so many rays that took so long.
    fn learn(&mut self, rays: u64, seconds: f64) {
        let rays = rays.max(1) as f64;
        let on_target = rays * TARGET.as_secs_f64() / seconds.max(1e-6);
        self.0 = on_target.min(self.0.max(rays) * GROWTH).max(FEWEST_RAYS);
    }

    /// How many items of `cost` rays and `bytes` each that is.
    fn items(&self, cost: u32, bytes: usize) -> usize {
        let items = (self.0 / f64::from(cost.max(1))) as usize;
        items.clamp(1, BATCH_BYTES / bytes)
    }
}

/// What every pass works with.
pub(crate) struct Context {
    pub gpu: Gpu,
    pub pool: Pool,
    pub kernels: Kernels,
    hierarchy: Hierarchy,
    pace: Pace,
}

impl Context {
    pub fn new(gpu: Gpu, hierarchy: Hierarchy) -> Self {
        Self { gpu, hierarchy, pool: Pool::default(), kernels: Kernels::default(), pace: Pace(FIRST_RAYS) }
    }

    /// The kernel `shader`/`entry`, with the modules that suit the adapter.
    pub fn kernel(
        &mut self,
        shader: &'static str,
        entry: &'static str,
        constant: Option<(&'static str, u32)>,
    ) -> Result<std::sync::Arc<Kernel>> {
        self.kernel_with(shader, entry, constant, RoughnessVariant::Exact)
    }

    /// [`Context::kernel`] with a choice of roughness derivative.
    pub fn kernel_with(
        &mut self,
        shader: &'static str,
        entry: &'static str,
        constant: Option<(&'static str, u32)>,
        roughness: RoughnessVariant,
    ) -> Result<std::sync::Arc<Kernel>> {
        let variant = Variant { fetch_texture: self.hierarchy == Hierarchy::Textures, roughness };
        self.kernels.get(&self.gpu, Spec { shader, entry, variant, constant })
    }

    /// Records a compute pass, submits it and waits.
    pub fn submit(&self, record: impl FnOnce(&mut wgpu::ComputePass)) -> Result<()> {
        let mut encoder = self.gpu.device().create_command_encoder(&Default::default());
        record(&mut encoder.begin_compute_pass(&Default::default()));
        let submission = self.gpu.queue().submit([encoder.finish()]);
        self.gpu.wait(submission)
    }

    /// [`Context::submit`] of `rays` rays; the size of the next dispatch follows from the time that it took.
    pub fn submit_rays(&mut self, rays: u64, record: impl FnOnce(&mut wgpu::ComputePass)) -> Result<()> {
        let start = Instant::now();
        self.submit(record)?;
        self.pace.learn(rays, start.elapsed().as_secs_f64());
        Ok(())
    }

    /// How many items of `cost` rays and `bytes` each go into the next dispatch.
    pub fn batch(&self, cost: u32, bytes: usize) -> usize {
        self.pace.items(cost, bytes)
    }

    /// Runs a pass with one ray per item over `items` items: `dispatch` handles one range of them.
    pub fn one_ray_each(
        &mut self,
        items: usize,
        mut dispatch: impl FnMut(&mut Self, Range<usize>) -> Result<()>,
    ) -> Result<()> {
        let mut first = 0;
        while first < items {
            let end = items.min(first + self.batch(1, ITEM_BYTES));
            dispatch(self, first..end)?;
            first = end;
        }
        Ok(())
    }

    /// Runs a pass whose threads share an item's samples: `samples` of each technique in turn.
    pub fn gather<G: Gathering, const TECHNIQUES: usize>(
        &mut self,
        items: usize,
        samples: [u32; TECHNIQUES],
        shape: GatherShape,
        progress: &dyn Progress,
        steps: &mut G,
    ) -> Result<()> {
        let span = shape.lanes * shape.rays;
        let longest = samples.into_iter().max().unwrap_or(0).min(span);
        let mut first = 0;
        while first < items {
            let end = items.min(first + self.batch(longest, G::ITEM_BYTES));
            let batch = steps.upload(self, first..end)?;
            for (technique, samples) in samples.into_iter().enumerate() {
                for sample in (0..samples).step_by(span as usize) {
                    progress.check()?;
                    let range = sample..samples.min(sample.saturating_add(span));
                    let rays = (end - first) as u64 * range.len() as u64;
                    steps.dispatch(self, &batch, technique, first..end, range)?;
                    progress.advance(rays);
                }
            }
            steps.collect(self, batch, end - first)?;
            first = end;
        }
        Ok(())
    }

    /// A uniform buffer.
    pub fn params<T: bytemuck::Pod>(&self, value: &T) -> View {
        uniform(&self.gpu, value)
    }
}

/// The steps of a pass that [`Context::gather`] runs.
pub(crate) trait Gathering {
    /// Bytes per item of a batch's largest array, for the bound on a batch's memory.
    const ITEM_BYTES: usize;
    /// What a batch holds on the device.
    type Batch;
    /// Uploads a range of items.
    fn upload(&mut self, ctx: &mut Context, items: Range<usize>) -> Result<Self::Batch>;
    /// Adds a range of a technique's samples to a batch's sums, and finishes them with the last.
    fn dispatch(
        &mut self,
        ctx: &mut Context,
        batch: &Self::Batch,
        technique: usize,
        items: Range<usize>,
        samples: Range<u32>,
    ) -> Result<()>;
    /// Fetches the results of a batch of `count` items.
    fn collect(&mut self, ctx: &mut Context, batch: Self::Batch, count: usize) -> Result<()>;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds that dispatches of 32-ray items take on a device of so many rays per second, which `speed` gives by dispatch.
    fn durations(dispatches: usize, speed: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut pace = Pace(FIRST_RAYS);
        let take = |number| {
            let rays = 32 * pace.items(32, ITEM_BYTES) as u64;
            let seconds = rays as f64 / speed(number);
            pace.learn(rays, seconds);
            seconds
        };
        (0..dispatches).map(take).collect()
    }

    #[test]
    fn dispatches_take_a_tenth_of_a_second_on_any_device() {
        for speed in [1e5, 1e6, 1e7, 1e8] {
            let durations = durations(12, |_| speed);
            // The first is a guess that even a tenth of two processor cores' speed keeps within seconds.
            assert!(durations[0] < 2.7, "{speed} rays/s: {durations:?}");
            assert!(durations[1..].iter().all(|s| *s <= 0.1001), "{speed} rays/s: {durations:?}");
            assert!(durations[11] > 0.09, "{speed} rays/s: {durations:?}");
        }
        // What memory bounds stays below.
        assert!(durations(12, |_| 1e10)[1..].iter().all(|s| *s <= 0.1001));
    }

    #[test]
    fn a_device_that_becomes_slow_exceeds_its_time_once() {
        let durations = durations(12, |number| if number < 6 { 1e7 } else { 1e6 });
        assert!((durations[6] - 1.0).abs() < 0.05, "{durations:?}");
        assert!(durations[7..].iter().all(|s| *s <= 0.1001), "{durations:?}");
    }
}
