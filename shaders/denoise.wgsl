// Denoising of irradiance by local regression, guided by two half-estimates of every point (method and references in
// texir-core's denoise.rs). Five passes: `smooth_halves`, `measure_noise`, `regress`, `clean`, `conserve`.
//
// In each, one thread owns one point and gathers from those around it; no barriers. Points are in the order of the
// cells that they are searched in. Per point, `regress` and `conserve` read some 550 others (32 bytes, and what those
// that are near enough hold), of which about 310 enter the former's 6 × 6 systems, one for each half; the other passes
// read about 100.

#import math
#import sampling

// A point where neighbours are searched.
struct Entry {
    position: vec3f,
    // Where it is in the host's arrays, which nothing here needs.
    index: u32,
    normal: vec3f,
    cell: u32,
}

// Both halves of what was gathered at a point.
struct Estimate {
    a: vec3f,
    // Points of different flags are not mixed.
    apart: u32,
    b: vec3f,
    pad: u32,
}

// What a point's closest neighbours tell about it.
struct Smoothed {
    a: vec3f,
    // Variance of the smoothed value over that of a single point: Σ w² / (Σ w)².
    variance_ratio: f32,
    b: vec3f,
    // Square of the point's value.
    squared_value: f32,
}

// The noise at a point.
struct Noise {
    // Mean square of the difference of both halves, relative to the squared value.
    relative: f32,
    // Variance of the difference between two smoothed estimates of the same half that is due to noise.
    smoothed: f32,
}

// The regression of each half.
struct Fitted {
    a: vec3f,
    pad0: u32,
    b: vec3f,
    pad1: u32,
}

struct DenoiseParams {
    // Points of this dispatch: [first, end).
    first: u32,
    end: u32,
    // The cell of the first of them.
    first_cell: u32,
    // Edge of a typical texel, metres.
    texel: f32,
    // The twin's constants; radii in texels.
    radius: f32,
    guide_radius: f32,
    noise_radius: f32,
    residual_radius: f32,
    tolerance: f32,
    curvature: f32,
    residual_threshold: f32,
    loss_sigmas: f32,
    ridge: f32,
    min_normal_cosine: f32,
    max_plane_distance: f32,
    // The smallest variance and squared value that is divided by.
    tiny: f32,
}

// Columns of cells around one: within one cell, and within three.
const NEAR_COLUMNS: u32 = 9u;
const COLUMNS: u32 = 49u;

@group(1) @binding(0) var<uniform> params: DenoiseParams;
@group(1) @binding(1) var<storage, read> entries: array<Entry>;
// Of every cell of this dispatch, COLUMNS ranges of `entries`.
@group(1) @binding(2) var<storage, read> spans: array<vec2u>;
@group(1) @binding(3) var<storage, read> estimates: array<Estimate>;
@group(1) @binding(4) var<storage, read_write> smoothed: array<Smoothed>;
@group(1) @binding(5) var<storage, read_write> noise: array<Noise>;
@group(1) @binding(6) var<storage, read_write> fits: array<Fitted>;
@group(1) @binding(7) var<storage, read_write> cleaned: array<vec4f>;
@group(1) @binding(8) var<storage, read_write> conserved: array<vec4f>;

fn owned_point(thread: u32, workgroup: vec3u, workgroups: vec3u) -> u32 {
    return params.first + linear_thread(thread, workgroup, workgroups);
}

// The entries of a column of cells around a point: [x, y).
fn span_of(own: Entry, column: u32) -> vec2u {
    return spans[(own.cell - params.first_cell) * COLUMNS + column];
}

// Offset of point j in shares of a search radius (texels), and the kernel there, 1 − |x|² (Epanechnikov); negative
// where it is too far, on another surface, or apart from the own point.
fn kernel_at(own: Entry, apart: u32, j: u32, radius_texels: f32) -> vec4f {
    let other = entries[j];
    let radius = radius_texels * params.texel;
    let offset = other.position - own.position;
    let same_surface = abs(dot(offset, own.normal)) < params.max_plane_distance * radius
        && dot(own.normal, other.normal) > params.min_normal_cosine
        && dot(offset, offset) < radius * radius;
    let at = offset / radius;
    return vec4f(at, select(-1.0, max(1.0 - dot(at, at), 0.0), same_surface && estimates[j].apart == apart));
}

fn square(v: vec3f) -> f32 {
    return dot(v, v);
}

