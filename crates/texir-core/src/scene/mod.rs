//! The mesh with its acceleration structure: what every tracing pass runs on.

mod hierarchy;
mod micromap;
pub mod trace;
mod wide;

use std::fmt;
use std::sync::{Arc, OnceLock};

use glam::Vec3;
pub use hierarchy::MAX_LEVELS;
pub use micromap::{DITHER_BLOCK, Micromap, TriangleOpacity};
use obvhs::cwbvh::CwBvh;
use obvhs::triangle::Triangle;

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::real::V3;
use trace::{Trace, TraceHit};
use wide::WideBvh;
pub use wide::{MOST_SHEETS, SLAB_ROUNDING};

/// Coordinates beyond this, metres, are taken for damage: sums of areas of such boxes would overflow.
const FARTHEST: f32 = 1e9;

/// Nodes and the costs of packing them are counted in 32 bits, of which there are up to 14 to each triangle and each
/// part of one.
const MOST_TRIANGLES: usize = 1 << 27;

/// Bytes of a triangle while the hierarchy over them is built: itself, its box, nodes and the costs of packing them.
const TRIANGLE: u64 = 270;
/// Bytes of a vertex: position, normal, coordinates.
const VERTEX: u64 = 32;

/// A mesh and an obvhs CWBVH (8-wide, compressed) over what rays meet of it. Neither changes once it is made.
pub struct Scene {
    mesh: Mesh,
    bvh: CwBvh,
    micromaps: Arc<[(u32, Micromap)]>,
    /// See [`Scene::is_translucent`].
    is_translucent: bool,
    /// What rays on the host go through: made when the first one does.
    wide: OnceLock<WideBvh>,
}

impl fmt::Debug for Scene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Mesh { positions, triangles, .. } = &self.mesh;
        let mut scene = f.debug_struct("Scene");
        scene.field("vertices", &positions.len()).field("triangles", &triangles.len()).finish_non_exhaustive()
    }
}

impl Scene {
    /// Errors on a mesh of which there can be no scene: see [`Scene::new`].
    pub fn check(mesh: &Mesh) -> Result<()> {
        mesh.check()?;
        if mesh.triangles.len() > MOST_TRIANGLES {
            return Err(Error::invalid(format!(
                "the mesh has {} triangles; expected at most {MOST_TRIANGLES}: simplify it, or divide it",
                mesh.triangles.len()
            )));
        }
        // Of several numbers, one that is none does not show in the largest.
        let is_near = |p: &Vec3| p.is_finite() && p.abs().max_element() <= FARTHEST;
        if let Some(p) = mesh.positions.iter().find(|p| !is_near(p)) {
            return Err(Error::invalid(format!(
                "the mesh has a vertex at {p}; expected coordinates up to {FARTHEST:e} m: is the file damaged, or in other units?"
            )));
        }
        Ok(())
    }

    /// Builds the BVH. Errors on a mesh that fails [`Mesh::check`], has more than 2²⁷ triangles, or coordinates that
    /// are not finite or exceed 1e9 m. A mesh that is merely far from the origin is accepted, though its light will be
    /// inaccurate: see [`Mesh::misplaced`].
    pub fn new(mesh: Mesh) -> Result<Self> {
        Self::with_opacity(mesh, |_| TriangleOpacity::Opaque)
    }

    /// [`Scene::new`], where rays go through what is transparent: such triangles, or parts of them, have places in the
    /// atlas and take light as all others do, and let all of it through. `opacity` is asked once for each triangle of
    /// the mesh. Errors also where all are transparent.
    pub fn with_opacity(mesh: Mesh, opacity: impl Fn(u32) -> TriangleOpacity) -> Result<Self> {
        Self::check(&mesh)?;
        // Of each transparent triangle: how many others precede it.
        let (mut solid, mut preceding, mut micromaps) = (Vec::new(), Vec::new(), Vec::new());
        for triangle in 0..mesh.triangles.len() as u32 {
            match opacity(triangle) {
                TriangleOpacity::Opaque => {}
                TriangleOpacity::Micromap(micromap) => micromaps.push((triangle, micromap)),
                TriangleOpacity::Transparent => {
                    preceding.push(solid.len() as u32);
                    continue;
                }
            }
            let [a, b, c] = mesh.corners(triangle);
            solid.push(Triangle { v0: a.into(), v1: b.into(), v2: c.into() });
        }
        if solid.is_empty() {
            return Err(Error::invalid(
                "all triangles of the mesh let light through; expected some that light falls on",
            ));
        }
        let mut bvh = hierarchy::build(solid);
        if !preceding.is_empty() {
            // From the place among those that rays meet to that among all.
            let skipped = |solid: u32| preceding.partition_point(|count| *count <= solid) as u32;
            bvh.primitive_indices.iter_mut().for_each(|index| *index += skipped(*index));
        }
        let is_translucent = micromaps.iter().any(|(_, micromap)| micromap.even_opacity().is_some());
        Ok(Self { mesh, bvh, micromaps: micromaps.into(), is_translucent, wide: OnceLock::new() })
    }

