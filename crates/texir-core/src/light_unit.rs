//! The unit in which light is computed with: half floats and shared exponents hold too little of some.

use std::ops::RangeInclusive;

use crate::raster::Rgb;

/// Scenes are this bright on average, about, where numbers hold what is a thousand times as bright, or as dark.
const USUAL: RangeInclusive<f64> = 1e-3..=1e2;

/// What light of this mean radiance is multiplied with while it is computed with; a power of two, and 1 for what is usual.
pub fn unit(radiance: f64) -> f32 {
    let is_usual = USUAL.contains(&radiance) || !(radiance > 0.0 && radiance.is_finite());
    // The inverse is a number as well.
    if is_usual { 1.0 } else { (-radiance.log2()).round().clamp(-120.0, 120.0).exp2() as f32 }
}

/// Brings light to another unit.
pub fn scale(map: &mut Rgb, factor: f32) {
    if factor != 1.0 {
        map.data.iter_mut().for_each(|pixel| *pixel = pixel.map(|v| v * factor));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_of_unusual_brightness_is_brought_to_about_one_and_back() {
        assert_eq!([1e-3, 0.3, 1.0, 1e2, 0.0, f64::NAN, f64::INFINITY].map(unit), [1.0; 7]);
        for radiance in [1e-300, 1e-30, 1e-4, 2e3, 1e30, 1e300] {
            let unit = unit(radiance);
            assert!(unit.is_normal() && unit.recip().is_normal() && unit * unit.recip() == 1.0, "{radiance}: {unit}");
        }
        for radiance in [1e-30, 1e-4, 2e3, 1e30] {
            assert!((0.7..1.5).contains(&(radiance * f64::from(unit(radiance)))), "{radiance}");
        }
    }
}
