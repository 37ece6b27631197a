// THE BRDF: simplified Disney with the constants of TexIR (Li et al. 2023), following Karis, "Real Shading in Unreal
// Engine 4" (2013). Twin of texir-core's brdf.rs. Directions are unit and point away from the surface; cosines are in
// [0, 1]; r is the perceptual roughness, α = r². No function includes the cosine n·l unless it says so.

#import math

const DIELECTRIC_F0: f32 = 0.04;

// The cosines of one pair of directions: n·l, n·v, n·h, v·h.
struct Cosines {
    nl: f32,
    nv: f32,
    nh: f32,
    vh: f32,
}

// D = α² / (π (α² + sin²θ_h (1−α²))²): GGX distribution of half-vectors, per solid angle. By the sine, as a cosine
// cannot resolve the peak of a smooth lobe.
fn ndf_from_sin2(sin2: f32, r: f32) -> f32 {
    let a2 = r * r * r * r;
    let d = a2 + sin2 * (1.0 - a2);
    return a2 / (PI * d * d);
}

// g(c) = 2/(c + √(α² + (1−α²)c²)): Smith's masking of GGX, as in glTF 2.0.
fn g_smith(c: f32, r: f32) -> f32 {
    let a2 = r * r * r * r;
    return 2.0 / (c + sqrt(a2 + (1.0 - a2) * c * c));
}

// g(c) = 1/(c(1−k)+k), k = (r+1)²/8: the authors'. The shadowing–masking term is G = g(nl)·g(nv)·nl·nv.
fn g_schlick(c: f32, r: f32) -> f32 {
    let k = (r + 1.0) * (r + 1.0) * 0.125;
    return 1.0 / (c * (1.0 - k) + k);
}

// x = 2^((−5.55472 vh − 6.98316) vh), the spherical-Gaussian Fresnel weight: F = F0(1−x) + x.
fn fresnel_weight(vh: f32) -> f32 {
    return exp2((-5.55472 * vh - 6.98316) * vh);
}

// ∂ ln x/∂vh.
fn d_ln_fresnel_weight(vh: f32) -> f32 {
    return 0.693147180559945 * (-11.10944 * vh - 6.98316);
}

// F0 = 0.04(1−m) + a·m.
fn f0_of(albedo: vec3f, metallic: f32) -> vec3f {
    return DIELECTRIC_F0 * (1.0 - metallic) + albedo * metallic;
}

// (sin, cos) of the polar angle of the half-vector drawn by u: cos²θ_h = (1−u)/(1+(α²−1)u), both without cancellation.
fn sample_half_vector(u: f32, r: f32) -> vec2f {
    let rest = 1.0 - u;
    let a2u = r * r * r * r * u;
    return sqrt(vec2f(a2u, rest) / (rest + a2u));
}

// w = f_s nl / (p F) of half-vector sampling: g(nl) g(nv) nl vh / nh. The cosine n·l is included; times F it is the
// estimator's weight.
fn sample_weight(c: Cosines, r: f32) -> f32 {
    return g_schlick(c.nl, r) * g_schlick(c.nv, r) * c.nl * c.vh / c.nh;
}

// ψ_D = ∂ln D/∂r at a half-vector drawn with the same r: 4(2u−1)/r (method section 4, reduced at the sampled nh).
fn d_ln_ndf_sampled(u: f32, r: f32) -> f32 {
    return 4.0 * (2.0 * u - 1.0) / r;
}

// ∂ln(g(nl) g(nv))/∂r = −(r+1)/4 · [(1−nl) g(nl) + (1−nv) g(nv)].
fn d_ln_schlick(nl: f32, nv: f32, r: f32) -> f32 {
    return -(r + 1.0) * 0.25 * ((1.0 - nl) * g_schlick(nl, r) + (1.0 - nv) * g_schlick(nv, r));
}
