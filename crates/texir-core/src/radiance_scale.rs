//! Scales radiance to about 1 before computing, as some steps drop radiance below a thousandth and half floats and
//! shared exponents have little range: results do not depend on the capture's unit (nits, shares of white).

use crate::capture::View;
use crate::error::Result;
use crate::progress::{Progress, Task};
use crate::raster::{Rgb, mean_of_channels};

/// The factor that brings radiance of this mean to (½, 1]: a power of two, so that scaling there and back is exact.
pub fn radiance_scale(radiance: f64) -> f32 {
    let is_known = radiance > 0.0 && radiance.is_finite();
    // The inverse is a number as well.
    if is_known { (-radiance.log2()).floor().clamp(-120.0, 120.0).exp2() as f32 } else { 1.0 }
}

/// Scales a map.
pub fn scale(map: &mut Rgb, factor: f32) {
    if factor != 1.0 {
        map.data.iter_mut().for_each(|pixel| *pixel = pixel.map(|v| v * factor));
    }
}

/// Scales what views show.
pub fn scale_views<'a>(views: impl IntoIterator<Item = &'a mut View>, factor: f32) {
    views.into_iter().for_each(|view| view.scale = view.scale.map(|scale| scale * factor));
}

/// The views by the [scale](radiance_scale) of what they show, and that scale. All images are read once.
pub fn normalised_views(views: &[View], progress: &dyn Progress) -> Result<(Vec<View>, f32)> {
    let (mut sum, mut count) = (0.0, 0u64);
    let task = Task::start(progress, "brightness", views.len() as u64, "views");
    for view in views {
        progress.check()?;
        let image = view.load_image(progress)?;
        let usable = view.usable(&image)?;
        for (radiance, _) in image.data.iter().zip(&usable.data).filter(|(_, usable)| **usable) {
            sum += f64::from(mean_of_channels(*radiance));
            count += 1;
        }
        progress.advance(1);
    }
    drop(task);
    let scale = radiance_scale(sum / count as f64);
    let mut views = views.to_vec();
    scale_views(&mut views, scale);
    Ok((views, scale))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_brought_to_about_one_and_back() {
        assert_eq!([0.0, -1.0, f64::NAN, f64::INFINITY].map(radiance_scale), [1.0; 4], "what is no radiance stays");
        assert_eq!([0.51, 1.0, 0.5, 2.0, 3.0].map(radiance_scale), [1.0, 1.0, 2.0, 0.5, 0.25]);
        for radiance in [1e-300, 1e-30, 1e-4, 2e3, 1e30, 1e300] {
            let scale = radiance_scale(radiance);
            assert!(
                scale.is_normal() && scale.recip().is_normal() && scale * scale.recip() == 1.0,
                "{radiance}: {scale}"
            );
        }
        for radiance in [1e-30, 1e-4, 2e3, 1e30] {
            let brought = radiance * f64::from(radiance_scale(radiance));
            assert!((0.5..=1.0).contains(&brought), "{radiance}: {brought}");
        }
    }
}
