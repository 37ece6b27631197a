//! Light sources without extent: points, spots and distant lights, as glTF's `KHR_lights_punctual` defines them.
//!
//! They are deltas: no ray meets them, so that their irradiance is computed apart from the gather
//! ([`crate::backend::Backend::punctual`]), with one shadow ray per point and light.

use glam::Vec3;

use crate::error::{Error, Result};

/// One punctual light. Intensity is per channel in the unit of radiance × m² (candela where radiance is in nits): an
/// unoccluded surface that faces the light at distance d receives E = intensity / d².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PunctualLight {
    /// Where it is, world space, metres; of no meaning for a distant light.
    pub position: [f32; 3],
    /// Infinitely far away: E = intensity wherever a surface faces it. Otherwise it is at `position`.
    pub distant: bool,
    /// Unit direction in which it shines (spots and distant lights).
    pub direction: [f32; 3],
    /// 1 / range, beyond which there is no light; 0: unlimited.
    pub inverse_range: f32,
    /// Intensity (near) or irradiance of a surface that faces it (distant), linear RGB.
    pub intensity: [f32; 3],
    /// Of a spot: intensity × clamp(cosine · scale + offset, 0, 1)², the cosine to `direction`.
    pub cone_scale: f32,
    /// See `cone_scale`; scale 0 and offset 1 shine in every direction.
    pub cone_offset: f32,
}

impl PunctualLight {
    /// A light at a point that shines in every direction.
    pub fn point(position: [f32; 3], intensity: [f32; 3]) -> Self {
        Self { position, intensity, cone_offset: 1.0, ..Self::default() }
    }

    /// A light at a point, full within the `inner` angle of its direction, none beyond the `outer` one (radians, inner
    /// < outer, or the edge is a hard one at `outer`), with the falloff that the extension recommends.
    pub fn spot(position: [f32; 3], direction: [f32; 3], intensity: [f32; 3], [inner, outer]: [f32; 2]) -> Self {
        let cone_scale = 1.0 / (inner.cos() - outer.cos()).max(0.001);
        let cone_offset = -outer.cos() * cone_scale;
        Self { position, direction, intensity, cone_scale, cone_offset, ..Self::default() }
    }

    /// A light from infinitely far away that shines along `direction`; `irradiance` is what a surface that faces it
    /// receives.
    pub fn distant(direction: [f32; 3], irradiance: [f32; 3]) -> Self {
        Self { direction, distant: true, intensity: irradiance, cone_offset: 1.0, ..Self::default() }
    }

    /// The same light with a range, metres: × clamp(1 − (d/range)⁴, 0, 1), as the extension recommends.
    pub fn with_range(self, range: f32) -> Self {
        Self { inverse_range: 1.0 / range, ..self }
    }

    /// Errors on numbers that no light can have, and on directions of another length than 1, which would dim what
    /// shines along them.
    pub fn check(&self) -> Result<()> {
        let vectors = [self.position, self.direction, self.intensity];
        let numbers = [self.inverse_range, self.cone_scale, self.cone_offset];
        let finite = vectors.iter().flatten().chain(&numbers).all(|v| v.is_finite());
        let aims = self.distant || self.cone_scale != 0.0;
        let unit = !aims || (Vec3::from(self.direction).length() - 1.0).abs() < 1e-3;
        let positive = self.intensity.iter().all(|v| *v >= 0.0) && self.inverse_range >= 0.0;
        if finite && positive && unit {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "its intensity times its colour is {:?}, its range {}, its place {:?}, its direction {:?}, its cone {} and {}; expected \
             finite numbers, intensity and range positive, a direction of \
             length 1",
            self.intensity,
            1.0 / self.inverse_range,
            self.position,
            self.direction,
            self.cone_scale,
            self.cone_offset
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_aims_has_a_direction_of_length_1() {
        let white = [1.0; 3];
        for (direction, sound) in [([0.0, 0.6, -0.8], true), ([0.0, 0.5, -0.5], false), ([0.0; 3], false)] {
            let lights =
                [PunctualLight::distant(direction, white), PunctualLight::spot([0.0; 3], direction, white, [0.1, 0.2])];
            for light in lights {
                assert_eq!(light.check().is_ok(), sound, "{light:?}");
            }
        }
        PunctualLight::point([0.0; 3], white).check().unwrap();
    }
}
