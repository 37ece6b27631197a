// Constants, trigonometry, shares and thread indices.

const PI: f32 = 3.14159265358979;
const TAU: f32 = 6.28318530717959;
const INV_PI: f32 = 0.318309886183791;

// (sin, cos) of 2πv for |v| ≤ 1, to a few 1e-7. The built-in functions may be off by 2^-11 (Vulkan, "Precision and
// Operation of SPIR-V Instructions"), and differently on every adapter. Taylor series around the nearest quarter turn.
fn sincos_turns(v: f32) -> vec2f {
    let quarter = round(4.0 * v);
    let x = TAU * (v - 0.25 * quarter);
    let x2 = x * x;
    let s = x * (1.0 + x2 * (-1.0 / 6.0 + x2 * (1.0 / 120.0 + x2 * (-1.0 / 5040.0 + x2 / 362880.0))));
    let c = 1.0 + x2 * (-0.5 + x2 * (1.0 / 24.0 + x2 * (-1.0 / 720.0 + x2 * (1.0 / 40320.0 - x2 / 3628800.0))));
    let q = u32(i32(quarter) & 3);
    let swapped = select(vec2f(s, c), vec2f(c, s), (q & 1u) != 0u);
    return vec2f(
        select(swapped.x, -swapped.x, q >= 2u),
        select(swapped.y, -swapped.y, q == 1u || q == 2u),
    );
}

// The largest number below 1 with 24 bits.
const BELOW_ONE: f32 = 0.99999994;

// How far u lies within [before, up_to), in [0, 1).
fn share_below(u: f32, before: f32, up_to: f32) -> f32 {
    return clamp((u - before) / (up_to - before), 0.0, BELOW_ONE);
}

// Threads of a workgroup, where a pass has no other number.
const WORKGROUP: u32 = 64u;

// Index of a workgroup in a dispatch that the host folded into two dimensions (one holds at most 65,535).
fn linear_workgroup(workgroup: vec3u, workgroups: vec3u) -> u32 {
    return workgroup.y * workgroups.x + workgroup.x;
}

// Index, among all of such a dispatch, of a thread by its index in the workgroup.
fn linear_thread(thread: u32, workgroup: vec3u, workgroups: vec3u) -> u32 {
    return linear_workgroup(workgroup, workgroups) * WORKGROUP + thread;
}

// The item of a thread where so many `lanes`, a divisor of WORKGROUP, share one: the thread is its lane thread % lanes.
fn item_of(thread: u32, lanes: u32, workgroup: vec3u, workgroups: vec3u) -> u32 {
    return linear_workgroup(workgroup, workgroups) * (WORKGROUP / lanes) + thread / lanes;
}
