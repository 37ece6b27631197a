//! CPU twins: one file per pass, sharing its stem with the shader, generic over the scalar. In `f64` (and
//! [`crate::real::Dual`]) they are the oracle that the WGSL is tested against; in `f32` over rayon and obvhs they are
//! [`CpuBackend`].

pub mod denoise;
pub mod group_loss;
pub mod irradiance;
mod lanes;
pub mod light_sampling;
pub mod lighting;
pub mod lobe;
pub mod lookup;
pub mod primary;
pub mod project;
pub mod punctual;
pub mod radiance_loss;
pub mod sampling;
pub mod shade;
pub mod shade_vjp;
pub mod specular_table;
pub mod texels;

#[cfg(test)]
mod tests;

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use crate::backend::{
    Backend, Gather, Gathered, GroupTarget, Groups, Loss, Material, MaterialGrad, Projected, RoughnessGradient,
    Sampling, ShadePoint, Shaded, check,
};
use crate::camera::Camera;
use crate::denoise::Noisy;
use crate::environment::Environment;
use crate::error::{Error, Result};
use crate::lights::Lights;
use crate::progress::Progress;
use crate::punctual::PunctualLight;
use crate::raster::Rgb;
use crate::real::V3;
use crate::scene::Scene;
use crate::scene::trace::TraceHit;
use crate::specular_table::{Curve, STRATA, TableSampling};
use crate::surface::{Hit, SurfacePoint, TexelHit};
use crate::texture::{Footprints, Pyramid, SparseRows};
use lighting::Lighting;
use shade::{MaterialIn, ShadedIn};

/// Items traced between two looks at progress and cancellation.
const CHUNK: usize = 4096;

/// The passes on the host, in `f32`: for machines without a Vulkan, Metal or DirectX driver.
pub struct CpuBackend {
    scene: Arc<Scene>,
    tbl: Option<(Rgb, Lights)>,
    environment: Option<Environment>,
}

impl fmt::Debug for CpuBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let radiance = self.tbl.as_ref().map(|(radiance, _)| radiance.size());
        let environment = self.environment.as_ref().map(|environment| environment.radiance().size());
        f.debug_struct("CpuBackend")
            .field("scene", &self.scene)
            .field("radiance", &radiance)
            .field("environment", &environment)
            .finish()
    }
}

impl CpuBackend {
    /// A backend for one scene, which others may share.
    pub fn new(scene: impl Into<Arc<Scene>>) -> Self {
        Self { scene: scene.into(), tbl: None, environment: None }
    }

    fn lighting(&self) -> Result<(Lighting<'_, Scene>, &Lights)> {
        let (radiance, lights) =
            self.tbl.as_ref().ok_or_else(|| Error::invalid("no texture-based lighting was set"))?;
        Ok((Lighting { tracer: &*self.scene, radiance, environment: self.environment.as_ref() }, lights))
    }
}

impl From<TraceHit<f32>> for Hit {
    fn from(h: TraceHit<f32>) -> Self {
        Hit { triangle: h.triangle, u: h.u, v: h.v, t: h.t }
    }
}

impl From<&Material> for MaterialIn<f32> {
    fn from(m: &Material) -> Self {
        Self { albedo: V3(m.albedo), roughness: m.roughness, metallic: m.metallic }
    }
}

/// Maps items in parallel, in chunks between which progress is reported and cancellation honoured.
fn map_in_chunks<T: Sync, U: Send>(
    items: &[T],
    progress: &dyn Progress,
    cost: u64,
    f: impl Fn(usize, &T) -> U + Sync,
) -> Result<Vec<U>> {
    let mut out = Vec::with_capacity(items.len());
    for (chunk, slice) in items.chunks(CHUNK).enumerate() {
        progress.check()?;
        out.par_extend(slice.par_iter().enumerate().map(|(i, item)| f(chunk * CHUNK + i, item)));
        progress.advance(slice.len() as u64 * cost);
    }
    Ok(out)
}

impl Backend for CpuBackend {
    fn name(&self) -> String {
        "CPU".to_owned()
    }

    fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    fn set_tbl(&mut self, radiance: &Rgb, lights: &Lights) -> Result<()> {
        check::tbl(&self.scene, radiance, lights)?;
        // Two at once may be more than there is memory for.
        self.tbl = None;
        self.tbl = Some((radiance.clone(), lights.clone()));
        Ok(())
    }

    fn set_environment(&mut self, environment: Option<&Environment>) -> Result<()> {
        self.environment = None;
        self.environment = environment.cloned();
        Ok(())
    }

    fn primary(&mut self, camera: &Camera, rows: Range<usize>) -> Result<Vec<Hit>> {
        camera.check()?;
        check::rows(&rows, camera.height)?;
        let hit = |i: usize| {
            primary::primary::<f32>(&*self.scene, camera, i % camera.width, i / camera.width)
                .map_or(Hit::MISS, Hit::from)
        };
        Ok((rows.start * camera.width..rows.end * camera.width).into_par_iter().map(hit).collect())
    }

    fn texels(&mut self, size: [usize; 2], rows: Range<usize>) -> Result<Vec<Option<TexelHit>>> {
        let (mesh, [width, height]) = (self.scene.mesh(), size);
        check::rows(&rows, height)?;
        let bins = texels::TileBins::new(mesh, size, rows.clone())?;
        let corners = |t: u32| mesh.corner_uvs(t).map(|uv| [uv.x * width as f32, uv.y * height as f32]);
        let hit = |i: usize| {
            let (x, y) = (i % width, i / width);
            texels::texel(bins.at(x, y), corners, x, y)
        };
        Ok((rows.start * width..rows.end * width).into_par_iter().map(hit).collect())
    }

