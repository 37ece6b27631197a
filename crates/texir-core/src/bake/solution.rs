//! A bake of as many texels as there are, and the rows of its maps.

use std::ops::Range;

use super::estimate::{self, Estimate};
#[cfg(feature = "oidn")]
use super::store::Items;
use super::store::Store;
use super::surface::Surface;
use super::texels::{PIECE, Texels};
use super::tiles::{Tiles, is_seen, rays_of};
use super::{Baked, Buried, Denoiser, PADDING, Quality};
use crate::atlas::{BAND, bands};
use crate::backend::{Backend, Gather, Gathered};
use crate::checkpoint::Checkpoints;
use crate::denoise::{self, Noisy};
use crate::error::{Error, Result};
use crate::progress::{Progress, Task};
use crate::raster::{Raster, Rgb, luminance};
use crate::surface::SurfacePoint;

/// A [`Baked`] that lies where its [`Texels`] do.
#[derive(Debug)]
pub struct Solution {
    irradiance: Store<'static, [f32; 3]>,
    /// 0 for texels inside other geometry, else 1.
    seen: Store<'static, u8>,
    standard_error: Option<Store<'static, f32>>,
    /// As [`Baked::rays`]: rays requested, not rays traced.
    pub rays: u64,
}

impl Solution {
    /// [`Baked::map`], in memory; `texels` are those that were baked.
    pub fn map(&self, texels: &Texels<'_>, buried: Buried) -> Result<Rgb> {
        let [width, height] = texels.size();
        let mut map = Vec::with_capacity(width * height);
        for rows in bands(width, height, BAND) {
            map.extend(self.map_rows(texels, buried, rows)?);
        }
        Raster::new(width, height, map)
    }

    /// Some rows of [`Baked::map`]; `texels` are those that were baked.
    pub fn map_rows(&self, texels: &Texels<'_>, buried: Buried, rows: Range<usize>) -> Result<Vec<[f32; 3]>> {
        self.check(texels, &rows)?;
        texels.rows(&self.irradiance, (buried == Buried::Fill).then_some(&self.seen), rows, PADDING)
    }

    /// Some rows of the map of [`Baked::standard_error`], 0 outside the charts and where [`Quality::error`] did not ask
    /// for it.
    pub fn error_rows(&self, texels: &Texels<'_>, rows: Range<usize>) -> Result<Vec<f32>> {
        self.check(texels, &rows)?;
        match &self.standard_error {
            Some(errors) => texels.rows(errors, None, rows, 0),
            None => Ok(vec![0.0; rows.len() * texels.size()[0]]),
        }
    }

