//! Two-dimensional arrays: images, atlases, masks and label maps.

use glam::Vec2;

use crate::error::{Error, Result};

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
        if data.len() == width * height {
            Ok(Self { width, height, data })
        } else {
            Err(Error::invalid(format!(
                "a {width}×{height} image needs {} values, {} given",
                width * height,
                data.len()
            )))
        }
    }

    /// The value at column `x`, row `y`.
    pub fn at(&self, x: usize, y: usize) -> &T {
        &self.data[y * self.width + x]
    }

    /// Index of the value that holds the texture coordinates `uv`, which are clamped to [0, 1]; v points down.
    pub fn nearest(&self, uv: Vec2) -> usize {
        let place = |x: f32, size: usize| ((x * size as f32).max(0.0) as usize).min(size - 1);
        place(uv.y, self.height) * self.width + place(uv.x, self.width)
    }

    /// `(width, height)`.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Applies `f` to every value.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Raster<U> {
        Raster { width: self.width, height: self.height, data: self.data.iter().map(f).collect() }
    }
}

impl<T: Copy> Raster<T> {
    /// An array with one value, made by `one`, of every square of `factor` × `factor`; what does not fill a square is cut off.
    pub fn reduced(self, factor: usize, one: impl Fn(&[T]) -> T) -> Self {
        if factor == 1 {
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

/// Luminance of linear RGB (Rec. 709 primaries).
pub fn luminance(rgb: &[f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}
