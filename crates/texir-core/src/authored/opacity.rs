//! What of a surface light meets: alpha (`alphaMode`) and `KHR_materials_transmission`.

use glam::{Vec2, Vec3};
use gltf::Material;
use gltf::material::AlphaMode;
use serde_json::Value;

use super::texture::{Alpha, Images, Texture};
use crate::scene::TriangleOpacity;

/// Parts along an edge of an image that is opaque in part, at least, for every texel of the lightmap along it: their
/// pattern is not to be seen in a soft shadow.
const PARTS_PER_TEXEL: f32 = 4.0;
/// Places that a part's opacity is looked up at.
const PLACES: u32 = 2;
/// Most parts along an edge, of any triangle.
const MOST_PARTS: f32 = 512.0;

/// The share of light that does not pass.
pub(super) struct Opacity {
    /// 1 − transmission.
    kept: f32,
    /// How opaque the rest is by its alpha, where no image tells.
    plain: f32,
    /// Where it is looked up.
    image: Option<Texture>,
    /// Whether that is between all and nothing in places.
    is_partial: bool,
}

/// A triangle as its opacity sees it.
pub(super) struct Cover<F> {
    /// The corners' coordinates of a set.
    pub corners: F,
    /// Texels of the lightmap along its longest edge.
    pub texels: f32,
}

/// What a material's alpha says.
pub(super) fn alpha(material: &Material) -> Alpha {
    let factor = material.pbr_metallic_roughness().base_color_factor()[3];
    match material.alpha_mode() {
        AlphaMode::Opaque => Alpha::Ignored,
        AlphaMode::Mask => Alpha::Cut { factor, cutoff: material.alpha_cutoff().unwrap_or(0.5) },
        AlphaMode::Blend => Alpha::Blended { factor },
    }
}

impl Opacity {
    /// Of what lets nothing through.
    pub const OPAQUE: Self = Self { kept: 1.0, plain: 1.0, image: None, is_partial: false };

    /// Of a material whose base colour has this texture. Transmission replaces what a surface reflects, not what it
    /// emits: what shines is there for light whatever it transmits.
    pub fn of(material: &Material, base_colour: Option<&Texture>, images: &Images) -> Self {
        let transmission = material.extension_value("KHR_materials_transmission");
        let transmission = transmission.filter(|_| material.emissive_factor() == [0.0; 3]);
        let transmission =
            transmission.and_then(|t| t.get("transmissionFactor")).and_then(Value::as_f64).unwrap_or(0.0);
        let kept = (1.0 - transmission as f32).clamp(0.0, 1.0);
        let plain = alpha(material).opacity(1.0);
        let image = base_colour.filter(|texture| images.opacities(texture).any(|opacity| opacity < 1.0)).cloned();
        let is_partial = |opacity: f32| opacity > 0.0 && opacity < 1.0;
        let is_partial =
            image.as_ref().is_some_and(|image| images.opacities(image).any(|opacity| is_partial(kept * opacity)));
        Self { kept, plain, image, is_partial }
    }

    /// Whether nothing passes, whatever of it is looked at.
    pub fn is_opaque(&self) -> bool {
        self.kept == 1.0 && self.plain == 1.0 && self.image.is_none()
    }

    /// How many parts a triangle's edge is to have.
    pub fn side(&self, cover: &Cover<impl Fn(usize) -> [Vec2; 3]>, images: &Images) -> u32 {
        let of_image = self.image.as_ref().map_or(1.0, |image| pixels(image, cover, images));
        let of_pattern = if self.is_partial { PARTS_PER_TEXEL * cover.texels } else { 1.0 };
        of_image.max(of_pattern).ceil().clamp(1.0, MOST_PARTS) as u32
    }

    /// What rays meet of a triangle of so many parts along each edge.
    pub fn over(
        &self,
        cover: &Cover<impl Fn(usize) -> [Vec2; 3]>,
        (side, seed): (u32, u32),
        images: &Images,
    ) -> TriangleOpacity {
        let Some(image) = &self.image else {
            return TriangleOpacity::from_coverage(side, seed, |_| self.kept * self.plain);
        };
        // Of the image as it is halved until a part is no wider than a pixel, through which edges run nonetheless.
        let level = (pixels(image, cover, images) / side as f32).max(1.0).log2().ceil() as usize;
        let places = lattice(PLACES);
        let [a, b, c] = (cover.corners)(image.placement.set).map(|uv| image.placement.place(uv));
        TriangleOpacity::from_coverage(side, seed, |part| {
            let [a, b, c] = part.map(|[u, v]| a + (b - a) * u + (c - a) * v);
            let places = places.iter().map(|place| a + (b - a) * place.x + (c - a) * place.y);
            self.kept * image.opacity(places, level, images)
        })
    }
}

/// Pixels of the image along a triangle's longest edge.
fn pixels(image: &Texture, cover: &Cover<impl Fn(usize) -> [Vec2; 3]>, images: &Images) -> f32 {
    longest((cover.corners)(image.placement.set).map(|uv| image.placement.place(uv) * image.size(images)))
}

/// The length of a triangle's longest edge.
pub(super) fn longest([a, b, c]: [Vec2; 3]) -> f32 {
    Vec3::new(a.distance(b), b.distance(c), c.distance(a)).max_element()
}

/// So many places in a triangle, by barycentric coordinates: a lattice of the golden ratio over the square, its upper
/// half folded onto the lower.
fn lattice(count: u32) -> Vec<Vec2> {
    let place = |k: u32| {
        let along = k as f32 + 0.5;
        let place = Vec2::new(along / count as f32, (along * 0.618_034).fract());
        if place.element_sum() > 1.0 { 1.0 - place } else { place }
    };
    (0..count).map(place).collect()
}
