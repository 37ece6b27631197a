//! Directions to the lights of the TBL, and the density with which they are drawn; twin of `shared/light_sampling.wgsl`.

use super::trace::TraceHit;
use crate::lights::Lights;
use crate::mesh::Mesh;
use crate::real::{Real, V3};

/// A point on a light, and the triangle it lies on: slot ⌊u·n⌋, whose fraction decides between the two lights, and a
/// uniform point by the square-root map.
pub fn light_point<R: Real>(mesh: &Mesh, lights: &Lights, choice: f32, [u, v]: [f32; 2]) -> (u32, V3<R>) {
    let scaled = choice * lights.slots.len() as f32;
    let slot = &lights.slots[(scaled as usize).min(lights.slots.len() - 1)];
    let triangle = if scaled.fract() < slot.keep { slot.triangle } else { slot.alias };
    let [a, b, c] = mesh.corners(triangle).map(|p| V3::of(p.to_array()));
    let root = R::of(f64::from(u)).sqrt();
    let v = R::of(f64::from(v));
    (triangle, a * (R::of(1.0) - root) + b * (root * (R::of(1.0) - v)) + c * (root * v))
}

/// Density, per solid angle, with which the light samples draw the direction of a hit: density per area · t² / |cosθ'|.
pub fn light_density<R: Real>(mesh: &Mesh, lights: &Lights, hit: &TraceHit<R>, direction: V3<R>) -> R {
    let per_area = R::of(f64::from(lights.density[hit.triangle as usize]));
    let [a, b, c] = mesh.corners(hit.triangle).map(|p| V3::of(p.to_array()));
    let cosine = (b - a).cross(c - a).normalize().dot(direction).abs();
    per_area * hit.t * hit.t / cosine.max(R::of(1e-6))
}
