// Closest hits through obvhs's CWBVH: 8-wide, boxes quantised to bytes (Ylitie, Karras and Laine, "Efficient Incoherent
// Ray Traversal on GPUs Through Compressed Wide BVHs", HPG 2017; obvhs interleaves minima and maxima).
//
// While-while: nodes until some yield triangles, then those triangles, because a CPU driver runs both sides of every
// `if` in a loop. A node is 5 words (80 bytes), a triangle 4 (64 bytes, a cache line): (corner a, the triangle's tag),
// (b − a, u of c), (c − a, v of c), (u and v of a, u and v of b).

#import fetch
#import opacity

// A ray's first hit; `primitive` counts in the hierarchy's order, MISS for none. Point = (1−u−v)·a + u·b + v·c.
struct Intersection {
    primitive: u32,
    u: f32,
    v: f32,
    t: f32,
}

const MISS: u32 = 0xffffffffu;
// The furthest that rays go, metres.
const T_FAR: f32 = 1e30;
// Entries of the traversal stack: one per level of the hierarchy, which has at most 31 (hierarchy.rs).
const STACK_SIZE: u32 = 32u;
// Relative bias of back-face hits, which count as BACK_FACE_BIAS · (t + max |origin|) further: of two coincident
// triangles that face opposite ways, a ray meets the one that faces it (the twin's BACK_FACE_BIAS).
const BACK_FACE_BIAS: f32 = 7.62939453125e-6;
// Slab tests round: exits are moved out by two units in the last place (Ize, "Robust BVH Ray Traversal", JCGT 2013).
const SLAB_ROUNDING: f32 = 1.00000024;

// A ray as node tests need it: 1/direction with zeros kept finite, and the octant that orders children front to back.
struct TraversalRay {
    origin: vec3f,
    inverse: vec3f,
    octant: u32,
}

fn traversal_ray(origin: vec3f, direction: vec3f) -> TraversalRay {
    let tiny = select(vec3f(1e-20), vec3f(-1e-20), direction < vec3f(0.0));
    let inverse = 1.0 / select(direction, tiny, abs(direction) < vec3f(1e-20));
    let back = select(vec3u(0x04040404u, 0x02020202u, 0x01010101u), vec3u(0u), direction < vec3f(0.0));
    return TraversalRay(origin, inverse, back.x | back.y | back.z);
}

fn bytes_of(word: u32) -> vec4u {
    return (vec4u(word) >> vec4u(0u, 8u, 16u, 24u)) & vec4u(0xffu);
}

// Four children of a node: their bits in its hit mask, triangles in the low 24, inner nodes by priority in the high 8.
fn child_hits(tags: u32, inside: vec4<bool>, octant: u32) -> u32 {
    let inner = (tags & (tags << 1u)) & 0x10101010u;
    let inner_bytes = (inner >> 4u) * 0xffu;
    let shift = bytes_of((tags ^ (octant & inner_bytes)) & 0x1f1f1f1fu);
    let bits = bytes_of((tags >> 5u) & 0x07070707u) << shift;
    let hit = select(vec4u(0u), bits, inside);
    return hit.x | hit.y | hit.z | hit.w;
}

// Whether the ray meets each of four boxes before t_max; planes in node units, `near` and `far` already ordered.
fn slabs(near: vec3u, far: vec3u, scale: vec3f, offset: vec3f, t_max: f32) -> vec4<bool> {
    let x0 = vec4f(bytes_of(near.x)) * scale.x + offset.x;
    let y0 = vec4f(bytes_of(near.y)) * scale.y + offset.y;
    let z0 = vec4f(bytes_of(near.z)) * scale.z + offset.z;
    let x1 = vec4f(bytes_of(far.x)) * scale.x + offset.x;
    let y1 = vec4f(bytes_of(far.y)) * scale.y + offset.y;
    let z1 = vec4f(bytes_of(far.z)) * scale.z + offset.z;
    let enter = max(max(x0, y0), max(z0, vec4f(0.0)));
    let leave = min(min(x1, y1) * SLAB_ROUNDING, min(z1 * SLAB_ROUNDING, vec4f(t_max)));
    return enter <= leave;
}

// A node's hit mask and its head and second word, which hold the indices of its children.
struct NodeHits {
    mask: u32,
    head: vec4u,
    links: vec4u,
}

fn intersect_node(node: u32, ray: TraversalRay, t_max: f32) -> NodeHits {
    let base = node * 5u;
    let head = node_word(base);
    let links = node_word(base + 1u);
    let x = node_word(base + 2u);
    let y = node_word(base + 3u);
    let z = node_word(base + 4u);
    let exponent = vec3u(head.w, head.w >> 8u, head.w >> 16u) & vec3u(0xffu);
    let scale = bitcast<vec3f>(exponent << vec3u(23u)) * ray.inverse;
    let offset = (bitcast<vec3f>(head.xyz) - ray.origin) * ray.inverse;
    let back = ray.inverse < vec3f(0.0);
    // Words are (min of children 0–3, min of 4–7, max of 0–3, max of 4–7).
    let nx = select(x, x.zwxy, back.x);
    let ny = select(y, y.zwxy, back.y);
    let nz = select(z, z.zwxy, back.z);
    let low = slabs(vec3u(nx.x, ny.x, nz.x), vec3u(nx.z, ny.z, nz.z), scale, offset, t_max);
    let high = slabs(vec3u(nx.y, ny.y, nz.y), vec3u(nx.w, ny.w, nz.w), scale, offset, t_max);
    return NodeHits(child_hits(links.z, low, ray.octant) | child_hits(links.w, high, ray.octant), head, links);
}

