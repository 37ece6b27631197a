//! The pixels of a view that the TBL may be made of.

use crate::raster::{Mask, Rgb, mean_of_channels};
use crate::stats::median;

/// A pixel that a mask excludes is taken for a light source when it is this many times brighter than the median of
/// those that the mask leaves.
const SOURCE: f32 = 2.0;

/// A view's image and its mask.
///
/// Masks say what a fit of materials is to leave out: what is no part of the scene (the rig, passers-by), and light
/// sources. Only the brightness tells the two apart: excluded pixels that are dim are not used, and bright ones are,
/// where most views that see a surface exclude it.
#[derive(Clone, Debug)]
pub(super) struct Photo {
    /// Linear radiance; pixels that must not be used are NaN.
    pub image: Rgb,
    /// Pixels that the mask does not exclude.
    unmasked: Option<Mask>,
}

impl Photo {
    /// Leaves out what `unmasked` says.
    pub fn new(mut image: Rgb, unmasked: Option<Mask>) -> Self {
        if let Some(unmasked) = &unmasked {
            let kept = image.data.iter().zip(&unmasked.data).filter(|(_, kept)| **kept);
            let means = kept.map(|(radiance, _)| mean_of_channels(*radiance));
            let mut means: Vec<f32> = means.filter(|mean| mean.is_finite()).collect();
            let median = median(&mut means).unwrap_or(0.0);
            for (radiance, kept) in image.data.iter_mut().zip(&unmasked.data) {
                if !kept && mean_of_channels(*radiance) <= SOURCE * median {
                    *radiance = [f32::NAN; 3];
                }
            }
        }
        Self { image, unmasked }
    }

    /// Whether the mask excludes a pixel.
    pub fn is_masked(&self, pixel: usize) -> bool {
        self.unmasked.as_ref().is_some_and(|unmasked| !unmasked.data[pixel])
    }
}
