// Irradiance gather: E = ∫ L cosθ dω = π/N Σ L(ω_i) with cosine-distributed directions; full E, cosine and π included.
//
// LANES threads share a point, each tracing every LANES-th sample of [first_sample, end_sample); the host bounds a
// thread's rays, because a CPU driver silently ends an invocation after 65,535 loop iterations. The lanes' sums are added
// in workgroup memory in a fixed tree (a barrier per level), so that a result does not depend on scheduling. More samples
// than one dispatch takes accumulate in `irradiance_sums` over several. Reads 32 and writes 12 bytes per point and
// dispatch, besides the hierarchy and the radiance atlas.

#import scene
#import hit
#import rng
#import sampling

// Threads per point: a power of two, at most 64.
override LANES: u32 = 64u;

struct IrradianceParams {
    // Points of this dispatch, and the index of its first in the caller's list (which seeds its sequence).
    count: u32,
    first_point: u32,
    // Samples of this dispatch, and of the whole gather.
    first_sample: u32,
    end_sample: u32,
    samples: u32,
    seed: u32,
}

@group(1) @binding(0) var<uniform> params: IrradianceParams;
@group(1) @binding(1) var<storage, read> points: array<SurfacePoint>;
// Three numbers per point: the running sum of L, after the last sample E.
@group(1) @binding(2) var<storage, read_write> irradiance_sums: array<f32>;

var<workgroup> lane_sums: array<vec3f, 64>;

@compute @workgroup_size(64)
fn irradiance(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let lane = thread % LANES;
    let i = linear_workgroup(workgroup, workgroups) * (64u / LANES) + thread / LANES;
    let present = i < params.count;
    let point = points[min(i, params.count - 1u)];
    let frame = frame_of(point.normal);
    let seed = hash2(params.seed, params.first_point + i);
    var sum = vec3f(0.0);
    for (var s = params.first_sample + lane; present && s < params.end_sample; s += LANES) {
        sum += incoming_radiance(point.position, world_from_frame(frame, cosine_direction(sobol2(s, seed))));
    }
    lane_sums[thread] = sum;
    for (var stride = LANES / 2u; stride > 0u; stride /= 2u) {
        workgroupBarrier();
        if lane < stride {
            lane_sums[thread] += lane_sums[thread + stride];
        }
    }
    if present && lane == 0u {
        var total = lane_sums[thread];
        if params.first_sample > 0u {
            total += vec3f(irradiance_sums[3u * i], irradiance_sums[3u * i + 1u], irradiance_sums[3u * i + 2u]);
        }
        if params.end_sample == params.samples {
            total *= PI / f32(params.samples);
        }
        irradiance_sums[3u * i] = total.x;
        irradiance_sums[3u * i + 1u] = total.y;
        irradiance_sums[3u * i + 2u] = total.z;
    }
}
