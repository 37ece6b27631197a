//! Colours of glTF materials: a factor times an image, made linear and averaged over what a texel of the lightmap shows
//! of it; of images with alpha, over what is opaque of that.

use std::borrow::Cow;
use std::io::Cursor;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use glam::{Affine2, Mat2, Vec2, Vec3, Vec4, Vec4Swizzles};
use gltf::buffer::Data;
use gltf::image::Source;
use gltf::texture::{Info, WrappingMode};
use half::f16;
use image::{DynamicImage, ImageReader, RgbaImage};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::image_io::{TransferCurve, limits};
use crate::mesh_io::gltf as geometry;
use crate::raster::Raster;
use crate::surface::TexelHit;

/// Most samples along each side of what is looked up: what is wider is looked up in a coarser image.
const SAMPLES: f32 = 4.0;
/// Where less than this share is opaque, nothing is known of the colour.
const OPAQUE: f32 = 1e-3;

/// A factor and the image that it scales.
pub(super) struct Colour {
    pub factor: Vec3,
    pub texture: Option<Texture>,
}

impl Colour {
    /// Linear RGB, the mean over a footprint on a triangle. `corners` tells the triangle's coordinates of a set;
    /// of those that it does not know the image's corner is looked up.
    pub fn over(&self, footprint: &Footprint, corners: impl Fn(usize) -> Option<[Vec2; 3]>, images: &Images) -> Vec3 {
        let texel = self.texture.as_ref().map(|texture| {
            let corners = corners(texture.placement.set).unwrap_or_default();
            texture.over(footprint, corners, &images.all[texture.image])
        });
        self.factor * texel.unwrap_or(Vec3::ONE)
    }

    /// Linear RGB, the mean over the whole image.
    pub fn mean(&self, images: &Images) -> Vec3 {
        self.factor * self.texture.as_ref().map_or(Vec3::ONE, |texture| images.all[texture.image].mean())
    }
}

/// What of a triangle a texel of the lightmap covers, or a part of a texel: a parallelogram in barycentric coordinates,
/// (u, v) as in [`TexelHit`].
pub(super) struct Footprint {
    centre: Vec2,
    /// Along the map's columns and along its rows.
    sides: [Vec2; 2],
    /// Whether what is beyond the triangle's edges belongs to it no more.
    ends: bool,
}

impl Footprint {
    /// Of the cell around a hit of a texel map, where `corners` are the triangle's place in the map, in cells.
    pub fn new(hit: &TexelHit, [a, b, c]: [Vec2; 3]) -> Self {
        let cells = Mat2::from_cols(b - a, c - a);
        let area = 0.5 * cells.determinant().abs();
        let sides = if area == 0.0 { Mat2::ZERO } else { cells.inverse() };
        // Most triangles go on in their neighbours. Where a chart ends, the cell's centre is as often outside, which
        // only touches it.
        let ends = area < 1.0 || !hit.inside;
        Self { centre: Vec2::new(hit.u, hit.v), sides: [sides.x_axis, sides.y_axis], ends }
    }

    /// All of the triangle.
    pub fn whole() -> Self {
        Self { centre: Vec2::splat(0.5), sides: [Vec2::X, Vec2::Y], ends: true }
    }

    /// Places in it, `counts` along its sides.
    fn places(&self, counts: [u32; 2]) -> impl Iterator<Item = Vec2> {
        let along = move |side: usize, i: u32| self.sides[side] * ((i as f32 + 0.5) / counts[side] as f32 - 0.5);
        (0..counts[0] * counts[1]).map(move |i| self.centre + along(0, i % counts[0]) + along(1, i / counts[0]))
    }
}

/// How a surface's coordinates lead to places in an image.
#[derive(Clone)]
pub(super) struct Placement {
    /// Which TEXCOORD.
    pub set: usize,
    image_from_uv: Affine2,
    wrap: [WrappingMode; 2],
}

