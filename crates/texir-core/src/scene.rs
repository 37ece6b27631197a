//! The mesh with its acceleration structure: what every tracing pass runs on.

use std::time::Duration;

use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::triangle::Triangle;

use crate::error::{Error, Result};
use crate::mesh::Mesh;

/// Most triangles for which the hierarchy is built with all care: a second per 300 thousand, and rays are 1.3 to 1.6 times
/// as fast (docs/performance.md).
const CAREFUL_BUILD: usize = 2_000_000;

/// A mesh and its obvhs CWBVH (8-wide, compressed).
pub struct Scene {
    /// The mesh, in world space.
    pub mesh: Mesh,
    /// The hierarchy; its primitive ids index [`CwBvh::primitive_indices`], which index `mesh.triangles`.
    pub bvh: CwBvh,
}

impl Scene {
    /// Builds the hierarchy. Errors on a mesh without triangles.
    pub fn new(mesh: Mesh) -> Result<Self> {
        if mesh.triangles.is_empty() {
            return Err(Error::invalid("the mesh has no triangles"));
        }
        let triangles: Vec<Triangle> = (0..mesh.triangles.len() as u32)
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                Triangle { v0: a.into(), v1: b.into(), v2: c.into() }
            })
            .collect();
        let quality = if triangles.len() <= CAREFUL_BUILD {
            BvhBuildParams::very_slow_build()
        } else {
            BvhBuildParams::medium_build()
        };
        let bvh = build_cwbvh_from_tris(&triangles, quality, &mut Duration::default());
        Ok(Self { mesh, bvh })
    }
}
