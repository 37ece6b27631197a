use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{Vec2, Vec3};

use super::*;
use crate::cpu::CpuBackend;
use crate::error::Error;
use crate::lights::Lights;
use crate::progress::Silent;
use crate::scene::Scene;

const SIDE: usize = 16;
const GATHER: Gather = Gather { cosine: 8, light: 0, seed: 3, part: 0 };
/// Ten points a tile.
const TILE: usize = 80;

/// A floor, and a ceiling that shines unevenly.
pub(super) fn two_sheets() -> (Scene, Rgb) {
    let mut mesh = Mesh::default();
    for (height, normal, left) in [(0.0, Vec3::Z, 0.05), (1.0, -Vec3::Z, 0.55)] {
        let base = mesh.positions.len() as u32;
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(Vec3::new(x, y, height));
            mesh.normals.push(normal);
            mesh.uvs.push(Vec2::new(left + 0.4 * x, 0.05 + 0.9 * y));
        }
        let (b, d) = if height == 0.0 { (1, 3) } else { (3, 1) };
        mesh.triangles.extend([[base, base + b, base + 2], [base, base + 2, base + d]]);
    }
    let data = (0..SIDE * SIDE).map(|i| [1.0 + (i % 7) as f32, 1.0, 0.5]).collect();
    (Scene::new(mesh).unwrap(), Rgb { width: SIDE, height: SIDE, data })
}

/// Stops after a number of rays, and remembers warnings.
#[derive(Default)]
struct Stop {
    rays: AtomicU64,
    limit: u64,
    warnings: Mutex<Vec<String>>,
}

impl Progress for Stop {
    fn start(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, done: u64) {
        self.rays.fetch_add(done, Ordering::Relaxed);
    }
    fn finish(&self) {}
    fn warn(&self, message: &str) {
        self.warnings.lock().unwrap().push(message.to_owned());
    }
    fn cancelled(&self) -> bool {
        self.rays.load(Ordering::Relaxed) >= self.limit
    }
}

pub(super) fn lit<'a>(scene: &'a Scene, radiance: &Rgb) -> CpuBackend<'a> {
    let mut backend = CpuBackend::new(scene);
    backend.set_tbl(radiance, &Lights::none(&scene.mesh)).unwrap();
    backend
}

fn open(path: &Path, scene: &Scene, radiance: &Rgb, progress: &dyn Progress) -> Checkpoints {
    Checkpoints::open(path, &identity(&scene.mesh, radiance, GATHER), progress).unwrap()
}

#[test]
fn tiles_of_any_size_give_the_same_bits() {
    let (scene, radiance) = two_sheets();
    let mut backend = lit(&scene, &radiance);
    let atlas = Atlas::new(&mut backend, &scene, SIDE, SIDE).unwrap();
    let mut bake = |tile| in_tiles(&mut backend, &atlas.points, GATHER, tile, &Checkpoints::none(), &Silent).unwrap();
    let whole = bake(usize::MAX);
    assert!(whole.len() > 100 && whole.iter().any(|g| g.irradiance[0] > 0.1));
    for tile in [0, 8, 100, 999] {
        assert!(whole == bake(tile), "tiles of {tile} rays");
    }
}

#[test]
fn a_bake_goes_on_where_it_was_stopped_to_the_same_bits() {
    let (scene, radiance) = two_sheets();
    let mut backend = lit(&scene, &radiance);
    let atlas = Atlas::new(&mut backend, &scene, SIDE, SIDE).unwrap();
    let whole = in_tiles(&mut backend, &atlas.points, GATHER, TILE, &Checkpoints::none(), &Silent).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/map.exr.partial");
    for limit in [1, 300, 1000] {
        let stop = Stop { limit, ..Stop::default() };
        let kept = open(&path, &scene, &radiance, &stop);
        let stopped = in_tiles(&mut backend, &atlas.points, GATHER, TILE, &kept, &stop);
        assert!(matches!(stopped, Err(Error::Cancelled)));
        let resumed =
            in_tiles(&mut backend, &atlas.points, GATHER, TILE, &open(&path, &scene, &radiance, &Silent), &Silent);
        assert!(whole == resumed.unwrap(), "stopped after {limit} rays");
        kept.finish();
        assert!(!path.exists());
    }
    // What was gathered is not gathered again: in the dark, the first tiles are still bright.
    let stop = Stop { limit: 300, ..Stop::default() };
    let kept = open(&path, &scene, &radiance, &stop);
    in_tiles(&mut backend, &atlas.points, GATHER, TILE, &kept, &stop).unwrap_err();
    let mut dark = lit(&scene, &radiance.map(|_| [0.0; 3]));
    let mixed = in_tiles(&mut dark, &atlas.points, GATHER, TILE, &kept, &Silent).unwrap();
    assert!(mixed[..30] == whole[..30] && mixed[40..].iter().all(|g| g.irradiance == [0.0; 3]));
}

#[test]
fn what_is_kept_of_another_bake_is_begun_anew_with_a_warning() {
    let (scene, radiance) = two_sheets();
    let mut backend = lit(&scene, &radiance);
    let atlas = Atlas::new(&mut backend, &scene, SIDE, SIDE).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.exr.partial");
    let mut bake = |radiance: &Rgb, gather, stop: &Stop| {
        let kept = Checkpoints::open(&path, &identity(&scene.mesh, radiance, gather), stop).unwrap();
        in_tiles(&mut backend, &atlas.points, gather, TILE, &kept, stop)
    };
    let begin = Stop { limit: 500, ..Stop::default() };
    bake(&radiance, GATHER, &begin).unwrap_err();
    assert!(begin.warnings.into_inner().unwrap().is_empty());
    for (radiance, gather) in [(radiance.map(|c| c.map(|x| 2.0 * x)), GATHER), (radiance, Gather { seed: 4, ..GATHER })]
    {
        let stop = Stop { limit: u64::MAX, ..Stop::default() };
        bake(&radiance, gather, &stop).unwrap();
        let warnings = stop.warnings.into_inner().unwrap();
        assert!(warnings.len() == 1 && warnings[0].contains("map.exr.partial"), "{warnings:?}");
    }
}

#[test]
fn an_adaptive_bake_goes_on_where_it_was_stopped_to_the_same_bits() {
    let (scene, radiance) = two_sheets();
    let mut backend = lit(&scene, &radiance);
    let atlas = Atlas::new(&mut backend, &scene, SIDE, SIDE).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.exr.partial");
    let quality = Quality { gather: Gather { cosine: 256, ..GATHER }, error: Some(0.05), denoise: true };
    let mut run =
        |kept: &Checkpoints, progress: &dyn Progress| bake(&mut backend, &scene.mesh, &atlas, &quality, kept, progress);
    let whole = run(&Checkpoints::none(), &Silent).unwrap();
    let most = 256 * atlas.points.len() as u64;
    assert!((most / 8 + 1..most).contains(&whole.rays), "{} of {most} rays", whole.rays);
    let open = || Checkpoints::open(&path, &identity(&scene.mesh, &radiance, quality), &Silent).unwrap();
    for limit in [1, whole.rays / 4, whole.rays / 2] {
        let stop = Stop { limit, ..Stop::default() };
        assert!(matches!(run(&open(), &stop), Err(Error::Cancelled)));
        assert!(run(&open(), &Silent).unwrap() == whole, "stopped after {limit} rays");
        open().finish();
    }
}
