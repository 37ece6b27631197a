//! Irradiance bake: every texel gathers the texture-based lighting through the scene (the paper's IrT).
//!
//! Per-texel data lies in arrays, in memory or in files ([`Workspace`]). Gathers go through them in tiles, denoising
//! and error estimates in blocks of space, output in rows; how they are cut does not change a bit of the result.

mod baked_texels;
mod blocks;
mod estimate;
mod memory;
mod passes;
mod spatial_blocks;
mod store;
mod texels;
mod thinned;
mod tiles;

use std::hash::{DefaultHasher, Hash, Hasher};

use bytemuck::cast_slice;

pub use self::baked_texels::BakedTexels;
pub use self::memory::{bounce_workspace_within, workspace_within};
pub use self::passes::bake_texels;
pub use self::store::Workspace;
pub use self::texels::Texels;
pub use self::thinned::thinned;
use crate::atlas::Atlas;
use crate::backend::{Backend, Gather};
use crate::checkpoint::Checkpoints;
use crate::environment::Environment;
use crate::error::{Error, Result};
use crate::lights::Lights;
use crate::progress::Progress;
use crate::raster::Rgb;

/// Rings of padding around the charts of a baked map.
pub const PADDING: usize = 4;

/// Irradiance per valid texel of an atlas, with what is known about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Baked {
    /// E = ∫ L cosθ dω (full, not divided by π), linear RGB.
    pub irradiance: Vec<[f32; 3]>,
    /// Texels inside other geometry, as a floor under a cupboard.
    pub buried: Vec<bool>,
    /// Standard error of the luminance of E before denoising, in the unit of E, estimated from a texel's neighbours;
    /// `None` unless [`Quality::error`] was set.
    pub standard_error: Option<Vec<f32>>,
    /// Rays requested; where there are no lights, those aimed at lights are counted but not traced.
    pub rays: u64,
}

/// What a map holds at texels inside other geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Buried {
    /// What they gathered.
    Keep,
    /// A neighbouring exposed texel's value, up to [`PADDING`] texels inwards: bilinear lookups would otherwise bleed
    /// buried texels into visible ones. Texels further inside keep what they gathered.
    Fill,
}

impl Baked {
    /// The atlas, padded by [`PADDING`] texels around the charts. Errors where it is not the atlas that was baked.
    pub fn map(&self, atlas: &Atlas, buried: Buried) -> Result<Rgb> {
        if self.irradiance.len() != atlas.texels.len() {
            return Err(Error::invalid(format!(
                "an atlas of {} texels is given; expected that of the {} that were baked",
                atlas.texels.len(),
                self.irradiance.len()
            )));
        }
        let known: Vec<bool> = self.buried.iter().map(|inside| !inside || buried == Buried::Keep).collect();
        atlas.scatter_padded(&self.irradiance, &known, [0.0; 3], PADDING)
    }
}

/// How a map is baked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Rays of a texel, at most. Its [`Gather::sequences`] are not used: a bake chooses them.
    pub gather: Gather,
    /// Relative error, [`Baked::standard_error`] over E, at which a texel stops taking rays; 0: it takes all.
    pub error: Option<f32>,
    /// What removes most of the noise, if anything.
    pub denoise: Option<Denoiser>,
}

impl Quality {
    /// A fixed number of rays, with most of the noise removed.
    pub fn denoised(gather: Gather) -> Self {
        Self { gather, error: None, denoise: Some(Denoiser::Regression) }
    }
}

/// What removes the noise of a bake.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Denoiser {
    /// Regression over neighbours on the surface, guided by two halves of the rays: [`Backend::denoise`].
    Regression,
    /// Intel's Open Image Denoise, guided by normals, for comparison: it sees the map as a picture, so that charts of
    /// the atlas that lie beside each other have a say in each other. It needs all of the map in memory, and the
    /// feature `oidn`: an error without.
    OpenImageDenoise,
}

impl Hash for Quality {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.gather, self.error.map(f32::to_bits), self.denoise).hash(state);
    }
}

/// Bakes the irradiance of every valid texel from the TBL that the backend was given with [`Backend::set_tbl`].
/// With `checkpoints` of the same [`identity`], a bake that was interrupted goes on where it was, to the same bits.
pub fn bake(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    quality: &Quality,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Baked> {
    bake_texels(backend, &Texels::of(atlas), quality, checkpoints, progress)?.into_baked()
}

/// [`bake`] of a fixed number of rays, as they come: unbiased.
pub fn irradiance(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    gather: Gather,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Baked> {
    passes::as_gathered(backend, &Texels::of(atlas), gather, checkpoints, progress)?.into_baked()
}

/// [`bake`] of a fixed number of rays, with most of the noise removed.
pub fn denoised(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    gather: Gather,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Baked> {
    bake(backend, atlas, &Quality::denoised(gather), checkpoints, progress)
}

/// What a [`bake`] of a map of `[width, height]` texels depends on: as long as none of it changes, its [`Checkpoints`]
/// hold. It covers the backend's scene and name, the lighting that [`Backend::set_tbl`] was given and the environment
/// that [`Backend::set_environment`] was given, the size, the quality and texir's version. What changes no more than
/// speed and memory, as a [`Workspace`], is not in it.
pub fn identity(
    backend: &dyn Backend,
    (radiance, lights): (&Rgb, &Lights),
    environment: Option<&Environment>,
    size: [usize; 2],
    quality: &Quality,
) -> String {
    identity_with(backend, radiance, size, quality, (lights, environment))
}

/// [`identity`] of a bake whose further light is `more`.
pub(crate) fn identity_with(
    backend: &dyn Backend,
    radiance: &Rgb,
    size: [usize; 2],
    quality: &Quality,
    more: impl Hash,
) -> String {
    let mut hasher = DefaultHasher::new();
    let (mesh, traced) = (backend.scene().mesh(), backend.scene().primitives());
    let vectors: [&[u8]; 2] = [cast_slice(&mesh.positions), cast_slice(&mesh.normals)];
    let (uvs, texels): (&[u8], &[u8]) = (cast_slice(&mesh.uvs), cast_slice(&radiance.data));
    (vectors, uvs, &mesh.triangles, traced, radiance.size(), texels).hash(&mut hasher);
    backend.scene().micromaps().hash(&mut hasher);
    (backend.name(), size, quality, more).hash(&mut hasher);
    format!("texir {}\nbake {:016x}\n", env!("CARGO_PKG_VERSION"), hasher.finish())
}

#[cfg(test)]
mod tests;
