// Smoothness over groups of pixels: the mean over all grouped pixels of |value − target_group|, and its gradient
// (method section 3). The target is the group's mean, through which the gradient flows, or a quantile of its reference
// members, held fixed.
//
// A workgroup owns one group and channel; its 256 threads stride over the members. Sums are added in a fixed tree, a
// barrier per level; the quantile is selected byte by byte from counts in integer atomics, which do not depend on
// order. Reads 8 bytes per member and pass (3 passes for the mean, 7 for the quantile), writes 4 per penalised member.

#import math

const THREADS: u32 = 256u;

struct GroupLossParams {
    channels: u32,
    // The quantile, in [0, 1].
    quantile: f32,
    // Groups × channels: the number of jobs.
    jobs: u32,
    // Weight of one value in the loss: 1 / (pixels of all groups × channels).
    share: f32,
}

@group(1) @binding(0) var<uniform> params: GroupLossParams;
// groups + 1 offsets into `members`.
@group(1) @binding(1) var<storage, read> offsets: array<u32>;
// Pixel indices, group by group.
@group(1) @binding(2) var<storage, read> members: array<u32>;
// How many of each group's first members are references.
@group(1) @binding(3) var<storage, read> references: array<u32>;
// `channels` numbers per pixel.
@group(1) @binding(4) var<storage, read> values: array<f32>;
@group(1) @binding(5) var<storage, read_write> d_values: array<f32>;
// One per job.
@group(1) @binding(6) var<storage, read_write> losses: array<f32>;

var<workgroup> thread_sums: array<vec2f, THREADS>;
var<workgroup> histogram: array<atomic<u32>, THREADS>;
// (prefix of the key found so far, rank left within it) and the smallest key above the selected one.
var<workgroup> selected: vec2u;
var<workgroup> above: atomic<u32>;

// One group's members in one channel: [first, end) of `members`; the first `references` are the reference set.
struct Job {
    index: u32,
    channel: u32,
    first: u32,
    end: u32,
    references: u32,
    exists: bool,
}

fn job_of(index: u32) -> Job {
    let clamped = min(index, params.jobs - 1u);
    let group = clamped / params.channels;
    let first = offsets[group];
    return Job(clamped, clamped % params.channels, first, offsets[group + 1u], references[group], index < params.jobs);
}

fn slot(job: Job, member: u32) -> u32 {
    return members[member] * params.channels + job.channel;
}

// Sum over the workgroup's threads, the same in each of them.
fn sum_over_threads(thread: u32, value: vec2f) -> vec2f {
    thread_sums[thread] = value;
    for (var stride = THREADS / 2u; stride > 0u; stride /= 2u) {
        workgroupBarrier();
        if thread < stride {
            thread_sums[thread] += thread_sums[thread + stride];
        }
    }
    let total = workgroupUniformLoad(&thread_sums[0]);
    return total;
}

// Writes the L1 loss of the members [first, end) against `centre` and its gradient: share · (sign_i − through_centre ·
// mean sign), where `through_centre` is 1 if `centre` is their mean and 0 if it is held fixed.
fn l1_to(job: Job, thread: u32, first: u32, centre: f32, through_centre: f32) {
    let count = f32(max(job.end - first, 1u));
    var local = vec2f(0.0);
    for (var m = first + thread; m < job.end; m += THREADS) {
        let difference = values[slot(job, m)] - centre;
        local += vec2f(abs(difference), sign(difference));
    }
    let total = sum_over_threads(thread, local);
    for (var m = first + thread; job.exists && m < job.end; m += THREADS) {
        let at = slot(job, m);
        d_values[at] = (sign(values[at] - centre) - through_centre * total.y / count) * params.share;
    }
    if job.exists && thread == 0u {
        losses[job.index] = total.x * params.share;
    }
}

@compute @workgroup_size(THREADS)
fn mean_target(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let job = job_of(linear_workgroup(workgroup, workgroups));
    var local = vec2f(0.0);
    for (var m = job.first + thread; m < job.end; m += THREADS) {
        local.x += values[slot(job, m)];
    }
    let mean = sum_over_threads(thread, local).x / f32(max(job.end - job.first, 1u));
    l1_to(job, thread, job.first, mean, 1.0);
}

// Bits of a number, ordered as the numbers are.
fn key_of(value: f32) -> u32 {
    let bits = bitcast<u32>(value);
    return select(bits | 0x80000000u, ~bits, (bits & 0x80000000u) != 0u);
}

fn value_of(key: u32) -> f32 {
    return bitcast<f32>(select(~key, key & 0x7fffffffu, (key & 0x80000000u) != 0u));
}

// The order statistics `rank` and `rank` + 1 (or `rank` again, at the end) of the references, by radix selection.
fn order_statistics(job: Job, thread: u32, rank: u32) -> vec2f {
    let end = job.first + job.references;
    if thread == 0u {
        selected = vec2u(0u, rank);
        atomicStore(&above, 0xffffffffu);
    }
    for (var shift = 24i; shift >= 0i; shift -= 8i) {
        atomicStore(&histogram[thread], 0u);
        let found = workgroupUniformLoad(&selected);
        for (var m = job.first + thread; m < end; m += THREADS) {
            let key = key_of(values[slot(job, m)]);
            // The bits above this byte agree with those found; shifted in two steps, as a shift by 32 is undefined.
            if ((key >> u32(shift)) >> 8u) == ((found.x >> u32(shift)) >> 8u) {
                atomicAdd(&histogram[(key >> u32(shift)) & 0xffu], 1u);
            }
        }
        workgroupBarrier();
        if thread == 0u {
            var byte = 0u;
            var left = found.y;
            for (var count = atomicLoad(&histogram[0]); byte < 255u && left >= count; count = atomicLoad(&histogram[byte])) {
                left -= count;
                byte += 1u;
            }
            selected = vec2u(found.x | (byte << u32(shift)), left);
        }
        workgroupBarrier();
    }
    let key = workgroupUniformLoad(&selected).x;
    var upto = vec2f(0.0);
    for (var m = job.first + thread; m < end; m += THREADS) {
        let other = key_of(values[slot(job, m)]);
        if other > key {
            atomicMin(&above, other);
        } else {
            upto.x += 1.0;
        }
    }
    // Exact: counts below 2^24.
    let not_above = u32(sum_over_threads(thread, upto).x);
    let next = select(atomicLoad(&above), key, not_above > rank + 1u || not_above == job.references);
    return vec2f(value_of(key), value_of(next));
}

@compute @workgroup_size(THREADS)
fn quantile_target(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let job = job_of(linear_workgroup(workgroup, workgroups));
    // Linear interpolation at position q(n−1) among the sorted references.
    let position = params.quantile * f32(max(job.references, 1u) - 1u);
    let pair = order_statistics(job, thread, u32(position));
    let centre = pair.x + (pair.y - pair.x) * fract(position);
    // A group without references is left out: nothing of it is penalised.
    let first = select(job.first + job.references, job.end, job.references == 0u);
    l1_to(job, thread, first, centre, 0.0);
}