    /// The mesh, in world space.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The nodes of the hierarchy, 80 bytes each, as obvhs lays them out; their primitive ids index
    /// [`Scene::primitives`].
    pub fn nodes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.bvh.nodes)
    }

    /// The triangle of the mesh that each primitive of the hierarchy is, or is a part of. Transparent ones are none.
    pub fn primitives(&self) -> &[u32] {
        &self.bvh.primitive_indices
    }

    /// The triangles that rays meet in parts, in ascending order.
    pub fn micromaps(&self) -> &[(u32, Micromap)] {
        &self.micromaps
    }

    /// Whether some triangles take the same share of light all over ([`Micromap::even_opacity`]).
    pub fn is_translucent(&self) -> bool {
        self.is_translucent
    }

    /// Whether rays meet each triangle of the mesh, or a part of it.
    pub fn is_solid(&self) -> Vec<bool> {
        let mut is_solid = vec![false; self.mesh.triangles.len()];
        self.primitives().iter().for_each(|&triangle| is_solid[triangle as usize] = true);
        is_solid
    }

    fn wide(&self) -> &WideBvh {
        self.wide.get_or_init(|| WideBvh::new(&self.bvh, &self.mesh, self.micromaps.clone()))
    }

    /// Bytes that [`Scene::new`] takes at most, the mesh included, as measured; micromaps come on top.
    pub fn memory(mesh: &Mesh) -> u64 {
        mesh.triangles.len() as u64 * TRIANGLE + mesh.positions.len() as u64 * VERTEX
    }
}

impl Trace<f32> for Scene {
    fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    fn closest(&self, origin: V3<f32>, direction: V3<f32>) -> Option<TraceHit<f32>> {
        self.wide().closest(origin, direction)
    }

    fn is_blocked(&self, origin: V3<f32>, direction: V3<f32>, length: f32) -> bool {
        self.wide().is_blocked(origin, direction, length)
    }

    fn transmittance(&self, origin: V3<f32>, direction: V3<f32>, length: f32) -> f32 {
        if self.is_translucent {
            return self.wide().transmittance(origin, direction, length);
        }
        if self.is_blocked(origin, direction, length) { 0.0 } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;
    use crate::rng::hash2;
    use trace::BruteForce;

    #[test]
    fn rays_go_through_panes_and_name_what_they_meet_behind_them() {
        // Squares above each other, of two triangles each.
        let corner = |k: u32| Vec3::new(f32::from([1, 2].contains(&(k % 4))), f32::from(k % 4 > 1), (k / 4) as f32);
        let mesh = Mesh {
            positions: (0..24).map(corner).collect(),
            normals: vec![Vec3::Z; 24],
            uvs: vec![Vec2::ZERO; 24],
            triangles: (0..6).flat_map(|s| [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|k| 4 * s + k))).collect(),
        };
        let met = |panes: &[u32], height: f32| {
            let opacity = |t: u32| {
                if panes.contains(&(t / 2)) { TriangleOpacity::Transparent } else { TriangleOpacity::Opaque }
            };
            let scene = Scene::with_opacity(mesh.clone(), opacity).unwrap();
            let [origin, down] = [[0.75, 0.5, height], [0.0, 0.0, -1.0]].map(V3::of);
            scene.closest(origin, down).map(|hit| (hit.triangle, hit.t))
        };
        assert_eq!(met(&[], 5.5), Some((10, 0.5)), "a control");
        assert_eq!(met(&[5], 5.5), Some((8, 1.5)));
        assert_eq!(met(&[0, 1, 3, 5], 5.5), Some((8, 1.5)));
        assert_eq!(met(&[0, 1, 3, 5], 3.5), Some((4, 1.5)));
        assert_eq!(met(&[0, 1, 3, 5], 1.5), None);
        let none =
            Scene::with_opacity(mesh.clone(), |_| TriangleOpacity::Transparent).map(drop).unwrap_err().to_string();
        assert!(none.contains("let light through"), "{none}");
    }

