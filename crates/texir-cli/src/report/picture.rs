//! Pictures of the report: rasters to 8-bit images, inline in the page.

use std::io::Cursor;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::FilterType;
use image::{ImageError, RgbImage};
use texir_core::metrics::encode;
use texir_core::raster::{Gray, Mask, Raster, Rgb};

use crate::failure::Failure;

/// Quality of the page's JPEGs: no visible blocks at twice their size, a sixth of the bytes of a PNG.
const JPEG_QUALITY: u8 = 90;

/// Longer side that textures are reduced to, pixels.
const TEXTURE_SIDE: u32 = 1024;

/// Difference of display values that the error colours end at.
pub const ERROR_RANGE: f32 = 0.25;

/// Colours of the error maps, equally spaced from 0 to [`ERROR_RANGE`]: dark to bright, distinct in grey as well.
pub const ERROR_COLOURS: [[u8; 3]; 6] =
    [[10, 10, 22], [59, 22, 104], [146, 40, 112], [220, 84, 74], [248, 164, 58], [253, 244, 186]];

/// Pixels that do not count, in the error maps.
pub const UNCOUNTED: [u8; 3] = [112, 116, 124];

/// An image file held in memory.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `data:` address of the encoded image.
    pub data_uri: String,
}

impl Picture {
    /// A picture that is already a PNG file.
    pub fn from_png(bytes: &[u8]) -> Result<Self, Failure> {
        let (width, height) = image::load_from_memory(bytes).map_err(not_encoded)?.to_rgb8().dimensions();
        Ok(Self { width, height, data_uri: format!("data:image/png;base64,{}", STANDARD.encode(bytes)) })
    }

    /// Linear RGB, shown as the metrics see it: clamp(x^(1/2.2), 0, 1).
    pub fn linear(image: &Rgb) -> Result<Self, Failure> {
        Self::jpeg(&rgb8(&image.map(|p| p.map(encode))))
    }

    /// Values in [0, 1], shown as they are: 0 black, 1 white.
    pub fn values(image: &Gray) -> Result<Self, Failure> {
        Self::jpeg(&rgb8(&image.map(|&v| [v; 3])))
    }

    /// A linear RGB texture, reduced to fit the page.
    pub fn linear_texture(image: &Rgb) -> Result<Self, Failure> {
        Self::jpeg(&reduced(rgb8(&image.map(|p| p.map(encode)))))
    }

    /// A texture of values in [0, 1], reduced to fit the page.
    pub fn value_texture(image: &Gray) -> Result<Self, Failure> {
        Self::jpeg(&reduced(rgb8(&image.map(|&v| [v; 3]))))
    }

    /// Absolute difference of two linear images as they are shown, mean over channels.
    pub fn linear_error(a: &Rgb, b: &Rgb, mask: &Mask) -> Result<Self, Failure> {
        Self::error(
            a.data
                .iter()
                .zip(&b.data)
                .map(|(p, q)| (0..3).map(|c| (encode(p[c]) - encode(q[c])).abs()).sum::<f32>() / 3.0),
            mask,
        )
    }

    /// Absolute difference of two images of values.
    pub fn value_error(a: &Gray, b: &Gray, mask: &Mask) -> Result<Self, Failure> {
        Self::error(a.data.iter().zip(&b.data).map(|(p, q)| (p - q).abs()), mask)
    }

    fn error(differences: impl Iterator<Item = f32>, mask: &Mask) -> Result<Self, Failure> {
        let colours = differences.zip(&mask.data).flat_map(|(d, &counts)| if counts { colour(d) } else { UNCOUNTED });
        let (width, height) = (mask.width as u32, mask.height as u32);
        let image = RgbImage::from_raw(width, height, colours.collect())
            .ok_or_else(|| Failure::new("an error map and its mask differ in size"))?;
        Self::jpeg(&image)
    }

    fn jpeg(image: &RgbImage) -> Result<Self, Failure> {
        let mut bytes = Cursor::new(Vec::new());
        JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).encode_image(image).map_err(not_encoded)?;
        Ok(Self {
            width: image.width(),
            height: image.height(),
            data_uri: format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes.into_inner())),
        })
    }
}

/// Colour of a difference, linear between [`ERROR_COLOURS`].
fn colour(difference: f32) -> [u8; 3] {
    let last = ERROR_COLOURS.len() - 1;
    let position = (difference / ERROR_RANGE).clamp(0.0, 1.0) * last as f32;
    let low = (position as usize).min(last - 1);
    let f = position - low as f32;
    std::array::from_fn(|c| {
        let (a, b) = (f32::from(ERROR_COLOURS[low][c]), f32::from(ERROR_COLOURS[low + 1][c]));
        (a + (b - a) * f).round() as u8
    })
}

/// Display values in [0, 1] to 8 bits.
fn rgb8(image: &Raster<[f32; 3]>) -> RgbImage {
    RgbImage::from_fn(image.width as u32, image.height as u32, |x, y| {
        image::Rgb(image.at(x as usize, y as usize).map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8))
    })
}

fn reduced(image: RgbImage) -> RgbImage {
    let side = image.width().max(image.height());
    if side <= TEXTURE_SIDE {
        return image;
    }
    let scale = |n: u32| (u64::from(n) * u64::from(TEXTURE_SIDE) / u64::from(side)).max(1) as u32;
    image::imageops::resize(&image, scale(image.width()), scale(image.height()), FilterType::Triangle)
}

fn not_encoded(error: ImageError) -> Failure {
    Failure::new(format!("a picture of the report could not be made: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_run_from_end_to_end_and_brighten() {
        assert_eq!(colour(0.0), ERROR_COLOURS[0]);
        assert_eq!(colour(9.0), ERROR_COLOURS[5]);
        let luma = |d: f32| colour(d).iter().zip([0.2126, 0.7152, 0.0722]).map(|(&c, w)| f32::from(c) * w).sum::<f32>();
        let lumas: Vec<f32> = (0..=20).map(|i| luma(ERROR_RANGE * i as f32 / 20.0)).collect();
        assert!(lumas.windows(2).all(|w| w[1] > w[0]), "{lumas:?}");
    }

    #[test]
    fn textures_shrink_and_keep_their_shape() {
        let picture = Picture::value_texture(&Gray::filled(2048, 1024, 0.5)).unwrap();
        assert_eq!((picture.width, picture.height), (1024, 512));
        let picture = Picture::values(&Gray::filled(20, 10, 0.5)).unwrap();
        assert_eq!((picture.width, picture.height), (20, 10));
        assert!(picture.data_uri.starts_with("data:image/jpeg;base64,/9j/"));
    }
}
