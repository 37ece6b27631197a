//! One drawn sample of the GGX lobe; twin of `shared/lobe.wgsl`.

use super::sampling::Frame;
use crate::brdf::{Cosines, sample_half_vector};
use crate::real::{Real, V3};

/// A light direction by a half-vector of the lobe, with what derivatives by roughness need.
#[derive(Clone, Copy, Debug)]
pub struct LobeSample<R> {
    /// Unit direction to the light.
    pub direction: V3<R>,
    /// Those of the directions, 1 at most.
    pub cosines: Cosines<R>,
    /// sin and cos of the half-vector's polar angle.
    pub half_angle: [R; 2],
    /// Its azimuth, as a unit vector in the tangent plane.
    pub azimuth: V3<R>,
    /// The number that the polar angle was drawn from.
    pub u: R,
    /// False when the light is below the surface.
    pub is_valid: bool,
}

/// Draws a half-vector of the lobe of roughness `r` and reflects the view about it.
pub fn sample_lobe<R: Real>(frame: &Frame<R>, view: V3<R>, r: R, [u, v]: [f32; 2]) -> LobeSample<R> {
    let (zero, one, two) = (R::of(0.0), R::of(1.0), R::of(2.0));
    let (u, phi) = (R::of(f64::from(u)), R::of(std::f64::consts::TAU * f64::from(v)));
    let half_angle @ [sin, cos] = sample_half_vector(u, r);
    let azimuth = frame.tangent * phi.cos() + frame.bitangent * phi.sin();
    let half = azimuth * sin + frame.normal * cos;
    let vh = view.dot(half);
    let direction = half * (two * vh) - view;
    let nl = frame.normal.dot(direction);
    let nv = frame.normal.dot(view).max(zero).min(one);
    let cosines = Cosines { nl: nl.min(one), nv, nh: cos, vh: vh.min(one) };
    LobeSample { direction, cosines, half_angle, azimuth, u, is_valid: nl > zero && vh > zero && cos > zero }
}
