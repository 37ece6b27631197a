// Where the hierarchy lies on CPU adapters: rgba32float textures, which their drivers fetch faster than storage buffers.
// Word i is at column i mod 4096, row i / 4096 (the host's TEXTURE_COLUMNS).

@group(0) @binding(0) var bvh_nodes: texture_2d<f32>;
@group(0) @binding(1) var bvh_triangles: texture_2d<f32>;

fn node_word(i: u32) -> vec4u {
    return bitcast<vec4u>(textureLoad(bvh_nodes, vec2u(i & 4095u, i >> 12u), 0));
}

fn triangle_word(i: u32) -> vec4u {
    return bitcast<vec4u>(textureLoad(bvh_triangles, vec2u(i & 4095u, i >> 12u), 0));
}
