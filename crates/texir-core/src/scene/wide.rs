//! Closest hits in `f32`: obvhs's hierarchy as processors trace it, its nodes unpacked, the eight children of one
//! tested at once and the nearest entered first.
//!
//! A packed node has 80 bytes, as GPUs want it; unpacked it has 256, and nothing needs to be decoded where rays meet
//! it.

use std::ops::Range;
use std::sync::Arc;

use arrayvec::ArrayVec;
use glam::Vec3A;
use obvhs::aabb::Aabb;
use obvhs::cwbvh::CwBvh;

use super::hierarchy::MAX_LEVELS;
use super::micromap::Micromap;
use super::trace::{BACK_FACE_BIAS, TraceHit, intersect};
use crate::mesh::Mesh;
use crate::real::V3;

/// Children of a node.
const WIDTH: usize = 8;
/// Children that are on the stack at most: all but one of every level.
const STACK_SIZE: usize = (WIDTH - 1) * MAX_LEVELS;
/// Slab tests round: exits are moved out by two units in the last place (Ize, "Robust BVH Ray Traversal", JCGT 2013).
pub const SLAB_ROUNDING: f32 = 1.0 + 2.0 * f32::EPSILON;
/// Intersection tests round differently from slab tests, and boxes were rounded when they were packed: they are wider
/// by this share of the largest coordinate of their node.
const MARGIN: f32 = 4.0 * f32::EPSILON;
/// Directions nearer to 0 than this are taken for it, so that the inverse is finite.
const TINY: f32 = 1e-20;

/// Triangles, one behind the other, that let the same share of light through all over and that a ray goes through at
/// most; what is behind more is dark.
pub const MOST_SHEETS: u32 = 32;

// What a search looks for: the closest hit, any, or the closest of what is there if what takes the same share of light
// all over is.
const CLOSEST: u8 = 0;
const ANY: u8 = 1;
const EVENLY: u8 = 2;

/// A hierarchy over triangles.
pub struct WideBvh {
    /// As obvhs numbers them.
    nodes: Vec<Node>,
    /// In the order of the leaves.
    primitives: Vec<Primitive>,
    /// What rays meet of triangles that they meet in parts.
    micromaps: Arc<[(u32, Micromap)]>,
}

/// Eight boxes, and what is in each.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Node {
    /// Least and greatest x of the eight boxes, y, and z. Nothing enters the box of a child that is missing.
    bounds: [[f32; WIDTH]; 6],
    /// The children. A missing one is a leaf without triangles, as NaN enters any box.
    children: [Child; WIDTH],
}

/// The index of a node; or, in a leaf, the first triangle and how many there are.
#[derive(Clone, Copy)]
struct Child(u32);

/// What a ray needs to know of a triangle.
struct Primitive {
    /// The first corner.
    corner: [f32; 3],
    /// From it to the second and to the third.
    edges: [[f32; 3]; 2],
    /// Index in the mesh; or, with the flag [`Primitive::IN_PARTS`], in [`WideBvh::micromaps`].
    triangle: u32,
}

impl Primitive {
    const IN_PARTS: u32 = 1 << 31;
}

/// A ray as boxes see it.
struct Ray {
    origin: [f32; 3],
    inverse: [f32; 3],
    /// Which of [`Node::bounds`] it enters by along each axis; it leaves by the other.
    near: [usize; 3],
}

/// How far a place is from the origin, along the axis where it is farthest.
#[inline(always)]
fn size_of(V3(place): V3<f32>) -> f32 {
    place.into_iter().fold(0.0, |size: f32, x| size.max(x.abs()))
}

/// How far a hit counts as, of a ray that begins as far from the origin as `size`.
#[inline(always)]
fn counted(t: f32, back: bool, size: f32) -> f32 {
    if back { t + BACK_FACE_BIAS as f32 * (t + size) } else { t }
}

/// A child whose box the ray enters, and when.
#[derive(Clone, Copy)]
struct StackEntry {
    child: Child,
    distance: f32,
}

