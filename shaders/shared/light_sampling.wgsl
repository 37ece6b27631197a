// Directions to the lights of the TBL, and the density with which they are drawn; twin of texir-core's light_sampling.rs.

#import bvh

// One slot of the alias table over the lights: `primitive` with probability `keep`, else `alternative`.
struct LightSlot {
    primitive: u32,
    alternative: u32,
    keep: f32,
    pad: f32,
}

@group(0) @binding(4) var<storage, read> light_slots: array<LightSlot>;
// Per primitive: density per square metre with which the slots draw a point on it.
@group(0) @binding(5) var<storage, read> light_density: array<f32>;

// A point on a light, and the primitive it lies on.
struct LightPoint {
    position: vec3f,
    primitive: u32,
}

// Slot ⌊choice·slots⌋, whose fraction decides between the two lights, and a uniform point by the square-root map.
fn light_point(choice: f32, slots: u32, u: vec2f) -> LightPoint {
    let scaled = choice * f32(slots);
    let slot = light_slots[min(u32(scaled), slots - 1u)];
    let primitive = select(slot.alternative, slot.primitive, fract(scaled) < slot.keep);
    let root = sqrt(u.x);
    let v0 = bitcast<vec3f>(triangle_word(primitive * 3u).xyz);
    let e1 = bitcast<vec3f>(triangle_word(primitive * 3u + 1u).xyz);
    let e2 = bitcast<vec3f>(triangle_word(primitive * 3u + 2u).xyz);
    return LightPoint(v0 + e1 * (root * (1.0 - u.y)) + e2 * (root * u.y), primitive);
}

// Density, per solid angle, with which light samples draw a point of `primitive`, `t` metres away and seen under the
// cosine θ' with its normal: density per area · t² / |cosθ'|.
fn light_pdf(primitive: u32, t: f32, cosine: f32) -> f32 {
    return light_density[primitive] * t * t / max(abs(cosine), 1e-6);
}
