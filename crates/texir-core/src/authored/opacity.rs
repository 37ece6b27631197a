//! How opaque a material leaves a surface: alpha (`alphaMode`) and `KHR_materials_transmission`.

use std::path::Path;

use glam::{Vec2, Vec3};
use gltf::Material;
use gltf::buffer::Data;
use gltf::material::AlphaMode;
use image::GrayImage;
use serde_json::Value;

use super::texture::{Placement, alpha};
use crate::error::Result;
use crate::mesh::cross;

/// Places that a surface is looked at, together; each of its triangles has at least one.
const PLACES: f32 = 4096.0;

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

impl Opacity {
    /// Of what lets nothing through.
    pub const OPAQUE: Self = Self { kept: 1.0, alpha: None };

    /// Errors on an image that cannot be read.
    pub fn of(path: &Path, material: &Material, buffers: &[Data]) -> Result<Self> {
        let transmission = material.extension_value("KHR_materials_transmission");
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

    /// The mean over a surface of such triangles, whose `uvs` are those of every TEXCOORD; 1 where nothing passes.
    pub fn over(&self, positions: &[Vec3], uvs: &[Vec<Vec2>], triangles: &[[u32; 3]]) -> f32 {
        let Some(alpha) = &self.alpha else { return self.kept };
        let area = |t: &[u32; 3]| cross(t.map(|i| positions[i as usize])).length();
        let whole: f32 = triangles.iter().map(area).sum();
        let of_triangle = |t: &[u32; 3]| {
            let share = area(t) / whole;
            let corners = |set: usize| uvs.get(set).map(|uvs| t.map(|i| uvs[i as usize])).unwrap_or_default();
            share * alpha.over(corners, (share * PLACES).ceil().max(1.0) as u32)
        };
        self.kept * triangles.iter().map(of_triangle).sum::<f32>()
    }
}

impl Alpha {
    /// The mean over so many places of a triangle, with its corners' coordinates of every set.
    fn over(&self, corners: impl Fn(usize) -> [Vec2; 3], places: u32) -> f32 {
        let opacity = |alpha: f32| match self.cutoff {
            Some(cutoff) => f32::from(self.factor * alpha >= cutoff),
            None => (self.factor * alpha).clamp(0.0, 1.0),
        };
        let Some((placement, channel)) = &self.image else { return opacity(1.0) };
        let [a, b, c] = corners(placement.set);
        let size = [channel.width() as usize, channel.height() as usize];
        let at = |k: u32| {
            // A lattice of the golden ratio over the square, its upper half folded onto the lower.
            let (u, v) = ((k as f32 + 0.5) / places as f32, (k as f32 * 0.618_034).fract());
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let [x, y] = placement.pixel(a + (b - a) * u + (c - a) * v, size);
            opacity(f32::from(channel.get_pixel(x as u32, y as u32).0[0]) / 255.0)
        };
        (0..places).map(at).sum::<f32>() / places as f32
    }
}
