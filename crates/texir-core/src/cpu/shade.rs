//! Shading, twin of `shade.wgsl`: diffuse from irradiance + importance-sampled GGX over the TBL, with the derivatives
//! that the adjoint needs (method section 4).

use super::lighting::Lighting;
use crate::backend::{RoughnessGradient, Sampling, ShadePoint};
use crate::brdf::{
    Cosines, Masking, basis, d_ln_ndf_sampled, d_ln_schlick, f0, fresnel_weight, g_schlick, sample_half_vector,
    sample_weight,
};
use crate::real::{Real, V3};
use crate::rng::{hash2, sobol2};
use crate::scene::trace::Trace;

/// A material in any scalar; see [`crate::backend::Material`].
#[derive(Clone, Copy, Debug)]
pub struct MaterialIn<R> {
    /// Linear albedo.
    pub albedo: V3<R>,
    /// Perceptual roughness.
    pub roughness: R,
    /// Metallic.
    pub metallic: R,
}

/// Shading result in any scalar; see [`crate::backend::Shaded`].
#[derive(Clone, Copy, Debug)]
pub struct ShadedIn<R> {
    /// L_o.
    pub radiance: V3<R>,
    /// A = Σ w L (1−x).
    pub specular_scale: V3<R>,
    /// ∂L_o/∂r.
    pub roughness_jacobian: V3<R>,
}

/// One drawn light sample: its direction, its cosines and what it weighs.
struct LobeSample<R> {
    direction: V3<R>,
    /// w = f_s nl / (p F).
    weight: R,
    /// x of Schlick's Fresnel term.
    fresnel: R,
    /// ∂ln w/∂r, for the chosen gradient.
    d_ln_weight: R,
    /// ∂x/∂r: 0 with directions held fixed.
    d_fresnel: R,
}

/// Draws a half-vector of the GGX lobe and reflects the view about it; `None` when the light direction is below the
/// surface.
fn sample_lobe<R: Real>(
    normal: V3<R>,
    view: V3<R>,
    r: R,
    [u, v]: [f32; 2],
    gradient: RoughnessGradient,
) -> Option<LobeSample<R>> {
    let (zero, one, two) = (R::of(0.0), R::of(1.0), R::of(2.0));
    let (tangent, bitangent) = basis(normal);
    let (u, phi) = (R::of(f64::from(u)), R::of(std::f64::consts::TAU * f64::from(v)));
    let [sin, cos] = sample_half_vector(u, r);
    let azimuth = tangent * phi.cos() + bitangent * phi.sin();
    let half = azimuth * sin + normal * cos;
    let vh = view.dot(half);
    let direction = half * (two * vh) - view;
    let nl = normal.dot(direction);
    if !(nl > zero && vh > zero && cos > zero) {
        return None;
    }
    let c = Cosines { nl: nl.min(one), nv: normal.dot(view).max(zero).min(one), nh: cos, vh: vh.min(one) };
    let x = fresnel_weight(c.vh);
    let (d_ln_weight, d_fresnel) = match gradient {
        RoughnessGradient::Exact => (d_ln_ndf_sampled(u, r) + d_ln_schlick(c.nl, c.nv, r), zero),
        RoughnessGradient::Authors => {
            // The half-vector tilts with r: dθ_h/dr = 2r √(u(1−u)) / ((1−u)+r⁴u), and everything with it.
            let d_theta = two * r * (u * (one - u)).sqrt() / ((one - u) + r * r * r * r * u);
            let d_nh = -sin * d_theta;
            let d_vh = view.dot(azimuth * cos - normal * sin) * d_theta;
            let d_nl = two * (d_vh * c.nh + c.vh * d_nh);
            let k = (r + one) * (r + one) * R::of(0.125);
            let d_ln_w =
                d_ln_schlick(c.nl, c.nv, r) - (one - k) * g_schlick(c.nl, r) * d_nl + d_nl / c.nl + d_vh / c.vh
                    - d_nh / c.nh;
            let slope = R::of(-5.55472 * 2.0) * c.vh - R::of(6.98316);
            (d_ln_w, x * R::of(std::f64::consts::LN_2) * slope * d_vh)
        }
    };
    Some(LobeSample { direction, weight: sample_weight(Masking::Schlick, &c, r), fresnel: x, d_ln_weight, d_fresnel })
}

/// L_o = a(1−m)E/π + F0⊙A + B with A = Σ w L (1−x), B = Σ w L x over `sampling.samples` samples, and ∂L_o/∂r.
///
/// Item `point.index` draws from the Sobol sequence of `hash2(seed, index)`.
pub fn shade<R: Real, T: Trace<R>>(
    lighting: &Lighting<'_, T>,
    point: &ShadePoint,
    material: &MaterialIn<R>,
    sampling: Sampling,
    gradient: RoughnessGradient,
) -> ShadedIn<R> {
    let one = R::of(1.0);
    let (normal, view) = (V3::of(point.normal), V3::of(point.view));
    let f0 = f0(material.albedo, material.metallic);
    let seed = hash2(sampling.seed, point.index);
    let (mut scale, mut bias, mut d_roughness) = (V3::zero(), V3::zero(), V3::zero());
    for i in 0..sampling.samples {
        let Some(s) = sample_lobe(normal, view, material.roughness, sobol2(i, seed), gradient) else { continue };
        let light: V3<R> = lighting.incoming(V3::of(point.position), s.direction) * s.weight;
        scale = scale + light * (one - s.fresnel);
        bias = bias + light * s.fresnel;
        let fresnel = f0.map(|f| f * (one - s.fresnel) + s.fresnel);
        let d_fresnel = f0.map(|f| (one - f) * s.d_fresnel);
        d_roughness = d_roughness + light.hadamard(fresnel * s.d_ln_weight + d_fresnel);
    }
    let share = one / R::of(f64::from(sampling.samples));
    let (scale, bias) = (scale * share, bias * share);
    let diffuse = material.albedo.hadamard(V3::of(point.irradiance))
        * ((one - material.metallic) * R::of(std::f64::consts::FRAC_1_PI));
    ShadedIn {
        radiance: diffuse + f0.hadamard(scale) + bias,
        specular_scale: scale,
        roughness_jacobian: d_roughness * share,
    }
}
