//! Image files in and out: OpenEXR, Radiance HDR and float TIFF for linear values, PNG for labels, masks and previews.
//!
//! Files are recognised by their first bytes, not by their names. Every writer leaves a whole file or none
//! ([`crate::atomic_file`]).

mod encoded;
mod exr;
mod hdr;
mod ktx2;
mod png;
mod primaries;
mod rows;

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

pub use self::encoded::{Encoded, TransferCurve, is_encoded, read_encoded};
pub use self::exr::{write_gray, write_rgb};
pub use self::hdr::{encode_hdr, write_hdr};
pub use self::ktx2::{BRIGHTEST_HALF, write_ktx2};
pub use self::png::{encode_png, write_png_gray, write_png_labels, write_png_mask, write_png_rgb};
pub use self::rows::ImageRows;
use crate::error::{Error, Result};
use crate::raster::{Gray, Labels, Mask, Raster, Rgb};

/// Images with more pixels than this (16384²) are refused before memory is taken for them: a damaged header must not
/// bring the machine down.
const MAX_PIXELS: usize = 1 << 28;

/// An image has at most this many pixels for each byte of its file (a one-bit PNG of one colour comes to half of that):
/// a small damaged file must not ask for the memory of a large one.
const MAX_PIXELS_PER_BYTE: usize = 1 << 14;

/// Of a pixel: four channels of 32 bits.
const MAX_BYTES_PER_PIXEL: usize = 16;

/// What a file's first bytes say it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    OpenExr,
    RadianceHdr,
    Tiff,
    Png,
    Jpeg,
}

fn format_of(path: &Path) -> Result<Format> {
    let mut start = Vec::with_capacity(16);
    let file = File::open(path).map_err(|e| Error::cannot_read(path, e))?;
    file.take(16).read_to_end(&mut start).map_err(|e| Error::cannot_read(path, e))?;
    Ok(match start.as_slice() {
        [0x76, 0x2f, 0x31, 0x01, ..] => Format::OpenExr,
        [b'#', b'?', ..] => Format::RadianceHdr,
        [b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..] => Format::Tiff,
        [0x89, b'P', b'N', b'G', ..] => Format::Png,
        [0xff, 0xd8, 0xff, ..] => Format::Jpeg,
        _ => {
            return Err(Error::file(
                path,
                "is no image that texir knows; expected OpenEXR, Radiance HDR, float TIFF or PNG",
            ));
        }
    })
}

fn bytes_of(path: &Path) -> Result<u64> {
    Ok(std::fs::metadata(path).map_err(|e| Error::cannot_read(path, e))?.len())
}

/// An image of this size, read from `path`, fits the limits.
fn check_size(path: &Path, width: usize, height: usize) -> Result<()> {
    let bytes = bytes_of(path)?;
    let limit = usize::try_from(bytes).unwrap_or(usize::MAX).saturating_mul(MAX_PIXELS_PER_BYTE).min(MAX_PIXELS);
    match width.checked_mul(height) {
        Some(pixels) if (1..=limit).contains(&pixels) => Ok(()),
        _ => Err(Error::file(
            path,
            format!("is {width}×{height} pixels in {bytes} bytes; expected 1 to {limit} of them: is the file damaged?"),
        )),
    }
}

/// What decoding an image of so many bytes may allocate at once, bytes.
fn most_memory(bytes: u64) -> u64 {
    let most = |pixels: usize| (pixels * MAX_BYTES_PER_PIXEL) as u64;
    bytes.saturating_mul(most(MAX_PIXELS_PER_BYTE)).min(most(MAX_PIXELS))
}

/// The same for decoders that take limits.
pub(crate) fn limits(bytes: u64) -> Limits {
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(most_memory(bytes));
    limits
}

/// The general decoder, for all formats but OpenEXR.
fn reader(path: &Path, format: Format) -> Result<ImageReader<BufReader<File>>> {
    let file = File::open(path).map_err(|e| Error::cannot_read(path, e))?;
    let bytes = file.metadata().map_err(|e| Error::cannot_read(path, e))?.len();
    let format = match format {
        Format::RadianceHdr => ImageFormat::Hdr,
        Format::Tiff => ImageFormat::Tiff,
        Format::Jpeg => ImageFormat::Jpeg,
        Format::Png => ImageFormat::Png,
        Format::OpenExr => ImageFormat::OpenExr,
    };
    let mut reader = ImageReader::with_format(BufReader::new(file), format);
    reader.limits(limits(bytes));
    Ok(reader)
}

/// Decodes with the general decoder, or says what is wrong: with a JPEG that ends early as well, whose rest the decoder
/// would make up.
fn decode(path: &Path, format: Format) -> std::result::Result<DynamicImage, String> {
    if format == Format::Jpeg && !jpeg_has_end(&std::fs::read(path).map_err(|e| e.to_string())?) {
        return Err("it ends before its image does".to_owned());
    }
    reader(path, format).map_err(|e| e.to_string())?.decode().map_err(|e| e.to_string())
}

