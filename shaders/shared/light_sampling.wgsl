// Directions to the lights of the TBL, and the density with which they are drawn; twin of texir-core's
// light_sampling.rs.

#import bvh
#import math

// A part of a triangle.
struct LightPrimitive {
    primitive: u32,
    // Which of the 4^level congruent parts of a triangle whose edges are halved so often: i, j, whether it is turned, and
    // the level, of 12, 12, 4 and 4 bits, as texir-core's lights/part.rs has them.
    part: u32,
    cluster: u32,
    // Density per square metre of points on the part once its cluster is chosen; 0 for what is no light.
    pdf_area: f32,
}

// Cubic cells of the scene's surface, times six facings.
struct LightGrid {
    origin: vec3f,
    // Cells per metre.
    per_metre: f32,
    // Cells along each axis.
    size: vec3u,
    // Clusters, the length of a table; 0 without lights.
    clusters: u32,
    // Where the tables of cells, the clusters' starts and their members begin in the index, and where the members' CDF
    // begins in the tables.
    first_cell: u32,
    first_cluster: u32,
    first_member: u32,
    first_cdf: u32,
    // 1 where all backs are black, 0 where only those of lights are.
    one_sided: u32,
}

// Entry 0 stands for all that is no light (density 0); then the parts of triangles that shine somewhere, triangle by
// triangle and by number.
@group(0) @binding(5) var<storage, read> light_primitives: array<LightPrimitive>;
// Four concatenated lists, as eight storage buffers are the default limit: per primitive, the first of its parts above
// and, in the last four bits, their level; per cell (x fastest) and facing, six to a cell, the number of its table; per
// cluster its first member, and at last where the members end; and those, entries above that shine.
@group(0) @binding(6) var<storage, read> light_index: array<u32>;
// Tables of a number per cluster: the probability of it and those before it; then, per member, the probability, within
// its cluster, of it and those before it.
@group(0) @binding(7) var<storage, read> light_tables: array<f32>;
@group(0) @binding(8) var<uniform> light_grid: LightGrid;

// A point on a light, and the triangle of the mesh it lies on: rays may meet that in any of its leaves, as another
// primitive.
struct LightPoint {
    position: vec3f,
    triangle: u32,
}

// Offset in light_tables of the table for a surface point; 0, the global one, outside the grid.
fn light_table(position: vec3f, normal: vec3f) -> u32 {
    let q = floor((position - light_grid.origin) * light_grid.per_metre);
    let inside = all(q >= vec3f(0.0)) && all(q < vec3f(light_grid.size));
    let cell = vec3u(select(vec3f(0.0), q, inside));
    let a = abs(normal);
    let axis = select(select(1u, 2u, a.z >= a.y), 0u, a.x > a.y && a.x > a.z);
    let facing = 2u * axis + select(0u, 1u, normal[axis] < 0.0);
    let index = 6u * ((cell.z * light_grid.size.y + cell.y) * light_grid.size.x + cell.x) + facing;
    if !inside {
        return 0u;
    }
    return light_index[light_grid.first_cell + index] * light_grid.clusters;
}

// Which of the numbers at `first` up to `last` of light_tables, running sums that end with 1, first exceeds u.
fn light_choice(first: u32, last: u32, u: f32) -> u32 {
    var low = first;
    var high = last;
    while low < high {
        let middle = (low + high) / 2u;
        if light_tables[middle] <= u {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

// What is left of u, still uniform, once it has chosen `chosen` of the numbers from `first` on.
fn light_rest(first: u32, chosen: u32, u: f32) -> f32 {
    let before = select(light_tables[max(chosen, 1u) - 1u], 0.0, chosen == first);
    return share_below(u, before, light_tables[chosen]);
}

// The first number of u chooses a cluster by the table, what is left of it a member of the cluster, and what is left of
// that is a coordinate on the part (square-root map).
fn light_point(table: u32, u: vec2f) -> LightPoint {
    let in_table = light_choice(table, table + light_grid.clusters - 1u, u.x);
    let in_cluster = light_rest(table, in_table, u.x);
    let cluster = light_grid.first_cluster + in_table - table;
    let first = light_index[cluster];
    let cdf = light_grid.first_cdf + first;
    let chosen = light_choice(cdf, light_grid.first_cdf + light_index[cluster + 1u] - 1u, in_cluster);
    let root = sqrt(light_rest(cdf, chosen, in_cluster));
    let light = light_primitives[light_index[light_grid.first_member + chosen - light_grid.first_cdf]];
    let in_triangle = triangle_from_part(light.part, vec2f(root * (1.0 - u.y), root * u.y));
    let v0 = triangle_part(light.primitive, 0u).xyz;
    let e1 = triangle_part(light.primitive, 1u).xyz;
    let e2 = triangle_part(light.primitive, 2u).xyz;
    return LightPoint(v0 + e1 * in_triangle.x + e2 * in_triangle.y, mesh_triangle(light.primitive));
}

// Barycentric coordinates in the triangle of what has these in a part of it.
fn triangle_from_part(part: u32, barycentric: vec2f) -> vec2f {
    let start = vec2f(vec2u(part & 0xfffu, part >> 12u & 0xfffu));
    let turned = (part >> 24u & 1u) != 0u;
    let at = select(start + barycentric, start + (1.0 - barycentric), turned);
    return at / f32(1u << (part >> 28u));
}

// The part of a primitive that a ray hit; entry 0 where it is no light.
fn light_at(hit: Intersection) -> LightPrimitive {
    let cut = light_index[select(hit.primitive, 0u, hit.primitive == MISS)];
    let side = 1u << (cut & 0xfu);
    let at = max(vec2f(hit.u, hit.v), vec2f(0.0)) * f32(side);
    let j = min(u32(at.y), side - 1u);
    let i = min(u32(at.x), side - 1u - j);
    let turned = at.x - f32(i) + at.y - f32(j) > 1.0 && i + j < side - 1u;
    return light_primitives[(cut >> 4u) + j * (2u * side - j) + 2u * i + select(0u, 1u, turned)];
}

// Whether the back of what a ray hit is black.
fn is_black_behind(light: LightPrimitive) -> bool {
    return light_grid.one_sided != 0u || light.pdf_area > 0.0;
}

// Density, per solid angle, with which light samples of a table draw a point of `light`, `t` metres away and seen under
// the cosine θ' with its normal: density per area · t² / |cosθ'|. 0 where there are no lights.
fn light_pdf(table: u32, light: LightPrimitive, t: f32, cosine: f32) -> f32 {
    let at = table + light.cluster;
    let before = select(light_tables[max(at, 1u) - 1u], 0.0, light.cluster == 0u);
    return (light_tables[at] - before) * light.pdf_area * t * t / max(abs(cosine), 1e-6);
}
