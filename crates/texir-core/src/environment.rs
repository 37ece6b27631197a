//! Light from far away: the radiance that rays see which leave the scene.

use crate::error::{Error, Result};
use crate::raster::Rgb;
use crate::real::{Real, V3};

/// An equirectangular panorama of radiance around the scene, linear RGB.
///
/// +Y is up and the image's centre lies along +X, turning towards +Z to its right: as three.js and (with its own axes, as
/// its glTF exporter turns them) Blender lay it.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    radiance: Rgb,
}

impl Environment {
    /// Wraps a panorama, twice as wide as high. Errors on an image of another shape, and on what no radiance can be.
    pub fn new(radiance: Rgb) -> Result<Self> {
        let (width, height) = radiance.size();
        if height == 0 || width != 2 * height {
            return Err(Error::invalid(format!(
                "the environment is {width}×{height} pixels; expected an equirectangular panorama, twice as wide as high"
            )));
        }
        if let Some(i) = radiance.data.iter().position(|l| !l.iter().all(|v| *v >= 0.0 && v.is_finite())) {
            return Err(Error::invalid(format!(
                "the environment's pixel ({}, {}) is {:?}; expected finite radiance of at least 0",
                i % width,
                i / width,
                radiance.data[i]
            )));
        }
        Ok(Self { radiance })
    }

    /// The same radiance from everywhere.
    pub fn constant(radiance: [f32; 3]) -> Result<Self> {
        Self::new(Rgb::filled(2, 1, radiance))
    }

    /// The panorama.
    pub fn radiance(&self) -> &Rgb {
        &self.radiance
    }

    /// Radiance arriving from the unit direction: the nearest pixel at u = ½ + atan2(z, x)/2π, v = acos(y)/π.
    pub fn towards<R: Real>(&self, V3([x, y, z]): V3<R>) -> V3<R> {
        let u = 0.5 + z.atan2(x).value() / std::f64::consts::TAU;
        let v = y.min(R::of(1.0)).max(R::of(-1.0)).acos().value() / std::f64::consts::PI;
        let pixel = |at: f64, size: usize| ((at * size as f64) as usize).min(size - 1);
        V3::of(*self.radiance.at(pixel(u, self.radiance.width), pixel(v, self.radiance.height)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_fall_where_three_js_and_blender_put_them() {
        let numbered = Rgb::new(8, 4, (0..32).map(|i| [i as f32; 3]).collect()).unwrap();
        let environment = Environment::new(numbered).unwrap();
        let at = |x: f64, y: f64, z: f64| {
            let length = (x * x + y * y + z * z).sqrt();
            let [value, ..] = environment.towards(V3([x / length, y / length, z / length])).to_f32();
            (value as usize % 8, value as usize / 8)
        };
        // A little off the axes, which lie between pixels.
        assert_eq!(at(1.0, 0.1, 0.1), (4, 1), "+X");
        assert_eq!(at(0.1, -0.1, 1.0), (5, 2), "+Z");
        assert_eq!(at(-1.0, 0.1, 0.1), (7, 1), "−X");
        assert_eq!(at(-0.1, 0.1, -1.0), (1, 1), "−Z");
        assert_eq!(at(0.01, 1.0, 0.01).1, 0, "up");
        assert_eq!(at(0.0, -1.0, 0.0).1, 3, "down");
    }

    #[test]
    fn what_is_no_panorama_is_refused() {
        for bad in [Rgb::filled(0, 0, [0.0; 3]), Rgb::filled(4, 4, [0.0; 3])] {
            assert!(Environment::new(bad).unwrap_err().to_string().contains("twice as wide"));
        }
        for bad in [f32::NAN, f32::INFINITY, -1.0] {
            let error = Environment::constant([0.0, bad, 0.0]).unwrap_err().to_string();
            assert!(error.contains("(0, 0)"), "{error}");
        }
    }
}
