// Adds the irradiance from one punctual light, with a shadow ray (glTF's KHR_lights_punctual).
//
// One thread per point; no barriers. Reads 48 and writes 16 bytes per point.

#import hit
#import math
#import shadow

struct PunctualLight {
    position: vec3f,
    // 1: infinitely far away.
    distant: u32,
    // The way it shines.
    direction: vec3f,
    inverse_range: f32,
    // Candela, or lux of a distant light, where radiance is in nits.
    intensity: vec3f,
    cone_scale: f32,
    cone_offset: f32,
}

struct PunctualParams {
    count: u32,
    // A light is seen when nothing lies before this share of the way to it (the twin's CLEAR_SHARE).
    clear_share: f32,
}

@group(1) @binding(0) var<uniform> light: PunctualLight;
@group(1) @binding(1) var<uniform> params: PunctualParams;
@group(1) @binding(2) var<storage, read> points: array<SurfacePoint>;
// The sum of E over lights, cosine included, not divided by π; w is padding.
@group(1) @binding(3) var<storage, read_write> irradiance: array<vec4f>;

@compute @workgroup_size(WORKGROUP)
fn punctual(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let i = linear_thread(thread, workgroup, workgroups);
    if i >= params.count {
        return;
    }
    let point = points[i];
    var direction = -light.direction;
    var reach = T_FAR;
    var falloff = 1.0;
    if light.distant == 0u {
        let way = light.position - point.position;
        let d2 = dot(way, way);
        direction = way / sqrt(d2);
        reach = sqrt(d2) * params.clear_share;
        let shares = d2 * light.inverse_range * light.inverse_range;
        let cone = saturate(light.cone_offset - dot(light.direction, direction) * light.cone_scale);
        falloff = max(1.0 - shares * shares, 0.0) * cone * cone / d2;
    }
    let cosine = dot(point.normal, direction);
    // A negative limit makes the traversal end at once where no light could arrive.
    let faces = cosine > 0.0 && falloff > 0.0;
    let share = transmittance(point.position, direction, select(-1.0, reach, faces));
    irradiance[i] += vec4f(select(vec3f(0.0), light.intensity * (falloff * cosine * share), faces), 0.0);
}
