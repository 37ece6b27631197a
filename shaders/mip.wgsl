// One level of the pyramid: coarse texels from fine ones, and the transpose. A coarse texel is the mean of its valid
// children, weighted by how much of each is valid, so that the space between charts does not bleed in.
//
// One thread per coarse texel and channel; it owns that texel and its up to four children, which have no other parent:
// no barriers, no atomics. Moves 20 bytes per thread and four coverages.

#import math

struct MipParams {
    // First texel of the level in the pyramid, its columns and rows.
    fine_offset: u32,
    fine_width: u32,
    fine_height: u32,
    coarse_offset: u32,
    coarse_width: u32,
    coarse_height: u32,
    channels: u32,
}

@group(1) @binding(0) var<uniform> params: MipParams;
// Share of each pyramid texel that valid atlas texels cover.
@group(1) @binding(1) var<storage, read> coverage: array<f32>;
// `channels` interleaved numbers per pyramid texel: values forward, cotangents backward.
@group(1) @binding(2) var<storage, read_write> pyramid: array<f32>;

// A coarse texel's children, and each one's share in it; all shares 0 where nothing is valid.
struct Family {
    parent: u32,
    channel: u32,
    children: vec4u,
    shares: vec4f,
    exists: bool,
}

fn family(thread: u32, workgroup: vec3u, workgroups: vec3u) -> Family {
    let k = linear_thread(thread, workgroup, workgroups);
    let coarse = k / params.channels;
    let exists = coarse < params.coarse_width * params.coarse_height;
    let x = 2u * (coarse % params.coarse_width) + vec4u(0u, 1u, 0u, 1u);
    let y = 2u * (coarse / params.coarse_width) + vec4u(0u, 0u, 1u, 1u);
    let inside = (x < vec4u(params.fine_width)) & (y < vec4u(params.fine_height));
    let children = params.fine_offset
        + min(y, vec4u(params.fine_height - 1u)) * params.fine_width
        + min(x, vec4u(params.fine_width - 1u));
    let cover = vec4f(coverage[children.x], coverage[children.y], coverage[children.z], coverage[children.w]);
    let counted = select(vec4f(0.0), cover, inside);
    let sum = counted.x + counted.y + counted.z + counted.w;
    let shares = select(vec4f(0.0), counted / sum, vec4<bool>(sum > 0.0));
    return Family(params.coarse_offset + coarse, k % params.channels, children, shares, exists);
}

@compute @workgroup_size(WORKGROUP)
fn reduce(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let f = family(thread, workgroup, workgroups);
    if f.exists {
        let at = f.children * params.channels + f.channel;
        let values = vec4f(pyramid[at.x], pyramid[at.y], pyramid[at.z], pyramid[at.w]);
        pyramid[f.parent * params.channels + f.channel] = dot(values, f.shares);
    }
}

// Transpose of `reduce`: adds the parent's cotangent to its children's.
@compute @workgroup_size(WORKGROUP)
fn reduce_vjp(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let f = family(thread, workgroup, workgroups);
    if f.exists {
        let d = pyramid[f.parent * params.channels + f.channel];
        for (var c = 0u; c < 4u; c++) {
            if f.shares[c] > 0.0 {
                pyramid[f.children[c] * params.channels + f.channel] += d * f.shares[c];
            }
        }
    }
}
