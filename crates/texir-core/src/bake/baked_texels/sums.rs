//! Sums of bakes of the same texels: what a series of bounces is made of.

use std::ops::Range;

use super::BakedTexels;
use crate::bake::PADDING;
use crate::bake::texels::Texels;
use crate::error::Result;
use crate::raster::luminance;
use crate::surface::SurfacePoint;

impl BakedTexels {
    /// The same once more.
    pub(crate) fn copy(&self, texels: &Texels<'_>) -> Result<Self> {
        let mut copy = Self {
            irradiance: texels.zeroed()?,
            outside: texels.zeroed()?,
            standard_error: self.standard_error.as_ref().map(|_| texels.zeroed()).transpose()?,
            rays: self.rays,
        };
        for items in texels.pieces() {
            copy.irradiance.set(&items, &self.irradiance.get(&items)?)?;
            copy.outside.set(&items, &self.outside.get(&items)?)?;
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
            let (all, outside) = (total.irradiance.get(&items)?, total.outside.get(&items)?);
            for (i, point) in points.iter().enumerate().filter(|(i, _)| outside[*i] != 0) {
                let (x, y) = (point.index as usize % width, point.index as usize / width);
                let (sum, count) = &mut sums[y / SIDE * columns + x / SIDE];
                let [own, all] = [luminance(&own[i]), luminance(&all[i])];
                *sum += if all > dark { f64::from(own / all) } else { 0.0 };
                *count += 1;
            }
        }
        Ok(sums.into_iter().map(|(sum, count)| (count >= ENOUGH).then(|| sum / f64::from(count))).collect())
    }

    /// Marks texels whose luminance is above `dark` as outside other geometry: with black back faces, a lit texel is
    /// never inside, however many back faces its rays meet (under a roof of one sheet, in an open box).
    pub(crate) fn mark_lit_outside(&mut self, texels: &Texels<'_>, dark: f32) -> Result<()> {
        for items in texels.pieces() {
            let (irradiance, outside) = (self.irradiance.get(&items)?, self.outside.get(&items)?);
            let lit = |(outside, e): (&u8, &[f32; 3])| *outside | u8::from(luminance(e) > dark);
            let outside: Vec<u8> = outside.iter().zip(irradiance.iter()).map(lit).collect();
            self.outside.set(&items, &outside)?;
        }
        Ok(())
    }

    /// Some rows of the map of light that surfaces can send on: [`Buried::Fill`](crate::bake::Buried::Fill) for texels
    /// that are inside other geometry by what `total` found.
    pub(crate) fn filled_rows(&self, texels: &Texels<'_>, total: &Self, rows: Range<usize>) -> Result<Vec<[f32; 3]>> {
        texels.rows(&self.irradiance, Some(&total.outside), rows, PADDING)
    }
}

fn sums(a: &[[f32; 3]], b: &[[f32; 3]]) -> Vec<[f32; 3]> {
    a.iter().zip(b).map(|(a, b)| [a[0] + b[0], a[1] + b[1], a[2] + b[2]]).collect()
}
