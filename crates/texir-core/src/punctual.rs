//! Light sources without extent: points, spots and distant lights, as glTF's `KHR_lights_punctual` defines them.
//!
//! They are deltas: no ray meets them, so that their irradiance is computed apart from the gather
//! ([`crate::backend::Backend::punctual`]), with one shadow ray per point and light.

use std::f32::consts::FRAC_PI_2;

use glam::Vec3;

use crate::error::{Error, Result};

/// Angles may be off by so many radians, from degrees with few digits.
const ROUNDED: f32 = 1e-3;

/// One punctual light, in world space (metres). Intensity is per channel in the unit of radiance × m² (candela where
/// radiance is in nits): an unoccluded surface that faces the light at distance d receives E = intensity / d². With a
/// range, E × clamp(1 − (d/range)⁴, 0, 1), as the extension recommends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PunctualLight {
    /// A point that shines in every direction.
    Point {
        /// Where it is.
        position: [f32; 3],
        /// Intensity, linear RGB.
        intensity: [f32; 3],
        /// Distance, metres, beyond which there is no light, if it ends anywhere.
        range: Option<f32>,
    },
    /// A point that shines within a cone, with the falloff that the extension recommends.
    Spot {
        /// Where it is.
        position: [f32; 3],
        /// Unit direction in which it shines, the axis of its cone.
        direction: [f32; 3],
        /// Intensity along the axis, linear RGB.
        intensity: [f32; 3],
        /// Distance, metres, beyond which there is no light, if it ends anywhere.
        range: Option<f32>,
        /// Angle from the axis, radians, up to which intensity is full: 0 to `outer_cone_angle`.
        inner_cone_angle: f32,
        /// Angle from the axis, radians, beyond which there is no light: at most π/2. At `inner_cone_angle`, the edge is
        /// a hard one.
        outer_cone_angle: f32,
    },
    /// Infinitely far away.
    Distant {
        /// Unit direction in which it shines.
        direction: [f32; 3],
        /// What an unoccluded surface that faces it receives: E (lux where radiance is in nits), linear RGB.
        irradiance: [f32; 3],
    },
}

/// A light in the numbers that passes compute with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients {
    /// Where it is; of no meaning for a distant light.
    pub position: [f32; 3],
    /// Infinitely far away. Otherwise it is at `position`.
    pub distant: bool,
    /// Unit direction in which it shines; 0 for a point.
    pub direction: [f32; 3],
    /// 1 / range; 0: unlimited.
    pub inverse_range: f32,
    /// Intensity (near) or irradiance of a surface that faces it (distant).
    pub intensity: [f32; 3],
    /// Intensity × clamp(cosine · scale + offset, 0, 1)², the cosine to `direction`.
    pub cone_scale: f32,
    /// See `cone_scale`; scale 0 and offset 1 shine in every direction.
    pub cone_offset: f32,
}

impl PunctualLight {
    /// The numbers that passes compute with.
    pub fn coefficients(&self) -> Coefficients {
        let everywhere = Coefficients {
            position: [0.0; 3],
            distant: false,
            direction: [0.0; 3],
            inverse_range: 0.0,
            intensity: [0.0; 3],
            cone_scale: 0.0,
            cone_offset: 1.0,
        };
        let inverse = |range: Option<f32>| range.map_or(0.0, f32::recip);
        match *self {
            Self::Point { position, intensity, range } => {
                Coefficients { position, intensity, inverse_range: inverse(range), ..everywhere }
            }
            Self::Spot { position, direction, intensity, range, inner_cone_angle, outer_cone_angle } => {
                let outer = outer_cone_angle.cos();
                let cone_scale = 1.0 / (inner_cone_angle.cos() - outer).max(0.001);
                let cone_offset = -outer * cone_scale;
                let inverse_range = inverse(range);
                Coefficients { position, direction, intensity, inverse_range, cone_scale, cone_offset, ..everywhere }
            }
            Self::Distant { direction, irradiance } => {
                Coefficients { direction, distant: true, intensity: irradiance, ..everywhere }
            }
        }
    }

