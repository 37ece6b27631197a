// Projects surface points into a view and tests visibility.
//
// One thread per point; no barriers. Reads 32 and writes 16 bytes per point.

#import camera
#import bvh
#import hit

// Where a point falls in a view.
struct Projected {
    // Continuous pixel coordinates (pixel centres at +0.5).
    pixel: vec2f,
    // Cosine between the shading normal and the direction to the camera.
    cosine: f32,
    // Distance to the camera, metres; 0 when not visible.
    distance: f32,
}

struct ProjectParams {
    count: u32,
    // A point is visible when nothing lies before this share of the way to the camera (the twin's CLEAR_SHARE).
    clear_share: f32,
}

@group(1) @binding(1) var<uniform> params: ProjectParams;
@group(1) @binding(2) var<storage, read> points: array<SurfacePoint>;
@group(1) @binding(3) var<storage, read_write> projected: array<Projected>;

@compute @workgroup_size(WORKGROUP)
fn project(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let i = linear_thread(thread, workgroup, workgroups);
    if i >= params.count {
        return;
    }
    let point = points[i];
    let pixel = camera_project(point.position);
    let to_camera = camera.position - point.position;
    let distance = length(to_camera);
    let direction = to_camera / distance;
    let cosine = dot(point.normal, direction);
    // A negative limit makes the traversal end at once for points that face away or fall outside.
    let seen = pixel.z != 0.0 && cosine > 0.0;
    if !is_blocked(point.position, direction, select(-1.0, distance * params.clear_share, seen)) && seen {
        projected[i] = Projected(pixel.xy, cosine, distance);
    } else {
        projected[i] = Projected(vec2f(0.0), 0.0, 0.0);
    }
}
