//! Projection of surface points into a view with visibility, twin of `project.wgsl`.

use crate::backend::Projected;
use crate::camera::Camera;
use crate::real::{Real, V3};
use crate::scene::trace::Trace;
use crate::surface::SurfacePoint;

/// A point counts as visible when nothing lies before this share of the way to the camera.
pub const CLEAR_SHARE: f64 = 0.9999;

/// Where `point` falls in the view, and whether it is seen.
pub fn project<R: Real>(tracer: &impl Trace<R>, camera: &Camera, point: &SurfacePoint) -> Projected {
    const HIDDEN: Projected = Projected { pixel: [0.0; 2], cosine: 0.0, distance: 0.0 };
    let position = V3::of(point.position);
    let Some(pixel) = camera.project_in::<R>(position) else { return HIDDEN };
    let to_camera = V3::of(camera.position().to_array()) - position;
    let distance = to_camera.dot(to_camera).sqrt();
    let direction = to_camera * (R::of(1.0) / distance);
    let cosine = V3::of(point.normal).dot(direction);
    let blocked = || tracer.is_blocked(position, direction, distance * R::of(CLEAR_SHARE));
    if !(cosine > R::of(0.0)) || blocked() {
        return HIDDEN;
    }
    Projected {
        pixel: pixel.map(|p| p.value() as f32),
        cosine: cosine.value() as f32,
        distance: distance.value() as f32,
    }
}
