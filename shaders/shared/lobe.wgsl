// One drawn sample of the GGX lobe, as the roughness derivatives need it.

#import brdf
#import sampling

struct LobeSample {
    // Unit direction to the light.
    direction: vec3f,
    cosines: Cosines,
    // sin and cos of the half-vector's polar angle, and its azimuth as a unit vector in the tangent plane.
    half_angle: vec2f,
    azimuth: vec3f,
    // The number that the polar angle was drawn from.
    u: f32,
    // False when the light is below the surface.
    valid: bool,
}

// Draws a half-vector of the lobe and reflects the view about it.
fn sample_lobe(frame: Frame, view: vec3f, r: f32, u: vec2f) -> LobeSample {
    let half_angle = sample_half_vector(u.x, r);
    let angle = sincos_turns(u.y);
    let azimuth = frame.tangent * angle.y + frame.bitangent * angle.x;
    let half = azimuth * half_angle.x + frame.normal * half_angle.y;
    let vh = dot(view, half);
    let direction = half * (2.0 * vh) - view;
    let nl = dot(frame.normal, direction);
    let nv = clamp(dot(frame.normal, view), 0.0, 1.0);
    let cosines = Cosines(min(nl, 1.0), nv, half_angle.y, min(vh, 1.0));
    return LobeSample(direction, cosines, half_angle, azimuth, u.x, nl > 0.0 && vh > 0.0 && half_angle.y > 0.0);
}