@compute @workgroup_size(WORKGROUP)
fn smooth_halves(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let i = owned_point(thread, workgroup, workgroups);
    if i >= params.end {
        return;
    }
    let own = entries[i];
    let estimate = estimates[i];
    var a = vec3f(0.0);
    var b = vec3f(0.0);
    var weight = 0.0;
    var squares = 0.0;
    for (var column = 0u; column < NEAR_COLUMNS; column++) {
        let span = span_of(own, column);
        for (var j = span.x; j < span.y; j++) {
            let kernel = kernel_at(own, estimate.apart, j, params.guide_radius).w;
            if kernel < 0.0 {
                continue;
            }
            let other = estimates[j];
            a += kernel * other.a;
            b += kernel * other.b;
            weight += kernel;
            squares += kernel * kernel;
        }
    }
    a /= weight;
    b /= weight;
    // The smaller: the own value beside something brighter, the smoothed one of a firefly.
    let level = min(square((a + b) * 0.5), square((estimate.a + estimate.b) * 0.5));
    smoothed[i] = Smoothed(a, squares / (weight * weight), b, max(level, params.tiny));
}

@compute @workgroup_size(WORKGROUP)
fn measure_noise(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let i = owned_point(thread, workgroup, workgroups);
    if i >= params.end {
        return;
    }
    let own = entries[i];
    let apart = estimates[i].apart;
    var sum = 0.0;
    var weight = 0.0;
    for (var column = 0u; column < NEAR_COLUMNS; column++) {
        let span = span_of(own, column);
        for (var j = span.x; j < span.y; j++) {
            let kernel = kernel_at(own, apart, j, params.noise_radius).w;
            if kernel < 0.0 {
                continue;
            }
            let other = estimates[j];
            // (a − b)² estimates the variance of a − b; relative to the value, it is alike in light and in shadow.
            sum += kernel * square(other.a - other.b) / smoothed[j].squared_value;
            weight += kernel;
        }
    }
    let relative = sum / weight;
    noise[i] = Noise(relative, max(relative * smoothed[i].squared_value * smoothed[i].variance_ratio, params.tiny));
}

// Weighted least squares of value = c + g·at + atᵀH at, with the terms (1, x, y, x²; xy, y²).
struct Fit {
    // Σ w m of the monomials m: (1, x, y, x²), (xy, y², x³, x²y), (xy², y³, x⁴, x³y), (x²y², xy³, y⁴, 0).
    moments: mat4x4f,
    // Σ w term value, by channel: the first four terms, and the last two.
    first: mat3x4f,
    last: mat3x2f,
}

fn add_to(fit: Fit, weight: f32, monomials: mat4x4f, value: vec3f) -> Fit {
    let terms = weight * monomials[0];
    let more = weight * monomials[1].xy;
    return Fit(
        fit.moments + weight * monomials,
        fit.first + mat3x4f(terms * value.x, terms * value.y, terms * value.z),
        fit.last + mat3x2f(more * value.x, more * value.y, more * value.z),
    );
}

fn is_plausible(value: vec3f) -> bool {
    return all(value >= vec3f(0.0)) && all(value <= vec3f(3.4e38));
}

// The fitted value at the centre, `curved` the weight of there being no curvature; the weighted mean where
// nothing can be fitted, or extrapolation makes it negative; what the point has itself where neither is a number.
fn centre(fit: Fit, curved: f32, own: vec3f) -> vec3f {
    let m = fit.moments;
    let weight = m[0].x;
    let ridge = params.ridge * weight;
    // The normal equations, lower triangle row by row, with the right-hand sides of the channels beside them.
    var a = array<array<f32, 6>, 6>(
        array<f32, 6>(weight, 0.0, 0.0, 0.0, 0.0, 0.0),
        array<f32, 6>(m[0].y, m[0].w + ridge, 0.0, 0.0, 0.0, 0.0),
        array<f32, 6>(m[0].z, m[1].x, m[1].y + ridge, 0.0, 0.0, 0.0),
        array<f32, 6>(m[0].w, m[1].z, m[1].w, m[2].z + ridge + curved, 0.0, 0.0),
        array<f32, 6>(m[1].x, m[1].w, m[2].x, m[2].w, m[3].x + ridge + curved, 0.0),
        array<f32, 6>(m[1].y, m[2].x, m[2].y, m[3].x, m[3].y, m[3].z + ridge + curved),
    );
    var b = array<vec3f, 6>(
        vec3f(fit.first[0].x, fit.first[1].x, fit.first[2].x),
        vec3f(fit.first[0].y, fit.first[1].y, fit.first[2].y),
        vec3f(fit.first[0].z, fit.first[1].z, fit.first[2].z),
        vec3f(fit.first[0].w, fit.first[1].w, fit.first[2].w),
        vec3f(fit.last[0].x, fit.last[1].x, fit.last[2].x),
        vec3f(fit.last[0].y, fit.last[1].y, fit.last[2].y),
    );
    let mean = b[0] / weight;
    // Gaussian elimination from the last unknown to the first, of which alone the solution is wanted: A stays
    // symmetric.
    var solvable = true;
    for (var k = 5; k > 0; k--) {
        let pivot = a[k][k];
        solvable = solvable && pivot > 0.0;
        for (var r = 0; r < k; r++) {
            let share = a[k][r] / pivot;
            for (var c = 0; c <= r; c++) {
                a[r][c] -= share * a[k][c];
            }
            b[r] -= share * b[k];
        }
    }
    let fitted = b[0] / a[0][0];
    if solvable && a[0][0] > 0.0 && is_plausible(fitted) {
        return fitted;
    }
    return select(own, mean, is_plausible(mean));
}

