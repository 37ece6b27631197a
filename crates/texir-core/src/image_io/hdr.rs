//! Radiance HDR (RGBE): 8 bits of mantissa, relative precision 0.4 % of the largest channel.

use std::io::Write;
use std::path::Path;

use image::codecs::hdr::HdrEncoder;

use crate::atomic_file::write_atomic;
use crate::error::Result;
use crate::raster::Rgb;

/// Writes linear RGB as Radiance HDR.
pub fn write_hdr(path: impl AsRef<Path>, image: &Rgb) -> Result<()> {
    write_atomic(path, |sink| encode_hdr(image, sink))
}

/// Encodes linear RGB as Radiance HDR.
pub fn encode_hdr(image: &Rgb, sink: impl Write) -> image::ImageResult<()> {
    let pixels: Vec<image::Rgb<f32>> = image.data.iter().map(|rgb| image::Rgb(*rgb)).collect();
    HdrEncoder::new(sink).encode(&pixels, image.width, image.height)
}
