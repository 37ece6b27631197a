//! Irradiance gather, twin of `irradiance.wgsl`.

use super::trace::{Lighting, Trace};
use crate::backend::Sampling;
use crate::brdf::basis;
use crate::real::{Real, V3};
use crate::rng::{hash2, sobol2};
use crate::surface::SurfacePoint;

/// A cosine-distributed unit direction around +Z, density cosθ/π.
pub fn cosine_direction<R: Real>([u, v]: [f32; 2]) -> V3<R> {
    let (u, phi) = (R::of(f64::from(u)), R::of(std::f64::consts::TAU * f64::from(v)));
    let radius = u.sqrt();
    V3([radius * phi.cos(), radius * phi.sin(), (R::of(1.0) - u).sqrt()])
}

/// E = π/N Σ L(ω_i): full irradiance, cosine and π included. Item `index` draws from the sequence of `hash2(seed, index)`.
pub fn irradiance<R: Real, T: Trace<R>>(
    lighting: &Lighting<'_, T>,
    point: &SurfacePoint,
    index: u32,
    sampling: Sampling,
) -> V3<R> {
    let normal = V3::of(point.normal);
    let (tangent, bitangent) = basis(normal);
    let seed = hash2(sampling.seed, index);
    let mut sum = V3::zero();
    for i in 0..sampling.samples {
        let V3([x, y, z]) = cosine_direction(sobol2(i, seed));
        sum = sum + lighting.incoming(V3::of(point.position), tangent * x + bitangent * y + normal * z);
    }
    sum * R::of(std::f64::consts::PI / f64::from(sampling.samples))
}
