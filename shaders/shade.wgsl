// Shading: L_o = a(1−m)E/π + F0⊙A + B with A = Σ w L (1−x), B = Σ w L x over importance-sampled GGX directions, and the
// Jacobian that shade_vjp.wgsl needs (method sections 2 and 4). w includes the cosine n·l.
//
// LANES threads share a pixel, each tracing every LANES-th sample of [first_sample, end_sample); sums, barriers and the
// bound on a thread's rays are those of irradiance.wgsl. Several dispatches accumulate raw sums in `shaded` (radiance
// holds B until the last). Reads 96 and writes 48 bytes per pixel and dispatch, and reads those 48 again in all but the
// first. `roughness` is one of two modules: the derivative is chosen when the pipeline is made, as a branch in the
// sample loop would pay for both.

#import lighting
#import shading
#import rng
#import lobe
#import roughness

// Threads per pixel: a power of two, at most WORKGROUP.
override LANES: u32 = 16u;

struct ShadeParams {
    // Pixels of this dispatch, of those that are bound.
    first_item: u32,
    end_item: u32,
    // Samples of this dispatch, and of the whole estimate.
    first_sample: u32,
    end_sample: u32,
    samples: u32,
    seed: u32,
}

@group(1) @binding(0) var<uniform> params: ShadeParams;
@group(1) @binding(1) var<storage, read> points: array<ShadePoint>;
@group(1) @binding(2) var<storage, read> materials: array<Material>;
@group(1) @binding(3) var<storage, read_write> shaded: array<Shaded>;

// Sums over samples: A, B and ∂L_o/∂r.
struct Sums {
    scale: vec3f,
    bias: vec3f,
    roughness_jacobian: vec3f,
}

var<workgroup> lane_sums: array<Sums, WORKGROUP>;

fn add(a: Sums, b: Sums) -> Sums {
    return Sums(a.scale + b.scale, a.bias + b.bias, a.roughness_jacobian + b.roughness_jacobian);
}

@compute @workgroup_size(WORKGROUP)
fn shade(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let lane = thread % LANES;
    let pixel = params.first_item + item_of(thread, LANES, workgroup, workgroups);
    let present = pixel < params.end_item;
    let item = min(pixel, params.end_item - 1u);
    let point = points[item];
    let material = materials[item];
    let f0 = f0_of(material.albedo, material.metallic);
    let frame = frame_of(point.normal);
    let seed = hash2(params.seed, point.index);
    var sums = Sums(vec3f(0.0), vec3f(0.0), vec3f(0.0));
    for (var i = params.first_sample + lane; present && i < params.end_sample; i += LANES) {
        let s = sample_lobe(frame, point.view, material.roughness, sobol2(i, seed));
        if s.valid {
            let x = fresnel_weight(s.cosines.vh);
            let light = incoming_radiance(point.position, s.direction) * sample_weight(s.cosines, material.roughness);
            let d = d_sample(s, x, frame, point.view, material.roughness);
            sums.scale += light * (1.0 - x);
            sums.bias += light * x;
            sums.roughness_jacobian += light * ((f0 * (1.0 - x) + x) * d.x + (1.0 - f0) * d.y);
        }
    }
    lane_sums[thread] = sums;
    for (var stride = LANES / 2u; stride > 0u; stride /= 2u) {
        workgroupBarrier();
        if lane < stride {
            lane_sums[thread] = add(lane_sums[thread], lane_sums[thread + stride]);
        }
    }
    if present && lane == 0u {
        var total = lane_sums[thread];
        if params.first_sample > 0u {
            total = add(total, Sums(shaded[pixel].specular_scale, shaded[pixel].radiance, shaded[pixel].roughness_jacobian));
        }
        var radiance = total.bias;
        if params.end_sample == params.samples {
            let share = 1.0 / f32(params.samples);
            total = Sums(total.scale * share, total.bias * share, total.roughness_jacobian * share);
            let diffuse = material.albedo * point.irradiance * ((1.0 - material.metallic) * INV_PI);
            radiance = diffuse + f0 * total.scale + total.bias;
        }
        shaded[pixel] = Shaded(radiance, 0.0, total.scale, 0.0, total.roughness_jacobian, 0.0);
    }
}
