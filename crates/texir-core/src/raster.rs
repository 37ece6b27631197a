//! Two-dimensional arrays: images, atlases, masks and label maps.

use glam::{DVec2, Vec2};

use crate::error::{Error, Result};

/// The strongest radiance that lighting may have: of more, squares leave single precision.
pub const MAX_RADIANCE: f32 = 1e15;

/// A size, as messages have it.
pub(crate) fn times([width, height]: [usize; 2]) -> String {
    format!("{width}×{height}")
}

/// A row-major `height × width` array, row 0 on top.
#[derive(Clone, Debug, PartialEq)]
pub struct Raster<T> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `height · width` values, row by row.
    pub data: Vec<T>,
}

/// Linear RGB (radiance, irradiance or albedo; the owner says which).
pub type Rgb = Raster<[f32; 3]>;
/// One channel, e.g. perceptual roughness.
pub type Gray = Raster<f32>;
/// Integer labels: semantic classes, room ids.
pub type Labels = Raster<u16>;
/// A yes/no map.
pub type Mask = Raster<bool>;

impl<T: Clone> Raster<T> {
    /// An array filled with `value`.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self { width, height, data: vec![value; width * height] }
    }
}

impl<T> Raster<T> {
    /// Wraps `data`, which must hold `width · height` values.
    pub fn new(width: usize, height: usize, data: Vec<T>) -> Result<Self> {
        let raster = Self { width, height, data };
        raster.check("the image")?;
        Ok(raster)
    }

    /// The value at column `x`, row `y`.
    pub fn at(&self, x: usize, y: usize) -> &T {
        &self.data[y * self.width + x]
    }

    /// That it holds a value per pixel, which its fields do not promise; `what` names it in the error.
    pub(crate) fn check(&self, what: &str) -> Result<()> {
        if self.width.checked_mul(self.height) == Some(self.data.len()) {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "{what} holds {} values; expected one for each of its {} pixels",
            self.data.len(),
            times(self.size())
        )))
    }

    /// The value at the texture coordinates `uv`, which are clamped to [0, 1]; v points down. `None` without pixels.
    pub fn nearest(&self, uv: Vec2) -> Option<&T> {
        let place = |x: f32, size: usize| ((x * size as f32).max(0.0) as usize).min(size.saturating_sub(1));
        self.data.get(place(uv.y, self.height) * self.width + place(uv.x, self.width))
    }

    /// Indices of the four values around a place in pixels, centres at halves, with the weights of a bilinear look-up,
    /// which sum to 1. Left and right meet where the image `wraps`; other borders are repeated. The image has pixels.
    pub(crate) fn around(&self, place: DVec2, wraps: bool) -> [(usize, f32); 4] {
        let corner = (place - 0.5).floor();
        let t = (place - 0.5 - corner).as_vec2();
        let within = |at: f64, size: usize| at.clamp(0.0, (size - 1) as f64) as usize;
        let share = |far: bool, t: f32| if far { t } else { 1.0 - t };
        [(false, false), (true, false), (false, true), (true, true)].map(|(right, lower)| {
            let x = corner.x + f64::from(u8::from(right));
            let x = within(if wraps { x.rem_euclid(self.width as f64) } else { x }, self.width);
            let y = within(corner.y + f64::from(u8::from(lower)), self.height);
            (y * self.width + x, share(right, t.x) * share(lower, t.y))
        })
    }

    /// `[width, height]`.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Applies `f` to every value.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Raster<U> {
        Raster { width: self.width, height: self.height, data: self.data.iter().map(f).collect() }
    }
}

impl<T: Copy> Raster<T> {
    /// An array with one value, made by `one`, of every square of `factor` × `factor`; what does not fill a square is
    /// cut off. Factors of 0 and 1 leave it as it is.
    pub fn reduced(self, factor: usize, one: impl Fn(&[T]) -> T) -> Self {
        if factor <= 1 {
            return self;
        }
        let (width, height) = (self.width / factor, self.height / factor);
        let square = |i: usize| -> Vec<T> {
            let (x, y) = (i % width * factor, i / width * factor);
            (0..factor).flat_map(|row| &self.data[(y + row) * self.width + x..][..factor]).copied().collect()
        };
        Self { width, height, data: (0..width * height).map(|i| one(&square(i))).collect() }
    }
}

