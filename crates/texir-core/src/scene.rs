//! The mesh with its acceleration structure: what every tracing pass runs on.

use obvhs::cwbvh::CwBvh;
use obvhs::triangle::Triangle;

use crate::error::{Error, Result};
use crate::hierarchy;
use crate::mesh::Mesh;

/// Coordinates beyond this, metres, are taken for damage: sums of areas of such boxes would overflow.
const FARTHEST: f32 = 1e9;

/// Bytes of a triangle while the hierarchy over them is built: itself, its box, nodes and the costs of packing them.
const TRIANGLE: u64 = 270;
/// Bytes of a vertex: position, normal, coordinates.
const VERTEX: u64 = 32;

/// A mesh and its obvhs CWBVH (8-wide, compressed).
pub struct Scene {
    /// The mesh, in world space.
    pub mesh: Mesh,
    /// The hierarchy; its primitive ids index [`CwBvh::primitive_indices`], which index `mesh.triangles`.
    pub bvh: CwBvh,
    /// The triangles in the order of the hierarchy's leaves, as rays meet them.
    pub(crate) primitives: Vec<Primitive>,
}

/// What a ray needs to know of a triangle.
#[derive(Clone, Copy)]
pub(crate) struct Primitive {
    /// The first corner.
    pub corner: [f32; 3],
    /// From it to the second and to the third.
    pub edges: [[f32; 3]; 2],
    /// Index in the mesh.
    pub triangle: u32,
}

impl Scene {
    /// Builds the hierarchy. Errors on a mesh without triangles, or with vertices that are nowhere near it.
    pub fn new(mesh: Mesh) -> Result<Self> {
        if mesh.triangles.is_empty() {
            return Err(Error::invalid("the mesh has no triangles"));
        }
        if let Some(p) = mesh.positions.iter().find(|p| !(p.abs().max_element() <= FARTHEST)) {
            return Err(Error::invalid(format!(
                "the mesh has a vertex at {p}; expected coordinates up to {FARTHEST:e} m: is the file damaged, or in other units?"
            )));
        }
        let triangles: Vec<Triangle> = (0..mesh.triangles.len() as u32)
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                Triangle { v0: a.into(), v1: b.into(), v2: c.into() }
            })
            .collect();
        let bvh = hierarchy::build(triangles);
        let primitive = |&triangle: &u32| {
            let [a, b, c] = mesh.corners(triangle);
            Primitive { corner: a.to_array(), edges: [(b - a).to_array(), (c - a).to_array()], triangle }
        };
        let primitives = bvh.primitive_indices.iter().map(primitive).collect();
        Ok(Self { mesh, bvh, primitives })
    }

    /// Bytes that [`Scene::new`] takes at most, the mesh included, as measured.
    pub fn memory(mesh: &Mesh) -> u64 {
        mesh.triangles.len() as u64 * TRIANGLE + mesh.positions.len() as u64 * VERTEX
    }
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec3};

    use super::*;

    #[test]
    fn vertices_that_are_nowhere_are_refused() {
        for far in [f32::NAN, f32::INFINITY, 1.7e28] {
            let positions = vec![Vec3::ZERO, Vec3::X, Vec3::new(0.0, 1.0, far)];
            let mesh =
                Mesh { positions, normals: vec![Vec3::Z; 3], uvs: vec![Vec2::ZERO; 3], triangles: vec![[0, 1, 2]] };
            let error = Scene::new(mesh).map(drop).unwrap_err().to_string();
            assert!(error.contains("a vertex at [0, 1, ") && error.contains("units"), "{error}");
        }
    }
}
