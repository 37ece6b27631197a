// Light from far away: an equirectangular panorama, and its bright pixels as a sampled set; twin of texir-core's
// environment.rs.

#import math

// Radiance, and the density, per steradian, with which sky samples draw a direction in the pixel.
@group(0) @binding(4) var environment: texture_2d<f32>;

struct BrightRow {
    // The end of the row's part of bright_pixels, where the next row's begins.
    end: u32,
    // Probability of this row and those before it.
    cdf: f32,
}

struct BrightPixel {
    // Index in the panorama.
    pixel: u32,
    // Probability, within the row, of this pixel and those before it.
    cdf: f32,
}

@group(0) @binding(9) var<storage, read> bright_rows: array<BrightRow>;
@group(0) @binding(10) var<storage, read> bright_pixels: array<BrightPixel>;

// What arrives from far away along the unit direction: the nearest pixel at u = ½ + atan2(z, x)/2π, v = acos(y)/π,
// without its loss of digits at the poles.
fn environment_towards(direction: vec3f) -> vec4f {
    let size = textureDimensions(environment);
    let polar = atan2(length(direction.xz), direction.y);
    let uv = vec2f(0.5 + atan2(direction.z, direction.x) * (0.5 * INV_PI), polar * INV_PI);
    return textureLoad(environment, min(vec2u(max(uv, vec2f(0.0)) * vec2f(size)), size - 1u), 0);
}

// A direction to a bright pixel, with what arrives along it.
struct SkySample {
    direction: vec3f,
    radiance: vec3f,
    density: f32,
}

// One of `rows` rows, a pixel in it, and a direction, uniform over the pixel's solid angle.
fn sample_environment(rows: u32, u: vec2f) -> SkySample {
    var low = 0u;
    var high = rows - 1u;
    while low < high {
        let middle = (low + high) / 2u;
        if bright_rows[middle].cdf <= u.x {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    let row_before = bright_rows[max(low, 1u) - 1u];
    let in_row = share_below(u.x, select(row_before.cdf, 0.0, low == 0u), bright_rows[low].cdf);
    let first = select(row_before.end, 0u, low == 0u);
    high = bright_rows[low].end - 1u;
    low = first;
    while low < high {
        let middle = (low + high) / 2u;
        if bright_pixels[middle].cdf <= in_row {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    let before = select(bright_pixels[max(low, 1u) - 1u].cdf, 0.0, low == first);
    let across = share_below(in_row, before, bright_pixels[low].cdf);
    let size = textureDimensions(environment);
    let pixel = vec2u(bright_pixels[low].pixel % size.x, bright_pixels[low].pixel / size.x);
    let upper = sincos_turns(0.5 * f32(pixel.y) / f32(size.y)).y;
    let lower = sincos_turns(0.5 * f32(pixel.y + 1u) / f32(size.y)).y;
    let cosine = mix(upper, lower, u.y);
    let sine = sqrt(max(1.0 - cosine * cosine, 0.0));
    let azimuth = sincos_turns((f32(pixel.x) + across) / f32(size.x) - 0.5);
    let found = textureLoad(environment, pixel, 0);
    return SkySample(vec3f(sine * azimuth.y, cosine, sine * azimuth.x), found.rgb, found.a);
}
