//! Textures with their mip levels made, and what of them a pixel shows.

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use super::Textures;
use crate::brdf::Masking;
use crate::cpu::lookup::reduce;
use crate::diffuse::DiffuseModel;
use crate::error::{Error, Result};
use crate::raster::Raster;
use crate::scene::Scene;
use crate::texture::{Footprint, Pyramid, Tap};

/// [`Textures`] that views of one scene can be rendered with, any number of them: see
/// [`Renderer::mipmapped`](super::Renderer::mipmapped).
pub struct Mipmapped<'t> {
    /// In whose atlas they lie.
    scene: Arc<Scene>,
    albedo: Map<'t, 3>,
    roughness: Map<'t, 1>,
    metallic: Option<Map<'t, 1>>,
    irradiance: Map<'t, 3>,
    /// Looked up on the atlas itself: on coarse levels, lamps would shine into the charts beside theirs.
    emission: Map<'t, 3>,
    pub(super) diffuse: DiffuseModel,
    pub(super) masking: Masking,
}

/// What a pixel shows of the textures.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Seen {
    pub albedo: [f32; 3],
    pub roughness: f32,
    pub metallic: f32,
    pub irradiance: [f32; 3],
    pub emission: [f32; 3],
}

impl fmt::Debug for Mipmapped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { scene, diffuse, masking, .. } = self;
        let mut textures = f.debug_struct("Mipmapped");
        textures.field("scene", scene).field("diffuse", diffuse).field("masking", masking).finish_non_exhaustive()
    }
}

impl<'t> Mipmapped<'t> {
    /// `pyramid` gives the atlas's at a size.
    pub(super) fn new(
        scene: Arc<Scene>,
        textures: &'t Textures,
        mut pyramid: impl FnMut([usize; 2]) -> Result<Arc<Pyramid>>,
    ) -> Result<Self> {
        let Textures { albedo, roughness, metallic, irradiance, emission, diffuse, masking } = textures;
        let mut of = |name: &str, size: [usize; 2], texels: usize| match size[0] * size[1] == texels {
            true => pyramid(size),
            false => Err(Error::invalid(format!(
                "{name}: {texels} texels; expected those of {} × {}, which it is said to have",
                size[0], size[1]
            ))),
        };
        let metallic = match metallic {
            Some(map) => Some(Map::of_values(of("metallic", map.size(), map.data.len())?, map)),
            None => None,
        };
        Ok(Self {
            scene,
            albedo: Map::new(of("albedo", albedo.size(), albedo.data.len())?, &albedo.data),
            roughness: Map::of_values(of("roughness", roughness.size(), roughness.data.len())?, roughness),
            metallic,
            irradiance: Map::new(of("irradiance", irradiance.size(), irradiance.data.len())?, &irradiance.data),
            emission: Map {
                pyramid: of("emission", emission.size(), emission.data.len())?,
                texels: &emission.data,
                above: Vec::new(),
            },
            diffuse: *diffuse,
            masking: *masking,
        })
    }

    /// An error for textures of another scene.
    pub(super) fn check(&self, scene: &Arc<Scene>) -> Result<()> {
        if Arc::ptr_eq(&self.scene, scene) {
            return Ok(());
        }
        Err(Error::invalid("textures that were mipmapped by the renderer of another scene"))
    }

    /// Whether anything is metal.
    pub(super) fn is_metal(&self) -> bool {
        self.metallic.as_ref().is_some_and(|map| map.texels.iter().any(|[m]| *m > 0.0))
    }

    /// What a pixel of this footprint shows.
    pub(super) fn at(&self, footprint: &Footprint) -> Seen {
        let shared = footprint.taps(&self.albedo.pyramid);
        let taps = |of: &Arc<Pyramid>| match Arc::ptr_eq(of, &self.albedo.pyramid) {
            true => Cow::Borrowed(&shared[..]),
            false => Cow::Owned(footprint.taps(of)),
        };
        Seen {
            albedo: self.albedo.sum(&shared),
            roughness: self.roughness.sum(&taps(&self.roughness.pyramid))[0],
            metallic: self.metallic.as_ref().map_or(0.0, |map| map.sum(&taps(&map.pyramid))[0]),
            irradiance: self.irradiance.sum(&taps(&self.irradiance.pyramid)),
            emission: self.emission.sum(&self.emission.pyramid.bilinear(0, footprint.uv)),
        }
    }
}

/// One texture of `N` channels.
struct Map<'t, const N: usize> {
    pyramid: Arc<Pyramid>,
    /// The finest level.
    texels: &'t [[f32; N]],
    /// The levels above it, in one piece.
    above: Vec<f32>,
}

impl<'t> Map<'t, 1> {
    fn of_values(pyramid: Arc<Pyramid>, texture: &'t Raster<f32>) -> Self {
        Self::new(pyramid, bytemuck::cast_slice(&texture.data))
    }
}

impl<'t, const N: usize> Map<'t, N> {
    fn new(pyramid: Arc<Pyramid>, texels: &'t [[f32; N]]) -> Self {
        let above = reduce(&pyramid, texels.as_flattened(), N, pyramid.levels.len());
        Self { pyramid, texels, above }
    }

    fn texel(&self, index: usize) -> &[f32; N] {
        match index.checked_sub(self.texels.len()) {
            None => &self.texels[index],
            Some(above) => &self.above.as_chunks().0[above],
        }
    }

    /// What taps see; 0 without any.
    fn sum(&self, taps: &[Tap]) -> [f32; N] {
        let mut sum = [0.0; N];
        for tap in taps {
            let texel = self.texel(tap.texel as usize);
            sum = std::array::from_fn(|c| sum[c] + texel[c] * tap.weight);
        }
        sum
    }
}
