// What rays meet of a triangle, in scenes where they meet all of all. A triangle's tag is its index in the mesh.

fn is_met(tag: u32, u: f32, v: f32, evenly: bool) -> bool {
    return true;
}

fn tagged_triangle(tag: u32) -> u32 {
    return tag;
}
