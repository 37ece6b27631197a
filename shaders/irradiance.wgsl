// Irradiance gather E = ∫ L cosθ dω (full: cosine and π included) from n_c cosine-distributed directions, n_l points on
// the lights and n_s directions to the bright sky, combined by the balance heuristic: E = Σ L cosθ / (n_c cosθ/π + n_l
// p_l + n_s p_s), with p the density per solid angle: p_l on lights, p_s along rays that leave the scene, 0 elsewhere
// (Veach and Guibas, "Optimally Combining Sampling Techniques for Monte Carlo Rendering", SIGGRAPH 1995).
//
// One entry point per technique, so that neither pays for the other's directions. LANES threads share a point, each
// tracing every LANES-th of a dispatch's samples; the host bounds a thread's rays, because a CPU driver silently ends
// an invocation after 65,535 loop iterations. The lanes' sums are added in workgroup memory in a fixed tree (a barrier
// per level), so that a result does not depend on scheduling. Dispatches add up in `gathered`, the first cosine one
// starting it. Reads 32 and writes 16 bytes per point and dispatch, and reads those 16 again in all but the first,
// besides the hierarchy and the radiance atlas.

#import lighting
#import hit
#import light_sampling
#import rng
#import sampling

// Threads per point: a power of two, at most WORKGROUP.
override LANES: u32 = 64u;

struct IrradianceParams {
    // Points of this dispatch, of those that are bound.
    first_item: u32,
    end_item: u32,
    // Samples of this dispatch.
    first_sample: u32,
    end_sample: u32,
    // Samples of the whole gather, by technique: n_c, n_l and n_s.
    cosine_samples: u32,
    light_samples: u32,
    environment_samples: u32,
    seed: u32,
    // Which stretch of its own sequences a point draws: sample 0 is their point part · n_c, part · n_l or part · n_s.
    part: u32,
    // Where texels share sequences: in how many parts a texel's stretch is drawn, of which `part` is one.
    parts: u32,
    // Texels in a row of the map whose blocks of MORTON_SIDE² texels share sequences; 0 where every point has its own.
    width: u32,
    // Rows of the environment with bright pixels.
    environment_rows: u32,
}

// What was found at a point.
struct Gathered {
    // The running sum of E.
    irradiance: vec3f,
    // How many cosine samples met the back of a triangle; after the last of them, their share.
    back_faces: f32,
}

@group(1) @binding(0) var<uniform> params: IrradianceParams;
@group(1) @binding(1) var<storage, read> points: array<SurfacePoint>;
@group(1) @binding(2) var<storage, read_write> gathered: array<Gathered>;
// Sample indices of this dispatch, sorted along a Hilbert curve: lanes in lockstep trace similar directions.
@group(1) @binding(3) var<storage, read> sample_order: array<u32>;

// L cosθ / (n_c cosθ/π + n_l p_l + n_s p_s) of a sample in `direction` that met `hit`, and 1 where it met a back. What
// misses the mesh sees the environment.
// A light shines from its front: behind a lamp's shade, its back is what an inexact mesh shows through cracks.
fn contribution(hit: Intersection, direction: vec3f, cosine: f32, table: u32) -> vec4f {
    let primitive = select(hit.primitive, 0u, hit.primitive == MISS);
    let normal = primitive_normal(primitive);
    let towards = dot(normal, direction);
    let back = towards > 0.0;
    let source = light_at(hit);
    let per_solid_angle = light_pdf(table, source, hit.t, towards / length(normal));
    let density = f32(params.cosine_samples) * cosine * INV_PI + f32(params.light_samples) * per_solid_angle;
    let light = select(radiance_at(hit) * (cosine / density), vec3f(0.0), back && is_black_behind(source));
    let beyond = environment_contribution(environment_towards(direction), cosine);
    return select(vec4f(light, select(0.0, 1.0, back)), vec4f(beyond, 0.0), hit.primitive == MISS);
}

// L cosθ / (n_c cosθ/π + n_s p_s) of what arrives from the environment: radiance, and p_s.
fn environment_contribution(seen: vec4f, cosine: f32) -> vec3f {
    return seen.rgb * (cosine / (f32(params.cosine_samples) * cosine * INV_PI + f32(params.environment_samples) * seen.a));
}

// The point that a thread works on.
struct LaneWork {
    // Its index, and which of the point's lanes the thread is.
    item: u32,
    lane: u32,
    exists: bool,
    point: SurfacePoint,
    // Seed of the point's sequences, and which stretch of them it draws.
    seed: u32,
    stretch: u32,
    // Where the point's table of the lights begins.
    table: u32,
}

