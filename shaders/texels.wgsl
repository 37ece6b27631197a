// Texel map: which surface point each atlas texel is. The lowest-numbered triangle that contains the texel's centre;
// else the nearest point of the nearest triangle that comes within `reach` of it (the lower number where equally near).
//
// A workgroup is a tile of the atlas, a thread one of its texels, which looks through the triangles that the host
// binned into the tile, at most `candidates` of them in one dispatch (the loop limit of CPU drivers); the state between
// dispatches is the hit itself, with the squared distance in t. No barriers. Reads 28 bytes per candidate, writes 16
// per texel, and reads those again in all but the first dispatch.

#import hit

// Side of a tile, texels.
override TILE: u32 = 16u;

struct TexelsParams {
    width: u32,
    height: u32,
    // First row of tiles of this dispatch, of those that hold the wanted rows of texels.
    first_row: u32,
    // Wanted rows of texels: [rows_begin, rows_end).
    rows_begin: u32,
    rows_end: u32,
    // Candidates of each tile that this dispatch looks through: [first_candidate, first_candidate + candidates).
    first_candidate: u32,
    candidates: u32,
    // Distance in texels within which a triangle counts as touching a texel (the twin's REACH).
    reach: f32,
}

@group(1) @binding(0) var<uniform> params: TexelsParams;
// tiles + 1 offsets into `bins`, and triangle indices tile by tile, ascending.
@group(1) @binding(1) var<storage, read> bin_offsets: array<u32>;
@group(1) @binding(2) var<storage, read> bins: array<u32>;
// Atlas coordinates of every triangle's three corners.
@group(1) @binding(3) var<storage, read> corner_uvs: array<vec2f>;
// t holds the squared distance in texels: 0 where the centre is inside.
@group(1) @binding(4) var<storage, read_write> hits: array<Hit>;

fn cross2(a: vec2f, b: vec2f) -> f32 {
    return a.x * b.y - a.y * b.x;
}

// Parameter of the point of the segment from 0 to `edge` that is nearest to `p`.
fn along(p: vec2f, edge: vec2f) -> f32 {
    return clamp(dot(p, edge) / dot(edge, edge), 0.0, 1.0);
}

// (u, v, squared distance) of the triangle's point nearest to the origin's offset `ap` from its first corner.
fn nearest(ab: vec2f, ac: vec2f, ap: vec2f, area: f32) -> vec3f {
    let u = cross2(ap, ac) / area;
    let v = cross2(ab, ap) / area;
    if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
        return vec3f(u, v, 0.0);
    }
    let s = along(ap, ab);
    let t = along(ap, ac);
    let w = along(ap - ab, ac - ab);
    var best = vec3f(0.0, 0.0, 3.4e38);
    for (var edge = 0u; edge < 3u; edge++) {
        let uv = select(select(vec2f(1.0 - w, w), vec2f(0.0, t), edge == 1u), vec2f(s, 0.0), edge == 0u);
        let offset = ap - ab * uv.x - ac * uv.y;
        let distance = dot(offset, offset);
        if distance < best.z {
            best = vec3f(uv, distance);
        }
    }
    return best;
}

@compute @workgroup_size(TILE, TILE)
fn texels(@builtin(local_invocation_id) local: vec3u, @builtin(workgroup_id) workgroup: vec3u) {
    let x = workgroup.x * TILE + local.x;
    let tile_row = params.first_row + workgroup.y;
    let y = (params.rows_begin / TILE + tile_row) * TILE + local.y;
    if x >= params.width || y < params.rows_begin || y >= params.rows_end {
        return;
    }
    let columns = (params.width + TILE - 1u) / TILE;
    let tile = tile_row * columns + workgroup.x;
    let out = (y - params.rows_begin) * params.width + x;
    let size = vec2f(f32(params.width), f32(params.height));
    let centre = vec2f(f32(x), f32(y)) + 0.5;
    var best = Hit(NO_TRIANGLE, 0.0, 0.0, params.reach * params.reach);
    if params.first_candidate > 0u {
        best = hits[out];
    }
    let first = bin_offsets[tile] + params.first_candidate;
    let end = min(first + params.candidates, bin_offsets[tile + 1u]);
    for (var k = first; k < end && best.t != 0.0; k++) {
        let triangle = bins[k];
        let a = corner_uvs[3u * triangle] * size;
        let ab = corner_uvs[3u * triangle + 1u] * size - a;
        let ac = corner_uvs[3u * triangle + 2u] * size - a;
        let area = cross2(ab, ac);
        // Where both edges are one, a fused product leaves its rounding error of an area that is 0.
        if area != 0.0 && any(ab != ac) {
            let found = nearest(ab, ac, centre - a, area);
            if found.z < best.t {
                best = Hit(triangle, found.x, found.y, found.z);
            }
        }
    }
    hits[out] = best;
}