impl Child {
    const ROOT: Self = Self(0);
    const LEAF: u32 = 1 << 31;
    /// Where a leaf has the number of its triangles, of which there are at most three.
    const COUNT: u32 = 29;

    fn leaf((first, count): (u32, u32)) -> Self {
        Self(Self::LEAF | count << Self::COUNT | first)
    }

    fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    /// Of a leaf.
    fn primitives(self) -> Range<usize> {
        let first = (self.0 & !(u32::MAX << Self::COUNT)) as usize;
        first..first + (self.0 >> Self::COUNT & 3) as usize
    }
}

impl Node {
    const EMPTY: Self = {
        let [least, greatest] = [[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]];
        Self { bounds: [least, greatest, least, greatest, least, greatest], children: [Child(Child::LEAF); WIDTH] }
    };
}

impl Ray {
    fn new(V3(origin): V3<f32>, V3(direction): V3<f32>) -> Self {
        let inverse = direction.map(|d| 1.0 / if d.abs() < TINY { TINY.copysign(d) } else { d });
        Self { origin, inverse, near: [0, 1, 2].map(|axis| 2 * axis + usize::from(inverse[axis] < 0.0)) }
    }
}

impl WideBvh {
    /// Unpacks a hierarchy over the triangles of a mesh, of which rays meet some in parts: by triangle, ascending.
    pub fn new(bvh: &CwBvh, mesh: &Mesh, micromaps: Arc<[(u32, Micromap)]>) -> Self {
        let primitive = |&triangle: &u32| {
            let [a, b, c] = mesh.corners(triangle);
            let in_parts = micromaps.binary_search_by_key(&triangle, |(triangle, _)| *triangle);
            let triangle = in_parts.map_or(triangle, |index| Primitive::IN_PARTS | index as u32);
            Primitive { corner: a.to_array(), edges: [(b - a).to_array(), (c - a).to_array()], triangle }
        };
        let primitives = bvh.primitive_indices.iter().map(primitive).collect();
        let mut wide = Self { nodes: vec![Node::EMPTY; bvh.nodes.len()], primitives, micromaps };
        wide.unpack(bvh, mesh, 0);
        wide
    }

    /// Unpacks a node and those below it. Returns what is in them.
    fn unpack(&mut self, bvh: &CwBvh, mesh: &Mesh, index: u32) -> Aabb {
        let packed = &bvh.nodes[index as usize];
        let whole = packed.aabb();
        let margin = Vec3A::splat(MARGIN * whole.min.abs().max(whole.max.abs()).max_element());
        let mut all = Aabb::INVALID;
        for k in (0..WIDTH).filter(|&k| !packed.is_child_empty(k)) {
            let (child, held) = if packed.is_leaf(k) {
                let leaf = Child::leaf(packed.child_primitives(k));
                let corners = bvh.primitive_indices[leaf.primitives()].iter().flat_map(|&t| mesh.corners(t));
                (leaf, corners.fold(Aabb::INVALID, |held, corner| held.union(&Aabb::from_point(corner.into()))))
            } else {
                let below = packed.child_node_index(k);
                (Child(below), self.unpack(bvh, mesh, below))
            };
            // A packed box is rounded out to a grid, but tells which part of a triangle in several leaves is in this
            // one.
            let packed = packed.child_aabb(k);
            let (least, greatest) = (held.min.max(packed.min), held.max.min(packed.max));
            let held = Aabb::new(least - margin, greatest + margin);
            let node = &mut self.nodes[index as usize];
            node.children[k] = child;
            for axis in 0..3 {
                (node.bounds[2 * axis][k], node.bounds[2 * axis + 1][k]) = (held.min[axis], held.max[axis]);
            }
            all = all.union(&held);
        }
        all
    }

    /// See [`Trace::closest`](super::trace::Trace::closest).
    pub fn closest(&self, origin: V3<f32>, direction: V3<f32>) -> Option<TraceHit<f32>> {
        self.fastest::<CLOSEST>(origin, direction, [0.0, f32::INFINITY])
    }

