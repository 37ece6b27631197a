//! Irradiance from a punctual light, twin of `punctual.wgsl`.

use super::project::CLEAR_SHARE;
use crate::punctual::Coefficients;
use crate::real::{Real, V3};
use crate::scene::trace::Trace;
use crate::surface::SurfacePoint;

/// E at a point: intensity × falloff × cosθ / d², 0 in shadow. Cosine included, not divided by π.
pub fn punctual<R: Real>(tracer: &impl Trace<R>, light: &Coefficients, point: &SurfacePoint) -> V3<R> {
    let (zero, one) = (R::of(0.0), R::of(1.0));
    let scalar = |v: f32| R::of(f64::from(v));
    let origin = V3::of(point.position);
    let axis = V3::<R>::of(light.direction);
    let (direction, distance, falloff) = if light.distant {
        (axis * R::of(-1.0), R::of(f64::INFINITY), one)
    } else {
        let way: V3<R> = V3::of(light.position) - origin;
        let d2 = way.dot(way);
        let distance = d2.sqrt();
        let direction = way * (one / distance);
        let shares = d2 * scalar(light.inverse_range) * scalar(light.inverse_range);
        let window = (one - shares * shares).max(zero);
        let cone = scalar(light.cone_offset) - axis.dot(direction) * scalar(light.cone_scale);
        let cone = cone.max(zero).min(one);
        (direction, distance, window * cone * cone / d2)
    };
    let cosine = V3::of(point.normal).dot(direction);
    if !(cosine > zero && falloff > zero) {
        return V3::zero();
    }
    let share = tracer.transmittance(origin, direction, distance * R::of(CLEAR_SHARE));
    V3::of(light.intensity) * (falloff * cosine * share)
}
