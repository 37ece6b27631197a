//! What the materials of an authored scene do to light.

use std::path::Path;

use glam::Vec3;
use gltf::buffer::Data;
use gltf::texture::Info;
use gltf::{Document, Material};

use super::opacity::{self, Opacity};
use super::texture::{Alpha, Colour, Images, Texture};
use crate::error::{Error, Result};
use crate::glb::is_one_sided;
use crate::image_io::TransferCurve;

/// Reflectances in files may be above 1 by so much, from few digits.
const ROUNDED: f32 = 1e-3;

/// Which reflections the bounces carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BounceAlbedo {
    /// Base colour alone: surfaces are Lambertian.
    Diffuse,
    /// Base colour plus the [`specular_albedo`](crate::specular_albedo::specular_albedo) of dielectrics, as if that were
    /// diffuse.
    DiffuseAndSpecular,
}

/// What a material emits and reflects.
pub(super) struct Shading {
    /// As the file calls it, for messages.
    pub name: String,
    pub albedo: Colour,
    pub emission: Colour,
    /// How rough (green) and how much of a metal (blue) it is, where that matters.
    pub metallic_roughness: Option<Colour>,
    /// Whether its backs send light as well.
    pub double_sided: bool,
    pub opacity: Opacity,
}

/// All materials of the document, then glTF's default. The images that they use come into `images`.
pub(super) fn shading(
    path: &Path,
    document: &Document,
    buffers: &[Data],
    bounce_albedo: BounceAlbedo,
    images: &mut Images,
) -> Result<Vec<Shading>> {
    let colour = |factor: Vec3, info: Option<Info>, values: (TransferCurve, Alpha), images: &mut Images| {
        let mut texture =
            |info: Info| Ok(Texture::new(&info, images.place(path, &info.texture().source(), buffers, values)?));
        Ok(Colour { factor, texture: info.map(&mut texture).transpose()? })
    };
    let mut of = |material: Material| -> Result<Shading> {
        let base = material.pbr_metallic_roughness();
        let [r, g, b, _] = base.base_color_factor();
        let name = material.name().map(|name| format!("\"{name}\""));
        let name = name.or_else(|| Some(format!("material {}", material.index()?))).unwrap_or_default();
        let metallic_roughness = Vec3::new(0.0, base.roughness_factor(), base.metallic_factor());
        let strength = material.emissive_strength().unwrap_or(1.0);
        let emitted = Vec3::from(material.emissive_factor()) * strength;
        let reflects = [r, g, b].iter().all(|v| (0.0..=1.0 + ROUNDED).contains(v));
        if !(emitted.min_element() >= 0.0 && emitted.is_finite() && reflects) {
            return Err(Error::file(
                path,
                format!(
                    "{name} emits {emitted} and reflects ({r}, {g}, {b}); expected emissiveFactor and emissiveStrength of at least 0, \
                     baseColorFactor from 0 to 1"
                ),
            ));
        }
        let alpha = opacity::alpha(&material);
        let albedo = colour(Vec3::new(r, g, b), base.base_color_texture(), (TransferCurve::Srgb, alpha), images)?;
        Ok(Shading {
            name,
            emission: colour(emitted, material.emissive_texture(), (TransferCurve::Srgb, Alpha::Ignored), images)?,
            metallic_roughness: match bounce_albedo {
                BounceAlbedo::DiffuseAndSpecular => {
                    let values = (TransferCurve::Linear, Alpha::Ignored);
                    Some(colour(metallic_roughness, base.metallic_roughness_texture(), values, images)?)
                }
                BounceAlbedo::Diffuse => None,
            },
            double_sided: material.double_sided() && !is_one_sided(material.extras()),
            opacity: Opacity::of(&material, albedo.texture.as_ref(), images),
            albedo,
        })
    };
    let mut all: Vec<Shading> = document.materials().map(&mut of).collect::<Result<_>>()?;
    let [black, white] = [Vec3::ZERO, Vec3::ONE].map(|factor| Colour { factor, texture: None });
    let name = "glTF's default (of primitives without a material)".to_owned();
    // A metal, and so white as it is.
    all.push(Shading {
        name,
        albedo: white,
        emission: black,
        metallic_roughness: None,
        double_sided: false,
        opacity: Opacity::OPAQUE,
    });
    Ok(all)
}
