// Directions from numbers in [0, 1)², and the frame that they are drawn in.

#import math

// Tangent and bitangent of a unit normal (Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 2017).
struct Frame {
    tangent: vec3f,
    bitangent: vec3f,
    normal: vec3f,
}

fn frame_of(n: vec3f) -> Frame {
    let s = select(1.0, -1.0, n.z < 0.0);
    let a = -1.0 / (s + n.z);
    let b = n.x * n.y * a;
    return Frame(vec3f(1.0 + s * n.x * n.x * a, s * b, -s * n.x), vec3f(b, s + n.y * n.y * a, -n.y), n);
}

fn world_from_frame(f: Frame, d: vec3f) -> vec3f {
    return f.tangent * d.x + f.bitangent * d.y + f.normal * d.z;
}

// A cosine-distributed unit direction around +Z; density cosθ/π per solid angle.
fn cosine_direction(u: vec2f) -> vec3f {
    let radius = sqrt(u.x);
    let angle = sincos_turns(u.y);
    return vec3f(radius * angle.y, radius * angle.x, sqrt(1.0 - u.x));
}
