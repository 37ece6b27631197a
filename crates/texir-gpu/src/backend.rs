//! [`Backend`] on a wgpu device.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use texir_core::backend::{
    Backend, Gather, Gathered, GroupTarget, Groups, Loss, Material, MaterialGrad, Projected, RoughnessGradient,
    Sampling, ShadePoint, Shaded, check,
};
use texir_core::camera::Camera;
use texir_core::denoise::Noisy;
use texir_core::environment::Environment;
use texir_core::error::{Error, Result};
use texir_core::lights::Lights;
use texir_core::progress::Progress;
use texir_core::punctual::PunctualLight;
use texir_core::raster::Rgb;
use texir_core::scene::Scene;
use texir_core::specular_table::{Curve, STRATA, TableSampling};
use texir_core::surface::{Hit, SurfacePoint, TexelHit};
use texir_core::texture::{Footprints, Pyramid, SparseRows};

use crate::batch::{Context, GatherShape};
use crate::cache::Cache;
use crate::gpu::Gpu;
use crate::pass::{
    denoise, group_loss, irradiance, lookup, primary, project, punctual, radiance_loss, shade, shade_vjp,
    specular_table, texels,
};
use crate::scene::{BvhStorage, EnvironmentMap, Geometry, Lighting, SceneOpacity};

/// The passes in WGSL, for one scene.
pub struct GpuBackend {
    scene: Arc<Scene>,
    context: Context,
    geometry: Geometry,
    lighting: Option<Lighting>,
    shape: Option<GatherShape>,
    cache: lookup::LookupCache,
    groups: Cache<u32>,
}

impl fmt::Debug for GpuBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { scene, context, shape, .. } = self;
        f.debug_struct("GpuBackend")
            .field("scene", scene)
            .field("gpu", &context.gpu)
            .field("shape", shape)
            .finish_non_exhaustive()
    }
}

// Bakes block, so that programs move it to a worker thread.
const _: () = {
    const fn is_sent<T: Send>() {}
    is_sent::<GpuBackend>();
};

impl GpuBackend {
    /// Uploads the scene, which others may share. The device's queue is used from the calling thread, and only during
    /// calls.
    pub fn new(gpu: &Gpu, scene: impl Into<Arc<Scene>>) -> Result<Self> {
        Self::with_bvh_storage(gpu, scene, BvhStorage::best(gpu))
    }

    /// [`GpuBackend::new`] with a choice that changes speed only, where the device takes it:
    /// [`BvhStorage::Textures`] is for software drivers, as a GPU may take small numbers read from a texture for
    /// 0, and rays then go wrong.
    pub fn with_bvh_storage(gpu: &Gpu, scene: impl Into<Arc<Scene>>, hierarchy: BvhStorage) -> Result<Self> {
        let scene = scene.into();
        let geometry = gpu.with_error_scopes("uploading the scene", || Geometry::new(gpu, &scene, hierarchy))?;
        let context = Context::new(gpu.clone(), hierarchy, SceneOpacity::of(&scene));
        let (cache, groups) = Default::default();
        Ok(Self { scene, context, geometry, lighting: None, shape: None, cache, groups })
    }

    /// Sets how samples are dealt to threads; `None` chooses by their number. Results differ only by rounding.
    pub fn set_gather_shape(&mut self, shape: Option<GatherShape>) -> Result<()> {
        self.shape = shape.map(GatherShape::check).transpose()?;
        Ok(())
    }

    /// Sets how long a dispatch of the passes that trace, search or denoise should take: a tenth of a second if nothing
    /// is set, a second at most. A host program that presents meanwhile wants milliseconds; shorter ones cost more in
    /// all. The first of each kind is a guess, by a slow processor's speed. Results do not depend on it.
    pub fn set_dispatch_time(&mut self, time: Duration) -> Result<()> {
        self.context.set_dispatch_time(time)
    }

    /// Runs a pass. After an error nothing stays that was kept for the next: buffers may have failed to be made.
    fn pass<T>(&mut self, name: &str, work: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        let gpu = self.context.gpu.clone();
        let result = gpu.with_error_scopes(name, || work(self));
        if result.is_err() {
            self.context.forget();
            (self.cache, self.groups) = Default::default();
        }
        result
    }

    fn shape_for(&self, samples: u32) -> GatherShape {
        self.shape.unwrap_or(GatherShape::for_samples(samples))
    }
}

fn lighting_of(lighting: &Option<Lighting>) -> Result<&Lighting> {
    lighting.as_ref().ok_or_else(|| Error::invalid("no lighting is set: call Backend::set_tbl first"))
}

/// Checks that items can be counted in 32 bits.
fn countable(items: usize) -> Result<()> {
    if u32::try_from(items).is_ok() {
        return Ok(());
    }
    Err(Error::invalid(format!("{items} items in one call: at most {} can be indexed", u32::MAX)))
}

impl Backend for GpuBackend {
    fn name(&self) -> String {
        self.context.gpu.describe()
    }

    fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    fn set_tbl(&mut self, radiance: &Rgb, lights: &Lights) -> Result<()> {
        check::tbl(&self.scene, radiance, lights)?;
        // Two at once may be more than there is memory for.
        self.lighting = None;
        let gpu = &self.context.gpu;
        let lighting =
            gpu.with_error_scopes("uploading the lighting", || Lighting::new(gpu, &self.scene, radiance, lights))?;
        self.lighting = Some(lighting);
        Ok(())
    }

    fn set_environment(&mut self, environment: Option<&Environment>) -> Result<()> {
        let gpu = &self.context.gpu;
        let upload =
            |environment| gpu.with_error_scopes("uploading the environment", || EnvironmentMap::new(gpu, environment));
        self.geometry.sky = upload(None)?;
        if environment.is_some() {
            self.geometry.sky = upload(environment)?;
        }
        Ok(())
    }

