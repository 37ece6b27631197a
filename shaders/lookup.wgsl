// Mip-mapped texture lookup y = M x with a stored sparse M, and its transpose x̄ = Mᵀ ȳ: the same gather, over rows
// forward and over columns backward, so that gradients are sums in a fixed order.
//
// One thread per row and channel; no barriers. Reads 8 bytes per tap and 4 per gathered number. Rows longer than
// MAX_TAPS take several dispatches, as a CPU driver silently ends an invocation after 65,535 loop iterations.

#import math

struct LookupParams {
    rows: u32,
    channels: u32,
    // Taps of each row that this dispatch adds: [first_tap, first_tap + taps).
    first_tap: u32,
    taps: u32,
}

// One entry of the sparse matrix.
struct Tap {
    texel: u32,
    weight: f32,
}

@group(1) @binding(0) var<uniform> params: LookupParams;
// rows + 1 offsets into `taps`.
@group(1) @binding(1) var<storage, read> offsets: array<u32>;
@group(1) @binding(2) var<storage, read> taps: array<Tap>;
// `channels` interleaved numbers per item.
@group(1) @binding(3) var<storage, read> source: array<f32>;
@group(1) @binding(4) var<storage, read_write> destination: array<f32>;
// Backward: the pyramid texel that each column belongs to.
@group(1) @binding(5) var<storage, read> touched: array<u32>;

fn gather(row: u32, channel: u32) -> f32 {
    let first = offsets[row] + params.first_tap;
    let end = min(first + params.taps, offsets[row + 1u]);
    var sum = 0.0;
    for (var t = first; t < end; t++) {
        sum += taps[t].weight * source[taps[t].texel * params.channels + channel];
    }
    return sum;
}

fn store(item: u32, channel: u32, sum: f32) {
    let at = item * params.channels + channel;
    if params.first_tap == 0u {
        destination[at] = sum;
    } else {
        destination[at] += sum;
    }
}

@compute @workgroup_size(WORKGROUP)
fn lookup(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let k = linear_thread(thread, workgroup, workgroups);
    let row = k / params.channels;
    let channel = k % params.channels;
    if row < params.rows {
        store(row, channel, gather(row, channel));
    }
}

// Transpose of `lookup`: from cotangents of the looked-up values to those of the pyramid's texels.
@compute @workgroup_size(WORKGROUP)
fn lookup_vjp(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let k = linear_thread(thread, workgroup, workgroups);
    let row = k / params.channels;
    let channel = k % params.channels;
    if row < params.rows {
        store(touched[row], channel, gather(row, channel));
    }
}
