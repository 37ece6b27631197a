// Where a ray or a texel meets the mesh, as texir-core's surface.rs has it.

struct Hit {
    // Index into the mesh's triangles, NO_TRIANGLE for a miss.
    triangle: u32,
    // Barycentric coordinates of the second and the third corner.
    u: f32,
    v: f32,
    // Distance along the ray, metres.
    t: f32,
}

const NO_TRIANGLE: u32 = 0xffffffffu;

// A surface point from which rays leave; the position is already off the surface.
struct SurfacePoint {
    position: vec3f,
    triangle: u32,
    normal: vec3f,
    // Index of the point, which chooses its samples.
    index: u32,
}
