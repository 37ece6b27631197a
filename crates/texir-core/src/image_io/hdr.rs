//! Radiance HDR (RGBE): 8 bits of mantissa, relative precision 0.4 % of the largest channel.

use std::io::Write;
use std::path::Path;

use image::codecs::hdr::HdrEncoder;

use super::ImageRows;
use crate::atomic_file::write_atomic;
use crate::error::{Error, Result};

/// Writes linear RGB as Radiance HDR.
pub fn write_hdr<'a>(path: impl AsRef<Path>, image: impl Into<ImageRows<'a, 3>>) -> Result<()> {
    write_atomic(path, |sink| encode_hdr(image, sink))
}

/// Encodes linear RGB as Radiance HDR.
pub fn encode_hdr<'a>(image: impl Into<ImageRows<'a, 3>>, mut sink: impl Write) -> Result<()> {
    let image = image.into();
    let [width, height] = image.size();
    image.each(|rows, pixels| {
        let pixels: Vec<image::Rgb<f32>> = pixels.iter().map(|rgb| image::Rgb(*rgb)).collect();
        let mut encoded = Vec::new();
        HdrEncoder::new(&mut encoded).encode(&pixels, width, rows.len()).map_err(Error::invalid)?;
        // An image of these rows alone: between its header and its pixels stands its size.
        let blank = encoded.windows(2).position(|two| two == b"\n\n").map_or(0, |at| at + 2);
        let size = encoded[blank..].iter().position(|byte| *byte == b'\n').map_or(0, |at| at + 1);
        let (header, encoded) = (&encoded[..blank], &encoded[blank + size..]);
        if rows.start == 0 {
            sink.write_all(header).and_then(|()| writeln!(sink, "-Y {height} +X {width}")).map_err(Error::invalid)?;
        }
        sink.write_all(encoded).map_err(Error::invalid)
    })
}
