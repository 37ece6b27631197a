//! Shading, twin of `shade.wgsl`: diffuse from irradiance + importance-sampled GGX over the TBL, with the derivatives
//! that the adjoint needs (method section 4).

use super::lighting::Lighting;
use super::lobe::{LobeSample, sample_lobe};
use super::sampling::Frame;
use crate::backend::{RoughnessGradient, Sampling, ShadePoint};
use crate::brdf::{
    Masking, d_ln_fresnel_weight, d_ln_ndf_sampled, d_ln_schlick, f0, fresnel_weight, g_schlick, sample_weight,
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

/// (∂ln w/∂r, ∂x/∂r) of a lobe sample whose Fresnel weight is x, for the chosen gradient.
fn d_sample<R: Real>(
    s: &LobeSample<R>,
    x: R,
    frame: &Frame<R>,
    view: V3<R>,
    r: R,
    gradient: RoughnessGradient,
) -> (R, R) {
    let (one, two, c) = (R::of(1.0), R::of(2.0), &s.cosines);
    match gradient {
        RoughnessGradient::Exact => (d_ln_ndf_sampled(s.u, r) + d_ln_schlick(c.nl, c.nv, r), R::of(0.0)),
        RoughnessGradient::Authors => {
            // The half-vector tilts with r: dθ_h/dr = 2r √(u(1−u)) / ((1−u)+r⁴u), and everything with it.
            let (u, [sin, cos]) = (s.u, s.half_angle);
            let d_theta = two * r * (u * (one - u)).sqrt() / ((one - u) + r * r * r * r * u);
            let d_nh = -sin * d_theta;
            let d_vh = view.dot(s.azimuth * cos - frame.normal * sin) * d_theta;
            let d_nl = two * (d_vh * c.nh + c.vh * d_nh);
            let k = (r + one) * (r + one) * R::of(0.125);
            let d_ln_w =
                d_ln_schlick(c.nl, c.nv, r) - (one - k) * g_schlick(c.nl, r) * d_nl + d_nl / c.nl + d_vh / c.vh
                    - d_nh / c.nh;
            (d_ln_w, x * d_ln_fresnel_weight(c.vh) * d_vh)
        }
    }
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
    let (frame, view, r) = (Frame::of(V3::of(point.normal)), V3::of(point.view), material.roughness);
    let f0 = f0(material.albedo, material.metallic);
    let seed = hash2(sampling.seed, point.index);
    let (mut scale, mut bias, mut d_roughness) = (V3::zero(), V3::zero(), V3::zero());
    for i in 0..sampling.samples {
        let s = sample_lobe(&frame, view, r, sobol2(i, seed));
        if !s.is_valid {
            continue;
        }
        let x = fresnel_weight(s.cosines.vh);
        let weight = sample_weight(Masking::Schlick, &s.cosines, r);
        let light: V3<R> = lighting.incoming(V3::of(point.position), s.direction) * weight;
        let (d_ln_weight, d_x) = d_sample(&s, x, &frame, view, r, gradient);
        scale = scale + light * (one - x);
        bias = bias + light * x;
        let (fresnel, d_fresnel) = (f0.map(|f| f * (one - x) + x), f0.map(|f| (one - f) * d_x));
        d_roughness = d_roughness + light.hadamard(fresnel * d_ln_weight + d_fresnel);
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
