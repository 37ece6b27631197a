//! Which surface every pixel of a view shows.

use std::sync::Arc;

use glam::Vec3;

use crate::backend::Backend;
use crate::camera::Camera;
use crate::error::Result;
use crate::scene::Scene;
use crate::surface::{Hit, SurfacePoint};

/// Two surfaces are one where their normals' cosine is at least this: a corner of a room is two.
const SAME_NORMAL: f32 = 0.8;

/// The primary hits of a view's pixels.
pub(crate) struct VisibleSurfaces<'a> {
    scene: Arc<Scene>,
    camera: &'a Camera,
    hits: Vec<Hit>,
}

impl<'a> VisibleSurfaces<'a> {
    /// Traces the pixels' centres.
    pub fn new(backend: &mut dyn Backend, camera: &'a Camera) -> Result<Self> {
        let hits = backend.primary(camera, camera.rows())?;
        Ok(Self { scene: backend.scene().clone(), camera, hits })
    }

    /// Whether a pixel shows the surface of a point at this distance from the camera, metres: it lies no further from
    /// the point's plane than half a pixel is wide there.
    pub fn shows(&self, pixel: usize, point: &SurfacePoint, distance: f32) -> bool {
        let (mesh, hit, normal) = (self.scene.mesh(), self.hits[pixel], Vec3::from(point.normal));
        let slack = 0.5 * distance / pixels_per_steradian(self.camera).sqrt();
        hit.is_hit()
            && (hit.interpolate(mesh.corners(hit.triangle)) - Vec3::from(point.position)).dot(normal).abs() <= slack
            && mesh.face_normal(hit.triangle).dot(normal).abs() >= SAME_NORMAL
    }
}

/// Resolution of a view: pixels per steradian at a panorama's horizon, or on a pinhole's axis. (The crowded columns
/// near a panorama's poles carry no more detail than its rows, so that sin φ does not enter.)
pub(crate) fn pixels_per_steradian(camera: &Camera) -> f32 {
    let middle = camera.pixels_per_radian(camera.height as f32 / 2.0);
    middle.x * middle.y
}
