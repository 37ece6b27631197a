//! Work in pieces that take about a tenth of a second each, or as long as the host program grants, whatever the device:
//! a longer dispatch freezes a desktop, and its driver ends it after a few seconds. Between pieces, progress is reported
//! and cancellation honoured. How work is cut never changes a result, as every item's samples depend on the item alone.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use texir_core::backend::RoughnessGradient;
use texir_core::error::{Error, Result};
use texir_core::progress::Progress;

use crate::buffer::{Pool, View, uniform};
use crate::gpu::Gpu;
use crate::kernel::{Kernel, KernelKey};
use crate::pass::WORKGROUP;
use crate::scene::{BvhStorage, SceneOpacity};
use crate::wgsl::Variant;

/// How long a dispatch should take where nobody says otherwise.
const USUAL_TIME: Duration = Duration::from_millis(100);

/// How long one may be made to take: drivers end it after two seconds.
const LONGEST_TIME: Duration = Duration::from_secs(1);

/// Rays of the first dispatch, before anything was measured, where it has the usual time: well below a second on a slow
/// processor.
const FIRST_RAYS: f64 = 262_144.0;

/// Rays that any dispatch may hold, however slow the last one was.
const FEWEST_RAYS: f64 = 1024.0;

/// How much more than the last dispatch one may hold: an estimate from a tiny one is a guess.
const GROWTH: f64 = 8.0;

/// Bytes per item of the largest array that passes with one ray per item upload.
const ITEM_BYTES: usize = 64;

/// Memory of a batch's largest array.
pub(crate) const BATCH_BYTES: usize = 64 << 20;

/// How samples are dealt to threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GatherShape {
    /// Threads that share an item: a power of two, at most 64, those of a workgroup.
    pub threads_per_item: u32,
    /// Rays that a thread traces in one dispatch. At most 64: software drivers silently end a thread after 65,535 loop
    /// iterations, of which a ray takes a few hundred.
    pub rays_per_thread: u32,
}

impl GatherShape {
    const MOST_THREADS: u32 = WORKGROUP as u32;

    /// The shape for a number of samples: as many threads as there is work for.
    pub const fn for_samples(samples: u32) -> Self {
        let threads_per_item =
            if samples >= Self::MOST_THREADS { Self::MOST_THREADS } else { samples.next_power_of_two() };
        Self { threads_per_item, rays_per_thread: 32 }
    }

    /// Threads of a workgroup over threads of an item.
    pub(crate) fn items_per_workgroup(self) -> usize {
        WORKGROUP / self.threads_per_item as usize
    }

    /// Checks the bounds of the fields.
    pub(crate) fn check(self) -> Result<Self> {
        if self.threads_per_item.is_power_of_two()
            && self.threads_per_item <= Self::MOST_THREADS
            && (1..=64).contains(&self.rays_per_thread)
        {
            return Ok(self);
        }
        Err(Error::invalid(format!(
            "gather shape {self:?}: threads_per_item must be a power of two up to {}, and rays_per_thread between 1 and 64",
            Self::MOST_THREADS
        )))
    }
}

/// How many rays the next dispatch of a kernel may hold. Kernels do not share it: a ray that ends where it starts, as
/// most of a projection's do, says nothing about one through the whole scene.
#[derive(Clone, Copy)]
struct DispatchBudget(f64);

impl DispatchBudget {
    /// Before anything was measured.
    fn first(target: Duration) -> Self {
        Self((FIRST_RAYS * target.as_secs_f64() / USUAL_TIME.as_secs_f64()).max(FEWEST_RAYS))
    }

    /// Learns from a dispatch of so many rays that took so long, and should take `target`.
    fn learn(&mut self, rays: u64, seconds: f64, target: Duration) {
        let rays = rays.max(1) as f64;
        let on_target = rays * target.as_secs_f64() / seconds.max(1e-6);
        self.0 = on_target.min(self.0.max(rays) * GROWTH).max(FEWEST_RAYS);
    }

    /// How many items of `cost` rays each that is.
    fn items(&self, cost: u64) -> usize {
        (self.0 / cost.max(1) as f64).max(1.0) as usize
    }

    /// How many of the next items that is, at least one, and the rays of all these: `costs` are those of each.
    fn items_of(&self, costs: impl IntoIterator<Item = u64>) -> (usize, u64) {
        let (mut items, mut rays) = (0, 0);
        for cost in costs {
            if items > 0 && (rays + cost) as f64 > self.0 {
                break;
            }
            (items, rays) = (items + 1, rays + cost);
        }
        (items, rays)
    }
}