/// Whether the segments of a JPEG and the data between them go on to its EOI marker (ITU-T T.81, annex B); what follows
/// is not looked at.
fn jpeg_has_end(bytes: &[u8]) -> bool {
    const EOI: u8 = 0xd9;
    // Behind SOI.
    let mut at = 2;
    loop {
        let marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0x00 | 0x01 | 0xd0..=0xd7 | 0xff);
        let rest = bytes.get(at..).unwrap_or_default();
        let Some(found) = rest.windows(2).position(marker) else { return false };
        match rest[found + 1..] {
            [EOI, ..] => return true,
            [_, high, low, ..] => at += found + 2 + usize::from(u16::from_be_bytes([high, low])),
            _ => return false,
        }
    }
}

/// `(width, height)` from the file's header alone. For OpenEXR the display window counts.
pub fn read_size(path: impl AsRef<Path>) -> Result<[usize; 2]> {
    let path = path.as_ref();
    let [width, height] = match format_of(path)? {
        Format::OpenExr => exr::size(path)?,
        format => {
            let (width, height) = reader(path, format)?.into_dimensions().map_err(|e| Error::cannot_read(path, e))?;
            [width as usize, height as usize]
        }
    };
    check_size(path, width, height)?;
    Ok([width, height])
}

/// Errors when the file ends before its pixels do, as after an interrupted copy. OpenEXR is read without decompressing
/// it: looking through a whole capture costs little more than reading it from the disk.
pub fn check_whole(path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    read_size(path)?;
    let whole = match format_of(path)? {
        Format::OpenExr => exr::check_whole(path),
        format => decode(path, format).map(drop),
    };
    whole.map_err(|e| Error::file(path, format!(
                "cannot be read to its end ({e}): is it damaged, cut short, or of a kind that is not read? copy or export it \
                 again"
            )))
}

/// Linear RGB of Rec. 709: OpenEXR (half, float; channels R, G, B, also under a layer's name, or Y alone; converted
/// where the header has other `chromaticities`), Radiance HDR (divided by the exposure in its header, as the format
/// asks), 32-bit float TIFF. 8-bit formats are refused: their encoding and their clipping are unknown.
pub fn read_rgb(path: impl AsRef<Path>) -> Result<Rgb> {
    read_rgb_with(path.as_ref(), 0.0)
}

/// [`read_rgb`] of a photo: NaN where an OpenEXR shows nothing, outside of its data window or where its alpha is 0.
pub fn read_photo(path: impl AsRef<Path>) -> Result<Rgb> {
    read_rgb_with(path.as_ref(), f32::NAN)
}

fn read_rgb_with(path: &Path, unknown: f32) -> Result<Rgb> {
    read_size(path)?;
    match format_of(path)? {
        Format::OpenExr => exr::read_rgb(path, unknown),
        Format::RadianceHdr => read_radiance_hdr(path),
        Format::Tiff => read_float_tiff(path),
        format @ (Format::Png | Format::Jpeg) => Err(Error::file(
            path,
            format!(
                "is a {format:?}, whose 8-bit values are neither linear nor unclipped; expected linear values as \
                 OpenEXR, Radiance HDR or float TIFF: merge bracketed exposures with `texir hdr`, or, knowing the curve, \
                 convert with `texir import --curve`"
            ),
        )),
    }
}

/// One linear channel: the only one, Y, or R of an OpenEXR; the same as any of R, G and B where a file has these.
pub fn read_gray(path: impl AsRef<Path>) -> Result<Gray> {
    let path = path.as_ref();
    match format_of(path)? {
        Format::OpenExr => exr::read_gray(path),
        _ => one_channel(path, &read_rgb(path)?),
    }
}

/// The one value of every pixel. Errors where channels differ: which of them is meant is not known.
fn one_channel(path: &Path, image: &Rgb) -> Result<Gray> {
    let bits = |pixel: &[f32; 3]| pixel.map(f32::to_bits);
    if let Some(i) = image.data.iter().position(|pixel| bits(pixel) != [pixel[0].to_bits(); 3]) {
        let (x, y, pixel) = (i % image.width, i / image.width, image.data[i]);
        return Err(Error::file(
            path,
            format!(
                "pixel ({x}, {y}) is {pixel:?}; expected one channel, or the same value in all three: save it as grey"
            ),
        ));
    }
    Ok(image.map(|pixel| pixel[0]))
}

/// Ids: PNG in grey or palette (the palette's index is the id), up to 16 bits; or the one channel of an OpenEXR.
pub fn read_labels(path: impl AsRef<Path>) -> Result<Labels> {
    let path = path.as_ref();
    read_size(path)?;
    match format_of(path)? {
        Format::Png => png::read_indices(path),
        Format::OpenExr => {
            let ids = exr::read_gray(path)?;
            if let Some(i) = ids.data.iter().position(|v| !(*v >= 0.0 && *v <= 65535.0 && v.fract() == 0.0)) {
                let (x, y) = (i % ids.width, i / ids.width);
                return Err(Error::file(
                    path,
                    format!("pixel ({x}, {y}) is {}; expected an id: a whole number of 0 to 65535", ids.data[i]),
                ));
            }
            Ok(ids.map(|v| *v as u16))
        }
        format => Err(Error::file(path, format!("is {format:?}; expected ids in a PNG (grey or palette) or OpenEXR"))),
    }
}

