// Directions to the lights of the TBL, and the density with which they are drawn; twin of texir-core's
// light_sampling.rs.

#import bvh
#import math

struct LightPrimitive {
    primitive: u32,
    cluster: u32,
    // Probability, within the cluster, of this triangle and those before it.
    cdf: f32,
    // Density per square metre of points on the primitive once its cluster is chosen; 0 for what is no light.
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
    // Where the tables of cells, and where the clusters' starts, begin in the index.
    first_cell: u32,
    first_cluster: u32,
    // 1 where all backs are black, 0 where only those of lights are.
    one_sided: u32,
}

// Entry 0 stands for all that is no light (density 0); then the lights, cluster by cluster.
@group(0) @binding(5) var<storage, read> light_primitives: array<LightPrimitive>;
// Three concatenated lists, as eight storage buffers are the default limit: per primitive, its light's entry above; per
// cell (x fastest) and facing, six to a cell, the number of its table; per cluster its first light, and at last where
// the lights end.
@group(0) @binding(6) var<storage, read> light_index: array<u32>;
// Tables of a number per cluster: the probability of it and those before it.
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

// The first number of u chooses a cluster by the table, what is left of it a triangle of the cluster, and what is left
// of that is a coordinate on the triangle (square-root map).
fn light_point(table: u32, u: vec2f) -> LightPoint {
    var low = 0u;
    var high = light_grid.clusters - 1u;
    while low < high {
        let middle = (low + high) / 2u;
        if light_tables[table + middle] <= u.x {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    let before_cluster = select(light_tables[table + max(low, 1u) - 1u], 0.0, low == 0u);
    let in_cluster = share_below(u.x, before_cluster, light_tables[table + low]);
    let first = light_index[light_grid.first_cluster + low];
    high = light_index[light_grid.first_cluster + low + 1u] - 1u;
    low = first;
    while low < high {
        let middle = (low + high) / 2u;
        if light_primitives[middle].cdf <= in_cluster {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    let before_triangle = select(light_primitives[max(low, 1u) - 1u].cdf, 0.0, low == first);
    let root = sqrt(share_below(in_cluster, before_triangle, light_primitives[low].cdf));
    let primitive = light_primitives[low].primitive;
    let v0 = triangle_part(primitive, 0u).xyz;
    let e1 = triangle_part(primitive, 1u).xyz;
    let e2 = triangle_part(primitive, 2u).xyz;
    return LightPoint(v0 + e1 * (root * (1.0 - u.y)) + e2 * (root * u.y), mesh_triangle(primitive));
}

// Whether the back of a primitive is black.
fn is_black_behind(primitive: u32) -> bool {
    return light_grid.one_sided != 0u || light_index[primitive] != 0u;
}

// Density, per solid angle, with which light samples of a table draw a point of `primitive`, `t` metres away and seen
// under the cosine θ' with its normal: density per area · t² / |cosθ'|. 0 where there are no lights.
fn light_pdf(table: u32, primitive: u32, t: f32, cosine: f32) -> f32 {
    let light = light_primitives[light_index[primitive]];
    let at = table + light.cluster;
    let before = select(light_tables[max(at, 1u) - 1u], 0.0, light.cluster == 0u);
    return (light_tables[at] - before) * light.pdf_area * t * t / max(abs(cosine), 1e-6);
}