    /// See [`Trace::is_blocked`](super::trace::Trace::is_blocked).
    pub fn is_blocked(&self, origin: V3<f32>, direction: V3<f32>, length: f32) -> bool {
        self.fastest::<ANY>(origin, direction, [0.0, length]).is_some()
    }

    /// See [`Trace::transmittance`](super::trace::Trace::transmittance).
    pub fn transmittance(&self, origin: V3<f32>, direction: V3<f32>, length: f32) -> f32 {
        let size = size_of(origin);
        let (mut share, mut t) = (1.0, 0.0);
        for _ in 0..=MOST_SHEETS {
            let Some(hit) = self.fastest::<EVENLY>(origin, direction, [t, length]) else { return share };
            let opacity = self.micromap(hit.triangle).and_then(Micromap::even_opacity);
            let Some(opacity) = opacity else { return 0.0 };
            // Beyond those in the same place, whose distances round apart.
            (share, t) = (share * (1.0 - opacity), counted(hit.t, true, size));
        }
        0.0
    }

    /// Of a triangle of the mesh that rays meet in parts.
    fn micromap(&self, triangle: u32) -> Option<&Micromap> {
        let index = self.micromaps.binary_search_by_key(&triangle, |(triangle, _)| *triangle).ok()?;
        Some(&self.micromaps[index].1)
    }

    /// [`Self::search`] by the fastest test of nodes that the processor has.
    fn fastest<const HOW: u8>(&self, origin: V3<f32>, direction: V3<f32>, between: [f32; 2]) -> Option<TraceHit<f32>> {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has it.
            return unsafe { avx2::search::<HOW>(self, origin, direction, between) };
        }
        self.search::<HOW>(origin, direction, between, portable)
    }

    /// The closest hit with t between two bounds along the unit direction, either side of a triangle, or the first that
    /// is found where [`ANY`] will do. By a test of nodes: when the ray enters each box, and, a bit each, whether it
    /// does before the greatest t.
    #[inline(always)]
    fn search<const HOW: u8>(
        &self,
        origin: V3<f32>,
        direction: V3<f32>,
        [t_min, t_max]: [f32; 2],
        test: impl Fn(&Node, &Ray, f32) -> ([f32; WIDTH], u32),
    ) -> Option<TraceHit<f32>> {
        // NaN enters any box, and hits nothing in it.
        if !origin.0.iter().chain(&direction.0).all(|x| x.is_finite()) {
            return None;
        }
        let ray = Ray::new(origin, direction);
        let size = size_of(origin);
        let mut best = None;
        // How far it counts as: within the limit are backs too, however far they count as.
        let mut reach = counted(t_max, true, size);
        // The nearest on top.
        let mut stack = ArrayVec::<StackEntry, STACK_SIZE>::new();
        let mut child = Child::ROOT;
        loop {
            // Down to a leaf, unless nothing on the way is entered.
            while !child.is_leaf() {
                let node = &self.nodes[child.0 as usize];
                let (distances, entered) = test(node, &ray, reach);
                match nearest(node, &distances, entered, &mut stack) {
                    Some(nearest) => child = nearest,
                    None => break,
                }
            }
            if child.is_leaf() {
                for primitive in &self.primitives[child.primitives()] {
                    let edges = primitive.edges.map(V3);
                    let hit = intersect(primitive.triangle, V3(primitive.corner), edges, origin, direction);
                    let is_between = |hit: &TraceHit<f32>| hit.t > t_min && hit.t < t_max;
                    let nearest = hit.filter(|hit| is_between(hit) && counted(hit.t, hit.back, size) < reach);
                    if let Some(hit) = nearest.and_then(|hit| self.met::<HOW>(hit)) {
                        (best, reach) = (Some(hit), counted(hit.t, hit.back, size));
                        if HOW == ANY {
                            return best;
                        }
                    }
                }
            }
            child = loop {
                match stack.pop() {
                    Some(entered) if entered.distance <= reach => break entered.child,
                    Some(_) => {}
                    None => return best,
                }
            }
        }
    }

    /// A hit of a [`Primitive::triangle`] as one of the mesh; `None` where there is a hole, unless it is to be met
    /// [`EVENLY`].
    #[inline(always)]
    fn met<const HOW: u8>(&self, hit: TraceHit<f32>) -> Option<TraceHit<f32>> {
        if hit.triangle & Primitive::IN_PARTS == 0 {
            return Some(hit);
        }
        let (triangle, micromap) = &self.micromaps[(hit.triangle & !Primitive::IN_PARTS) as usize];
        let is_even = HOW == EVENLY && micromap.even_opacity().is_some();
        (is_even || micromap.is_opaque(hit.u, hit.v)).then_some(TraceHit { triangle: *triangle, ..hit })
    }
}

