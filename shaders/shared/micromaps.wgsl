// What rays meet of a triangle, in scenes where they meet some in parts: opacity micromaps (the twin's
// scene/micromap.rs). A triangle's tag is its index in the mesh; or, with the flag IN_PARTS, the word among those of
// the triangles where its micromap begins, with (the index in the mesh, parts along an edge, the bits of its opacity if
// that is the same all over, else 0, 0) and a bit per part, 128 in a word.

#import fetch

const IN_PARTS: u32 = 0x80000000u;

// Whether the part at barycentric coordinates is there; all of what is equally opaque, if asked for `evenly`.
fn is_met(tag: u32, u: f32, v: f32, evenly: bool) -> bool {
    if (tag & IN_PARTS) == 0u {
        return true;
    }
    let micromap = tag & ~IN_PARTS;
    let head = triangle_word(micromap);
    if evenly && head.z != 0u {
        return true;
    }
    let side = head.y;
    let place = vec2f(u, v) * f32(side);
    let row = min(u32(place.y), side - 1u);
    let last = side - 1u - row;
    let column = min(u32(place.x), last);
    // Beyond a row's last cell there is no triangle to turn.
    let turned = column < last && (place.x - f32(column)) + (place.y - f32(row)) > 1.0;
    let part = row * (2u * side - row) + 2u * column + select(0u, 1u, turned);
    let bits = triangle_word(micromap + 1u + part / 128u)[(part / 32u) % 4u];
    return ((bits >> (part % 32u)) & 1u) == 1u;
}

// The share of light that does not pass where a triangle is met evenly.
fn even_opacity(tag: u32) -> f32 {
    if (tag & IN_PARTS) == 0u {
        return 1.0;
    }
    let opacity = triangle_word(tag & ~IN_PARTS).z;
    return select(bitcast<f32>(opacity), 1.0, opacity == 0u);
}

fn tagged_triangle(tag: u32) -> u32 {
    if (tag & IN_PARTS) == 0u {
        return tag;
    }
    return triangle_word(tag & ~IN_PARTS).x;
}
