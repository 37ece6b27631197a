// Primary visibility: the closest hit through every pixel centre.
//
// One thread per pixel; no barriers. Writes 16 bytes per pixel, reads the hierarchy.

#import camera
#import bvh
#import hit

struct PrimaryParams {
    // First pixel of this dispatch, and how many it covers.
    first: u32,
    count: u32,
}

@group(1) @binding(1) var<uniform> params: PrimaryParams;
@group(1) @binding(2) var<storage, read_write> hits: array<Hit>;

@compute @workgroup_size(WORKGROUP)
fn primary(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let i = linear_thread(thread, workgroup, workgroups);
    if i >= params.count {
        return;
    }
    let pixel = params.first + i;
    let centre = vec2f(f32(pixel % camera.width), f32(pixel / camera.width)) + 0.5;
    let hit = closest_hit(camera.position, camera_direction(centre), T_FAR);
    if hit.primitive == MISS {
        hits[i] = Hit(NO_TRIANGLE, 0.0, 0.0, 0.0);
    } else {
        hits[i] = Hit(mesh_triangle(hit.primitive), hit.u, hit.v, hit.t);
    }
}
