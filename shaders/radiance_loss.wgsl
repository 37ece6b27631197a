// Image loss: the mean of |T(rendered) − T(target)| over pixels and channels, T(x) = ln(1+x), and its gradient (method
// section 3).
//
// One thread per pixel for the gradient; a workgroup adds its pixels' losses in a fixed tree (a barrier per level) and
// leaves one number, which the host adds up in order. Reads 24 and writes 12 bytes per pixel.

#import math

struct RadianceLossParams {
    count: u32,
    // 1 / (3 count).
    share: f32,
}

@group(1) @binding(0) var<uniform> params: RadianceLossParams;
// Three numbers per pixel.
@group(1) @binding(1) var<storage, read> rendered: array<f32>;
@group(1) @binding(2) var<storage, read> target_radiance: array<f32>;
@group(1) @binding(3) var<storage, read_write> d_rendered: array<f32>;
// One per workgroup.
@group(1) @binding(4) var<storage, read_write> losses: array<f32>;

var<workgroup> thread_sums: array<f32, WORKGROUP>;

@compute @workgroup_size(WORKGROUP)
fn radiance_loss(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let group = linear_workgroup(workgroup, workgroups);
    let i = group * WORKGROUP + thread;
    var loss = 0.0;
    if i < params.count {
        for (var k = 3u * i; k < 3u * i + 3u; k++) {
            let a = rendered[k];
            let b = target_radiance[k];
            // T rises, so that the difference of T has the sign of a − b, free of the logarithm's rounding.
            loss += abs(log((1.0 + a) / (1.0 + b))) * params.share;
            d_rendered[k] = sign(a - b) * params.share / (1.0 + a);
        }
    }
    thread_sums[thread] = loss;
    for (var stride = WORKGROUP / 2u; stride > 0u; stride /= 2u) {
        workgroupBarrier();
        if thread < stride {
            thread_sums[thread] += thread_sums[thread + stride];
        }
    }
    if thread == 0u && group * WORKGROUP < params.count {
        losses[group] = thread_sums[0];
    }
}