impl Placement {
    /// From a material's reference, `KHR_texture_transform` included.
    pub fn new(info: &Info) -> Self {
        let transform = info.texture_transform();
        let set = transform.as_ref().and_then(|t| t.tex_coord()).unwrap_or(info.tex_coord()) as usize;
        // The extension turns coordinates counter-clockwise as seen, and v points down.
        let image_from_uv = transform.map_or(Affine2::IDENTITY, |t| {
            Affine2::from_scale_angle_translation(t.scale().into(), -t.rotation(), t.offset().into())
        });
        let sampler = info.texture().sampler();
        Self { set, image_from_uv, wrap: [sampler.wrap_s(), sampler.wrap_t()] }
    }

    /// Where coordinates of its set are in the image, whose sides are 1 each.
    pub fn place(&self, uv: Vec2) -> Vec2 {
        self.image_from_uv.transform_point2(uv)
    }
}

/// How a material uses an image.
#[derive(Clone)]
pub(super) struct Texture {
    /// Index into [`Images`].
    image: usize,
    pub placement: Placement,
}

impl Texture {
    /// From a material's reference; `image` is the place of its image in [`Images`].
    pub fn new(info: &Info, image: usize) -> Self {
        Self { image, placement: Placement::new(info) }
    }

    /// How opaque the image is on average, as it is halved `level` times, at places in it.
    pub fn opacity(&self, places: impl ExactSizeIterator<Item = Vec2>, level: usize, images: &Images) -> f32 {
        let (image, count) = (&images.all[self.image], places.len() as f32);
        let level = level.min(image.coarse.len());
        places.map(|place| image.opacity(level, place, self.placement.wrap)).sum::<f32>() / count
    }

    /// Columns and rows of its image.
    pub fn size(&self, images: &Images) -> Vec2 {
        images.all[self.image].size()
    }

    /// The mean over the footprint: images are finer than lightmaps, and what emits must not hang on where
    /// a few points fall.
    fn over(&self, footprint: &Footprint, corners: [Vec2; 3], image: &Image) -> Vec3 {
        let wrap = &self.placement.wrap;
        let [a, b, c] = corners.map(|uv| self.placement.place(uv));
        let pixels = |barycentric: Vec2| ((b - a) * barycentric.x + (c - a) * barycentric.y) * image.size();
        let widths = footprint.sides.map(|side| pixels(side).length());
        let level = (widths[0].max(widths[1]) / SAMPLES).log2().ceil().clamp(0.0, image.coarse.len() as f32);
        let counts = widths.map(|width| (width / level.exp2()).ceil().clamp(1.0, SAMPLES) as u32);
        let at = |place: Vec2| image.at(level as usize, a + (b - a) * place.x + (c - a) * place.y, *wrap);
        let inside = |place: &Vec2| !footprint.ends || (place.min_element() >= 0.0 && place.element_sum() <= 1.0);
        let (sum, count) = footprint
            .places(counts)
            .filter(inside)
            .fold((Vec4::ZERO, 0u32), |(sum, count), place| (sum + at(place), count + 1));
        let mean = if count == 0 { at(footprint.centre) } else { sum / count as f32 };
        if mean.w < OPAQUE { image.mean() } else { mean.xyz() / mean.w }
    }
}

/// What the alpha of pixels says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Alpha {
    /// Nothing: all is opaque.
    Ignored,
    /// What has at least `cutoff` after multiplication by `factor` is opaque, and nothing else.
    Cut { factor: f32, cutoff: f32 },
    /// How opaque it is after multiplication.
    Blended { factor: f32 },
}

impl Alpha {
    /// How opaque what has this alpha is, from 0 to 1.
    pub fn opacity(self, alpha: f32) -> f32 {
        match self {
            Self::Ignored => 1.0,
            Self::Cut { factor, cutoff } => f32::from(factor * alpha >= cutoff),
            Self::Blended { factor } => (factor * alpha).clamp(0.0, 1.0),
        }
    }
}

/// Images of a document, each as materials use it.
#[derive(Default)]
pub(super) struct Images {
    all: Vec<Image>,
    /// Index in the document, and what its values mean.
    keys: Vec<(usize, TransferCurve, Alpha)>,
}

impl Images {
    /// The place of an image whose values `curve` makes linear; it is decoded if it is not here yet.
    pub fn place(
        &mut self,
        path: &Path,
        image: &gltf::Image,
        buffers: &[Data],
        (curve, alpha): (TransferCurve, Alpha),
    ) -> Result<usize> {
        let key = (image.index(), curve, alpha);
        if let Some(place) = self.keys.iter().position(|known| *known == key) {
            return Ok(place);
        }
        self.all.push(Image::new(decoded(path, image, buffers)?, curve, alpha));
        self.keys.push(key);
        Ok(self.all.len() - 1)
    }

