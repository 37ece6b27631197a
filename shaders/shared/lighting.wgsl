// Texture-based lighting: the radiance that arrives along a ray is the radiance atlas's value where the ray first meets
// the mesh (method section 1).

#import bvh
#import environment

// Outgoing radiance in the atlas, linear RGB.
@group(0) @binding(2) var tbl: texture_2d<f32>;

// Outgoing radiance at a hit: the nearest texel; 0 for a miss.
fn radiance_at(hit: Intersection) -> vec3f {
    let found = hit.primitive != MISS;
    let primitive = select(0u, hit.primitive, found);
    let ab = triangle_part(primitive, 3u);
    let c = vec2f(triangle_part(primitive, 1u).w, triangle_part(primitive, 2u).w);
    let uv = ab.xy * (1.0 - hit.u - hit.v) + ab.zw * hit.u + c * hit.v;
    let size = textureDimensions(tbl);
    let texel = min(vec2u(max(uv, vec2f(0.0)) * vec2f(size)), size - 1u);
    let radiance = textureLoad(tbl, texel, 0).rgb;
    return select(vec3f(0.0), radiance, found);
}

// Radiance arriving at `origin` from the unit `direction`.
fn incoming_radiance(origin: vec3f, direction: vec3f) -> vec3f {
    let hit = closest_hit(origin, direction, T_FAR);
    return select(radiance_at(hit), environment_towards(direction).rgb, hit.primitive == MISS);
}
