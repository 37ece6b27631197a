//! One view, ready to be sampled at surface points: the image with the surface that every pixel shows.

use glam::{Vec2, Vec3};

use super::TblOptions;
use super::photo::Photo;
use crate::backend::{Backend, Projected};
use crate::camera::{Camera, Projection};
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::surface::{Hit, SurfacePoint};

/// Two surfaces are one where their normals' cosine is at least this: a corner of a room is two.
const SAME_NORMAL: f32 = 0.8;
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

/// An image with the primary hits of its pixels.
pub(super) struct Sampler<'a> {
    mesh: &'a Mesh,
    camera: &'a Camera,
    photo: &'a Photo,
    hits: Vec<Hit>,
    options: &'a TblOptions,
}

impl<'a> Sampler<'a> {
    /// Traces the view's pixels. The image must have the camera's size.
    pub fn new(
        backend: &mut dyn Backend,
        mesh: &'a Mesh,
        camera: &'a Camera,
        photo: &'a Photo,
        options: &'a TblOptions,
    ) -> Result<Self> {
        if photo.image.size() != (camera.width, camera.height) {
            return Err(Error::invalid(format!(
                "a view's image is {:?} pixels, its camera {:?}",
                photo.image.size(),
                (camera.width, camera.height)
            )));
        }
        let hits = backend.primary(camera)?;
        Ok(Self { mesh, camera, photo, hits, options })
    }

    /// What the view shows of a point that projects to `at`; `area` is the texel's, m². `None` if it cannot tell.
    ///
    /// A tent over the texel's footprint in the image, at least one pixel to either side (bilinear), that only takes in
    /// pixels which show the same surface and which the mask excludes as it excludes the nearest.
    pub fn observe(&self, point: &SurfacePoint, at: &Projected, area: f32) -> Option<Observation> {
        if !(at.distance > 0.0 && at.cosine >= self.options.min_cosine) {
            return None;
        }
        let position = Vec3::from(point.position);
        let per_radian = pixels_per_radian(self.camera, at.pixel[1]);
        // Along the surface's tilt the footprint is narrower by the cosine; √cos is its mean.
        let footprint = (area * at.cosine).sqrt() / at.distance;
        let reach = (per_radian * footprint).clamp(Vec2::ONE, Vec2::splat(MAX_REACH));
        let slack = self.slack(at.distance);
        let (mut sum, mut clean, mut all) = (Vec3::ZERO, 0.0, 0.0);
        let centre = Vec2::from(at.pixel);
        let masked = self.pixel(centre.x as i64, centre.y as i64).is_some_and(|pixel| self.photo.is_masked(pixel));
        let range = |axis: usize| {
            (centre[axis] - reach[axis] - 0.5).ceil() as i64..=(centre[axis] + reach[axis] - 0.5).floor() as i64
        };
        for y in range(1) {
            for x in range(0) {
                let d = (Vec2::new(x as f32, y as f32) + 0.5 - centre).abs() / reach;
                let tent = (1.0 - d.x).max(0.0) * (1.0 - d.y).max(0.0);
                all += tent;
                let Some(pixel) = self.pixel(x, y) else { continue };
                let radiance = Vec3::from(self.photo.image.data[pixel]);
                let usable =
                    radiance.is_finite() && radiance.min_element() >= 0.0 && self.photo.is_masked(pixel) == masked;
                if usable && self.shows(pixel, position, point.normal.into(), slack) {
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

    /// How far from a surface's plane, metres, a pixel's point may lie to be on the same surface.
    fn slack(&self, distance: f32) -> f32 {
        0.5 * distance / pixels_per_steradian(self.camera).sqrt()
    }

    /// Whether a pixel shows the surface through `position` with `normal`.
    fn shows(&self, pixel: usize, position: Vec3, normal: Vec3, slack: f32) -> bool {
        let hit = self.hits[pixel];
        hit.is_hit()
            && (self.position(&hit) - position).dot(normal).abs() <= slack
            && self.mesh.face_normal(hit.triangle).dot(normal).abs() >= SAME_NORMAL
    }

    /// World position of a hit on the mesh.
    fn position(&self, hit: &Hit) -> Vec3 {
        let [a, b, c] = self.mesh.corners(hit.triangle);
        a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v
    }

    /// Index of a pixel; panoramas wrap in x.
    fn pixel(&self, x: i64, y: i64) -> Option<usize> {
        let (w, h) = (self.camera.width as i64, self.camera.height as i64);
        let x = if self.camera.projection == Projection::Equirectangular { x.rem_euclid(w) } else { x };
        (x >= 0 && x < w && y >= 0 && y < h).then(|| (y * w + x) as usize)
    }
}

/// Pixels per radian along the image's axes, near row `y`: the columns of a panorama crowd towards its poles (1/sin φ).
fn pixels_per_radian(camera: &Camera, y: f32) -> Vec2 {
    match camera.projection {
        Projection::Equirectangular => {
            let sin = (std::f32::consts::PI * y / camera.height as f32).sin();
            let (columns, rows) =
                (camera.width as f32 / std::f32::consts::TAU, camera.height as f32 / std::f32::consts::PI);
            Vec2::new(columns / sin.max(1.0 / camera.width as f32), rows)
        }
        Projection::Pinhole { fx, fy, .. } => Vec2::new(fx.abs(), fy.abs()),
    }
}

/// Resolution of a view: pixels per steradian at a panorama's horizon, or on a pinhole's axis. (The crowded columns near
/// a panorama's poles carry no more detail than its rows, so that sin φ does not enter.)
pub(super) fn pixels_per_steradian(camera: &Camera) -> f32 {
    let middle = pixels_per_radian(camera, camera.height as f32 / 2.0);
    middle.x * middle.y
}