    /// How opaque the pixels of a texture's image are.
    pub fn opacities(&self, texture: &Texture) -> impl Iterator<Item = f32> {
        self.all[texture.image].fine.pixels().map(|pixel| f32::from(pixel.0[3]) / 255.0)
    }

    /// Bytes of all.
    pub fn memory(&self) -> u64 {
        let of = |image: &Image| {
            image.fine.as_raw().len() + image.coarse.iter().map(|level| size_of_val(&level.data[..])).sum::<usize>()
        };
        self.all.iter().map(|image| of(image) as u64).sum()
    }
}

/// An image and its mips, each of half the width and height of the one before (rounded up), down to one pixel.
struct Image {
    /// Its last channel is how opaque it is.
    fine: RgbaImage,
    /// Linear values of its eight bits.
    linear: [f32; 256],
    /// Linear RGB times how opaque it is, and that; pixels of one level are of one size.
    coarse: Vec<Raster<[f16; 4]>>,
}

impl Image {
    fn new(decoded: DynamicImage, curve: TransferCurve, alpha: Alpha) -> Self {
        let mut fine = decoded.into_rgba8();
        let opacity: [u8; 256] = std::array::from_fn(|v| (255.0 * alpha.opacity(v as f32 / 255.0)).round() as u8);
        fine.pixels_mut().for_each(|pixel| pixel.0[3] = opacity[usize::from(pixel.0[3])]);
        let mut image =
            Self { fine, linear: std::array::from_fn(|v| curve.decode(v as f32 / 255.0)), coarse: Vec::new() };
        loop {
            let level = image.coarse.len();
            let [width, height] = image.size_of(level);
            if width * height == 1 {
                return image;
            }
            let [columns, rows] = [width, height].map(halved);
            let mean = |i: usize| {
                let mut sum = Vec4::ZERO;
                for (y, of_row) in &rows[i / columns.len()] {
                    for (x, share) in &columns[i % columns.len()] {
                        sum += image.pixel(level, *x, *y) * share * of_row;
                    }
                }
                sum.to_array().map(f16::from_f32)
            };
            let data = (0..columns.len() * rows.len()).into_par_iter().map(mean).collect();
            image.coarse.push(Raster { width: columns.len(), height: rows.len(), data });
        }
    }

    fn size(&self) -> Vec2 {
        Vec2::new(self.fine.width() as f32, self.fine.height() as f32)
    }

    fn size_of(&self, level: usize) -> [usize; 2] {
        match level.checked_sub(1) {
            None => [self.fine.width() as usize, self.fine.height() as usize],
            Some(coarse) => [self.coarse[coarse].width, self.coarse[coarse].height],
        }
    }

    /// Linear RGB times how opaque the pixel is, and that.
    fn pixel(&self, level: usize, x: usize, y: usize) -> Vec4 {
        match level.checked_sub(1) {
            None => {
                let [r, g, b, opacity] = self.fine.get_pixel(x as u32, y as u32).0;
                let opacity = f32::from(opacity) / 255.0;
                (Vec3::from([r, g, b].map(|v| self.linear[usize::from(v)])) * opacity).extend(opacity)
            }
            Some(coarse) => Vec4::from(self.coarse[coarse].at(x, y).map(f16::to_f32)),
        }
    }

    /// How opaque the pixel at texture coordinates is.
    fn opacity(&self, level: usize, uv: Vec2, [across, down]: [WrappingMode; 2]) -> f32 {
        let [width, height] = self.size_of(level);
        let place = (uv * Vec2::new(width as f32, height as f32)).floor();
        let (x, y) = (wrapped(place.x, width, across), wrapped(place.y, height, down));
        match level.checked_sub(1) {
            None => f32::from(self.fine.get_pixel(x as u32, y as u32).0[3]) / 255.0,
            Some(coarse) => self.coarse[coarse].at(x, y)[3].to_f32(),
        }
    }