    fn primary(&mut self, camera: &Camera, rows: Range<usize>) -> Result<Vec<Hit>> {
        camera.check()?;
        check::rows(&rows, camera.height)?;
        self.pass("primary", |b| primary::run(&mut b.context, &b.geometry, camera, rows))
    }

    fn texels(&mut self, size: [usize; 2], rows: Range<usize>) -> Result<Vec<Option<TexelHit>>> {
        check::rows(&rows, size[1])?;
        if size[0] == 0 || rows.is_empty() {
            return Ok(Vec::new());
        }
        countable(size[0] * size[1])?;
        self.pass("texels", |b| texels::run(&mut b.context, b.scene.mesh(), size, rows))
    }

    fn irradiance(
        &mut self,
        points: &[SurfacePoint],
        gather: Gather,
        progress: &dyn Progress,
    ) -> Result<Vec<Gathered>> {
        countable(points.len())?;
        check::irradiance(points, gather)?;
        let shape = self.shape_for(gather.cosine);
        self.pass("irradiance", |b| {
            irradiance::run(&mut b.context, (&b.geometry, lighting_of(&b.lighting)?), points, gather, shape, progress)
        })
    }

    fn punctual(
        &mut self,
        points: &[SurfacePoint],
        lights: &[PunctualLight],
        progress: &dyn Progress,
    ) -> Result<Vec<[f32; 3]>> {
        countable(points.len())?;
        check::punctual(points, lights)?;
        self.pass("punctual", |b| punctual::run(&mut b.context, &b.geometry, points, lights, progress))
    }

    fn denoise(&mut self, noisy: Noisy<'_>, progress: &dyn Progress) -> Result<Vec<[f32; 3]>> {
        countable(noisy.points.len())?;
        noisy.check()?;
        self.pass("denoise", |b| denoise::run(&mut b.context, noisy, progress))
    }

    fn project(&mut self, points: &[SurfacePoint], camera: &Camera) -> Result<Vec<Projected>> {
        countable(points.len())?;
        check::points(points)?;
        camera.check()?;
        self.pass("project", |b| project::run(&mut b.context, &b.geometry, points, camera))
    }

    fn shade(
        &mut self,
        points: &[ShadePoint],
        materials: &[Material],
        sampling: Sampling,
        gradient: RoughnessGradient,
        progress: &dyn Progress,
    ) -> Result<Vec<Shaded>> {
        countable(points.len())?;
        check::shade(points, materials, sampling)?;
        let shape = self.shape_for(sampling.samples);
        let (items, how) = ((points, materials), (sampling, gradient));
        self.pass("shade", |b| {
            shade::run(&mut b.context, (&b.geometry, lighting_of(&b.lighting)?), items, how, shape, progress)
        })
    }

    fn shade_vjp(
        &mut self,
        points: &[ShadePoint],
        materials: &[Material],
        shaded: &[Shaded],
        d_radiance: &[[f32; 3]],
    ) -> Result<Vec<MaterialGrad>> {
        countable(points.len())?;
        check::shade_vjp(points, materials, shaded, d_radiance)?;
        self.pass("shade_vjp", |b| shade_vjp::run(&mut b.context, points, materials, shaded, d_radiance))
    }

    fn specular_tables(
        &mut self,
        pixels: &[[ShadePoint; STRATA]],
        f0: f32,
        sampling: TableSampling,
        progress: &dyn Progress,
    ) -> Result<Vec<Curve>> {
        check::specular_tables(pixels, sampling)?;
        countable(pixels.len())?;
        self.pass("specular_table", |b| {
            specular_table::run(
                &mut b.context,
                (&b.geometry, lighting_of(&b.lighting)?),
                (pixels, f0),
                sampling,
                progress,
            )
        })
    }

    fn radiance_loss(&mut self, rendered: &[[f32; 3]], target: &[[f32; 3]]) -> Result<Loss<[f32; 3]>> {
        countable(rendered.len())?;
        check::radiance_loss(rendered, target)?;
        self.pass("radiance_loss", |b| radiance_loss::run(&mut b.context, rendered, target))
    }

    fn group_loss(
        &mut self,
        values: &[f32],
        channels: usize,
        groups: &Groups,
        target: GroupTarget,
    ) -> Result<Loss<f32>> {
        countable(values.len())?;
        check::group_loss(values, channels, groups, target)?;
        if groups.references.is_empty() || channels == 0 {
            return Ok(Loss { value: 0.0, gradient: vec![0.0; values.len()] });
        }
        self.pass("group_loss", |b| group_loss::run(&mut b.context, &mut b.groups, values, channels, groups, target))
    }

    fn lookup(
        &mut self,
        pyramid: &Pyramid,
        texture: &[f32],
        channels: usize,
        footprints: &SparseRows,
    ) -> Result<Vec<f32>> {
        check::lookup(pyramid, texture, channels, footprints)?;
        countable(pyramid.len() * channels)?;
        self.pass("lookup", |b| lookup::run(&mut b.context, &mut b.cache, pyramid, texture, channels, footprints))
    }

    fn lookup_vjp(
        &mut self,
        pyramid: &Pyramid,
        d_values: &[f32],
        channels: usize,
        footprints: &Footprints,
    ) -> Result<Vec<f32>> {
        check::lookup_vjp(pyramid, d_values, channels, footprints)?;
        countable(pyramid.len() * channels)?;
        self.pass("lookup_vjp", |b| {
            lookup::run_vjp(&mut b.context, &mut b.cache, pyramid, d_values, channels, footprints)
        })
    }
}