@compute @workgroup_size(WORKGROUP)
fn regress(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let i = owned_point(thread, workgroup, workgroups);
    if i >= params.end {
        return;
    }
    let own = entries[i];
    let estimate = estimates[i];
    let guide = smoothed[i];
    let own_noise = noise[i];
    let frame = frame_of(own.normal);
    var a: Fit;
    var b: Fit;
    for (var column = 0u; column < COLUMNS; column++) {
        let span = span_of(own, column);
        for (var j = span.x; j < span.y; j++) {
            let kernel = kernel_at(own, estimate.apart, j, params.radius);
            if kernel.w < 0.0 {
                continue;
            }
            let other = estimates[j];
            let x = dot(kernel.xyz, frame.tangent);
            let y = dot(kernel.xyz, frame.bitangent);
            let monomials = mat4x4f(
                vec4f(1.0, x, y, x * x),
                vec4f(x * y, y * y, x * x * x, x * x * y),
                vec4f(x * y * y, y * y * y, x * x * x * x, x * x * x * y),
                vec4f(x * x * y * y, x * y * y * y, y * y * y * y, 0.0),
            );
            // A half's weights are the other half's, so that a point's noise does not choose its own neighbours.
            let guide_there = smoothed[j];
            let differences = vec2f(square(guide.b - guide_there.b), square(guide.a - guide_there.a));
            let beyond = max(differences - own_noise.smoothed, vec2f(0.0));
            let alike = 1.0 + beyond / (own_noise.smoothed * params.tolerance * params.tolerance);
            let weights = kernel.w / (alike * alike);
            a = add_to(a, weights.x, monomials, other.a);
            b = add_to(b, weights.y, monomials, other.b);
        }
    }
    // A half's variance over that of the coefficients before anything is seen.
    let curved = own_noise.relative / (2.0 * params.curvature * params.curvature);
    fits[i] = Fitted(centre(a, curved, estimate.a), 0u, centre(b, curved, estimate.b), 0u);
}

@compute @workgroup_size(WORKGROUP)
fn clean(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let i = owned_point(thread, workgroup, workgroups);
    if i >= params.end {
        return;
    }
    let own = entries[i];
    let estimate = estimates[i];
    // Of what is beyond the fits, relative to them: what both halves share, and the variance of their mean.
    var shared_part = 0.0;
    var variance = 0.0;
    for (var column = 0u; column < NEAR_COLUMNS; column++) {
        let span = span_of(own, column);
        for (var j = span.x; j < span.y; j++) {
            let kernel = kernel_at(own, estimate.apart, j, params.residual_radius).w;
            if kernel < 0.0 {
                continue;
            }
            let other = estimates[j];
            let fit = fits[j];
            let a = other.a - fit.a;
            let b = other.b - fit.b;
            let level = max(square(fit.a + fit.b), params.tiny);
            shared_part += kernel * dot(a, b) / level;
            variance += kernel * square(a - b) / (4.0 * level);
        }
    }
    // Wiener's weight, of what is more than chance.
    let signal = max(shared_part - variance * params.residual_threshold, 0.0);
    let kept = select(0.0, signal / (signal + variance), signal > 0.0);
    let fit = (fits[i].a + fits[i].b) * 0.5;
    cleaned[i] = vec4f(fit + ((estimate.a + estimate.b) * 0.5 - fit) * kept, 0.0);
}

fn level_of(value: vec3f) -> f32 {
    return max(square(value), params.tiny);
}

@compute @workgroup_size(WORKGROUP)
fn conserve(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let i = owned_point(thread, workgroup, workgroups);
    if i >= params.end {
        return;
    }
    let own = entries[i];
    let apart = estimates[i].apart;
    let value = cleaned[i].xyz;
    let level = level_of(value);
    // What texels of like brightness lost on average, and its squared standard error.
    var lost = vec3f(0.0);
    var weight = 0.0;
    var squares = 0.0;
    for (var column = 0u; column < COLUMNS; column++) {
        let span = span_of(own, column);
        for (var j = span.x; j < span.y; j++) {
            let kernel = kernel_at(own, apart, j, params.radius).w;
            if kernel < 0.0 {
                continue;
            }
            let other = estimates[j];
            let there = cleaned[j].xyz;
            let share = kernel * kernel * min(level, level_of(there)) / max(level, level_of(there));
            let here = (other.a + other.b) * 0.5 - there;
            lost += share * here;
            weight += share;
            squares += share * share * square(here);
        }
    }
    lost /= weight;
    let chance = squares / (weight * weight) * params.loss_sigmas * params.loss_sigmas;
    let given = select(0.0, 1.0 - chance / square(lost), square(lost) > chance);
    conserved[i] = vec4f(max(value + lost * given, vec3f(0.0)), 0.0);
}
