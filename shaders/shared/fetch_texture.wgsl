// Where the hierarchy lies on CPU adapters: rgba32float textures, which their drivers fetch faster than storage
// buffers. Storage textures, because llvmpipe looks up a mip level, lane by lane, at each fetch from a sampled one.
// Word i is at column i mod TEXTURE_COLUMNS, row i / TEXTURE_COLUMNS.

const TEXTURE_COLUMNS: u32 = 8192u;

@group(0) @binding(0) var bvh_nodes: texture_storage_2d<rgba32float, read>;
@group(0) @binding(1) var bvh_triangles: texture_storage_2d<rgba32float, read>;

fn node_word(i: u32) -> vec4u {
    return bitcast<vec4u>(textureLoad(bvh_nodes, vec2u(i % TEXTURE_COLUMNS, i / TEXTURE_COLUMNS)));
}

fn triangle_word(i: u32) -> vec4u {
    return bitcast<vec4u>(textureLoad(bvh_triangles, vec2u(i % TEXTURE_COLUMNS, i / TEXTURE_COLUMNS)));
}
