//! Light from far away: the radiance that rays see which leave the scene, and its bright parts as a sampled set.

use std::f64::consts::{PI, TAU};
use std::hash::{Hash, Hasher};

use bytemuck::{Pod, Zeroable, cast_slice};

use crate::distribution::{cdf, sample_cdf};
use crate::error::{Error, Result};
use crate::lights::CONTRAST;
use crate::raster::{Rgb, luminance};
use crate::real::{Real, V3};

/// An equirectangular panorama of radiance around the scene, linear RGB.
///
/// +Y is up and the image's centre lies along +X, turning towards +Z to its right: as three.js and (with its own axes,
/// as its glTF exporter turns them) Blender lay it.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    radiance: Rgb,
    bright: BrightPixels,
}

impl Hash for Environment {
    fn hash<H: Hasher>(&self, state: &mut H) {
        // What is sampled follows from it.
        cast_slice::<_, u8>(&self.radiance.data).hash(state);
    }
}

/// The pixels of a panorama that stand out (a sun, its surroundings, lit windows), drawn in proportion to luminance ×
/// solid angle: first a row, then a pixel in it.
#[derive(Clone, Debug, PartialEq)]
pub struct BrightPixels {
    /// The rows that have any; empty where nothing stands out.
    pub rows: Vec<BrightRow>,
    /// Row by row.
    pub pixels: Vec<BrightPixel>,
    /// By pixel of the panorama: density, per steradian, of what is drawn in it; 0 for what does not stand out.
    pub density: Vec<f32>,
}

/// A row of a panorama with bright pixels.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct BrightRow {
    /// The end of the row's part of [`BrightPixels::pixels`], where the next row's begins.
    pub end: u32,
    /// Probability of this row and those before it.
    pub cdf: f32,
}

/// A sampled pixel.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct BrightPixel {
    /// Index in the panorama.
    pub pixel: u32,
    /// Probability, within the row, of this pixel and those before it.
    pub cdf: f32,
}

impl Environment {
    /// Wraps a panorama, twice as wide as high. Errors on an image of another shape, and on radiance outside 0 to
    /// [`MAX_RADIANCE`](crate::raster::MAX_RADIANCE).
    pub fn new(radiance: Rgb) -> Result<Self> {
        let [width, height] = radiance.size();
        if height == 0 || height.checked_mul(2) != Some(width) {
            return Err(Error::invalid(format!(
                "the environment is {width}×{height} pixels; expected an equirectangular panorama, twice as wide as high"
            )));
        }
        radiance.check_radiance("the environment")?;
        let bright = BrightPixels::find(&radiance);
        Ok(Self { radiance, bright })
    }

    /// The same radiance from everywhere.
    pub fn constant(radiance: [f32; 3]) -> Result<Self> {
        Self::new(Rgb::filled(2, 1, radiance))
    }

    /// The panorama.
    pub fn radiance(&self) -> &Rgb {
        &self.radiance
    }

    /// What of it is sampled.
    pub fn bright(&self) -> &BrightPixels {
        &self.bright
    }

    /// Bytes that it takes, here and in a backend.
    pub fn memory(&self) -> u64 {
        2 * (size_of_val(&self.radiance.data[..]) + size_of_val(&self.bright.density[..])) as u64
    }

    /// Radiance arriving from the unit direction.
    pub fn towards<R: Real>(&self, direction: V3<R>) -> V3<R> {
        V3::of(self.radiance.data[self.pixel(direction)])
    }

    /// The pixel of a unit direction: the nearest at u = ½ + atan2(z, x)/2π, v = acos(y)/π, without its loss of digits
    /// at the poles.
    pub fn pixel<R: Real>(&self, V3([x, y, z]): V3<R>) -> usize {
        let u = 0.5 + z.atan2(x).value() / TAU;
        let v = (x * x + z * z).sqrt().atan2(y).value() / PI;
        let at = |share: f64, size: usize| ((share * size as f64) as usize).min(size - 1);
        at(v, self.radiance.height) * self.radiance.width + at(u, self.radiance.width)
    }

    /// A direction to a bright pixel, and the pixel; uniform over the pixel's solid angle. What is left of the first
    /// number when row and pixel are chosen places the direction across the pixel.
    pub fn sample_environment<R: Real>(&self, [u, v]: [f32; 2]) -> (V3<R>, usize) {
        let BrightPixels { rows, pixels, .. } = &self.bright;
        let (row, rest) = sample_cdf(rows.len(), |i| rows[i].cdf, u);
        let first = if row > 0 { rows[row - 1].end as usize } else { 0 };
        let members = &pixels[first..rows[row].end as usize];
        let (i, rest) = sample_cdf(members.len(), |i| members[i].cdf, rest);
        let pixel = members[i].pixel as usize;
        let (column, row) = (pixel % self.radiance.width, pixel / self.radiance.width);
        let per_row = PI / self.radiance.height as f64;
        let [upper, lower] = [row, row + 1].map(|edge| R::of(edge as f64 * per_row).cos());
        let cosine = upper + (lower - upper) * R::of(f64::from(v));
        let sine = (R::of(1.0) - cosine * cosine).max(R::of(0.0)).sqrt();
        let turn = (column as f64 + f64::from(rest)) / self.radiance.width as f64 - 0.5;
        let azimuth = R::of(TAU * turn);
        (V3([sine * azimuth.cos(), cosine, sine * azimuth.sin()]), pixel)
    }
}

