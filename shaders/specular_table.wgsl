// Specular tables: S(r_k) = Σ L f_s(r_k) nl / Σ_j n_j p_j at every node k, by the balance heuristic (Veach and Guibas
// 1995) over GGX lobes, the cosine and the lights. Every node uses every sample (texir-core's specular_table.rs).
//
// LANES threads share a pixel. In each round they trace a sample each and leave what the nodes need of it in workgroup
// memory; then each adds all of the pixel's samples of the round to the nodes that are its own, in the order of their
// index. So a thread keeps NODES / LANES sums, not NODES, and no sum depends on scheduling. Dispatches add up in
// `tables`, which the host clears; it also bounds a thread's rays, as in irradiance.wgsl. Reads 640 and writes 384
// bytes per pixel and dispatch.

#import lighting
#import light_sampling
#import rng
#import lobe
#import shading

// As in texir-core's specular_table.rs: roughnesses tabulated, points of a pixel that its rays leave from, lobes.
const NODES: u32 = 32u;
const STRATA: u32 = 4u;
const LOBES: u32 = 5u;
// Threads per pixel: a divisor of NODES, of which WORKGROUP is a multiple.
const LANES: u32 = 8u;

// The sampling technique of a pipeline: a constant, so that each compiles its own directions alone.
override TECHNIQUE: u32 = 0u;
const FROM_LOBES: u32 = 0u;
const FROM_COSINE: u32 = 1u;
const FROM_LIGHTS: u32 = 2u;

// Values of `masking`: texir-core's brdf::Masking.
const SMITH: u32 = 1u;

struct SpecularTableParams {
    // Pixels of this dispatch, of those that are bound.
    first_item: u32,
    end_item: u32,
    // Samples of this dispatch: of all lobes one after another, or of the cosine, or of the lights.
    first_sample: u32,
    end_sample: u32,
    // n_j of each lobe, of the cosine and of the lights, per stratum.
    lobe_samples: u32,
    cosine_samples: u32,
    light_samples: u32,
    seed: u32,
    // Reflectance at normal incidence.
    f0: f32,
    // How microfacets hide each other: SMITH, or else the authors' way.
    masking: u32,
    // Roughnesses of the LOBES, then unused.
    lobes: array<vec4f, 2>,
    // Roughnesses of the NODES.
    nodes: array<vec4f, 8>,
}

@group(1) @binding(0) var<uniform> params: SpecularTableParams;
@group(1) @binding(1) var<storage, read> pixels: array<array<ShadePoint, STRATA>>;
// Sums over samples, linear RGB by node.
@group(1) @binding(2) var<storage, read_write> tables: array<array<array<f32, 3>, NODES>>;

// A direction to trace.
struct SampleRay {
    direction: vec3f,
    // The triangle of the mesh that it must reach to count, MISS for any.
    triangle: u32,
}

// Sample `s` of the dispatch's technique, from one of the pixel's points.
fn sample_ray(point: ShadePoint, frame: Frame, s: u32, seed: u32) -> SampleRay {
    if TECHNIQUE == FROM_LIGHTS {
        let table = light_table(point.position, point.normal);
        let light = light_point(table, sobol2(s, hash2(seed, LOBES + 1u)));
        return SampleRay(normalize(light.position - point.position), light.triangle);
    }
    if TECHNIQUE == FROM_COSINE {
        return SampleRay(world_from_frame(frame, cosine_direction(sobol2(s, hash2(seed, LOBES)))), MISS);
    }
    let lobe = s / (STRATA * params.lobe_samples);
    let u = sobol2(s % (STRATA * params.lobe_samples), hash2(seed, lobe));
    return SampleRay(sample_lobe(frame, point.view, lobe_roughness(lobe), u).direction, MISS);
}

// Which of the pixel's points sample `s` leaves from.
fn stratum_of(s: u32) -> u32 {
    switch TECHNIQUE {
        case FROM_LIGHTS: {
            return s / params.light_samples;
        }
        case FROM_COSINE: {
            return s / params.cosine_samples;
        }
        default: {
            return s / params.lobe_samples % STRATA;
        }
    }
}

