// Shadow rays of scenes where what rays meet takes all of the light.

#import bvh

// The share of light that passes from 0 < t < t_max along the unit direction.
fn transmittance(origin: vec3f, direction: vec3f, t_max: f32) -> f32 {
    return select(1.0, 0.0, is_blocked(origin, direction, t_max));
}