impl BrightPixels {
    /// The pixels of more than [`CONTRAST`] times the mean luminance over all directions.
    fn find(radiance: &Rgb) -> Self {
        let [width, height] = radiance.size();
        let solid_angle = |row: usize| {
            let [upper, lower] = [row, row + 1].map(|edge| (edge as f64 * PI / height as f64).cos());
            (upper - lower) * TAU / width as f64
        };
        let luminances: Vec<f32> = radiance.data.iter().map(luminance).collect();
        let power = |pixel: usize| f64::from(luminances[pixel]) * solid_angle(pixel / width);
        let mean = (0..luminances.len()).map(power).sum::<f64>() / (2.0 * TAU);
        let bright = |pixel: &usize| f64::from(luminances[*pixel]) > f64::from(CONTRAST) * mean;
        let total: f64 = (0..luminances.len()).filter(bright).map(power).sum();
        let (mut rows, mut weights, mut pixels) = (Vec::new(), Vec::new(), Vec::new());
        for row in 0..height {
            let members: Vec<usize> = (row * width..(row + 1) * width).filter(bright).collect();
            let powers: Vec<f32> = members.iter().map(|&pixel| power(pixel) as f32).collect();
            if members.is_empty() {
                continue;
            }
            let member = |(&pixel, cdf): (&usize, f32)| BrightPixel { pixel: pixel as u32, cdf };
            pixels.extend(members.iter().zip(cdf(&powers)).map(member));
            weights.push(powers.iter().sum());
            rows.push(BrightRow { end: pixels.len() as u32, cdf: 0.0 });
        }
        rows.iter_mut().zip(cdf(&weights)).for_each(|(row, cdf)| row.cdf = cdf);
        let density = |pixel: usize| if bright(&pixel) { (f64::from(luminances[pixel]) / total) as f32 } else { 0.0 };
        Self { rows, pixels, density: (0..luminances.len()).map(density).collect() }
    }

    /// Whether nothing stands out.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_fall_where_three_js_and_blender_put_them() {
        let numbered = Rgb::new(8, 4, (0..32).map(|i| [i as f32; 3]).collect()).unwrap();
        let environment = Environment::new(numbered).unwrap();
        let at = |x: f64, y: f64, z: f64| {
            let length = (x * x + y * y + z * z).sqrt();
            let [value, ..] = environment.towards(V3([x / length, y / length, z / length])).to_f32();
            (value as usize % 8, value as usize / 8)
        };
        // A little off the axes, which lie between pixels.
        assert_eq!(at(1.0, 0.1, 0.1), (4, 1), "+X");
        assert_eq!(at(0.1, -0.1, 1.0), (5, 2), "+Z");
        assert_eq!(at(-1.0, 0.1, 0.1), (7, 1), "−X");
        assert_eq!(at(-0.1, 0.1, -1.0), (1, 1), "−Z");
        assert_eq!(at(0.01, 1.0, 0.01).1, 0, "up");
        assert_eq!(at(0.0, -1.0, 0.0).1, 3, "down");
    }

    #[test]
    fn bright_pixels_are_drawn_by_their_power() {
        // Two bright pixels, at the horizon and near the zenith, where pixels are smaller.
        let mut radiance = Rgb::filled(32, 16, [0.1; 3]);
        radiance.data[8 * 32 + 3] = [60.0; 3];
        radiance.data[32 + 20] = [90.0, 60.0, 30.0];
        let sky = Environment::new(radiance).unwrap();
        assert_eq!(sky.bright().pixels.len(), 2);
        const N: u32 = 4096;
        let mut count = 0;
        for i in 0..N {
            let (direction, pixel) = sky.sample_environment::<f64>(crate::rng::sobol2(i, 5));
            assert!((direction.dot(direction) - 1.0).abs() < 1e-12);
            assert_eq!(sky.pixel(direction), pixel);
            count += u32::from(pixel == 8 * 32 + 3);
        }
        let band = |row: f64| (row * PI / 16.0).cos() - ((row + 1.0) * PI / 16.0).cos();
        let [low, high] = [60.0 * band(8.0), f64::from(luminance(&[90.0, 60.0, 30.0])) * band(1.0)];
        assert!((f64::from(count) / f64::from(N) - low / (low + high)).abs() < 1e-3, "{count}");
        // Densities integrate to 1.
        let at = |pixel: usize| f64::from(sky.bright().density[pixel]) * TAU / 32.0;
        assert!((at(8 * 32 + 3) * band(8.0) + at(32 + 20) * band(1.0) - 1.0).abs() < 1e-6);
        assert!(Environment::constant([1.0; 3]).unwrap().bright().is_empty());
    }

    #[test]
    fn what_is_no_panorama_is_refused() {
        for bad in [Rgb::filled(0, 0, [0.0; 3]), Rgb::filled(4, 4, [0.0; 3])] {
            assert!(Environment::new(bad).unwrap_err().to_string().contains("twice as wide"));
        }
        for bad in [f32::NAN, f32::INFINITY, -1.0, 1e38] {
            let error = Environment::constant([0.0, bad, 0.0]).unwrap_err().to_string();
            assert!(error.contains("column 0, row 0; expected 0 to 1e15"), "{error}");
        }
        for pixels in [0, 31, 33] {
            let error = Environment::new(Rgb { width: 8, height: 4, data: vec![[1.0; 3]; pixels] }).unwrap_err();
            assert!(error.to_string().contains("one for each of its 8×4 pixels"), "{error}");
        }
        assert!(Environment::constant([crate::raster::MAX_RADIANCE; 3]).is_ok());
    }
}