fn lobe_roughness(lobe: u32) -> f32 {
    return params.lobes[lobe / 4u][lobe % 4u];
}

// g of the shadowing–masking term.
fn masking(c: f32, r: f32) -> f32 {
    if params.masking == SMITH {
        return g_smith(c, r);
    }
    return g_schlick(c, r);
}

fn node_roughness(node: u32) -> f32 {
    return params.nodes[node / 4u][node % 4u];
}

// What all nodes need of a sample: L F nl / Σ_j n_j p_j, sin²θ_h, n·l and n·v.
struct Sample {
    light: vec3f,
    sin2: f32,
    nl: f32,
    nv: f32,
}

// Traces a sample; one that does not count has no light.
fn trace_sample(point: ShadePoint, ray: SampleRay, present: bool) -> Sample {
    let half = normalize(ray.direction + point.view);
    let across = cross(point.normal, half);
    let nl = dot(point.normal, ray.direction);
    let nv = dot(point.normal, point.view);
    // From behind there is no half vector where the direction is the view's opposite, and NaN times no light is NaN.
    let sin2 = select(0.0, dot(across, across), nl > 0.0 && nv > 0.0);
    let nh = saturate(dot(point.normal, half));
    let c = Cosines(saturate(nl), saturate(nv), nh, clamp(dot(point.view, half), 1e-6, 1.0));
    // A negative limit makes the traversal end at once for what does not count anyway.
    let hit = closest_hit(point.position, ray.direction, select(-1.0, T_FAR, present && nl > 0.0 && nv > 0.0));
    let primitive = select(hit.primitive, 0u, hit.primitive == MISS);
    var lobes = 0.0;
    for (var lobe = 0u; lobe < LOBES; lobe++) {
        lobes += ndf_from_sin2(sin2, lobe_roughness(lobe));
    }
    let density = f32(params.lobe_samples) * lobes * c.nh / (4.0 * c.vh)
        + f32(params.cosine_samples) * c.nl * INV_PI
        + f32(params.light_samples)
            * light_pdf(light_table(point.position, point.normal), light_at(hit), hit.t, dot(normalize(primitive_normal(primitive)), ray.direction));
    let x = fresnel_weight(c.vh);
    let light = radiance_at(hit) * ((params.f0 * (1.0 - x) + x) * c.nl / density);
    let counts = hit.primitive != MISS && (ray.triangle == MISS || ray.triangle == mesh_triangle(hit.primitive));
    return Sample(select(vec3f(0.0), light, counts), sin2, c.nl, c.nv);
}

var<workgroup> samples: array<Sample, WORKGROUP>;

@compute @workgroup_size(WORKGROUP)
fn specular_table(
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroups: vec3u,
) {
    let lane = thread % LANES;
    let pixel = params.first_item + item_of(thread, LANES, workgroup, workgroups);
    let exists = pixel < params.end_item;
    let item = min(pixel, params.end_item - 1u);
    let seed = hash2(params.seed, pixels[item][0].index);
    // The thread's own nodes are every LANES-th.
    var sums: array<vec3f, NODES / LANES>;
    for (var first = params.first_sample; first < params.end_sample; first += LANES) {
        let s = min(first + lane, params.end_sample - 1u);
        let point = pixels[item][stratum_of(s)];
        samples[thread] = trace_sample(point, sample_ray(point, frame_of(point.normal), s, seed), exists && s == first + lane);
        workgroupBarrier();
        for (var k = 0u; k < NODES / LANES; k++) {
            let r = node_roughness(k * LANES + lane);
            for (var i = 0u; i < LANES; i++) {
                let drawn = samples[thread - lane + i];
                // f_s / F = D g(nl) g(nv) / 4.
                sums[k] += drawn.light
                    * (0.25 * ndf_from_sin2(drawn.sin2, r) * masking(drawn.nl, r) * masking(drawn.nv, r));
            }
        }
        workgroupBarrier();
    }
    for (var k = 0u; exists && k < NODES / LANES; k++) {
        for (var c = 0u; c < 3u; c++) {
            tables[item][k * LANES + lane][c] += sums[k][c];
        }
    }
}