    /// Errors on numbers that no light can have, and on directions of another length than 1, which would dim what
    /// shines along them.
    pub fn check(&self) -> Result<()> {
        match *self {
            Self::Point { position, intensity, range } => {
                check_place(position)?;
                check_power("intensity", intensity)?;
                check_range(range)
            }
            Self::Spot { position, direction, intensity, range, inner_cone_angle, outer_cone_angle } => {
                check_place(position)?;
                check_direction(direction)?;
                check_power("intensity", intensity)?;
                check_range(range)?;
                let (inner, outer) = (inner_cone_angle, outer_cone_angle);
                if 0.0 <= inner && inner <= outer + ROUNDED && outer <= FRAC_PI_2 + ROUNDED {
                    return Ok(());
                }
                Err(Error::invalid(format!(
                    "inner_cone_angle is {inner}, outer_cone_angle {outer}; expected radians from the spot's axis, \
                     0 ≤ inner_cone_angle ≤ outer_cone_angle ≤ π/2"
                )))
            }
            Self::Distant { direction, irradiance } => {
                check_direction(direction)?;
                check_power("irradiance", irradiance)
            }
        }
    }
}

fn check_place(position: [f32; 3]) -> Result<()> {
    if Vec3::from(position).is_finite() {
        return Ok(());
    }
    Err(Error::invalid(format!("position is {position:?}; expected finite metres")))
}

fn check_direction(direction: [f32; 3]) -> Result<()> {
    if (Vec3::from(direction).length() - 1.0).abs() < 1e-3 {
        return Ok(());
    }
    Err(Error::invalid(format!("direction is {direction:?}; expected a vector of length 1")))
}

fn check_power(field: &str, power: [f32; 3]) -> Result<()> {
    if power.iter().all(|v| *v >= 0.0 && v.is_finite()) {
        return Ok(());
    }
    Err(Error::invalid(format!("{field} times colour is {power:?}; expected finite numbers of at least 0")))
}

fn check_range(range: Option<f32>) -> Result<()> {
    match range {
        // Nor may its inverse be infinite.
        Some(range) if !(range.is_finite() && range > 0.0 && range.recip().is_finite()) => Err(Error::invalid(
            format!("range is {range}; expected metres, above 0, or none for a light without an end"),
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::check;

    const WHITE: [f32; 3] = [1.0; 3];
    const DOWN: [f32; 3] = [0.0, 0.0, -1.0];

    fn spot(direction: [f32; 3], inner_cone_angle: f32, outer_cone_angle: f32) -> PunctualLight {
        let (position, intensity) = ([0.0; 3], WHITE);
        PunctualLight::Spot { position, direction, intensity, range: None, inner_cone_angle, outer_cone_angle }
    }

    fn point(position: [f32; 3], intensity: [f32; 3], range: Option<f32>) -> PunctualLight {
        PunctualLight::Point { position, intensity, range }
    }

    #[test]
    fn what_aims_has_a_direction_of_length_1() {
        for (direction, sound) in [([0.0, 0.6, -0.8], true), ([0.0, 0.5, -0.5], false), ([0.0; 3], false)] {
            let distant = PunctualLight::Distant { direction, irradiance: WHITE };
            for light in [distant, spot(direction, 0.1, 0.2)] {
                assert_eq!(light.check().is_ok(), sound, "{light:?}");
            }
        }
        point([0.0; 3], WHITE, None).check().unwrap();
    }

    #[test]
    fn what_no_light_can_have_is_named_with_the_light() {
        let good = point([0.0; 3], WHITE, Some(1.0));
        for (bad, what) in [
            (point([f32::NAN; 3], WHITE, None), "light 1: position is [NaN"),
            (point([0.0; 3], [-1.0, 0.0, 0.0], None), "light 1: intensity times colour is [-1.0"),
            (point([0.0; 3], WHITE, Some(0.0)), "light 1: range is 0; expected metres"),
            (point([0.0; 3], WHITE, Some(-1.0)), "light 1: range is -1; expected metres"),
            (point([0.0; 3], WHITE, Some(f32::INFINITY)), "light 1: range is inf; expected metres"),
            (PunctualLight::Distant { direction: DOWN, irradiance: [f32::INFINITY; 3] }, "irradiance times colour is"),
            (spot(DOWN, 0.5, 0.2), "inner_cone_angle is 0.5, outer_cone_angle 0.2; expected"),
            (spot(DOWN, 0.0, 2.0), "outer_cone_angle 2; expected"),
            (spot(DOWN, f32::NAN, 0.5), "inner_cone_angle is NaN"),
        ] {
            let error = check::punctual_lights(&[good, bad]).unwrap_err().to_string();
            assert!(error.contains(what), "{error}; expected {what}");
        }
        check::punctual_lights(&[good, spot(DOWN, 0.0, FRAC_PI_2)]).unwrap();
    }
}