/// What every pass works with.
pub(crate) struct Context {
    pub gpu: Gpu,
    pub pool: Pool,
    hierarchy: BvhStorage,
    opacity: SceneOpacity,
    budgets: HashMap<KernelKey, DispatchBudget>,
    /// How long a dispatch should take.
    target: Duration,
}

impl Context {
    /// Of a scene that lies there, and of which rays meet this.
    pub fn new(gpu: Gpu, hierarchy: BvhStorage, opacity: SceneOpacity) -> Self {
        Self { gpu, hierarchy, opacity, pool: Pool::default(), budgets: HashMap::new(), target: USUAL_TIME }
    }

    /// Sets how long a dispatch should take.
    pub fn set_dispatch_time(&mut self, target: Duration) -> Result<()> {
        if target.is_zero() || target > LONGEST_TIME {
            return Err(Error::invalid(format!(
                "dispatches of {target:?} each; expected more than 0 and at most {LONGEST_TIME:?}"
            )));
        }
        self.target = target;
        self.budgets.clear();
        Ok(())
    }

    /// The kernel `shader`/`entry`, with the modules that suit the adapter.
    pub fn kernel(
        &mut self,
        shader: &'static str,
        entry: &'static str,
        constant: Option<(&'static str, u32)>,
    ) -> Result<Arc<Kernel>> {
        self.kernel_with(shader, entry, constant, RoughnessGradient::Exact)
    }

    /// [`Context::kernel`] with a choice of roughness derivative.
    pub fn kernel_with(
        &mut self,
        shader: &'static str,
        entry: &'static str,
        constant: Option<(&'static str, u32)>,
        roughness: RoughnessGradient,
    ) -> Result<Arc<Kernel>> {
        let variant = Variant { hierarchy: self.hierarchy, opacity: self.opacity, roughness };
        self.gpu.kernel(KernelKey { shader, entry, variant, constant })
    }

    /// Records a compute pass and submits it: whoever reads what it leaves waits. A pass that the device refuses is an
    /// error here.
    pub fn submit(&self, record: impl FnOnce(&mut wgpu::ComputePass)) -> Result<()> {
        self.gpu.with_error_scopes("a dispatch", || {
            let mut encoder = self.gpu.device().create_command_encoder(&Default::default());
            record(&mut encoder.begin_compute_pass(&Default::default()));
            self.gpu.queue().submit([encoder.finish()]);
            Ok(())
        })
    }

    /// Keeps nothing of what passes have left.
    pub fn forget(&mut self) {
        self.pool = Pool::default();
        self.budgets.clear();
    }

    /// Dispatches `workgroups` of a kernel, which trace `rays` rays, and waits; the size of its next dispatch follows
    /// from the time that it took.
    pub fn trace(&mut self, kernel: &Kernel, groups: &[wgpu::BindGroup], workgroups: usize, rays: u64) -> Result<()> {
        self.timed(kernel, rays, |pass| kernel.record(pass, groups, workgroups))
    }

    /// [`Context::trace`] of a dispatch that `record` records.
    pub fn timed(&mut self, kernel: &Kernel, rays: u64, record: impl FnOnce(&mut wgpu::ComputePass)) -> Result<()> {
        let start = Instant::now();
        self.submit(record)?;
        self.gpu.finish()?;
        let mut budget = self.budget(kernel);
        budget.learn(rays, start.elapsed().as_secs_f64(), self.target);
        self.budgets.insert(kernel.key(), budget);
        Ok(())
    }

    fn budget(&self, kernel: &Kernel) -> DispatchBudget {
        self.budgets.get(&kernel.key()).copied().unwrap_or(DispatchBudget::first(self.target))
    }

    /// How many items of `cost` rays each go into a kernel's next dispatch.
    pub fn items(&self, kernel: &Kernel, cost: u64) -> usize {
        self.budget(kernel).items(cost)
    }

    /// [`DispatchBudget::items_of`] a kernel's next dispatch.
    pub fn items_of(&self, kernel: &Kernel, costs: impl IntoIterator<Item = u64>) -> (usize, u64) {
        self.budget(kernel).items_of(costs)
    }

    /// Runs a kernel with one ray per item over `items` items: `dispatch` handles one range of them.
    pub fn one_ray_each(
        &mut self,
        kernel: &Kernel,
        items: usize,
        mut dispatch: impl FnMut(&mut Self, Range<usize>) -> Result<()>,
    ) -> Result<()> {
        let mut first = 0;
        while first < items {
            let end = items.min(first + self.items(kernel, 1).min(BATCH_BYTES / ITEM_BYTES));
            dispatch(self, first..end)?;
            first = end;
        }
        Ok(())
    }

    /// Runs a pass whose threads share an item's samples: `samples` of each technique in turn.
    pub fn gather<G: BatchedPass, const TECHNIQUES: usize>(
        &mut self,
        items: usize,
        samples: [u32; TECHNIQUES],
        shape: GatherShape,
        progress: &dyn Progress,
        steps: &mut G,
    ) -> Result<()> {
        let span = shape.threads_per_item * shape.rays_per_thread;
        let mut first = 0;
        while first < items {
            // What one dispatch of the fastest technique holds; those of slower ones, and of one that has become slow,
            // hold less of it.
            let longest = |technique: usize| u64::from(samples[technique].min(span));
            let at_once = |technique| self.items(steps.kernel(technique), longest(technique));
            let most = (0..TECHNIQUES).filter(|&t| samples[t] > 0).map(at_once).max().unwrap_or(1);
            let count = (items - first).min(most).min(BATCH_BYTES / G::ITEM_BYTES);
            let batch = steps.upload(self, first..first + count)?;
            for (technique, samples) in samples.into_iter().enumerate() {
                for sample in (0..samples).step_by(span as usize) {
                    let range = sample..samples.min(sample.saturating_add(span));
                    let mut item = 0;
                    while item < count {
                        progress.check()?;
                        let end = count.min(item + self.items(steps.kernel(technique), range.len() as u64));
                        steps.dispatch(self, &batch, technique, item..end, range.clone())?;
                        progress.advance((end - item) as u64 * range.len() as u64);
                        item = end;
                    }
                }
            }
            steps.collect(self, batch, count)?;
            first += count;
        }
        Ok(())
    }

    /// A uniform buffer.
    pub fn params<T: bytemuck::Pod>(&self, value: &T) -> View {
        uniform(&self.gpu, value)
    }
}

/// The steps of a pass that [`Context::gather`] runs.
pub(crate) trait BatchedPass {
    /// Bytes per item of a batch's largest array, for the bound on a batch's memory.
    const ITEM_BYTES: usize;
    /// What a batch holds on the device.
    type Batch;
    /// What draws a technique's samples.
    fn kernel(&self, technique: usize) -> &Kernel;
    /// Uploads a range of items.
    fn upload(&mut self, ctx: &mut Context, items: Range<usize>) -> Result<Self::Batch>;
    /// Adds a range of a technique's samples to the sums of some of a batch's items, and finishes them with the last.
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

    /// Seconds that dispatches of 32-ray items, which should take `target`, do on a device of so many rays per second,
    /// which `speed` gives by dispatch.
    fn durations(dispatches: usize, target: Duration, speed: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut pace = DispatchBudget::first(target);
        let take = |number| {
            let rays = 32 * pace.items(32) as u64;
            let seconds = rays as f64 / speed(number);
            pace.learn(rays, seconds, target);
            seconds
        };
        (0..dispatches).map(take).collect()
    }

    #[test]
    fn dispatches_take_a_tenth_of_a_second_on_any_device() {
        for speed in [1e5, 1e6, 1e7, 1e8, 1e10] {
            let durations = durations(12, USUAL_TIME, |_| speed);
            // The first is a guess that even a tenth of two processor cores' speed keeps within seconds.
            assert!(durations[0] < 2.7, "{speed} rays/s: {durations:?}");
            assert!(durations[1..].iter().all(|s| *s <= 0.1001), "{speed} rays/s: {durations:?}");
            assert!(durations[11] > 0.09, "{speed} rays/s: {durations:?}");
        }
    }

    #[test]
    fn dispatches_take_as_long_as_the_host_program_grants() {
        for speed in [1e7, 1e8, 1e10] {
            let durations = durations(12, Duration::from_millis(4), |_| speed);
            assert!(durations.iter().all(|s| *s <= 0.0041), "{speed} rays/s: {durations:?}");
            assert!(durations[11] > 0.0036, "{speed} rays/s: {durations:?}");
        }
    }

    #[test]
    fn a_dispatch_holds_items_by_what_they_cost() {
        let budget = DispatchBudget(100.0);
        assert_eq!(budget.items_of([30, 0, 70, 1, 5]), (3, 100));
        assert_eq!(budget.items_of([500, 1]), (1, 500));
        assert_eq!(budget.items_of([]), (0, 0));
    }

    #[test]
    fn a_device_that_becomes_slow_exceeds_its_time_once() {
        let durations = durations(12, USUAL_TIME, |number| if number < 6 { 1e7 } else { 1e6 });
        assert!((durations[6] - 1.0).abs() < 0.05, "{durations:?}");
        assert!(durations[7..].iter().all(|s| *s <= 0.1001), "{durations:?}");
    }
}
