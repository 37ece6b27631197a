//! Closest hits through the hierarchy in `f32`: obvhs's traversal, with a node test of texir's own that takes a node's eight
//! children at once where the processor has AVX2. Elsewhere obvhs's tests them four at a time.

use glam::UVec2;
use obvhs::cwbvh::node::CwBvhNode;
use obvhs::ray::Ray;
use obvhs::traverse;

use super::trace::{TraceHit, intersect};
use crate::real::V3;
use crate::scene::Scene;
use crate::surface::Hit;

/// The closest hit with t > 0 along the unit direction, either side of a triangle.
pub fn closest(scene: &Scene, origin: V3<f32>, direction: V3<f32>) -> Option<TraceHit<f32>> {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor has both.
        return unsafe { avx2::closest(scene, origin, direction) };
    }
    portable(scene, origin, direction)
}

/// [`closest`] with obvhs's node test.
fn portable(scene: &Scene, origin: V3<f32>, direction: V3<f32>) -> Option<TraceHit<f32>> {
    // obvhs takes −0 for negative in one place and for positive in another, and misses boxes.
    let direction = V3(direction.0.map(|d| d + 0.0));
    let ray = Ray::new_inf(origin.0.into(), direction.0.into());
    search(scene, origin, direction, |node, octant, t_max| node.intersect_ray(&Ray { tmax: t_max, ..ray }, octant))
}

