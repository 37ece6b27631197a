//! Colours of glTF materials: a factor times an image, looked up bilinearly and made linear.

use std::borrow::Cow;
use std::io::Cursor;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use glam::{Affine2, DVec3, Vec2, Vec3};
use gltf::buffer::Data;
use gltf::image::Source;
use gltf::texture::{Info, WrappingMode};
use image::{ImageReader, RgbImage};

use crate::error::{Error, Result};
use crate::image_io::{TransferCurve, limits};

/// A factor and the image that it scales.
pub(super) struct Colour {
    pub factor: Vec3,
    pub texture: Option<Texture>,
    /// How the image encodes what it holds.
    pub curve: TransferCurve,
}

impl Colour {
    /// Linear RGB at the place that `uv` tells of every set of coordinates; zero in those that it does not know.
    pub fn at(&self, uv: impl Fn(usize) -> Option<Vec2>, images: &[Option<RgbImage>]) -> Vec3 {
        let texel = self.texture.as_ref().and_then(|texture| {
            let uv = uv(texture.set).unwrap_or_default();
            Some(texture.at(uv, images.get(texture.image)?.as_ref()?, self.curve))
        });
        self.factor * texel.unwrap_or(Vec3::ONE)
    }

    /// Linear RGB, the mean over the whole image.
    pub fn mean(&self, images: &[Option<RgbImage>]) -> Vec3 {
        let image = self.texture.as_ref().and_then(|texture| images.get(texture.image)?.as_ref());
        let Some(image) = image else { return self.factor };
        let linear: [f64; 256] = std::array::from_fn(|v| f64::from(decoded_byte(self.curve, v as u8)));
        let sum =
            image.pixels().fold(DVec3::ZERO, |sum, pixel| sum + DVec3::from(pixel.0.map(|v| linear[usize::from(v)])));
        self.factor * (sum / image.pixels().len() as f64).as_vec3()
    }
}

/// How a material uses an image.
pub(super) struct Texture {
    /// Index of the image in the document.
    pub image: usize,
    /// Which TEXCOORD.
    pub set: usize,
    image_from_uv: Affine2,
    wrap: [WrappingMode; 2],
}

impl Texture {
    /// From a material's reference, `KHR_texture_transform` included.
    pub fn new(info: &Info) -> Self {
        let transform = info.texture_transform();
        let set = transform.as_ref().and_then(|t| t.tex_coord()).unwrap_or(info.tex_coord()) as usize;
        // The extension turns coordinates counter-clockwise as seen, and v points down.
        let image_from_uv = transform.map_or(Affine2::IDENTITY, |t| {
            Affine2::from_scale_angle_translation(t.scale().into(), -t.rotation(), t.offset().into())
        });
        let sampler = info.texture().sampler();
        let wrap = [sampler.wrap_s(), sampler.wrap_t()];
        Self { image: info.texture().source().index(), set, image_from_uv, wrap }
    }

    fn at(&self, uv: Vec2, image: &RgbImage, curve: TransferCurve) -> Vec3 {
        let size = Vec2::new(image.width() as f32, image.height() as f32);
        // Texel centres are at half-integers.
        let place = self.image_from_uv.transform_point2(uv) * size - 0.5;
        let (low, f) = (place.floor(), place - place.floor());
        let pixel = |dx: f32, dy: f32| {
            let x = wrapped(low.x + dx, image.width(), self.wrap[0]);
            let y = wrapped(low.y + dy, image.height(), self.wrap[1]);
            Vec3::from(image.get_pixel(x, y).0.map(|v| decoded_byte(curve, v)))
        };
        let row = |dy: f32| pixel(0.0, dy).lerp(pixel(1.0, dy), f.x);
        row(0.0).lerp(row(1.0), f.y)
    }
}

/// The pixel that stands for whole-numbered place `at` of a row of `size`.
fn wrapped(at: f32, size: u32, mode: WrappingMode) -> u32 {
    let n = size as f32;
    let inside = match mode {
        WrappingMode::ClampToEdge => at,
        WrappingMode::Repeat => at.rem_euclid(n),
        WrappingMode::MirroredRepeat => {
            let turn = at.rem_euclid(2.0 * n);
            turn.min(2.0 * n - 1.0 - turn)
        }
    };
    (inside.max(0.0) as u32).min(size - 1)
}

/// What eight bits stand for.
fn decoded_byte(curve: TransferCurve, v: u8) -> f32 {
    curve.decode(f32::from(v) / 255.0)
}

/// An image's file as it stands in the document: a buffer view, a data URI or a file beside it.
pub(super) fn encoded<'a>(path: &Path, image: &gltf::Image<'a>, buffers: &'a [Data]) -> Result<Cow<'a, [u8]>> {
    let failed = |what: &dyn std::fmt::Display| Error::file(path, format!("image {}: {what}", image.index()));
    match image.source() {
        Source::View { view, .. } => {
            let buffer = buffers.get(view.buffer().index());
            let end = view.offset().checked_add(view.length());
            end.and_then(|end| buffer?.0.get(view.offset()..end))
                .map(Cow::Borrowed)
                .ok_or_else(|| failed(&"reaches beyond its buffer"))
        }
        Source::Uri { uri, .. } => match uri.strip_prefix("data:") {
            Some(data) => {
                let (_, text) = data.split_once(";base64,").ok_or_else(|| failed(&"is a data URI without base64"))?;
                BASE64.decode(text).map(Cow::Owned).map_err(|e| failed(&e))
            }
            None => {
                let name = urlencoding::decode(uri).map_err(|e| failed(&e))?;
                let file = path.parent().unwrap_or(Path::new("")).join(&*name);
                let read = std::fs::read(&file).map(Cow::Owned);
                read.map_err(|e| failed(&format!("{} cannot be read: {e}", file.display())))
            }
        },
    }
}

/// Decodes a PNG or JPEG.
pub(super) fn decoded(path: &Path, image: &gltf::Image, buffers: &[Data]) -> Result<RgbImage> {
    let bytes = encoded(path, image, buffers)?;
    let failed = |e: &dyn std::fmt::Display| Error::file(path, format!("image {}: {e}", image.index()));
    let mut reader = ImageReader::new(Cursor::new(&*bytes)).with_guessed_format().map_err(|e| failed(&e))?;
    reader.limits(limits(bytes.len() as u64));
    let decoded = reader.decode().map_err(|e| failed(&e))?.into_rgb8();
    if decoded.width() == 0 || decoded.height() == 0 {
        return Err(failed(&"has no pixels"));
    }
    Ok(decoded)
}
