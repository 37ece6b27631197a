// Equirectangular and pinhole cameras, twin of texir-core's camera.rs. OpenGL axes: +X right, +Y up, looking along −Z.
// One branch per pixel on the kind, beside a traced ray, costs nothing that a second pipeline would save.

#import math

const EQUIRECTANGULAR: u32 = 0u;

struct Camera {
    // World axes of the camera: columns of world_from_camera.
    right: vec3f,
    // EQUIRECTANGULAR, or else a pinhole.
    kind: u32,
    up: vec3f,
    // Image columns and rows.
    width: u32,
    back: vec3f,
    height: u32,
    // Optical centre in world space.
    position: vec3f,
    // Pinhole: focal lengths and principal point, pixels.
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
}

@group(1) @binding(0) var<uniform> camera: Camera;

// Unit world direction through continuous pixel coordinates (pixel centres at +0.5).
fn camera_direction(pixel: vec2f) -> vec3f {
    var local = vec3f((pixel.x - camera.cx) / camera.fx, -(pixel.y - camera.cy) / camera.fy, -1.0);
    if camera.kind == EQUIRECTANGULAR {
        let lambda = sincos_turns(pixel.x / f32(camera.width) - 0.5);
        let phi = sincos_turns(0.5 * pixel.y / f32(camera.height));
        local = vec3f(lambda.x * phi.x, phi.y, -lambda.y * phi.x);
    }
    return normalize(camera.right * local.x + camera.up * local.y + camera.back * local.z);
}

// Continuous pixel coordinates (x, y) of a world point; z is 1 inside the image and in front of it, else 0.
fn camera_project(point: vec3f) -> vec3f {
    let from_centre = point - camera.position;
    let local = vec3f(dot(camera.right, from_centre), dot(camera.up, from_centre), dot(camera.back, from_centre));
    let size = vec2f(f32(camera.width), f32(camera.height));
    var pixel = vec2f(camera.cx - camera.fx * local.x / local.z, camera.cy + camera.fy * local.y / local.z);
    var inside = local.z < 0.0;
    if camera.kind == EQUIRECTANGULAR {
        // acos(y / length), without its loss of digits at the poles.
        let polar = atan2(length(local.xz), local.y);
        pixel = vec2f(atan2(local.x, -local.z) / TAU + 0.5, polar / PI) * size;
        inside = true;
    }
    inside = inside && all(pixel >= vec2f(0.0)) && all(pixel <= size);
    return vec3f(pixel, select(0.0, 1.0, inside));
}