/// The nearest of the children that are entered; the others go onto the stack.
#[inline(always)]
fn nearest(
    node: &Node,
    distances: &[f32; WIDTH],
    mut entered: u32,
    stack: &mut ArrayVec<StackEntry, STACK_SIZE>,
) -> Option<Child> {
    let mut take = || {
        let k = entered.trailing_zeros() as usize;
        entered &= entered.wrapping_sub(1);
        (k < WIDTH).then(|| StackEntry { child: node.children[k], distance: distances[k] })
    };
    let mut nearest = take()?;
    let first = stack.len();
    while let Some(mut other) = take() {
        if other.distance < nearest.distance {
            std::mem::swap(&mut other, &mut nearest);
        }
        let mut at = stack.len();
        stack.push(other);
        while at > first && stack[at - 1].distance < other.distance {
            stack[at] = stack[at - 1];
            at -= 1;
        }
        stack[at] = other;
    }
    Some(nearest.child)
}

/// The test of a node for any processor.
fn portable(node: &Node, ray: &Ray, t_max: f32) -> ([f32; WIDTH], u32) {
    let (mut enter, mut leave, mut entered) = ([0.0f32; WIDTH], [t_max; WIDTH], 0);
    for axis in 0..3 {
        let passes = |bound: f32| (bound - ray.origin[axis]) * ray.inverse[axis];
        let [near, far] = [ray.near[axis], ray.near[axis] ^ 1].map(|plane| &node.bounds[plane]);
        for k in 0..WIDTH {
            enter[k] = enter[k].max(passes(near[k]));
            leave[k] = leave[k].min(passes(far[k]) * SLAB_ROUNDING);
        }
    }
    for k in 0..WIDTH {
        entered |= u32::from(enter[k] <= leave[k]) << k;
    }
    (enter, entered)
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::{Node, Ray, SLAB_ROUNDING, WIDTH, WideBvh};
    use crate::real::V3;
    use crate::scene::trace::TraceHit;

    #[target_feature(enable = "avx2")]
    pub fn search<const HOW: u8>(
        wide: &WideBvh,
        origin: V3<f32>,
        direction: V3<f32>,
        between: [f32; 2],
    ) -> Option<TraceHit<f32>> {
        wide.search::<HOW>(origin, direction, between, |node, ray, t_max| test(node, ray, t_max))
    }

    /// All boxes at once.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn test(node: &Node, ray: &Ray, t_max: f32) -> ([f32; WIDTH], u32) {
        let [near_x, near_y, near_z] = ray.near;
        let (x0, x1) = (passes(node, ray, 0, near_x), passes(node, ray, 0, near_x ^ 1));
        let (y0, y1) = (passes(node, ray, 1, near_y), passes(node, ray, 1, near_y ^ 1));
        let (z0, z1) = (passes(node, ray, 2, near_z), passes(node, ray, 2, near_z ^ 1));
        let enter = _mm256_max_ps(_mm256_max_ps(x0, y0), _mm256_max_ps(z0, _mm256_setzero_ps()));
        let leave = _mm256_mul_ps(_mm256_min_ps(_mm256_min_ps(x1, y1), z1), _mm256_set1_ps(SLAB_ROUNDING));
        let entered = _mm256_cmp_ps::<_CMP_LE_OQ>(enter, _mm256_min_ps(leave, _mm256_set1_ps(t_max)));
        (bytemuck::cast(enter), _mm256_movemask_ps(entered) as u32)
    }

    /// When the ray passes a plane of each box.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn passes(node: &Node, ray: &Ray, axis: usize, plane: usize) -> __m256 {
        let from_origin = _mm256_sub_ps(bytemuck::cast(node.bounds[plane]), _mm256_set1_ps(ray.origin[axis]));
        _mm256_mul_ps(from_origin, _mm256_set1_ps(ray.inverse[axis]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;
    use crate::rng::hash2;
    use crate::scene::trace::{BruteForce, Trace};
    use crate::scene::{Scene, TriangleOpacity};
    use glam::{EulerRot, Quat, Vec2, Vec3};

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
        let exact = BruteForce(scene.mesh());
        let wide = WideBvh::new(&scene.bvh, scene.mesh(), scene.micromaps.clone());
        let mut hits = 0;
        for (origin, direction) in rays() {
            let expected = Trace::<f32>::closest(&exact, origin, direction);
            let same = |found: Option<TraceHit<f32>>| {
                assert_eq!(found.map(|h| (h.triangle, h.t)), expected.map(|h| (h.triangle, h.t)), "{direction:?}");
            };
            same(wide.closest(origin, direction));
            same(wide.search::<CLOSEST>(origin, direction, [0.0, f32::INFINITY], portable));
            let Some(hit) = expected else { continue };
            for (length, blocked) in [(hit.t * 1.001, true), (hit.t, false)] {
                assert_eq!(wide.is_blocked(origin, direction, length), blocked, "{direction:?}");
                assert_eq!(
                    wide.search::<ANY>(origin, direction, [0.0, length], portable).is_some(),
                    blocked,
                    "{direction:?}"
                );
            }
            hits += 1;
        }
        assert!((300..3700).contains(&hits), "{hits} of 4000 rays hit");
    }

    #[test]
    fn backs_hide_what_is_behind_them_however_far_they_count_as() {
        // A back just nearer than the point that is looked at, and a front just beyond it, which counts as nearer.
        let sheet = |z: f32, corners: [[f32; 2]; 3]| corners.map(|[x, y]| Vec3::new(x, y, z));
        let (back, front) = ([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]], [[1.0, -1.0], [-1.0, -1.0], [0.0, 1.0]]);
        let mesh = Mesh {
            positions: [sheet(4.0, back), sheet(4.000_01, front)].concat(),
            normals: vec![Vec3::Z; 6],
            uvs: vec![Vec2::ZERO; 6],
            triangles: vec![[0, 1, 2], [3, 4, 5]],
        };
        let scene = Scene::new(mesh).unwrap();
        let exact = BruteForce(scene.mesh());
        let (origin, direction) = (V3([0.0f32; 3]), V3([0.0, 0.0, 1.0]));
        let closest = scene.closest(origin, direction).unwrap();
        assert!(closest.triangle == 1 && !closest.back, "{closest:?}");
        for (length, blocked) in [(4.000_005, true), (4.0, false)] {
            assert_eq!(scene.is_blocked(origin, direction, length), blocked, "{length}");
            assert_eq!(exact.is_blocked(origin, direction, length), blocked, "{length}");
        }
    }

    #[test]
    fn thin_things_within_large_nodes_are_hit() {
        // A panel a few rounding errors off the middle of a scene that is 200 m wide.
        let mut mesh = Mesh::default();
        for (x, size) in
            [(-3e-6, 1.0), (-100.0, 9.0), (-75.0, 9.0), (-50.0, 9.0), (50.0, 9.0), (75.0, 9.0), (100.0, 9.0)]
        {
            let corner = mesh.positions.len() as u32;
            mesh.positions
                .extend([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]].map(|[y, z]| Vec3::new(x, size * y, size * z)));
            mesh.triangles.push([corner, corner + 1, corner + 2]);
        }
        mesh.normals = vec![Vec3::X; mesh.positions.len()];
        mesh.uvs = vec![Vec2::ZERO; mesh.positions.len()];
        let scene = Scene::new(mesh).unwrap();
        for i in 1..1000 {
            let away = i as f32 * 0.01;
            for x in [away, -away] {
                let (origin, direction) = (V3([x, 0.5, 0.2]), V3([-x.signum(), 0.0, 0.0]));
                let hit = scene.closest(origin, direction).unwrap();
                assert_eq!(hit.triangle, 0, "from {x}");
            }
        }
    }

    #[test]
    fn rays_that_are_not_numbers_are_not_traced() {
        let scene = scene();
        let wide = WideBvh::new(&scene.bvh, scene.mesh(), scene.micromaps.clone());
        let (numbers, nan) = (V3([0.5, 0.5, 0.5]), f32::NAN);
        let traced = |_: &Node, ray: &Ray, _: f32| panic!("from {:?} along 1 over {:?}", ray.origin, ray.inverse);
        for none in [V3([nan; 3]), V3([0.5, 0.5, nan]), V3([f32::INFINITY, 0.5, 0.5])] {
            for (origin, direction) in [(numbers, none), (none, numbers), (none, none)] {
                assert!(wide.search::<CLOSEST>(origin, direction, [0.0, f32::INFINITY], traced).is_none());
            }
        }
    }

    /// Two sheets in one place that face opposite ways, and rays through both: the even ones from the front of the
    /// first. Cut along different diagonals, turned, and away from the origin, so that distances round apart.
    fn two_sheets() -> (Mesh, impl Iterator<Item = (V3<f32>, V3<f32>)>) {
        let turn = Quat::from_euler(EulerRot::XYZ, 0.4, 1.1, -0.7);
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let place = move |(x, y): (f32, f32)| turn * Vec3::new(2.0 * x, 2.0 * y, 0.3) + Vec3::new(7.0, -3.0, 5.0);
        let mesh = Mesh {
            positions: corners.map(place).to_vec(),
            normals: vec![turn * Vec3::Z; 4],
            uvs: vec![Vec2::ZERO; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3], [1, 0, 3], [1, 3, 2]],
        };
        let rays = (0..20_000).map(move |i| {
            let unit = |k: u32| hash2(i, k) as f32 / u32::MAX as f32 * 2.0 - 1.0;
            let side = if i % 2 == 0 { 1.0 } else { -1.0 };
            let from = turn * Vec3::new(3.0 * unit(0), 3.0 * unit(1), 0.3 + side * (0.1 + 2.0 * unit(2).abs()))
                + Vec3::new(7.0, -3.0, 5.0);
            let to = place((0.99 * unit(3), 0.99 * unit(4)));
            (V3(from.to_array()), V3((to - from).normalize().to_array()))
        });
        (mesh, rays)
    }

    #[test]
    fn of_two_translucent_sheets_in_one_place_one_takes_its_share() {
        let (mesh, rays) = two_sheets();
        let translucent = |seed| TriangleOpacity::from_coverage(4, seed, |_| 0.25);
        let scene = Scene::with_opacity(mesh, translucent).unwrap();
        for (i, (origin, direction)) in rays.enumerate() {
            assert_eq!(scene.transmittance(origin, direction, f32::INFINITY), 0.75, "ray {i}");
        }
    }

    #[test]
    fn of_two_sheets_in_one_place_rays_meet_the_one_that_faces_them() {
        let (mesh, rays) = two_sheets();
        let scene = Scene::new(mesh).unwrap();
        let mut crossed = [0u32; 2];
        for (i, (origin, direction)) in rays.enumerate() {
            let exhaustive = Trace::<f32>::closest(&BruteForce(scene.mesh()), origin, direction).unwrap();
            let hit = scene.closest(origin, direction).unwrap();
            assert!(!hit.back && !exhaustive.back, "ray {i} from {origin:?} along {direction:?}");
            crossed[i % 2] += u32::from(hit.triangle < 2);
        }
        assert_eq!(crossed, [10_000, 0], "either side meets its own sheet");
    }
}