    /// Linear RGB of what is opaque; black where nothing is.
    fn mean(&self) -> Vec3 {
        let mean = self.pixel(self.coarse.len(), 0, 0);
        mean.xyz() / mean.w.max(f32::MIN_POSITIVE)
    }

    /// [`Self::pixel`] between pixels, at texture coordinates.
    fn at(&self, level: usize, uv: Vec2, wrap: [WrappingMode; 2]) -> Vec4 {
        let [width, height] = self.size_of(level);
        // Pixel centres are at half-integers.
        let place = uv * Vec2::new(width as f32, height as f32) - 0.5;
        let (low, f) = (place.floor(), place - place.floor());
        let pixel = |dx: f32, dy: f32| {
            self.pixel(level, wrapped(low.x + dx, width, wrap[0]), wrapped(low.y + dy, height, wrap[1]))
        };
        let row = |dy: f32| pixel(0.0, dy).lerp(pixel(1.0, dy), f.x);
        row(0.0).lerp(row(1.0), f.y)
    }
}

/// Of a row of `size` pixels as half as many, rounded up: the shares that each has of those.
fn halved(size: usize) -> Vec<Vec<(usize, f32)>> {
    let width = size as f32 / size.div_ceil(2) as f32;
    let shares = |i: usize| {
        let (start, end) = (i as f32 * width, (i + 1) as f32 * width);
        let share = move |x: usize| (end.min((x + 1) as f32) - start.max(x as f32)) / width;
        (start as usize..(end.ceil() as usize).min(size))
            .map(|x| (x, share(x)))
            .filter(|(_, share)| *share > 0.0)
            .collect()
    };
    (0..size.div_ceil(2)).map(shares).collect()
}

/// The pixel that stands for whole-numbered place `at` of a row of `size`.
fn wrapped(at: f32, size: usize, mode: WrappingMode) -> usize {
    let n = size as f32;
    let inside = match mode {
        // Most are, and remainders are slow.
        _ if (0.0..n).contains(&at) => at,
        WrappingMode::ClampToEdge => at,
        WrappingMode::Repeat => at.rem_euclid(n),
        WrappingMode::MirroredRepeat => {
            let turn = at.rem_euclid(2.0 * n);
            turn.min(2.0 * n - 1.0 - turn)
        }
    };
    (inside.max(0.0) as usize).min(size - 1)
}

/// What an image is called in messages: by its file, its name or its place in the document.
fn called(image: &gltf::Image) -> String {
    match (image.source(), image.name()) {
        (Source::Uri { uri, .. }, _) if !uri.starts_with("data:") => format!("image {} ({uri})", image.index()),
        (_, Some(name)) => format!("image {} (\"{name}\")", image.index()),
        _ => format!("image {}", image.index()),
    }
}

/// An image's file as it stands in the document: a buffer view, a data URI or a file beside it.
pub(super) fn encoded<'a>(path: &Path, image: &gltf::Image<'a>, buffers: &'a [Data]) -> Result<Cow<'a, [u8]>> {
    let failed = |what: &dyn std::fmt::Display| Error::file(path, format!("{}: {what}", called(image)));
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
                let file = geometry::beside(path, &name);
                geometry::check_is_file(&file).map_err(|what| failed(&format!("its file {name} {what}")))?;
                let read = std::fs::read(&file).map(Cow::Owned);
                read.map_err(|e| failed(&format!("{e}; expected it beside the scene: copy it there, or export a .glb")))
            }
        },
    }
}

/// Decodes a PNG or JPEG.
fn decoded(path: &Path, image: &gltf::Image, buffers: &[Data]) -> Result<DynamicImage> {
    let bytes = encoded(path, image, buffers)?;
    let failed = |e: &dyn std::fmt::Display| {
        let what = format!("{} cannot be decoded: {e}; expected a PNG or JPEG: export it as one", called(image));
        Error::file(path, what)
    };
    let mut reader = ImageReader::new(Cursor::new(&*bytes)).with_guessed_format().map_err(|e| failed(&e))?;
    reader.limits(limits(bytes.len() as u64));
    let decoded = reader.decode().map_err(|e| failed(&e))?;
    if decoded.width() == 0 || decoded.height() == 0 {
        return Err(failed(&"it has no pixels"));
    }
    Ok(decoded)
}