/// The colours of a PNG in colour or palette, 8-bit RGB as stored; `None` for other images, whose values are ids
/// ([`read_labels`]).
pub fn read_colors(path: impl AsRef<Path>) -> Result<Option<Raster<[u8; 3]>>> {
    let path = path.as_ref();
    read_size(path)?;
    if format_of(path)? != Format::Png || !png::is_colored(path)? {
        return Ok(None);
    }
    let decoded = reader(path, Format::Png)?.decode().map_err(|e| Error::cannot_read(path, e))?;
    let rgb = decoded.into_rgb8();
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    Raster::new(width, height, rgb.pixels().map(|p| p.0).collect()).map(Some)
}

/// True where any colour channel of a PNG, or the one channel of an OpenEXR, is not zero.
pub fn read_mask(path: impl AsRef<Path>) -> Result<Mask> {
    let path = path.as_ref();
    read_size(path)?;
    match format_of(path)? {
        Format::Png => {
            let decoded = reader(path, Format::Png)?.decode().map_err(|e| Error::cannot_read(path, e))?;
            let rgb = decoded.into_rgb16();
            let (width, height) = (rgb.width() as usize, rgb.height() as usize);
            Raster::new(width, height, rgb.pixels().map(|p| p.0 != [0; 3]).collect())
        }
        Format::OpenExr => Ok(exr::read_gray(path)?.map(|v| *v != 0.0)),
        format => Err(Error::file(path, format!("is {format:?}; expected a mask as PNG or OpenEXR (lossless)"))),
    }
}

fn read_radiance_hdr(path: &Path) -> Result<Rgb> {
    let file = BufReader::new(File::open(path).map_err(|e| Error::cannot_read(path, e))?);
    let decoder = image::codecs::hdr::HdrDecoder::new(file).map_err(|e| Error::cannot_read(path, e))?;
    let exposure = decoder.metadata().exposure.unwrap_or(1.0);
    if !(exposure > 0.0 && exposure.is_finite()) {
        return Err(Error::file(path, format!("EXPOSURE is {exposure}; expected a positive number")));
    }
    let (width, height) = decoder.dimensions();
    let decoded = DynamicImage::from_decoder(decoder).map_err(|e| Error::cannot_read(path, e))?;
    let data = decoded.into_rgb32f().pixels().map(|p| p.0.map(|v| v / exposure)).collect();
    Raster::new(width as usize, height as usize, data)
}

fn read_float_tiff(path: &Path) -> Result<Rgb> {
    let decoded = reader(path, Format::Tiff)?.decode().map_err(|e| Error::cannot_read(path, e))?;
    if !matches!(decoded, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) {
        return Err(Error::file(
            path,
            format!("holds {:?} pixels; expected 32-bit float RGB, the only TIFF known to be linear", decoded.color()),
        ));
    }
    let rgb = decoded.into_rgb32f();
    Raster::new(rgb.width() as usize, rgb.height() as usize, rgb.pixels().map(|p| p.0).collect())
}

/// Radiance beyond this is taken for no number: sums of it are none.
const LARGEST: f32 = 1e35;

/// How many pixels hold what no radiance can be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sanitised {
    /// Pixels with a channel that was NaN, infinite or as good as that: above 1e35.
    pub non_finite: usize,
    /// Pixels with a channel below zero.
    pub negative: usize,
}

impl Sanitised {
    /// Nothing had to be changed.
    pub fn is_clean(&self) -> bool {
        *self == Self::default()
    }
}

impl std::fmt::Display for Sanitised {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} pixels are NaN, infinite or above {LARGEST:e}, and {} negative: of the former nothing is known, channels of the \
             latter are taken as 0",
            self.non_finite, self.negative
        )
    }
}

/// Sets pixels with a channel that is NaN, infinite or above 1e35 to `unknown` in all channels, and negative channels
/// to 0; counts the pixels.
pub fn sanitise_radiance(image: &mut Rgb, unknown: f32) -> Sanitised {
    let mut found = Sanitised::default();
    for pixel in &mut image.data {
        if pixel.iter().any(|v| !(*v <= LARGEST)) {
            found.non_finite += 1;
            *pixel = [unknown; 3];
        } else if pixel.iter().any(|v| *v < 0.0) {
            found.negative += 1;
            *pixel = pixel.map(|v| v.max(0.0));
        }
    }
    found
}

/// The sRGB transfer function (IEC 61966-2-1): linear [0, 1] to encoded [0, 1]; values outside are clipped.
pub fn srgb_from_linear(v: f32) -> f32 {
    let v = v.clamp(0.0, 1.0);
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// Encodes linear RGB in [0, 1] as 8-bit sRGB; NaN becomes 0.
pub fn encode_srgb(linear: &Rgb) -> Raster<[u8; 3]> {
    linear.map(|rgb| rgb.map(|v| (srgb_from_linear(v) * 255.0).round() as u8))
}

#[cfg(test)]
mod tests;
