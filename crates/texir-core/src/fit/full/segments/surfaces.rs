//! Flat surfaces, and the two sides of thin things.

use glam::Vec3;
use rayon::prelude::*;

use crate::atlas::{Atlas, TexelIndex};
use crate::fit::adjacency::Adjacency;
use crate::ray_origin::offset_origin;
use crate::real::V3;
use crate::scene::Scene;
use crate::scene::trace::Trace;
use crate::surface::{Hit, SurfacePoint};

/// Neighbours on one flat surface differ in their normals by less than the angle of this cosine.
const FLAT: f32 = 0.95;
/// Things up to this thick are thin, metres: two rooms are further apart.
const THIN: f32 = 0.06;
/// Cosine of the angle up to which the two sides of something thin are parallel.
const PARALLEL: f32 = 0.7;

/// The flat surface that each texel is part of.
pub fn flat_surfaces(atlas: &Atlas, adjacency: &Adjacency) -> Vec<u32> {
    let normal = |t: u32| Vec3::from(atlas.points[t as usize].normal);
    adjacency.regions(&[], |a, b| normal(a).dot(normal(b)) > FLAT).0
}

/// The texels of thin things, the leaves of doors and the boards of shelves, each with the one on the other side,
/// ascending.
pub fn backs(scene: &Scene, atlas: &Atlas) -> Vec<[u32; 2]> {
    let index = TexelIndex::new(atlas);
    let front = |t: usize| {
        let SurfacePoint { position, triangle, normal, .. } = atlas.points[t];
        let face = scene.mesh().face_normal(triangle);
        let inwards = if face.dot(normal.into()) > 0.0 { -face } else { face };
        // The point lies a step outside.
        let origin = offset_origin(position.into(), 2.0 * inwards);
        let hit = Trace::<f32>::closest(scene, V3::of(origin.to_array()), V3::of(inwards.to_array()))?;
        let leaves = scene.mesh().face_normal(hit.triangle).dot(inwards) > PARALLEL;
        let hit = Hit { triangle: hit.triangle, u: hit.u, v: hit.v, t: hit.t };
        index.nearest(hit.uv(scene.mesh())).filter(|_| leaves && hit.t < THIN)
    };
    let of = |t: usize| Some([t as u32, front(t)?]);
    (0..atlas.points.len()).into_par_iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;
    use crate::backend::Backend;
    use crate::cpu::CpuBackend;
    use crate::mesh::Mesh;

    /// A block from z = 0 down, of this thickness, of which there are top and bottom; `flipped` turns the bottom
    /// inside.
    fn slab(thickness: f32, flipped: bool) -> Scene {
        let quad = |z: f32, up: bool, left: f32| {
            let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
            let corners = if up { corners } else { [corners[0], corners[3], corners[2], corners[1]] };
            let normal = if up { Vec3::Z } else { -Vec3::Z };
            corners.map(|(x, y)| (Vec3::new(x, y, z), normal, Vec2::new(left + 0.4 * x, 0.8 * y)))
        };
        let corners = [quad(0.0, true, 0.05), quad(-thickness, flipped, 0.55)].concat();
        Scene::new(Mesh {
            positions: corners.iter().map(|c| c.0).collect(),
            normals: corners.iter().map(|c| c.1).collect(),
            uvs: corners.iter().map(|c| c.2).collect(),
            triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
        })
        .unwrap()
    }

    #[test]
    fn thin_things_have_backs_and_thick_ones_have_none() {
        let backs_of = |scene: Scene| {
            let mut backend = CpuBackend::new(scene);
            let atlas = Atlas::new(&mut backend, [40, 20]).unwrap();
            (backs(backend.scene(), &atlas), atlas)
        };
        let (found, atlas) = backs_of(slab(0.04, false));
        assert!(found.len() as f32 > 0.9 * atlas.points.len() as f32, "{} of {}", found.len(), atlas.points.len());
        for [back, front] in found {
            let [back, front] = [back, front].map(|t| atlas.points[t as usize]);
            assert!(back.normal[2] == -front.normal[2]);
            let aside = (Vec3::from(back.position) - Vec3::from(front.position)).truncate().length();
            assert!(aside < 1.5 / 16.0, "{aside} m aside");
        }
        assert_eq!(backs_of(slab(0.2, false)).0, [[0; 2]; 0], "what is thick");
        assert_eq!(backs_of(slab(0.04, true)).0, [[0; 2]; 0], "two sheets that face alike");
    }
}
