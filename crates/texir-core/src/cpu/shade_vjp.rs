//! Adjoint of shading, twin of `shade_vjp.wgsl`: pixel-local, from the Jacobian that [`super::shade`] left.

use super::shade::{MaterialIn, ShadedIn};
use crate::backend::ShadePoint;
use crate::brdf::DIELECTRIC_F0;
use crate::real::{Real, V3};

/// Cotangents of a material: `d_albedo = δ⊙((1−m)E/π + mA)`, `d_roughness = ⟨δ, ∂L_o/∂r⟩`,
/// `d_metallic = ⟨δ, −aE/π + (a−0.04)A⟩`, with δ = ∂Loss/∂L_o.
pub fn shade_vjp<R: Real>(
    point: &ShadePoint,
    material: &MaterialIn<R>,
    shaded: &ShadedIn<R>,
    d_radiance: V3<R>,
) -> MaterialIn<R> {
    let diffuse = V3::of(point.irradiance) * R::of(std::f64::consts::FRAC_1_PI);
    let scale = shaded.specular_scale;
    let tint = material.albedo.map(|a| a - R::of(DIELECTRIC_F0));
    MaterialIn {
        albedo: d_radiance.hadamard(diffuse * (R::of(1.0) - material.metallic) + scale * material.metallic),
        roughness: d_radiance.dot(shaded.roughness_jacobian),
        metallic: d_radiance.dot(tint.hadamard(scale) - material.albedo.hadamard(diffuse)),
    }
}