    fn irradiance(
        &mut self,
        points: &[SurfacePoint],
        gather: Gather,
        progress: &dyn Progress,
    ) -> Result<Vec<Gathered>> {
        check::irradiance(points, gather)?;
        let (lighting, lights) = self.lighting()?;
        map_in_chunks(points, progress, u64::from(gather.cosine) + u64::from(gather.light), |_, point| {
            irradiance::irradiance::<f32, _>(&lighting, lights, point, gather)
        })
    }

    fn punctual(
        &mut self,
        points: &[SurfacePoint],
        lights: &[PunctualLight],
        progress: &dyn Progress,
    ) -> Result<Vec<[f32; 3]>> {
        check::punctual(points, lights)?;
        let lights: Vec<_> = lights.iter().map(PunctualLight::coefficients).collect();
        map_in_chunks(points, progress, lights.len() as u64, |_, point| {
            let sum = |sum, light| sum + punctual::punctual::<f32>(&*self.scene, light, point);
            lights.iter().fold(V3::zero(), sum).to_f32()
        })
    }

    fn denoise(&mut self, noisy: Noisy<'_>, progress: &dyn Progress) -> Result<Vec<[f32; 3]>> {
        noisy.check()?;
        denoise::denoise(noisy, progress)
    }

    fn project(&mut self, points: &[SurfacePoint], camera: &Camera) -> Result<Vec<Projected>> {
        check::points(points)?;
        camera.check()?;
        Ok(points.par_iter().map(|p| project::project::<f32>(&*self.scene, camera, p)).collect())
    }

    fn shade(
        &mut self,
        points: &[ShadePoint],
        materials: &[Material],
        sampling: Sampling,
        gradient: RoughnessGradient,
        progress: &dyn Progress,
    ) -> Result<Vec<Shaded>> {
        check::shade(points, materials, sampling)?;
        let (lighting, _) = self.lighting()?;
        map_in_chunks(points, progress, u64::from(sampling.samples), |i, point| {
            let s = shade::shade(&lighting, point, &MaterialIn::from(&materials[i]), sampling, gradient);
            Shaded {
                radiance: s.radiance.0,
                specular_scale: s.specular_scale.0,
                roughness_jacobian: s.roughness_jacobian.0,
            }
        })
    }

    fn shade_vjp(
        &mut self,
        points: &[ShadePoint],
        materials: &[Material],
        shaded: &[Shaded],
        d_radiance: &[[f32; 3]],
    ) -> Result<Vec<MaterialGrad>> {
        check::shade_vjp(points, materials, shaded, d_radiance)?;
        let grad = |i: usize| {
            let jacobian = ShadedIn {
                radiance: V3(shaded[i].radiance),
                specular_scale: V3(shaded[i].specular_scale),
                roughness_jacobian: V3(shaded[i].roughness_jacobian),
            };
            let d = shade_vjp::shade_vjp(&points[i], &MaterialIn::from(&materials[i]), &jacobian, V3(d_radiance[i]));
            MaterialGrad { albedo: d.albedo.0, roughness: d.roughness, metallic: d.metallic }
        };
        Ok((0..points.len()).into_par_iter().map(grad).collect())
    }

    fn specular_tables(
        &mut self,
        pixels: &[[ShadePoint; STRATA]],
        f0: f32,
        sampling: TableSampling,
        progress: &dyn Progress,
    ) -> Result<Vec<Curve>> {
        check::specular_tables(pixels, sampling)?;
        let (lighting, lights) = self.lighting()?;
        map_in_chunks(pixels, progress, u64::from(sampling.rays()), |_, strata| {
            Curve::new(specular_table::specular_table(&lighting, lights, strata, f0, sampling).map(V3::to_f32))
        })
    }

    fn radiance_loss(&mut self, rendered: &[[f32; 3]], target: &[[f32; 3]]) -> Result<Loss<[f32; 3]>> {
        check::radiance_loss(rendered, target)?;
        let share = (1.0 / (3.0 * rendered.len() as f64)) as f32;
        let mut value = 0.0;
        let gradient = (0..rendered.len())
            .map(|i| {
                let (loss, d) = radiance_loss::radiance_loss(V3(rendered[i]), V3(target[i]), share);
                value += f64::from(loss);
                d.0
            })
            .collect();
        Ok(Loss { value: value as f32, gradient })
    }

    fn group_loss(
        &mut self,
        values: &[f32],
        channels: usize,
        groups: &Groups,
        target: GroupTarget,
    ) -> Result<Loss<f32>> {
        check::group_loss(values, channels, groups, target)?;
        let mut gradient = vec![0.0; values.len()];
        let value = group_loss::group_loss(values, channels, groups, target, &mut gradient);
        Ok(Loss { value, gradient })
    }

    fn lookup(
        &mut self,
        pyramid: &Pyramid,
        texture: &[f32],
        channels: usize,
        footprints: &SparseRows,
    ) -> Result<Vec<f32>> {
        check::lookup(pyramid, texture, channels, footprints)?;
        Ok(lookup::lookup(pyramid, texture, channels, footprints))
    }

    fn lookup_vjp(
        &mut self,
        pyramid: &Pyramid,
        d_values: &[f32],
        channels: usize,
        footprints: &Footprints,
    ) -> Result<Vec<f32>> {
        check::lookup_vjp(pyramid, d_values, channels, footprints)?;
        Ok(lookup::lookup_vjp(pyramid, d_values, channels, footprints))
    }
}