    /// That there are as many texels as were baked, and rows of theirs.
    fn check(&self, texels: &Texels<'_>, rows: &Range<usize>) -> Result<()> {
        let (baked, valid, height) = (self.irradiance.len(), texels.valid(), texels.size()[1]);
        if baked == valid && rows.start <= rows.end && rows.end <= height {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "rows {rows:?} of {valid} texels on {height} rows are asked for; expected rows of the {baked} texels that were baked"
        )))
    }

    /// How many texels lie inside other geometry.
    pub fn buried(&self) -> Result<usize> {
        self.seen.pieces(PIECE).map(|seen| Ok(seen?.iter().filter(|seen| **seen == 0).count())).sum()
    }

    /// Goes through all texels: their points, irradiance, and whether they lie outside other geometry.
    pub(crate) fn each(&self, texels: &Texels<'_>, mut visit: impl FnMut(&SurfacePoint, [f32; 3], bool)) -> Result<()> {
        for items in texels.pieces() {
            let (points, irradiance) = (texels.points.get(&items)?, self.irradiance.get(&items)?);
            let seen = self.seen.get(&items)?;
            for ((point, irradiance), seen) in points.iter().zip(irradiance.iter()).zip(seen.iter()) {
                visit(point, *irradiance, *seen != 0);
            }
        }
        Ok(())
    }

    /// The same once more.
    pub(crate) fn copy(&self, texels: &Texels<'_>) -> Result<Self> {
        let mut copy = Self {
            irradiance: texels.zeroed()?,
            seen: texels.zeroed()?,
            standard_error: self.standard_error.as_ref().map(|_| texels.zeroed()).transpose()?,
            rays: self.rays,
        };
        for items in texels.pieces() {
            copy.irradiance.set(&items, &self.irradiance.get(&items)?)?;
            copy.seen.set(&items, &self.seen.get(&items)?)?;
            if let (Some(copy), Some(errors)) = (&mut copy.standard_error, &self.standard_error) {
                copy.set(&items, &errors.get(&items)?)?;
            }
        }
        Ok(copy)
    }

    /// Adds the light of another bake of the same texels, with noise of its own.
    pub(crate) fn add(&mut self, texels: &Texels<'_>, other: &Self) -> Result<()> {
        self.rays += other.rays;
        for items in texels.pieces() {
            let sum = sums(&self.irradiance.get(&items)?, &other.irradiance.get(&items)?);
            self.irradiance.set(&items, &sum)?;
            if let (Some(errors), Some(others)) = (&mut self.standard_error, &other.standard_error) {
                let both: Vec<f32> =
                    errors.get(&items)?.iter().zip(others.get(&items)?.iter()).map(|(a, b)| a.hypot(*b)).collect();
                errors.set(&items, &both)?;
            }
        }
        Ok(())
    }

    /// Adds noise-free irradiance, which `light` computes for a chunk of points, given the chunk's number.
    pub(crate) fn add_exact(
        &mut self,
        texels: &Texels<'_>,
        mut light: impl FnMut(usize, &[SurfacePoint]) -> Result<Vec<[f32; 3]>>,
    ) -> Result<()> {
        for (number, items) in texels.pieces().enumerate() {
            let sum = sums(&self.irradiance.get(&items)?, &light(number, &texels.points.get(&items)?)?);
            self.irradiance.set(&items, &sum)?;
        }
        Ok(())
    }

    /// Mean over the channels and all texels.
    pub(crate) fn mean(&self, texels: &Texels<'_>) -> Result<f64> {
        let mut sum = 0.0;
        for items in texels.pieces() {
            sum += self.irradiance.get(&items)?.iter().flatten().map(|v| f64::from(*v)).sum::<f64>();
        }
        Ok(sum / (3 * texels.valid()).max(1) as f64)
    }

    /// The share of the light of `total` that this is, its mean over the texels of every square of the map; `None` for
    /// those of few texels. Texels inside other geometry are left out, and those of which `total` is at most `dark`
    /// have a share of 0.
    pub(crate) fn shares(&self, texels: &Texels<'_>, total: &Self, dark: f32) -> Result<Vec<Option<f64>>> {
        /// Edge of a square.
        const SIDE: usize = 16;
        /// Texels whose mean is worth something.
        const ENOUGH: u32 = 64;
        let [width, height] = texels.size();
        let columns = width.div_ceil(SIDE);
        let mut sums = vec![(0.0, 0); columns * height.div_ceil(SIDE)];
        for items in texels.pieces() {
            let (points, own) = (texels.points.get(&items)?, self.irradiance.get(&items)?);
            let (all, seen) = (total.irradiance.get(&items)?, total.seen.get(&items)?);
            for (i, point) in points.iter().enumerate().filter(|(i, _)| seen[*i] != 0) {
                let (x, y) = (point.index as usize % width, point.index as usize / width);
                let (sum, count) = &mut sums[y / SIDE * columns + x / SIDE];
                let [own, all] = [luminance(&own[i]), luminance(&all[i])];
                *sum += if all > dark { f64::from(own / all) } else { 0.0 };
                *count += 1;
            }
        }
        Ok(sums.into_iter().map(|(sum, count)| (count >= ENOUGH).then(|| sum / f64::from(count))).collect())
    }

    /// Marks texels whose luminance is above `dark` as outside other geometry: with black back faces, a lit texel is never
    /// inside, however many back faces its rays meet (under a roof of one sheet, in an open box).
    pub(crate) fn see_lit(&mut self, texels: &Texels<'_>, dark: f32) -> Result<()> {
        for items in texels.pieces() {
            let (irradiance, seen) = (self.irradiance.get(&items)?, self.seen.get(&items)?);
            let lit = |(seen, e): (&u8, &[f32; 3])| *seen | u8::from(luminance(e) > dark);
            let seen: Vec<u8> = seen.iter().zip(irradiance.iter()).map(lit).collect();
            self.seen.set(&items, &seen)?;
        }
        Ok(())
    }

    /// Some rows of the map of light that surfaces can send on: [`Buried::Fill`] for texels that are inside other
    /// geometry, which `first` tells.
    pub(crate) fn seen_rows(&self, texels: &Texels<'_>, first: &Self, rows: Range<usize>) -> Result<Vec<[f32; 3]>> {
        texels.rows(&self.irradiance, Some(&first.seen), rows, PADDING)
    }

    /// Removes most of the noise, block by block; each is kept.
    fn denoise(
        &mut self,
        backend: &mut dyn Backend,
        surface: &Surface<'_>,
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
                let buried: Vec<bool> = self.seen.get(&block.items)?.iter().map(|seen| *seen == 0).collect();
                let [a, b] = &estimate.halves;
                let half = |half: &Store<Gathered>| -> Result<Vec<[f32; 3]>> {
                    Ok(half.get(&block.items)?.iter().map(|g| g.irradiance).collect())
                };
                let halves = [half(a)?, half(b)?];
                let mut clean = vec![[0.0; 3]; points.len()];
                for alike in surface.alike(points) {
                    let [a, b] = halves.each_ref().map(|half| alike.of(half));
                    let (points, apart) = (&alike.of(points), &alike.of(&buried));
                    let noisy = Noisy { points, halves: [&a, &b], apart, texel: alike.texel };
                    alike.put(backend.denoise(noisy, progress)?, &mut clean);
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
        let clean = denoise::oidn::denoise(&picture(&self.irradiance, Some(&self.seen))?, &picture(&normals, None)?)?;
        let (gathered, seen) = (self.irradiance.get(&all)?, self.seen.get(&all)?);
        let values: Vec<[f32; 3]> = (points.iter().zip(gathered.iter().zip(seen.iter())))
            .map(|(point, (gathered, seen))| if *seen == 0 { *gathered } else { clean.data[point.index as usize] })
            .collect();
        self.irradiance.set(&all, &values)?;
        Ok(self)
    }

    /// All of it, in memory.
    pub fn into_baked(self) -> Result<Baked> {
        Ok(Baked {
            irradiance: self.irradiance.into_vec()?,
            buried: self.seen.into_vec()?.into_iter().map(|seen| seen == 0).collect(),
            standard_error: self.standard_error.map(Store::into_vec).transpose()?,
            rays: self.rays,
        })
    }
}