    #[test]
    fn rays_meet_the_parts_of_triangles_that_are_there() {
        // Random triangles, some in parts; and the same with these parts as triangles of their own.
        let unit = |i: u32, k: u32| hash2(i, k) as f32 / u32::MAX as f32;
        let corners = |i: u32| {
            let corner = |k: u32| Vec3::new(unit(i, k), unit(i, k + 1), unit(i, k + 2));
            [corner(0), corner(3), corner(6)]
        };
        let side = |i: u32| 1 + i % 9;
        let is_there = |i: u32, k: usize| hash2(i, 100 + k as u32).is_multiple_of(2);
        let (mut mesh, mut cut) = (Mesh::default(), Mesh::default());
        let add = |mesh: &mut Mesh, corners: [Vec3; 3]| {
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(corners);
            mesh.normals.extend([Vec3::Z; 3]);
            mesh.uvs.extend([Vec2::ZERO; 3]);
            mesh.triangles.push([first, first + 1, first + 2]);
        };
        for i in 0..60 {
            let whole @ [a, b, c] = corners(i);
            add(&mut mesh, whole);
            if i.is_multiple_of(3) {
                add(&mut cut, whole);
                continue;
            }
            for (_, part) in micromap::parts(side(i)).enumerate().filter(|(k, _)| is_there(i, *k)) {
                add(&mut cut, micromap::corners(side(i), part).map(|[u, v]| a + (b - a) * u + (c - a) * v));
            }
        }
        let opacity = |i: u32| {
            let next = std::cell::Cell::new(0);
            let coverage = |_| f32::from(is_there(i, next.replace(next.get() + 1)));
            if i.is_multiple_of(3) {
                TriangleOpacity::Opaque
            } else {
                TriangleOpacity::from_coverage(side(i), 0, coverage)
            }
        };
        let scene = Scene::with_opacity(mesh.clone(), opacity).unwrap();
        assert!(scene.micromaps().len() > 30);
        let (exact, without_holes) = (BruteForce(&cut), BruteForce(&mesh));
        let (mut hits, mut misses, mut edges, mut other) = (0, 0, 0, 0);
        for i in 0..20_000 {
            let origin = V3([unit(i, 200), unit(i, 201), unit(i, 202)]);
            let direction = Vec3::new(unit(i, 203), unit(i, 204), unit(i, 205)) - 0.5;
            let direction = V3(direction.normalize().to_array());
            let found = scene.closest(origin, direction).map(|hit| hit.t);
            let expected = Trace::<f32>::closest(&exact, origin, direction).map(|hit| hit.t);
            let same = |a: Option<f32>, b: Option<f32>| match (a, b) {
                (Some(a), Some(b)) => (a - b).abs() < 1e-4,
                (a, b) => a.is_none() && b.is_none(),
            };
            *(if found.is_some() { &mut hits } else { &mut misses }) += 1;
            edges += u32::from(!same(found, expected));
            other += u32::from(!same(found, Trace::<f32>::closest(&without_holes, origin, direction).map(|hit| hit.t)));
            for (length, blocked) in found.into_iter().flat_map(|t| [(t * 1.001, true), (t * 0.999, false)]) {
                assert_eq!(scene.is_blocked(origin, direction, length), blocked, "ray {i}");
            }
        }
        assert!(edges < 10, "{edges} of 20,000 rays differ, more than go by an edge");
        assert!(hits > 5000 && misses > 1000 && other > 2000, "{hits} hits, {misses} misses, {other} by holes");
    }

    #[test]
    fn vertices_that_are_nowhere_are_refused() {
        for far in [f32::NAN, f32::INFINITY, 1.7e28] {
            for axis in 0..3 {
                let mut positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
                positions[2][axis] = far;
                let said = format!("a vertex at {}", positions[2]);
                let mesh =
                    Mesh { positions, normals: vec![Vec3::Z; 3], uvs: vec![Vec2::ZERO; 3], triangles: vec![[0, 1, 2]] };
                let error = Scene::new(mesh).map(drop).unwrap_err().to_string();
                assert!(error.contains(&said) && error.contains("units"), "{error}");
            }
        }
    }
}
