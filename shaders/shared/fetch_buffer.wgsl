// Where the hierarchy lies on GPUs: storage buffers of integers, so that no bit pattern is taken for a NaN or a
// denormal.

@group(0) @binding(0) var<storage, read> bvh_nodes: array<vec4u>;
@group(0) @binding(1) var<storage, read> bvh_triangles: array<vec4u>;

fn node_word(i: u32) -> vec4u {
    return bvh_nodes[i];
}

fn triangle_word(i: u32) -> vec4u {
    return bvh_triangles[i];
}