fn lane_work(thread: u32, workgroup: vec3u, workgroups: vec3u) -> LaneWork {
    let item = params.first_item + item_of(thread, LANES, workgroup, workgroups);
    let point = points[min(item, params.end_item - 1u)];
    var seed = hash2(params.seed, point.index);
    var stretch = params.part;
    if params.width > 0u {
        let at = vec2u(point.index % params.width, point.index / params.width);
        let block = at / MORTON_SIDE;
        seed = hash2(params.seed, block.y * ((params.width + MORTON_SIDE - 1u) / MORTON_SIDE) + block.x);
        stretch = scrambled_morton(at % MORTON_SIDE, hash2(seed, 0u)) * params.parts + params.part;
    }
    let table = light_table(point.position, point.normal);
    return LaneWork(item, thread % LANES, item < params.end_item, point, seed, stretch, table);
}

fn sample_count() -> u32 {
    return params.end_sample - params.first_sample;
}

var<workgroup> lane_sums: array<vec4f, WORKGROUP>;

// Adds the lanes' sums; the result is meant for lane 0.
fn sum_over_lanes(thread: u32, lane: u32, sum: vec4f) -> vec4f {
    lane_sums[thread] = sum;
    for (var stride = LANES / 2u; stride > 0u; stride /= 2u) {
        workgroupBarrier();
        if lane < stride {
            lane_sums[thread] += lane_sums[thread + stride];
        }
    }
    return lane_sums[thread];
}

@compute @workgroup_size(WORKGROUP)
fn gather_cosine(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let own = lane_work(thread, workgroup, workgroups);
    let frame = frame_of(own.point.normal);
    let offset = vec2u(hash2(own.seed, 3u), hash2(own.seed, 4u));
    var sum = vec4f(0.0);
    for (var k = own.lane; own.exists && k < sample_count(); k += LANES) {
        let local = cosine_direction(lattice2(own.stretch * params.cosine_samples + sample_order[k], offset));
        let direction = world_from_frame(frame, local);
        sum += contribution(closest_hit(own.point.position, direction, T_FAR), direction, local.z, own.table);
    }
    var total = sum_over_lanes(thread, own.lane, sum);
    if own.exists && own.lane == 0u {
        if params.first_sample > 0u {
            total += vec4f(gathered[own.item].irradiance, gathered[own.item].back_faces);
        }
        if params.end_sample == params.cosine_samples {
            total.w /= f32(params.cosine_samples);
        }
        gathered[own.item] = Gathered(total.xyz, total.w);
    }
}

@compute @workgroup_size(WORKGROUP)
fn gather_lights(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let own = lane_work(thread, workgroup, workgroups);
    let offset = vec2u(hash2(own.seed, 1u), hash2(own.seed, 2u));
    var sum = vec3f(0.0);
    for (var k = own.lane; own.exists && k < sample_count(); k += LANES) {
        let light = light_point(own.table, lattice2(own.stretch * params.light_samples + sample_order[k], offset));
        let direction = normalize(light.position - own.point.position);
        let cosine = dot(own.point.normal, direction);
        // A negative limit makes the traversal end at once for lights below the horizon.
        let hit = closest_hit(own.point.position, direction, select(-1.0, T_FAR, cosine > 0.0));
        if hit.primitive != MISS && mesh_triangle(hit.primitive) == light.triangle {
            sum += contribution(hit, direction, cosine, own.table).xyz;
        }
    }
    let total = sum_over_lanes(thread, own.lane, vec4f(sum, 0.0)).xyz;
    if own.exists && own.lane == 0u {
        gathered[own.item].irradiance += total;
    }
}

@compute @workgroup_size(WORKGROUP)
fn gather_environment(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let own = lane_work(thread, workgroup, workgroups);
    let offset = vec2u(hash2(own.seed, 5u), hash2(own.seed, 6u));
    var sum = vec3f(0.0);
    for (var k = own.lane; own.exists && k < sample_count(); k += LANES) {
        let sky = sample_environment(params.environment_rows, lattice2(own.stretch * params.environment_samples + sample_order[k], offset));
        let cosine = dot(own.point.normal, sky.direction);
        // A negative limit makes the traversal end at once for what is below the horizon.
        if !is_blocked(own.point.position, sky.direction, select(-1.0, T_FAR, cosine > 0.0)) && cosine > 0.0 {
            sum += environment_contribution(vec4f(sky.radiance, sky.density), cosine);
        }
    }
    let total = sum_over_lanes(thread, own.lane, vec4f(sum, 0.0)).xyz;
    if own.exists && own.lane == 0u {
        gathered[own.item].irradiance += total;
    }
}