// One of the words of a triangle, as numbers.
fn triangle_part(primitive: u32, part: u32) -> vec4f {
    return bitcast<vec4f>(triangle_word(primitive * 4u + part));
}

// NaN enters any box: a ray of it would visit the whole hierarchy. By the bits, as compilers may take comparisons of
// numbers for those of finite ones.
fn is_finite(v: vec3f) -> bool {
    return all((bitcast<vec3u>(v) & vec3u(0x7f800000u)) != vec3u(0x7f800000u));
}

// The closest hit with t_min < t < t_max of what is there of a triangle, or with `any_hit` the first that is found.
// `any_hit` and `evenly` (see is_met) are constants.
fn trace(origin: vec3f, direction: vec3f, t_min: f32, t_max: f32, any_hit: bool, evenly: bool) -> Intersection {
    let ray = traversal_ray(origin, direction);
    let size = max(max(abs(origin.x), abs(origin.y)), abs(origin.z));
    var best = Intersection(MISS, 0.0, 0.0, t_max);
    // How far it counts as.
    var reach = t_max + BACK_FACE_BIAS * (t_max + size);
    var stack: array<vec2u, STACK_SIZE>;
    var depth = 0u;
    // (index of the first child, hits by priority in the high 8 bits | mask of inner children): the root alone.
    var nodes = vec2u(0u, select(0u, 0x80000000u, is_finite(origin) && is_finite(direction)));
    loop {
        // (index of the first primitive, hit primitives as bits).
        var leaf = vec2u(0u);
        while leaf.y == 0u && nodes.y > 0x00ffffffu {
            let bit = firstLeadingBit(nodes.y);
            let slot = (bit - 24u) ^ (ray.octant & 0xffu);
            let child = nodes.x + countOneBits(nodes.y & ~(0xffffffffu << slot));
            nodes.y &= ~(1u << bit);
            if nodes.y > 0x00ffffffu {
                stack[depth] = nodes;
                depth += 1u;
            }
            let hits = intersect_node(child, ray, reach);
            nodes = vec2u(hits.links.x, (hits.mask & 0xff000000u) | (hits.head.w >> 24u));
            leaf = vec2u(hits.links.y, hits.mask & 0x00ffffffu);
            if nodes.y <= 0x00ffffffu && depth > 0u {
                depth -= 1u;
                nodes = stack[depth];
            }
        }
        if leaf.y == 0u {
            break;
        }
        while leaf.y != 0u {
            let bit = firstLeadingBit(leaf.y);
            leaf.y &= ~(1u << bit);
            let primitive = leaf.x + bit;
            let corner = triangle_word(primitive * 4u);
            let v0 = bitcast<vec3f>(corner.xyz);
            let e1 = triangle_part(primitive, 1u).xyz;
            let e2 = triangle_part(primitive, 2u).xyz;
            let p = cross(direction, e2);
            let determinant = dot(e1, p);
            let inverse = 1.0 / determinant;
            let s = origin - v0;
            let u = dot(s, p) * inverse;
            let q = cross(s, e1);
            let v = dot(direction, q) * inverse;
            let t = dot(e2, q) * inverse;
            let counted = t + select(0.0, BACK_FACE_BIAS * (t + size), determinant < 0.0);
            let nearer = u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > t_min && t < t_max && counted < reach;
            if determinant != 0.0 && nearer && is_met(corner.w, u, v, evenly) {
                best = Intersection(primitive, u, v, t);
                reach = counted;
            }
        }
        if any_hit && best.primitive != MISS {
            break;
        }
    }
    return best;
}

// The closest hit with 0 < t < t_max along the unit direction, either side of a triangle (Möller and Trumbore 1997);
// backs count as BACK_FACE_BIAS further.
fn closest_hit(origin: vec3f, direction: vec3f, t_max: f32) -> Intersection {
    return trace(origin, direction, 0.0, t_max, false, false);
}

// Whether anything is hit with 0 < t < t_max along the unit direction, either side of a triangle.
fn is_blocked(origin: vec3f, direction: vec3f, t_max: f32) -> bool {
    return trace(origin, direction, 0.0, t_max, true, false).primitive != MISS;
}

// Normal of a primitive, on the side from which its corners run counter-clockwise; its length is twice the area.
fn primitive_normal(primitive: u32) -> vec3f {
    return cross(triangle_part(primitive, 1u).xyz, triangle_part(primitive, 2u).xyz);
}

// Index in the mesh of a primitive of the hierarchy.
fn mesh_triangle(primitive: u32) -> u32 {
    return tagged_triangle(triangle_word(primitive * 4u).w);
}
