//! The mesh with its acceleration structure: what every tracing pass runs on.

mod hierarchy;
pub mod trace;
mod wide;

use std::fmt;
use std::sync::OnceLock;

use glam::Vec3;
pub use hierarchy::MAX_LEVELS;
use obvhs::cwbvh::CwBvh;
use obvhs::triangle::Triangle;

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::real::V3;
use trace::{Trace, TraceHit};
pub use wide::SLAB_ROUNDING;
use wide::WideBvh;

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
        Self::with_panes(mesh, |_| false)
    }

    /// [`Scene::new`], where no ray meets the triangles that are panes: they have places in the atlas and take light as
    /// all others do, and let all of it through. Errors also where there are no others.
    pub fn with_panes(mesh: Mesh, is_pane: impl Fn(u32) -> bool) -> Result<Self> {
        Self::check(&mesh)?;
        let all = 0..mesh.triangles.len() as u32;
        let solid: Vec<Triangle> = all
            .clone()
            .filter(|t| !is_pane(*t))
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                Triangle { v0: a.into(), v1: b.into(), v2: c.into() }
            })
            .collect();
        if solid.is_empty() {
            return Err(Error::invalid(
                "all triangles of the mesh let light through; expected some that light falls on",
            ));
        }
        let mut bvh = hierarchy::build(solid);
        // From the place among solid triangles to that among all. Of each pane: how many solid ones precede it.
        let preceding: Vec<u32> = all.filter(|t| is_pane(*t)).enumerate().map(|(k, t)| t - k as u32).collect();
        if !preceding.is_empty() {
            let panes_before = |solid: u32| preceding.partition_point(|count| *count <= solid) as u32;
            bvh.primitive_indices.iter_mut().for_each(|index| *index += panes_before(*index));
        }
        Ok(Self { mesh, bvh, wide: OnceLock::new() })
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

    /// The triangle of the mesh that each primitive of the hierarchy is, or is a part of. Panes are none.
    pub fn primitives(&self) -> &[u32] {
        &self.bvh.primitive_indices
    }

    /// Whether rays meet each triangle of the mesh: panes they do not.
    pub fn is_solid(&self) -> Vec<bool> {
        let mut is_solid = vec![false; self.mesh.triangles.len()];
        self.primitives().iter().for_each(|&triangle| is_solid[triangle as usize] = true);
        is_solid
    }

    fn wide(&self) -> &WideBvh {
        self.wide.get_or_init(|| WideBvh::new(&self.bvh, &self.mesh))
    }

    /// Bytes that [`Scene::new`] takes at most, the mesh included, as measured.
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
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;

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
            let scene = Scene::with_panes(mesh.clone(), |t| panes.contains(&(t / 2))).unwrap();
            let [origin, down] = [[0.75, 0.5, height], [0.0, 0.0, -1.0]].map(V3::of);
            scene.closest(origin, down).map(|hit| (hit.triangle, hit.t))
        };
        assert_eq!(met(&[], 5.5), Some((10, 0.5)), "a control");
        assert_eq!(met(&[5], 5.5), Some((8, 1.5)));
        assert_eq!(met(&[0, 1, 3, 5], 5.5), Some((8, 1.5)));
        assert_eq!(met(&[0, 1, 3, 5], 3.5), Some((4, 1.5)));
        assert_eq!(met(&[0, 1, 3, 5], 1.5), None);
        let none = Scene::with_panes(mesh.clone(), |_| true).map(drop).unwrap_err().to_string();
        assert!(none.contains("let light through"), "{none}");
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
