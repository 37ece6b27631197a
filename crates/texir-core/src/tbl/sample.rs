//! One view, ready to be sampled at surface points: the image with the surface that every pixel shows.

use glam::{Vec2, Vec3};

use super::TblOptions;
use super::photo::Photo;
use super::shown::{VisibleSurfaces, pixels_per_steradian};
use crate::backend::{Backend, Projected};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::raster::times;
use crate::surface::SurfacePoint;

/// The filter is no wider than this many pixels to either side.
const MAX_REACH: f32 = 8.0;

/// What a view says about a surface point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Observation {
    /// Linear radiance.
    pub radiance: [f32; 3],
    /// How much the view is worth: pixels per square metre of surface, less where the filter crosses an edge.
    pub weight: f32,
    /// The view's mask excludes the pixel that shows the point.
    pub masked: bool,
}

/// An image with the surfaces that it shows.
pub(super) struct Sampler<'a> {
    camera: &'a Camera,
    photo: &'a Photo,
    shown: VisibleSurfaces<'a>,
    options: &'a TblOptions,
}

impl<'a> Sampler<'a> {
    /// Traces the view's pixels. The image must have the camera's size.
    pub fn new(
        backend: &mut dyn Backend,
        camera: &'a Camera,
        photo: &'a Photo,
        options: &'a TblOptions,
    ) -> Result<Self> {
        if photo.image.size() != [camera.width, camera.height] {
            return Err(Error::invalid(format!(
                "a view's image is {} pixels, its camera {}",
                times(photo.image.size()),
                times([camera.width, camera.height])
            )));
        }
        Ok(Self { camera, photo, shown: VisibleSurfaces::new(backend, camera)?, options })
    }

    /// What the view shows of a point that projects to `at`; `area` is the texel's, m². `None` if it cannot tell.
    ///
    /// A tent over the texel's footprint in the image, at least one pixel to either side (bilinear), that only takes in
    /// pixels which show the same surface and which the mask excludes as it excludes the nearest.
    pub fn observe(&self, point: &SurfacePoint, at: &Projected, area: f32) -> Option<Observation> {
        if !(at.distance > 0.0 && at.cosine >= self.options.min_cosine) {
            return None;
        }
        let per_radian = self.camera.pixels_per_radian(at.pixel[1]);
        // Along the surface's tilt the footprint is narrower by the cosine; √cos is its mean.
        let footprint = (area * at.cosine).sqrt() / at.distance;
        let reach = (per_radian * footprint).clamp(Vec2::ONE, Vec2::splat(MAX_REACH));
        let (mut sum, mut clean, mut all) = (Vec3::ZERO, 0.0, 0.0);
        let centre = Vec2::from(at.pixel);
        let masked =
            self.camera.pixel(centre.x as i64, centre.y as i64).is_some_and(|pixel| self.photo.is_masked(pixel));
        let range = |axis: usize| {
            (centre[axis] - reach[axis] - 0.5).ceil() as i64..=(centre[axis] + reach[axis] - 0.5).floor() as i64
        };
        for y in range(1) {
            for x in range(0) {
                let d = (Vec2::new(x as f32, y as f32) + 0.5 - centre).abs() / reach;
                let tent = (1.0 - d.x).max(0.0) * (1.0 - d.y).max(0.0);
                all += tent;
                let Some(pixel) = self.camera.pixel(x, y) else { continue };
                let radiance = Vec3::from(self.photo.image.data[pixel]);
                let usable =
                    radiance.is_finite() && radiance.min_element() >= 0.0 && self.photo.is_masked(pixel) == masked;
                if usable && self.shown.shows(pixel, point, at.distance) {
                    sum += radiance * tent;
                    clean += tent;
                }
            }
        }
        if clean <= 0.0 {
            return None;
        }
        let resolution = pixels_per_steradian(self.camera) * at.cosine / (at.distance * at.distance);
        Some(Observation { radiance: (sum / clean).to_array(), weight: resolution * clean / all, masked })
    }
}
