//! PNG: label maps with their indices untouched, masks, previews.

use std::fs::File;
use std::io::{BufReader, Write};
use std::path::Path;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use png::{BitDepth, ColorType, Decoder, Transformations};

use crate::atomic_file::write_atomic;
use crate::error::{Error, Result};
use crate::raster::{Gray, Labels, Mask, Raster};

/// Whether a PNG holds colours, its pixels' own or a palette's, rather than grey levels.
pub(super) fn is_colored(path: &Path) -> Result<bool> {
    let file = File::open(path).map_err(|e| Error::cannot_read(path, e))?;
    let reader = Decoder::new(BufReader::new(file)).read_info().map_err(|e| Error::cannot_read(path, e))?;
    Ok(!matches!(reader.info().color_type, ColorType::Grayscale | ColorType::GrayscaleAlpha))
}

/// Grey levels or palette indices as they are stored (the general decoder would replace an index by its colour).
pub(super) fn read_indices(path: &Path) -> Result<Labels> {
    let mut decoder = Decoder::new(BufReader::new(File::open(path).map_err(|e| Error::cannot_read(path, e))?));
    decoder.set_transformations(Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(|e| Error::cannot_read(path, e))?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let (colour, depth) = reader.output_color_type();
    if !matches!(colour, ColorType::Grayscale | ColorType::Indexed) {
        let what = format!(
            "is an {colour:?} PNG; expected ids in a grey or palette PNG, or a list of their colours: \"classes\" in \
             transforms.json"
        );
        return Err(Error::file(path, what));
    }
    let bytes = reader.output_buffer_size().ok_or_else(|| Error::cannot_read(path, "too large"))?;
    let mut packed = vec![0; bytes];
    let frame = reader.next_frame(&mut packed).map_err(|e| Error::cannot_read(path, e))?;
    let bits = match depth {
        BitDepth::One => 1,
        BitDepth::Two => 2,
        BitDepth::Four => 4,
        BitDepth::Eight => 8,
        BitDepth::Sixteen => 16,
    };
    let mut ids = Vec::with_capacity(width * height);
    for row in packed.chunks_exact(frame.line_size).take(height) {
        ids.extend((0..width).map(|x| match bits {
            16 => u16::from_be_bytes([row[2 * x], row[2 * x + 1]]),
            // Below eight bits the leftmost pixel is in the high bits of its byte.
            _ => {
                let shift = 8 - bits - (x * bits) % 8;
                u16::from(row[x * bits / 8] >> shift) & ((1 << bits) - 1)
            }
        }));
    }
    Raster::new(width, height, ids)
}

/// Encodes 8-bit RGB, values as they are, into `sink`.
pub fn encode_png(image: &Raster<[u8; 3]>, sink: impl Write) -> Result<()> {
    encode(sink, image.size(), bytemuck::cast_slice(&image.data), ExtendedColorType::Rgb8)
        .map_err(|e| Error::invalid(format!("an image cannot be encoded as PNG: {e}")))
}

/// Writes 8-bit RGB, values as they are: encode with [`super::encode_srgb`] first where a display is meant.
pub fn write_png_rgb(path: impl AsRef<Path>, image: &Raster<[u8; 3]>) -> Result<()> {
    write_atomic(path, |sink| encode_png(image, sink))
}

/// Writes [0, 1] as 8-bit grey, linearly; values outside are clipped.
pub fn write_png_gray(path: impl AsRef<Path>, image: &Gray) -> Result<()> {
    let levels: Vec<u8> = image.data.iter().map(|v| (v * 255.0).round() as u8).collect();
    write_atomic(path, |sink| encode(sink, image.size(), &levels, ExtendedColorType::L8))
}

/// Writes ids as grey levels: 8-bit where all fit, else 16-bit.
pub fn write_png_labels(path: impl AsRef<Path>, labels: &Labels) -> Result<()> {
    if labels.data.iter().all(|id| *id <= 255) {
        let levels: Vec<u8> = labels.data.iter().map(|id| *id as u8).collect();
        write_atomic(path, |sink| encode(sink, labels.size(), &levels, ExtendedColorType::L8))
    } else {
        // The encoder takes 16-bit values in the machine's byte order.
        let levels: &[u8] = bytemuck::cast_slice(&labels.data);
        write_atomic(path, |sink| encode(sink, labels.size(), levels, ExtendedColorType::L16))
    }
}

/// Writes true as 255 and false as 0.
pub fn write_png_mask(path: impl AsRef<Path>, mask: &Mask) -> Result<()> {
    let levels: Vec<u8> = mask.data.iter().map(|yes| if *yes { 255 } else { 0 }).collect();
    write_atomic(path, |sink| encode(sink, mask.size(), &levels, ExtendedColorType::L8))
}

fn encode(
    sink: impl Write,
    [width, height]: [usize; 2],
    bytes: &[u8],
    colour: ExtendedColorType,
) -> image::ImageResult<()> {
    PngEncoder::new(sink).write_image(bytes, width as u32, height as u32, colour)
}
