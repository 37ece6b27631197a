// What rays meet of a triangle, in scenes where they meet some in parts: opacity micromaps (the twin's
// scene/micromap.rs). A triangle's tag is its index in the mesh; or, with the flag IN_PARTS, the word among those of
// the triangles where its micromap begins, with (the index in the mesh, parts along an edge, the bits of its opacity if
// that is the same all over, else 0, a seed); and, if it is not, a bit per part, 128 in a word. The flag MIRRORED with
// the parts along an edge: the second and the third corner are swapped.

#import fetch
#import rng

const IN_PARTS: u32 = 0x80000000u;
const MIRRORED: u32 = 0x80000000u;
// Columns and rows of parts whose dither is one.
const DITHER_BLOCK: u32 = 4u;

// How much of a part must be covered for it to be there, in [0, 1): the R2 sequence (1/ρ and 1/ρ² of the plastic number
// ρ, in fractions of 2³²), shifted in every block anew.
fn part_threshold(column: u32, row: u32, turned: bool, seed: u32) -> f32 {
    let sequence = column * 3242174889u + row * 2447445414u;
    let shift = hash2(hash2(column / DITHER_BLOCK, row / DITHER_BLOCK), seed);
    return to_unit(sequence + shift + select(0u, 0x80000000u, turned));
}

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
    let side = head.y & ~MIRRORED;
    let place = select(vec2f(u, v), vec2f(v, u), (head.y & MIRRORED) != 0u) * f32(side);
    let row = min(u32(place.y), side - 1u);
    let last = side - 1u - row;
    let column = min(u32(place.x), last);
    // Beyond a row's last cell there is no triangle to turn.
    let turned = column < last && (place.x - f32(column)) + (place.y - f32(row)) > 1.0;
    if head.z != 0u {
        return bitcast<f32>(head.z) > part_threshold(column, row, turned, head.w);
    }
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
