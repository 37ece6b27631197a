// The exact derivative with respect to roughness, for directions and densities held fixed (method section 4).

#import lobe

// (∂ ln w/∂r, ∂x/∂r) of a lobe sample: ψ, and 0 as the half-vector stays.
fn d_sample(s: LobeSample, x: f32, frame: Frame, view: vec3f, r: f32) -> vec2f {
    return vec2f(d_ln_ndf_sampled(s.u, r) + d_ln_schlick(s.cosines.nl, s.cosines.nv, r), 0.0);
}
