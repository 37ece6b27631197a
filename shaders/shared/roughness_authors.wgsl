// The TexIR authors' derivative with respect to roughness: the sampled half-vector tilts with r, and every cosine with
// it, but the radiance that was looked up stays. Biased; reproduced for comparison (method section 4).

#import lobe

// (∂ ln w/∂r, ∂x/∂r) of a lobe sample, with dθ_h/dr = 2r √(u(1−u)) / ((1−u)+r⁴u).
fn d_sample(s: LobeSample, x: f32, frame: Frame, view: vec3f, r: f32) -> vec2f {
    let c = s.cosines;
    let d_theta = 2.0 * r * sqrt(s.u * (1.0 - s.u)) / ((1.0 - s.u) + r * r * r * r * s.u);
    let d_nh = -s.half_angle.x * d_theta;
    let d_vh = dot(view, s.azimuth * s.half_angle.y - frame.normal * s.half_angle.x) * d_theta;
    let d_nl = 2.0 * (d_vh * c.nh + c.vh * d_nh);
    let k = (r + 1.0) * (r + 1.0) * 0.125;
    let d_ln_w = d_ln_schlick(c.nl, c.nv, r) - (1.0 - k) * g_schlick(c.nl, r) * d_nl
        + d_nl / c.nl + d_vh / c.vh - d_nh / c.nh;
    return vec2f(d_ln_w, x * d_ln_fresnel_weight(c.vh) * d_vh);
}