impl Rgb {
    /// Pixels with a finite value in all channels.
    pub fn finite(&self) -> Mask {
        self.map(|pixel| pixel.iter().all(|v| v.is_finite()))
    }

    /// That it is an image of radiance that light may have; `what` names it in the error.
    pub(crate) fn check_radiance(&self, what: &str) -> Result<()> {
        self.check(what)?;
        let impossible = |pixel: &[f32; 3]| !pixel.iter().all(|v| (0.0..=MAX_RADIANCE).contains(v));
        let Some(i) = self.data.iter().position(impossible) else { return Ok(()) };
        Err(Error::invalid(format!(
            "{what} has radiance {:?} in column {}, row {}; expected 0 to {MAX_RADIANCE:e}",
            self.data[i],
            i % self.width,
            i / self.width
        )))
    }
}

impl Gray {
    /// The value at a place in pixels, bilinear between centres: see [`Raster::around`].
    pub(crate) fn bilinear(&self, place: DVec2, wraps: bool) -> f32 {
        self.around(place, wraps).iter().map(|&(at, weight)| weight * self.data[at]).sum()
    }
}

impl Mask {
    /// Pixels that both masks keep. Errors unless they have one size.
    pub fn and(&self, other: &Self) -> Result<Self> {
        if self.size() != other.size() {
            return Err(Error::invalid(format!(
                "masks of {} and {} pixels are combined; expected masks of one size",
                times(self.size()),
                times(other.size())
            )));
        }
        Self::new(self.width, self.height, self.data.iter().zip(&other.data).map(|(a, b)| *a && *b).collect())
    }
}

/// Luminance of linear RGB (Rec. 709 primaries).
pub fn luminance(rgb: &[f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

/// Mean of the channels of linear RGB; [`luminance`] weighs them as eyes do.
pub(crate) fn mean_of_channels(rgb: impl Into<[f32; 3]>) -> f32 {
    rgb.into().iter().sum::<f32>() / 3.0
}

/// Mean of pixels, channel by channel.
pub(crate) fn mean_pixel(pixels: &[[f32; 3]]) -> [f32; 3] {
    std::array::from_fn(|c| pixels.iter().map(|pixel| pixel[c]).sum::<f32>() / pixels.len() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_pixels_has_no_nearest_one() {
        let [empty, image] = [(0, 0, vec![]), (2, 1, vec![1.0, 2.0])].map(|(w, h, d)| Gray::new(w, h, d).unwrap());
        let corners = [Vec2::ZERO, Vec2::ONE, Vec2::splat(f32::NAN)];
        assert_eq!(corners.map(|uv| empty.nearest(uv)), [None; 3]);
        assert_eq!(corners.map(|uv| image.nearest(uv)), [Some(&1.0), Some(&2.0), Some(&1.0)]);
    }

    #[test]
    fn masks_of_two_sizes_are_not_combined() {
        let [wide, high] = [(2, 1), (1, 2)].map(|(width, height)| Mask::filled(width, height, true));
        assert!(wide.and(&high).unwrap_err().to_string().contains("2×1 and 1×2"));
        assert_eq!(wide.and(&wide).unwrap(), wide);
    }

    #[test]
    fn a_look_up_is_exact_at_centres_and_wraps_or_repeats_borders() {
        let image = Gray { width: 4, height: 2, data: vec![1.0, 2.0, 4.0, 8.0, 10.0, 20.0, 40.0, 80.0] };
        let value = |x: f64, y: f64, wraps: bool| image.bilinear(DVec2::new(x, y), wraps);
        assert_eq!(value(2.5, 1.5, false), 40.0);
        assert_eq!(value(1.0, 1.0, false), (1.0 + 2.0 + 10.0 + 20.0) / 4.0);
        assert_eq!(value(1.75, 0.5, false), 0.75 * 2.0 + 0.25 * 4.0);
        // Borders: half a pixel outside of the first centre, and far outside.
        assert_eq!([value(0.0, 0.5, false), value(-7.0, -7.0, false), value(9.0, 9.0, false)], [1.0, 1.0, 80.0]);
        assert_eq!([value(0.0, 0.5, true), value(4.0, 0.5, true), value(4.5, 0.5, true)], [4.5, 4.5, 1.0]);
    }
}
