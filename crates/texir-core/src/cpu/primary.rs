//! Primary visibility, twin of `primary.wgsl`.

use super::trace::{Trace, TraceHit};
use crate::camera::Camera;
use crate::real::{Real, V3};

/// The closest hit through the centre of pixel `(x, y)`.
pub fn primary<R: Real>(tracer: &impl Trace<R>, camera: &Camera, x: usize, y: usize) -> Option<TraceHit<R>> {
    let direction = camera.direction_in(R::of(x as f64 + 0.5), R::of(y as f64 + 0.5));
    tracer.closest(V3::of(camera.position().to_array()), direction)
}
