// Adjoint of shade.wgsl, from δ = ∂Loss/∂L_o to the material (method section 4): pixel-local, traces no ray.
//
// One thread per pixel; no barriers. Reads 156 and writes 32 bytes per pixel.

#import math
#import brdf
#import shading

struct ShadeVjpParams {
    count: u32,
}

@group(1) @binding(0) var<uniform> params: ShadeVjpParams;
@group(1) @binding(1) var<storage, read> points: array<ShadePoint>;
@group(1) @binding(2) var<storage, read> materials: array<Material>;
@group(1) @binding(3) var<storage, read> shaded: array<Shaded>;
// δ, three numbers per pixel.
@group(1) @binding(4) var<storage, read> d_radiance: array<f32>;
@group(1) @binding(5) var<storage, read_write> d_materials: array<MaterialGrad>;

@compute @workgroup_size(WORKGROUP)
fn shade_vjp(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let i = linear_thread(thread, workgroup, workgroups);
    if i >= params.count {
        return;
    }
    let delta = vec3f(d_radiance[3u * i], d_radiance[3u * i + 1u], d_radiance[3u * i + 2u]);
    let material = materials[i];
    let scale = shaded[i].specular_scale;
    let diffuse = points[i].irradiance * INV_PI;
    // d_a = δ⊙((1−m)E/π + mA), d_r = ⟨δ, ∂L_o/∂r⟩, d_m = ⟨δ, (a−0.04)A − aE/π⟩.
    d_materials[i] = MaterialGrad(
        delta * (diffuse * (1.0 - material.metallic) + scale * material.metallic),
        dot(delta, shaded[i].roughness_jacobian),
        dot(delta, (material.albedo - DIELECTRIC_F0) * scale - material.albedo * diffuse),
        0.0,
        0.0,
        0.0,
    );
}