fn sums(a: &[[f32; 3]], b: &[[f32; 3]]) -> Vec<[f32; 3]> {
    a.iter().zip(b).map(|(a, b)| [a[0] + b[0], a[1] + b[1], a[2] + b[2]]).collect()
}

/// [`super::bake`] of texels that need not be in memory.
pub fn solve(
    backend: &mut dyn Backend,
    texels: &Texels<'_>,
    quality: &Quality,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Solution> {
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
            return solve(backend, texels, &noisy, checkpoints, progress)?.denoised_as_a_picture(texels, progress);
        }
    }
    if quality.error.is_none() && quality.denoise.is_none() {
        return as_gathered(backend, texels, quality.gather, checkpoints, progress);
    }
    let scene = backend.scene().clone();
    let surface = Surface::new(texels, scene.mesh(), denoise::REACH.max(estimate::RADIUS))?;
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
) -> Result<Solution> {
    let gather = gather.shared(texels.size()[0]);
    let rays = texels.points.len() as u64 * rays_of(gather);
    let (mut irradiance, mut seen) = (texels.zeroed()?, texels.zeroed()?);
    let _task = Task::start(progress, "irradiance", rays, "rays");
    Tiles::new(&texels.points, None, rays_of(gather)).gather(
        gather,
        backend,
        checkpoints,
        progress,
        |items, found| {
            irradiance.set(items, &found.iter().map(|g| g.irradiance).collect::<Vec<_>>())?;
            seen.set(items, &found.iter().map(|g| is_seen(g.back_faces)).collect::<Vec<_>>())
        },
    )?;
    Ok(Solution { irradiance, seen, standard_error: None, rays })
}
