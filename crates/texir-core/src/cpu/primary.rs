//! Primary visibility, twin of `primary.wgsl`.

use crate::camera::Camera;
use crate::real::{Real, V3};
use crate::scene::trace::{Trace, TraceHit};

/// The closest hit through the centre of pixel `(x, y)`.
pub fn primary<R: Real>(tracer: &impl Trace<R>, camera: &Camera, x: usize, y: usize) -> Option<TraceHit<R>> {
    let direction = camera.direction_in(R::of(x as f64 + 0.5), R::of(y as f64 + 0.5));
    tracer.closest(V3::of(camera.position().to_array()), direction)
}