/// Traverses with a node test: which children the ray meets before `t_max`, as obvhs's hit mask for the octant.
#[inline(always)]
fn search(
    scene: &Scene,
    origin: V3<f32>,
    direction: V3<f32>,
    node_hits: impl Fn(&CwBvhNode, u32, f32) -> u32,
) -> Option<TraceHit<f32>> {
    let mut best = TraceHit { triangle: Hit::NONE, u: 0.0, v: 0.0, t: f32::INFINITY };
    let mut state = scene.bvh.new_traversal(direction.0.into());
    let mut node;
    traverse!(scene.bvh, node, state, node_hits(node, state.oct_inv4, best.t), {
        let primitive = &scene.primitives[state.primitive_id as usize];
        if let Some((t, u, v)) = intersect(V3(primitive.corner), primitive.edges.map(V3), origin, direction)
            && t < best.t
        {
            best = TraceHit { triangle: primitive.triangle, u, v, t };
        }
    });
    (best.triangle != Hit::NONE).then_some(best)
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use obvhs::cwbvh::node::CwBvhNode;

    use super::search;
    use crate::cpu::trace::TraceHit;
    use crate::real::V3;
    use crate::scene::Scene;

    /// Slab tests round: exits are moved out by two units in the last place (Ize, "Robust BVH Ray Traversal", JCGT 2013).
    const SLAB_ROUNDING: f32 = 1.0 + 2.0 * f32::EPSILON;
    /// Directions nearer to 0 than this are taken for it, so that the inverse is finite.
    const TINY: f32 = 1e-20;

    #[target_feature(enable = "avx2,fma")]
    pub fn closest(scene: &Scene, origin: V3<f32>, direction: V3<f32>) -> Option<TraceHit<f32>> {
        let inverse = direction.0.map(|d| 1.0 / if d.abs() < TINY { TINY.copysign(d) } else { d });
        search(scene, origin, direction, |node, octant, t_max| hits(node, origin.0, inverse, octant, t_max))
    }

    /// The hit mask of a node's children: twin of `intersect_node` in `bvh.wgsl`.
    #[inline]
    #[target_feature(enable = "avx2,fma")]
    fn hits(node: &CwBvhNode, origin: [f32; 3], inverse: [f32; 3], octant: u32, t_max: f32) -> u32 {
        let bytes = |bytes: i64| _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(bytes));
        // Where the ray passes the near and the far planes of an axis.
        let slabs = |axis: usize, low: &[u8; 8], high: &[u8; 8]| {
            let extent = f32::from_bits(u32::from(node.e[axis]) << 23);
            let scale = _mm256_set1_ps(extent * inverse[axis]);
            let offset = _mm256_set1_ps((node.p[axis] - origin[axis]) * inverse[axis]);
            let [near, far] = if inverse[axis] < 0.0 { [high, low] } else { [low, high] };
            [near, far]
                .map(|planes| _mm256_fmadd_ps(_mm256_cvtepi32_ps(bytes(i64::from_le_bytes(*planes))), scale, offset))
        };
        let [x0, x1] = slabs(0, &node.child_min_x, &node.child_max_x);
        let [y0, y1] = slabs(1, &node.child_min_y, &node.child_max_y);
        let [z0, z1] = slabs(2, &node.child_min_z, &node.child_max_z);
        let enter = _mm256_max_ps(_mm256_max_ps(x0, y0), _mm256_max_ps(z0, _mm256_setzero_ps()));
        let leave = _mm256_mul_ps(_mm256_min_ps(_mm256_min_ps(x1, y1), z1), _mm256_set1_ps(SLAB_ROUNDING));
        let inside = _mm256_cmp_ps::<_CMP_LE_OQ>(enter, _mm256_min_ps(leave, _mm256_set1_ps(t_max)));
        let (bits, shifts) = node.get_child_and_index_bits(octant);
        let each = _mm256_sllv_epi32(bytes(bits as i64), bytes(shifts as i64));
        let eight = _mm256_and_si256(each, _mm256_castps_si256(inside));
        let four = _mm_or_si128(_mm256_castsi256_si128(eight), _mm256_extracti128_si256::<1>(eight));
        let two = _mm_cvtsi128_si64(_mm_or_si128(four, _mm_unpackhi_epi64(four, four))) as u64;
        (two | (two >> 32)) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::trace::{Exhaustive, Trace};
    use crate::mesh::Mesh;
    use crate::rng::hash2;
    use glam::{Vec2, Vec3};

    /// Triangles of all sizes in a unit cube, some of them parallel to its sides.
    fn scene() -> Scene {
        let unit = |i: u32, k: u32| hash2(i, k) as f32 / u32::MAX as f32;
        let mut mesh = Mesh::default();
        for i in 0..2000 {
            let at = Vec3::new(unit(i, 0), unit(i, 1), unit(i, 2));
            let size = 0.2 * unit(i, 3).powi(3);
            let edge = |k: u32| size * (Vec3::new(unit(i, k), unit(i, k + 1), unit(i, k + 2)) - 0.5);
            let flat = Vec3::from_array([0, 1, 2].map(|axis| if i % 4 == axis { 0.0 } else { 1.0 }));
            mesh.positions.extend([at, at + edge(4) * flat, at + edge(7) * flat]);
            mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
        }
        mesh.normals = vec![Vec3::Z; mesh.positions.len()];
        mesh.uvs = vec![Vec2::ZERO; mesh.positions.len()];
        Scene::new(mesh).unwrap()
    }

    /// Rays from within the cube: in all directions, and along the axes with zeros of either sign.
    fn rays() -> impl Iterator<Item = (V3<f32>, V3<f32>)> {
        let unit = |i: u32, k: u32| hash2(i, 100 + k) as f32 / u32::MAX as f32;
        (0..4000u32).map(move |i| {
            let origin = V3([unit(i, 0), unit(i, 1), unit(i, 2)]);
            let direction = Vec3::new(unit(i, 3), unit(i, 4), unit(i, 5)) - 0.5;
            let kept = |axis: u32| if i % 5 == 1 && axis != i / 5 % 3 { 0.0 } else { 1.0 };
            let direction = direction * Vec3::new(kept(0), kept(1), kept(2));
            (origin, V3(direction.normalize().to_array()))
        })
    }

    #[test]
    fn every_node_test_finds_what_an_exhaustive_search_finds() {
        let scene = scene();
        let exact = Exhaustive(&scene.mesh);
        let mut hits = 0;
        for (origin, direction) in rays() {
            let expected = Trace::<f32>::closest(&exact, origin, direction);
            for found in [closest(&scene, origin, direction), portable(&scene, origin, direction)] {
                assert_eq!(found.map(|h| (h.triangle, h.t)), expected.map(|h| (h.triangle, h.t)), "{direction:?}");
            }
            hits += u32::from(expected.is_some());
        }
        assert!((300..3700).contains(&hits), "{hits} of 4000 rays hit");
    }
}
