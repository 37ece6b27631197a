// What shading and its adjoint exchange, as texir-core's backend.rs has it.

// A pixel apart from its material. `view` points to the camera; `irradiance` is full E (cosine included, not over π).
struct ShadePoint {
    position: vec3f,
    // Index of the pixel, which chooses its samples.
    index: u32,
    normal: vec3f,
    pad0: f32,
    view: vec3f,
    pad1: f32,
    irradiance: vec3f,
    pad2: f32,
}

struct Material {
    albedo: vec3f,
    roughness: f32,
    metallic: f32,
    pad0: f32,
    pad1: f32,
    pad2: f32,
}

// Outgoing radiance and its Jacobian: A = ∂L_o/∂F0 and ∂L_o/∂r.
struct Shaded {
    radiance: vec3f,
    pad0: f32,
    specular_scale: vec3f,
    pad1: f32,
    roughness_jacobian: vec3f,
    pad2: f32,
}

// Cotangents of a material.
struct MaterialGrad {
    albedo: vec3f,
    roughness: f32,
    metallic: f32,
    pad0: f32,
    pad1: f32,
    pad2: f32,
}
