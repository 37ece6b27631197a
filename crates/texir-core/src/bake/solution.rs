//! A bake of as many texels as there are, and the rows of its maps.

use std::ops::Range;

use super::estimate::{self, Estimate};
use super::store::Store;
use super::surface::Surface;
use super::texels::{PIECE, Texels};
use super::tiles::{Tiles, rays_of};
use super::{Baked, Buried, PADDING, Quality};
use crate::backend::{Backend, Gather, Gathered};
use crate::checkpoint::Checkpoints;
use crate::denoise::{self, denoise_some};
use crate::error::Result;
use crate::mesh::Mesh;
use crate::progress::Progress;

/// A texel lies inside an object when this share of its rays meets the backs of triangles.
const BURIED: f32 = 0.5;

/// A [`Baked`] that lies where its [`Texels`] do.
#[derive(Debug)]
pub struct Solution {
    irradiance: Store<'static, [f32; 3]>,
    /// 0 for texels inside other geometry, else 1.
    seen: Store<'static, u8>,
    standard_error: Option<Store<'static, f32>>,
    /// Rays traced.
    pub rays: u64,
}

impl Solution {
    /// Some rows of [`Baked::map`]; `texels` are those that were baked.
    pub fn map_rows(&self, texels: &Texels<'_>, buried: Buried, rows: Range<usize>) -> Result<Vec<[f32; 3]>> {
        texels.rows(&self.irradiance, (buried == Buried::Fill).then_some(&self.seen), rows, PADDING)
    }

    /// Some rows of the map of [`Baked::standard_error`], 0 outside the charts and where [`Quality::error`] did not ask for it.
    pub fn error_rows(&self, texels: &Texels<'_>, rows: Range<usize>) -> Result<Vec<f32>> {
        match &self.standard_error {
            Some(errors) => texels.rows(errors, None, rows, 0),
            None => Ok(vec![0.0; rows.len() * texels.size()[0]]),
        }
    }

    /// How many texels lie inside other geometry.
    pub fn buried(&self) -> Result<usize> {
        self.seen.pieces(PIECE).map(|seen| Ok(seen?.iter().filter(|seen| **seen == 0).count())).sum()
    }

    /// Removes most of the noise, block by block; those of a bake in files are kept.
    fn denoise(
        &mut self,
        surface: &Surface<'_>,
        estimate: &Estimate,
        checkpoints: &Checkpoints,
        progress: &dyn Progress,
    ) -> Result<()> {
        let (texel, kept) = (surface.texel, surface.kept(checkpoints));
        surface.each("denoising", progress, |k, block, points| {
            let own = |i: usize| block.owns(&points[i]);
            let owned = block.items.filter(own);
            let clean = kept.array(&format!("denoised-{k}"), owned.len(), || {
                let buried: Vec<bool> = self.seen.get(&block.items)?.iter().map(|seen| *seen == 0).collect();
                let [a, b] = &estimate.halves;
                let half = |half: &Store<Gathered>| -> Result<Vec<[f32; 3]>> {
                    Ok(half.get(&block.items)?.iter().map(|g| g.irradiance).collect())
                };
                Ok(denoise_some(points, &[half(a)?, half(b)?], &buried, texel, own))
            })?;
            self.irradiance.set(&owned, &clean)
        })
    }

    pub(super) fn into_baked(self) -> Result<Baked> {
        Ok(Baked {
            irradiance: self.irradiance.into_vec()?,
            buried: self.seen.into_vec()?.into_iter().map(|seen| seen == 0).collect(),
            standard_error: self.standard_error.map(Store::into_vec).transpose()?,
            rays: self.rays,
        })
    }
}

/// [`super::bake`] of texels that need not be in memory.
pub fn solve(
    backend: &mut dyn Backend,
    mesh: &Mesh,
    texels: &Texels<'_>,
    quality: &Quality,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Solution> {
    if quality.error.is_none() && !quality.denoise {
        return as_gathered(backend, texels, quality.gather, checkpoints, progress);
    }
    let surface = Surface::new(texels, mesh, denoise::REACH.max(estimate::RADIUS))?;
    solve_on(backend, &surface, quality, checkpoints, progress)
}

/// [`solve`] with denoising or with errors, which look at neighbours.
pub(super) fn solve_on(
    backend: &mut dyn Backend,
    surface: &Surface<'_>,
    quality: &Quality,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Solution> {
    let estimate = Estimate::sample(backend, surface, quality.gather, quality.error, checkpoints, progress)?;
    let (irradiance, seen) = estimate.means(surface.texels)?;
    let standard_error = quality.error.map(|_| estimate.standard_errors(surface, progress)).transpose()?;
    let mut solution = Solution { irradiance, seen, standard_error, rays: estimate.rays()? };
    if quality.denoise {
        solution.denoise(surface, &estimate, checkpoints, progress)?;
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
) -> Result<Solution> {
    let rays = texels.points.len() as u64 * rays_of(gather);
    let (mut irradiance, mut seen) = (texels.zeroed()?, texels.zeroed()?);
    progress.start("irradiance", rays, "rays");
    Tiles::new(&texels.points, None, gather).gather(gather.seed, backend, checkpoints, progress, |items, found| {
        irradiance.set(items, &found.iter().map(|g| g.irradiance).collect::<Vec<_>>())?;
        seen.set(items, &found.iter().map(|g| is_seen(g.back_faces)).collect::<Vec<_>>())
    })?;
    progress.finish();
    Ok(Solution { irradiance, seen, standard_error: None, rays })
}

/// See [`BURIED`].
pub(super) fn is_seen(back_faces: f32) -> u8 {
    u8::from(back_faces < BURIED)
}
