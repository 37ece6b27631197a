//! What of a surface light meets: alpha (`alphaMode`) and `KHR_materials_transmission`.

use std::path::Path;

use glam::{Vec2, Vec3};
use gltf::Material;
use gltf::buffer::Data;
use gltf::material::AlphaMode;
use image::GrayImage;
use serde_json::Value;

use super::texture::{Placement, alpha};
use crate::error::Result;
use crate::scene::TriangleOpacity;

/// Parts along an edge of what is equally opaque all over, for every texel of the lightmap along it: their pattern is
/// not to be seen in the shadow.
const PARTS_PER_TEXEL: f32 = 4.0;
/// Most parts along an edge, of any triangle.
const MOST_PARTS: f32 = 512.0;
/// Most places that a part's opacity is looked up at. At least two, as edges run through parts as wide as a pixel.
const MOST_PLACES: f32 = 16.0;

/// The share of light that does not pass.
pub(super) struct Opacity {
    /// 1 − transmission.
    kept: f32,
    /// `None`: opaque.
    alpha: Option<Alpha>,
}

struct Alpha {
    factor: f32,
    /// Where alpha only tells what is there from what is not: the least alpha of what is there.
    cutoff: Option<f32>,
    image: Option<(Placement, GrayImage)>,
}

/// A triangle as its opacity sees it.
pub(super) struct Cover<F> {
    /// The corners' coordinates of a set.
    pub corners: F,
    /// Texels of the lightmap along its longest edge.
    pub texels: f32,
}

impl Opacity {
    /// Of what lets nothing through.
    pub const OPAQUE: Self = Self { kept: 1.0, alpha: None };

    /// Errors on an image that cannot be read. Transmission replaces what a surface reflects, not what it emits: what
    /// shines is there for light whatever it transmits.
    pub fn of(path: &Path, material: &Material, buffers: &[Data]) -> Result<Self> {
        let transmission = material.extension_value("KHR_materials_transmission");
        let transmission = transmission.filter(|_| material.emissive_factor() == [0.0; 3]);
        let transmission =
            transmission.and_then(|t| t.get("transmissionFactor")).and_then(Value::as_f64).unwrap_or(0.0);
        let base = material.pbr_metallic_roughness();
        let of_base = |cutoff| -> Result<Alpha> {
            let info = base.base_color_texture();
            let image = info.map(|info| {
                let channel = alpha(path, &info.texture().source(), buffers)?;
                Ok(channel.map(|channel| (Placement::new(&info), channel)))
            });
            Ok(Alpha { factor: base.base_color_factor()[3], cutoff, image: image.transpose()?.flatten() })
        };
        let alpha = match material.alpha_mode() {
            AlphaMode::Opaque => None,
            AlphaMode::Mask => Some(of_base(Some(material.alpha_cutoff().unwrap_or(0.5)))?),
            AlphaMode::Blend => Some(of_base(None)?),
        };
        Ok(Self { kept: (1.0 - transmission as f32).clamp(0.0, 1.0), alpha })
    }

    /// Whether nothing passes, whatever the images hold.
    pub fn is_opaque(&self) -> bool {
        self.kept == 1.0 && self.alpha.is_none()
    }

    /// How many parts a triangle's edge is to have: as many as its longest has pixels of the image.
    pub fn side(&self, cover: &Cover<impl Fn(usize) -> [Vec2; 3]>) -> u32 {
        let parts = match self.pixels(cover) {
            Some(pixels) => pixels,
            None if self.plain() == 0.0 || self.plain() == 1.0 => 1.0,
            None => PARTS_PER_TEXEL * cover.texels,
        };
        parts.ceil().clamp(1.0, MOST_PARTS) as u32
    }

    /// What rays meet of a triangle of so many parts along each edge.
    pub fn over(&self, cover: &Cover<impl Fn(usize) -> [Vec2; 3]>, side: u32, seed: u32) -> TriangleOpacity {
        let Some((alpha, (placement, channel))) = self.image() else {
            let plain = self.plain();
            return TriangleOpacity::from_coverage(side, seed, |_| plain);
        };
        let per_part = self.pixels(cover).unwrap_or(0.0) / side as f32;
        let places = (2.0 * per_part * per_part).ceil().clamp(2.0, MOST_PLACES) as u32;
        let [a, b, c] = (cover.corners)(placement.set);
        TriangleOpacity::from_coverage(side, seed, |part| {
            let corners = part.map(|[u, v]| a + (b - a) * u + (c - a) * v);
            self.kept * alpha.over(corners, placement, channel, places)
        })
    }

    /// Where nothing is looked up.
    fn plain(&self) -> f32 {
        self.kept * self.alpha.as_ref().map_or(1.0, |alpha| alpha.opacity(1.0))
    }

    fn image(&self) -> Option<(&Alpha, &(Placement, GrayImage))> {
        self.alpha.as_ref().and_then(|alpha| Some((alpha, alpha.image.as_ref()?)))
    }

    /// Pixels of the image along the longest edge.
    fn pixels(&self, cover: &Cover<impl Fn(usize) -> [Vec2; 3]>) -> Option<f32> {
        let (_, (placement, channel)) = self.image()?;
        let size = Vec2::new(channel.width() as f32, channel.height() as f32);
        let [a, b, c] = (cover.corners)(placement.set).map(|uv| placement.place(uv) * size);
        Some(longest([a, b, c]))
    }
}

/// The length of a triangle's longest edge.
pub(super) fn longest([a, b, c]: [Vec2; 3]) -> f32 {
    Vec3::new(a.distance(b), b.distance(c), c.distance(a)).max_element()
}

impl Alpha {
    fn opacity(&self, of_image: f32) -> f32 {
        match self.cutoff {
            Some(cutoff) => f32::from(self.factor * of_image >= cutoff),
            None => (self.factor * of_image).clamp(0.0, 1.0),
        }
    }

    /// The mean over so many places between three corners.
    fn over(&self, [a, b, c]: [Vec2; 3], placement: &Placement, channel: &GrayImage, places: u32) -> f32 {
        let size = [channel.width() as usize, channel.height() as usize];
        let at = |k: u32| {
            // A lattice of the golden ratio over the square, its upper half folded onto the lower.
            let along = k as f32 + 0.5;
            let (u, v) = (along / places as f32, (along * 0.618_034).fract());
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let [x, y] = placement.pixel(a + (b - a) * u + (c - a) * v, size);
            self.opacity(f32::from(channel.get_pixel(x as u32, y as u32).0[0]) / 255.0)
        };
        (0..places).map(at).sum::<f32>() / places as f32
    }
}
