//! The passes of a bake: gathers, errors, denoising.

#[cfg(feature = "oidn")]
use super::PADDING;
use super::baked_texels::BakedTexels;
use super::estimate::{self, Estimate};
use super::spatial_blocks::SpatialBlocks;
#[cfg(feature = "oidn")]
use super::store::Items;
use super::store::Store;
use super::texels::Texels;
use super::tiles::{Tiles, is_outside, rays_of};
use super::{Denoiser, Quality};
use crate::backend::{Backend, Gather, Gathered};
use crate::checkpoint::Checkpoints;
use crate::denoise::{self, Noisy};
use crate::error::{Error, Result};
use crate::progress::{Progress, Task};
#[cfg(feature = "oidn")]
use crate::raster::Raster;

/// [`super::bake`] of texels that need not be in memory.
pub fn bake_texels(
    backend: &mut dyn Backend,
    texels: &Texels<'_>,
    quality: &Quality,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<BakedTexels> {
    if let Some(error) = quality.error.filter(|error| !(*error >= 0.0)) {
        return Err(Error::invalid(format!("the relative error asked for is {error}; expected 0 or more")));
    }
    if quality.denoise == Some(Denoiser::OpenImageDenoise) {
        #[cfg(not(feature = "oidn"))]
        return Err(Error::invalid(
            "Open Image Denoise was asked for, but texir is built without it; build it with the feature `oidn`",
        ));
        #[cfg(feature = "oidn")]
        {
            let noisy = Quality { denoise: None, ..*quality };
            return bake_texels(backend, texels, &noisy, checkpoints, progress)?
                .denoised_as_a_picture(texels, progress);
        }
    }
    if quality.error.is_none() && quality.denoise.is_none() {
        return as_gathered(backend, texels, quality.gather, checkpoints, progress);
    }
    let scene = backend.scene().clone();
    let surface = SpatialBlocks::new(texels, scene.mesh(), denoise::REACH.max(estimate::RADIUS))?;
    bake_blocks(backend, &surface, quality, checkpoints, progress)
}

/// [`bake_texels`] with denoising or with errors, which look at neighbours.
pub(super) fn bake_blocks(
    backend: &mut dyn Backend,
    surface: &SpatialBlocks<'_>,
    quality: &Quality,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<BakedTexels> {
    let estimate = Estimate::sample(backend, surface, quality.gather, quality.error, checkpoints, progress)?;
    let (irradiance, outside) = estimate.means(surface.texels)?;
    let standard_error = quality.error.map(|_| estimate.standard_errors(surface, progress)).transpose()?;
    let mut solution = BakedTexels { irradiance, outside, standard_error, rays: estimate.rays()? };
    if quality.denoise == Some(Denoiser::Regression) {
        solution.denoise(backend, surface, &estimate, checkpoints, progress)?;
    }
    Ok(solution)
}

/// [`super::irradiance`] of texels that need not be in memory.
pub(super) fn as_gathered(
    backend: &mut dyn Backend,
    texels: &Texels<'_>,
    gather: Gather,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<BakedTexels> {
    let gather = gather.shared(texels.size()[0]);
    let rays = texels.points.len() as u64 * rays_of(gather);
    let (mut irradiance, mut outside) = (texels.zeroed()?, texels.zeroed()?);
    let _task = Task::start(progress, "irradiance", rays, "rays");
    Tiles::new(&texels.points, None, rays_of(gather)).gather(
        gather,
        backend,
        checkpoints,
        progress,
        |items, found| {
            irradiance.set(items, &found.iter().map(|g| g.irradiance).collect::<Vec<_>>())?;
            outside.set(items, &found.iter().map(|g| is_outside(g.back_faces)).collect::<Vec<_>>())
        },
    )?;
    Ok(BakedTexels { irradiance, outside, standard_error: None, rays })
}

impl BakedTexels {
    /// Removes most of the noise, block by block; each is kept.
    fn denoise(
        &mut self,
        backend: &mut dyn Backend,
        surface: &SpatialBlocks<'_>,
        estimate: &Estimate,
        checkpoints: &Checkpoints,
        progress: &dyn Progress,
    ) -> Result<()> {
        let kept = surface.kept(checkpoints);
        // Texels without a size are beside nothing.
        if !(surface.texel > 0.0) {
            return Ok(());
        }
        surface.each("denoising", progress, |k, block, points| {
            let own = |i: usize| block.owns(&points[i]);
            let owned = block.items.filter(own);
            let clean = kept.array(&format!("denoised-{k}"), owned.len(), || {
                let buried: Vec<bool> = self.outside.get(&block.items)?.iter().map(|outside| *outside == 0).collect();
                let [a, b] = &estimate.halves;
                let half = |half: &Store<Gathered>| -> Result<Vec<[f32; 3]>> {
                    Ok(half.get(&block.items)?.iter().map(|g| g.irradiance).collect())
                };
                let halves = [half(a)?, half(b)?];
                let mut clean = vec![[0.0; 3]; points.len()];
                for class in surface.size_classes(points) {
                    let [a, b] = halves.each_ref().map(|half| class.gather(half));
                    let (points, apart) = (&class.gather(points), &class.gather(&buried));
                    let noisy = Noisy { points, halves: [&a, &b], apart, texel: class.texel };
                    class.scatter(backend.denoise(noisy, progress)?, &mut clean);
                }
                Ok(clean.into_iter().enumerate().filter(|(i, _)| own(*i)).map(|(_, clean)| clean).collect())
            })?;
            self.irradiance.set(&owned, &clean)
        })
    }

    /// Removes most of the noise by a library that sees the whole map at once. Texels inside other geometry are as
    /// their neighbours to it, and keep what they gathered.
    #[cfg(feature = "oidn")]
    fn denoised_as_a_picture(mut self, texels: &Texels<'_>, progress: &dyn Progress) -> Result<Self> {
        let _task = Task::start(progress, "denoising", texels.valid() as u64, "texels");
        let [width, height] = texels.size();
        let picture = |values: &Store<'_, [f32; 3]>, known: Option<&Store<'_, u8>>| {
            Raster::new(width, height, texels.rows(values, known, 0..height, PADDING)?)
        };
        let all = Items::Range(0..texels.valid());
        let points = texels.points.get(&all)?;
        let normals = Store::Memory(points.iter().map(|point| point.normal).collect());
        let clean =
            denoise::oidn::denoise(&picture(&self.irradiance, Some(&self.outside))?, &picture(&normals, None)?)?;
        let (gathered, outside) = (self.irradiance.get(&all)?, self.outside.get(&all)?);
        let values: Vec<[f32; 3]> = (points.iter().zip(gathered.iter().zip(outside.iter())))
            .map(
                |(point, (gathered, outside))| if *outside == 0 { *gathered } else { clean.data[point.index as usize] },
            )
            .collect();
        self.irradiance.set(&all, &values)?;
        Ok(self)
    }
}
