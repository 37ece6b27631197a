//! A square of few texels seen from a handful of places: what tests of light sources look at.

use std::sync::Arc;

use glam::{Mat4, Vec2, Vec3};

use super::adjacency::Adjacency;
use crate::atlas::{Atlas, TexelIndex};
use crate::backend::Backend;
use crate::camera::{Camera, Projection};
use crate::capture::{Split, View};
use crate::cpu::CpuBackend;
use crate::image_io::write_rgb;
use crate::mesh::Mesh;
use crate::raster::Rgb;
use crate::scene::Scene;

/// Texels per side.
pub(super) const SIDE: usize = 8;
/// Rays of a pixel, per axis: images are box-filtered.
const AXIS: usize = 4;

/// The square [−1, 1]² at z = 0, facing up.
pub(super) struct LitSquare {
    pub scene: Arc<Scene>,
    pub atlas: Atlas,
    pub adjacency: Adjacency,
    folder: tempfile::TempDir,
}

impl LitSquare {
    pub fn new() -> Self {
        let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let mesh = Mesh {
            positions: square.map(|(x, y)| Vec3::new(2.0 * x - 1.0, 2.0 * y - 1.0, 0.0)).to_vec(),
            normals: vec![Vec3::Z; 4],
            uvs: square.map(|(x, y)| Vec2::new(x, y)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let scene = Arc::new(Scene::new(mesh).unwrap());
        let atlas = Atlas::new(&mut CpuBackend::new(scene.clone()), [SIDE, SIDE]).unwrap();
        let adjacency = Adjacency::new(scene.mesh(), &atlas);
        Self { scene, atlas, adjacency, folder: tempfile::tempdir().unwrap() }
    }

    pub fn backend(&self) -> CpuBackend {
        CpuBackend::new(self.scene.clone())
    }

    /// Panoramas of `texture` (bilinear) from five places a metre above.
    pub fn views(&self, texture: &Rgb, [width, height]: [usize; 2]) -> Vec<View> {
        let mut backend = self.backend();
        let index = TexelIndex::new(&self.atlas);
        [(-0.4, 0.1), (0.13, 0.07), (0.5, -0.2), (-0.1, 0.55), (0.3, 0.4)]
            .map(|(x, y)| {
                let world_from_camera = Mat4::from_translation(Vec3::new(x, y, 1.0));
                let camera = Camera { projection: Projection::Equirectangular, width, height, world_from_camera };
                let fine = camera.supersampled(AXIS);
                let mut image = Rgb::filled(width, height, [0.0; 3]);
                for (i, hit) in
                    backend.primary(&fine, fine.rows()).unwrap().iter().enumerate().filter(|(_, hit)| hit.is_hit())
                {
                    let pixel = i / fine.width / AXIS * width + i % fine.width / AXIS;
                    for tap in index.bilinear(hit.uv(self.scene.mesh())) {
                        let seen = texture.data[self.atlas.texels[tap.texel as usize] as usize];
                        (0..3).for_each(|c| image.data[pixel][c] += seen[c] * tap.weight / (AXIS * AXIS) as f32);
                    }
                }
                let path = self.folder.path().join(format!("{width} {x} {y}.exr"));
                write_rgb(&path, &image).unwrap();
                let (name, image) = (x.to_string(), path);
                View::new(name, camera, Split::Train, image)
            })
            .to_vec()
    }
}
