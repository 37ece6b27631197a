//! 8 and 16-bit images of photo programs: values that encode light by some curve, clipped at both ends.

use std::path::Path;
use std::str::FromStr;

use image::{ColorType, DynamicImage, ImageDecoder};

use super::{Format, decode, format_of, read_size, reader};
use crate::error::{Error, Result};
use crate::raster::{Mask, Raster, Rgb};

/// Encoded values at or above this share of the largest are taken to be clipped.
const CLIPPED: f32 = 254.5 / 255.0;

/// How an encoded value in [0, 1] stands for linear light in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TransferCurve {
    /// IEC 61966-2-1.
    Srgb,
    /// The value itself.
    Linear,
    /// value^γ.
    Gamma(f32),
}

impl TransferCurve {
    /// Linear light of an encoded value, both in [0, 1].
    pub fn decode(self, v: f32) -> f32 {
        let v = v.clamp(0.0, 1.0);
        match self {
            Self::Srgb if v <= 0.040_45 => v / 12.92,
            Self::Srgb => ((v + 0.055) / 1.055).powf(2.4),
            Self::Linear => v,
            Self::Gamma(gamma) => v.powf(gamma),
        }
    }
}

impl FromStr for TransferCurve {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "srgb" => Ok(Self::Srgb),
            "linear" => Ok(Self::Linear),
            _ => text
                .strip_prefix("gamma=")
                .and_then(|gamma| gamma.parse().ok())
                .filter(|gamma: &f32| *gamma > 0.0 && gamma.is_finite())
                .map(Self::Gamma)
                .ok_or_else(|| format!("{text:?} is no curve; expected srgb, linear or gamma=NUMBER")),
        }
    }
}

/// An image of encoded values.
#[derive(Clone, Debug, PartialEq)]
pub struct Encoded {
    /// Values in [0, 1], as encoded.
    pub values: Rgb,
    /// Where the image is not fully transparent, when it has an alpha channel.
    pub opaque: Option<Mask>,
    /// Bits per channel that the file has room for.
    pub bits: u32,
}

impl Encoded {
    /// Linear light in [0, 1], and how many pixels have a channel at the upper end: what they showed was brighter.
    pub fn decode(&self, curve: TransferCurve) -> (Rgb, usize) {
        let clipped = self.values.data.iter().filter(|p| p.iter().any(|v| *v >= CLIPPED)).count();
        (self.values.map(|p| p.map(|v| curve.decode(v))), clipped)
    }
}

/// True for PNG, JPEG and TIFF of whole numbers: what [`super::read_rgb`] refuses because its encoding is not known.
pub fn is_encoded(path: impl AsRef<Path>) -> Result<bool> {
    let path = path.as_ref();
    Ok(match format_of(path)? {
        Format::Png | Format::Jpeg => true,
        Format::OpenExr | Format::RadianceHdr => false,
        format @ Format::Tiff => {
            let decoder = reader(path, format)?.into_decoder().map_err(|e| Error::cannot_read(path, e))?;
            !matches!(decoder.color_type(), ColorType::Rgb32F | ColorType::Rgba32F)
        }
    })
}

/// Reads PNG, JPEG or TIFF of 8 or 16 bits per channel.
pub fn read_encoded(path: impl AsRef<Path>) -> Result<Encoded> {
    let path = path.as_ref();
    read_size(path)?;
    if !is_encoded(path)? {
        return Err(Error::file(path, "holds linear floats; expected PNG, JPEG or TIFF of 8 or 16 bits per channel"));
    }
    let decoded = decode(path, format_of(path)?).map_err(|what| Error::cannot_read(path, what))?;
    let bits = match decoded {
        DynamicImage::ImageLuma8(_) | DynamicImage::ImageLumaA8(_) => 8,
        DynamicImage::ImageRgb8(_) | DynamicImage::ImageRgba8(_) => 8,
        _ => 16,
    };
    let alpha = decoded.color().has_alpha();
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let (values, opaque) = if alpha {
        let rgba = decoded.into_rgba16();
        let opaque = rgba.pixels().map(|p| p.0[3] > 0).collect();
        let values = rgba.pixels().map(|p| [p.0[0], p.0[1], p.0[2]].map(unit)).collect();
        (values, Some(Raster::new(width, height, opaque)?))
    } else {
        (decoded.into_rgb16().pixels().map(|p| p.0.map(unit)).collect(), None)
    };
    Ok(Encoded { values: Raster::new(width, height, values)?, opaque, bits })
}

/// 16 bits as [0, 1]; 8-bit values were spread to 16 exactly.
fn unit(v: u16) -> f32 {
    f32::from(v) / f32::from(u16::MAX)
}
