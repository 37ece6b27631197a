//! Light of scenes as their authors describe them: emissive surfaces, punctual lights, an environment, and all that
//! bounces between Lambertian surfaces.
//!
//! `read_gltf` makes a `Model` of a glTF file (feature `files`); [`Surfaces`] hold what a renderer needs to know of it
//! per texel of the lightmap, and can as well be filled by an engine from its own scene; [`irradiance`] solves the
//! light.
//!
//! Photometric: emission and environment are luminance in nits (cd/m²), intensities in candela, distant lights in lux,
//! and irradiance comes out as illuminance in lux, all per linear RGB channel. Any other consistent set of units scales
//! alike.

use bytemuck::cast_slice;

#[cfg(feature = "files")]
mod export;
#[cfg(feature = "files")]
mod gltf;
#[cfg(feature = "files")]
mod layout;
#[cfg(feature = "files")]
mod materials;
#[cfg(feature = "files")]
mod opacity;
#[cfg(feature = "files")]
mod openings;
mod punctual;
#[cfg(feature = "files")]
mod reach;
mod series;
#[cfg(feature = "files")]
mod shading;
#[cfg(feature = "files")]
mod shells;
#[cfg(feature = "files")]
mod sides;
mod solve;
#[cfg(all(test, feature = "files"))]
mod tests;
#[cfg(feature = "files")]
mod texture;
#[cfg(feature = "files")]
mod unfinished;

#[cfg(feature = "files")]
pub use self::export::write_lightmapped_glb;
#[cfg(feature = "files")]
pub use self::gltf::{Model, read_gltf};
pub use self::series::Remainder;
#[cfg(feature = "files")]
pub use self::shading::BounceAlbedo;
pub use self::solve::{Bounces, Solved, irradiance};
#[cfg(feature = "files")]
pub use self::unfinished::BounceLimit;
use crate::backend::{Backend, MAX_RADIANCE, check};
use crate::bake::{self, Quality, Texels};
use crate::environment::Environment;
use crate::error::{Error, Result};
use crate::punctual::PunctualLight;
use crate::raster::Rgb;

/// What an authored scene emits and reflects, per texel of the lightmap, and the light that is not on its surfaces.
#[derive(Clone, Debug)]
pub struct Surfaces {
    /// Lambertian albedo, linear, in [0, 1]; continued around the charts by [`crate::bake::PADDING`] texels.
    pub albedo: Rgb,
    /// Emitted radiance, the same in every direction of the front; continued likewise.
    pub emission: Rgb,
    /// Points, spots and distant lights, in world space.
    pub lights: Vec<PunctualLight>,
    /// What rays see that leave the scene.
    pub environment: Option<Environment>,
}

impl Surfaces {
    /// Nothing shines: no emission, no lights, no environment.
    pub fn is_dark(&self) -> bool {
        let black = |map: &Rgb| map.data.iter().flatten().all(|v| *v == 0.0);
        self.lights.is_empty()
            && black(&self.emission)
            && self.environment.as_ref().is_none_or(|environment| black(environment.radiance()))
    }

    /// Whether the maps have the size of the lightmap, and all numbers are possible.
    pub fn check(&self, texels: &Texels<'_>) -> Result<()> {
        let size = texels.size();
        for (name, map) in [("albedo", &self.albedo), ("emission", &self.emission)] {
            if [map.width, map.height] != size || map.data.len() != size[0] * size[1] {
                return Err(Error::invalid(format!(
                    "the {name} map is {}×{} texels and holds {}; expected {}×{} as the lightmap",
                    map.width,
                    map.height,
                    map.data.len(),
                    size[0],
                    size[1]
                )));
            }
        }
        let channel = |map: &Rgb, good: fn(&f32) -> bool| map.data.iter().flatten().all(good);
        if !channel(&self.albedo, |v| (0.0..=1.0).contains(v)) {
            return Err(Error::invalid("the albedo map leaves [0, 1]; expected linear reflectances"));
        }
        if !channel(&self.emission, |v| (0.0..=MAX_RADIANCE).contains(v)) {
            return Err(Error::invalid(format!("the emission map leaves [0, {MAX_RADIANCE:e}]; expected radiance")));
        }
        check::punctual_lights(&self.lights)
    }

    /// What [`irradiance`] of these surfaces depends on, for its checkpoints, which hold as long as none of it changes:
    /// the backend's scene and name, all of the surfaces, the size of their maps, [`Bounces::quality`] and texir's
    /// version. The tolerance and the number of bounces are not in it: a bake may go on with others.
    pub fn identity(&self, backend: &dyn Backend, quality: &Quality) -> String {
        let Self { albedo, emission, lights, environment } = self;
        // Numbers in words are read back to the same bits.
        let more = (cast_slice::<_, u8>(&albedo.data), format!("{lights:?}"), environment);
        bake::identity_with(backend, emission, emission.size(), quality, more)
    }
}
