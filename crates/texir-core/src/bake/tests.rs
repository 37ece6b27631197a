use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use bytesize::ByteSize;
use glam::{Vec2, Vec3};

use super::spatial_blocks::SpatialBlocks;
use super::store::POINT;
use super::tiles::{Tiles, rays_of};
use super::*;
use crate::authored::{self, Bounces, Surfaces};
use crate::backend::Gathered;
use crate::cpu::CpuBackend;
use crate::denoise;
use crate::environment::Environment;
use crate::error::Error;
use crate::lights::Lights;
use crate::mesh::Mesh;
use crate::progress::Silent;
use crate::punctual::PunctualLight;
use crate::scene::Scene;

const SIDE: usize = 16;
const GATHER: Gather = Gather::new(8, 0, 3);
/// Points of a tile.
const TILE: usize = 10;

/// A floor, and a ceiling that shines unevenly.
pub(super) fn two_sheets() -> (Arc<Scene>, Rgb) {
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
    (Arc::new(Scene::new(mesh).unwrap()), Rgb { width: SIDE, height: SIDE, data })
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

pub(super) fn lit(scene: &Arc<Scene>, radiance: &Rgb) -> CpuBackend {
    let mut backend = CpuBackend::new(scene.clone());
    backend.set_tbl(radiance, &Lights::none(scene.mesh())).unwrap();
    backend
}

/// Gathers at all texels in tiles of so many points.
fn in_tiles(
    backend: &mut CpuBackend,
    atlas: &Atlas,
    gather: Gather,
    len: usize,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Vec<Gathered>> {
    let texels = Texels::of(atlas);
    let mut all = Vec::new();
    let tiles = Tiles::new(&texels.points, None, rays_of(gather)).of(len);
    tiles.gather(gather, backend, checkpoints, progress, |_, found| {
        all.extend_from_slice(found);
        Ok(())
    })?;
    Ok(all)
}

/// [`identity`] of a map of [`SIDE`] texels whose light samples the cosine alone.
fn identity_of(scene: &Arc<Scene>, radiance: &Rgb, quality: &Quality) -> String {
    let no_lights = Lights::none(scene.mesh());
    identity(&CpuBackend::new(scene.clone()), (radiance, &no_lights), None, [SIDE; 2], quality)
}

fn open(path: &Path, scene: &Arc<Scene>, radiance: &Rgb, progress: &dyn Progress) -> Checkpoints {
    Checkpoints::open(path, &identity_of(scene, radiance, &Quality::denoised(GATHER)), progress).unwrap()
}

#[test]
fn tiles_of_any_size_give_the_same_bits() {
    let (scene, radiance) = two_sheets();
    let mut backend = lit(&scene, &radiance);
    let atlas = Atlas::new(&mut backend, [SIDE, SIDE]).unwrap();
    let mut bake = |tile| in_tiles(&mut backend, &atlas, GATHER, tile, &Checkpoints::none(), &Silent).unwrap();
    let whole = bake(usize::MAX);
    assert!(whole.len() > 100 && whole.iter().any(|g| g.irradiance[0] > 0.1));
    for tile in [1, 12, 124] {
        assert!(whole == bake(tile), "tiles of {tile} points");
    }
}

#[test]
fn a_bake_goes_on_where_it_was_stopped_to_the_same_bits() {
    let (scene, radiance) = two_sheets();
    let mut backend = lit(&scene, &radiance);
    let atlas = Atlas::new(&mut backend, [SIDE, SIDE]).unwrap();
    let whole = in_tiles(&mut backend, &atlas, GATHER, TILE, &Checkpoints::none(), &Silent).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/map.exr.partial");
    for limit in [1, 300, 1000] {
        let stop = Stop { limit, ..Stop::default() };
        let kept = open(&path, &scene, &radiance, &stop);
        let stopped = in_tiles(&mut backend, &atlas, GATHER, TILE, &kept, &stop);
        assert!(matches!(stopped, Err(Error::Cancelled)));
        drop(kept);
        let kept = open(&path, &scene, &radiance, &Silent);
        let resumed = in_tiles(&mut backend, &atlas, GATHER, TILE, &kept, &Silent);
        assert!(whole == resumed.unwrap(), "stopped after {limit} rays");
        kept.finish();
        assert!(!path.exists());
    }
    // What was gathered is not gathered again: in the dark, the first tiles are still bright.
    let stop = Stop { limit: 300, ..Stop::default() };
    let kept = open(&path, &scene, &radiance, &stop);
    in_tiles(&mut backend, &atlas, GATHER, TILE, &kept, &stop).unwrap_err();
    let mut dark = lit(&scene, &radiance.map(|_| [0.0; 3]));
    let mixed = in_tiles(&mut dark, &atlas, GATHER, TILE, &kept, &Silent).unwrap();
    assert!(mixed[..30] == whole[..30] && mixed[40..].iter().all(|g| g.irradiance == [0.0; 3]));
}

#[test]
fn what_is_kept_of_another_bake_is_begun_anew_with_a_warning() {
    let (scene, radiance) = two_sheets();
    let mut backend = lit(&scene, &radiance);
    let atlas = Atlas::new(&mut backend, [SIDE, SIDE]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.exr.partial");
    let mut bake = |radiance: &Rgb, gather, stop: &Stop| {
        let kept = Checkpoints::open(&path, &identity_of(&scene, radiance, &Quality::denoised(gather)), stop).unwrap();
        in_tiles(&mut backend, &atlas, gather, TILE, &kept, stop)
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
    let atlas = Atlas::new(&mut backend, [SIDE, SIDE]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.exr.partial");
    let quality =
        Quality { gather: Gather { cosine: 256, ..GATHER }, error: Some(0.05), denoise: Some(Denoiser::Regression) };
    let mut run = |kept: &Checkpoints, progress: &dyn Progress| bake(&mut backend, &atlas, &quality, kept, progress);
    let whole = run(&Checkpoints::none(), &Silent).unwrap();
    let most = 256 * atlas.points.len() as u64;
    assert!((most / 8 + 1..most).contains(&whole.rays), "{} of {most} rays", whole.rays);
    let open = || Checkpoints::open(&path, &identity_of(&scene, &radiance, &quality), &Silent).unwrap();
    for limit in [1, whole.rays / 4, whole.rays / 2] {
        let stop = Stop { limit, ..Stop::default() };
        assert!(matches!(run(&open(), &stop), Err(Error::Cancelled)));
        assert!(run(&open(), &Silent).unwrap() == whole, "stopped after {limit} rays");
        open().finish();
    }
}

/// Texels of the map that is baked in memory and in files, a side.
const LARGE: usize = 160;

/// A floor in strips, each a chart of its own, in an order that is not that of space; a rug that buries a part of it;
/// and a ceiling that shines.
fn strips() -> (Arc<Scene>, Rgb) {
    let mut mesh = Mesh::default();
    let mut sheet = |[x0, x1, y0, y1]: [f32; 4], height: f32, up: bool, slot: usize| {
        let (base, column, row) = (mesh.positions.len() as u32, slot % 4, slot / 4);
        for (x, y) in [(x0, y0), (x1, y0), (x1, y1), (x0, y1)] {
            mesh.positions.push(Vec3::new(x, y, height));
            mesh.normals.push(if up { Vec3::Z } else { -Vec3::Z });
            let place = Vec2::new((x - x0) / (x1 - x0), (y - y0) / (y1 - y0));
            mesh.uvs.push((Vec2::new(column as f32, row as f32) + 0.1 + 0.75 * place) / 4.0);
        }
        let (b, d) = if up { (1, 3) } else { (3, 1) };
        mesh.triangles.extend([[base, base + b, base + 2], [base, base + 2, base + d]]);
    };
    for k in 0..12 {
        sheet([k as f32, (k + 1) as f32, 0.0, 1.0], 0.0, true, k * 5 % 12);
    }
    sheet([3.3, 5.3, 0.1, 0.9], 0.01, true, 12);
    sheet([0.0, 12.0, 0.0, 1.0], 0.5, false, 14);
    let data = (0..SIDE * SIDE).map(|i| [0.1 + (i % 7) as f32, 1.0, if i % 5 == 0 { 9.0 } else { 0.1 }]).collect();
    (Arc::new(Scene::new(mesh).unwrap()), Rgb { width: SIDE, height: SIDE, data })
}

#[test]
fn buried_texels_take_what_is_lit_beside_them_and_keep_the_rest() {
    let (scene, radiance) = two_sheets();
    let atlas = Atlas::new(&mut lit(&scene, &radiance), [LARGE, LARGE]).unwrap();
    let row = |texel: &u32| *texel as usize / LARGE;
    let first_lit = LARGE / 2;
    let baked = Baked {
        irradiance: atlas.texels.iter().map(|texel| [row(texel) as f32; 3]).collect(),
        buried: atlas.texels.iter().map(|texel| row(texel) < first_lit).collect(),
        standard_error: None,
        rays: 0,
    };
    let (filled, kept) = (baked.map(&atlas, Buried::Fill).unwrap(), baked.map(&atlas, Buried::Keep).unwrap());
    for (texel, row) in atlas.texels.iter().map(|texel| (*texel as usize, row(texel))) {
        let taken = if (first_lit - PADDING..first_lit).contains(&row) { first_lit } else { row };
        assert!(filled.data[texel] == [taken as f32; 3] && kept.data[texel] == [row as f32; 3], "row {row}");
    }
}

/// In files, with few texels at a time.
fn on_disk(folder: &Path) -> Workspace {
    Workspace::Disk { folder: folder.to_owned(), memory: ByteSize(13_400 * POINT) }
}

/// The map and its errors, made some rows at a time.
fn maps(solution: &BakedTexels, texels: &Texels<'_>, buried: Buried, band: usize) -> (Vec<[f32; 3]>, Vec<f32>) {
    let bands = || (0..LARGE).step_by(band).map(|row| row..(row + band).min(LARGE));
    let map = bands().flat_map(|rows| solution.map_rows(texels, buried, rows).unwrap()).collect();
    (map, bands().flat_map(|rows| solution.error_rows(texels, rows).unwrap()).collect())
}

#[test]
fn a_bake_in_files_has_the_bits_of_one_in_memory() {
    let (scene, radiance) = strips();
    let mut backend = lit(&scene, &radiance);
    let atlas = Atlas::new(&mut backend, [LARGE, LARGE]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let gather = Gather { cosine: 64, ..GATHER };
    let mut texels = |workspace| Texels::map(&mut backend, [LARGE; 2], workspace, &Silent).unwrap();
    let (memory, disk) = (texels(Workspace::Memory), texels(on_disk(folder.path())));
    assert_eq!(disk.valid(), atlas.texels.len());
    assert_eq!(disk.typical(scene.mesh()).unwrap(), atlas.typical_texel(scene.mesh()));
    let regression = Some(Denoiser::Regression);
    let ways = [(None, None), (None, regression), (Some(0.0), None), (Some(0.0), regression), (Some(0.2), regression)];
    for (error, denoise) in ways {
        let quality = Quality { gather, error, denoise };
        let mut solve = |texels: &Texels<'_>| {
            super::bake_texels(&mut backend, texels, &quality, &Checkpoints::none(), &Silent).unwrap()
        };
        let (in_memory, on_disk) = (solve(&memory), solve(&disk));
        let baked = bake(&mut backend, &atlas, &quality, &Checkpoints::none(), &Silent).unwrap();
        let buried = baked.buried.iter().filter(|inside| **inside).count();
        assert!(buried > 10 && on_disk.buried().unwrap() == buried && on_disk.rays == baked.rays, "{quality:?}");
        for buried in [Buried::Keep, Buried::Fill] {
            let whole = maps(&in_memory, &memory, buried, LARGE);
            assert!(whole.0 == baked.map(&atlas, buried).unwrap().data, "{quality:?}, {buried:?}");
            assert!(error.is_none() || whole.1.iter().any(|e| *e > 0.0));
            for band in [1, 7, 16] {
                assert!(maps(&on_disk, &disk, buried, band) == whole, "{quality:?}, {buried:?}, {band} rows");
            }
        }
    }
    // Negative control: where blocks have not enough around them, their borders differ.
    let quality = Quality { gather, error: None, denoise: Some(Denoiser::Regression) };
    let mut solve = |texels: &Texels<'_>, reach| {
        let surface = SpatialBlocks::new(texels, scene.mesh(), reach).unwrap();
        let solved = passes::bake_blocks(&mut backend, &surface, &quality, &Checkpoints::none(), &Silent).unwrap();
        maps(&solved, texels, Buried::Keep, LARGE).0
    };
    let (whole, enough, little) = (solve(&memory, 1.0), solve(&disk, denoise::REACH), solve(&disk, 1.0));
    assert!(whole == enough && whole != little);
}

#[test]
fn a_small_thing_of_many_texels_has_neighbours_of_its_own_size() {
    // A floor of 10 m, and a square of 5 cm that has more than a third of the map.
    let mut mesh = Mesh::default();
    for (edge, height, left, width) in [(10.0, 0.0, 0.02, 0.55), (0.05, 1.0, 0.6, 0.38)] {
        let base = mesh.positions.len() as u32;
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(Vec3::new(edge * x, edge * y, height));
            mesh.normals.push(Vec3::Z);
            mesh.uvs.push(Vec2::new(left + width * x, 0.02 + 0.96 * y));
        }
        mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }
    let scene = Arc::new(Scene::new(mesh).unwrap());
    let mut backend = CpuBackend::new(scene.clone());
    let texels = Texels::map(&mut backend, [LARGE; 2], Workspace::Memory, &Silent).unwrap();
    let surface = SpatialBlocks::new(&texels, scene.mesh(), 1.0).unwrap();
    let points = texels.pieces().map(|items| texels.points.get(&items).unwrap().into_owned()).collect::<Vec<_>>();
    let points = points.concat();
    let [floor, square] = &surface.size_classes(&points)[..] else { panic!("two size classes are expected") };
    let height = |class: &spatial_blocks::SizeClass| {
        class.gather(&points).iter().map(|point| point.position[2]).collect::<Vec<_>>()
    };
    assert!(height(floor).iter().all(|z| *z < 0.5) && height(square).iter().all(|z| *z > 0.5));
    assert_eq!(height(floor).len() + height(square).len(), points.len());
    // Texels of some 5 cm / √(0.38 · 0.96 LARGE²).
    let edge = 0.05 / (0.38 * 0.96 * (LARGE * LARGE) as f32).sqrt();
    assert!((0.5..2.0).contains(&(square.texel / edge)) && floor.texel == surface.texel, "{} {edge}", square.texel);
    // Each has its value back in its place.
    let mut all = vec![0.0; points.len()];
    floor.scatter(height(floor), &mut all);
    square.scatter(height(square), &mut all);
    assert!(points.iter().zip(&all).all(|(point, z)| point.position[2] == *z));
}

#[test]
fn bounces_in_files_have_the_bits_of_those_in_memory() {
    let (scene, _) = strips();
    let mut backend = CpuBackend::new(scene);
    let folder = tempfile::tempdir().unwrap();
    // The ceiling shines; its chart is in the last row of the atlas.
    let shines = |i: usize| if i / LARGE > LARGE * 3 / 4 { [9.0, 5.0, 2.0] } else { [0.0; 3] };
    let surfaces = Surfaces {
        albedo: Rgb::filled(LARGE, LARGE, [0.7, 0.5, 0.3]),
        emission: Rgb { width: LARGE, height: LARGE, data: (0..LARGE * LARGE).map(shines).collect() },
        lights: vec![PunctualLight::Point { position: [6.0, 0.5, 0.3], intensity: [2.0; 3], range: None }],
        environment: None,
    };
    for (error, denoise) in [(None, None), (Some(0.3), Some(Denoiser::Regression))] {
        let quality = Quality { gather: GATHER, error, denoise };
        let bounces = Bounces { quality, tolerance: 1e-3, max_bounces: 4 };
        let mut solve = |workspace| {
            let texels = Texels::map(&mut backend, [LARGE; 2], workspace, &Silent).unwrap();
            let none = Checkpoints::none();
            let solved = authored::irradiance(&mut backend, &texels, &surfaces, &bounces, &none, &Silent).unwrap();
            let buried = solved.solution.buried().unwrap();
            (maps(&solved.solution, &texels, Buried::Fill, 16), buried, solved.solution.rays, solved.series)
        };
        let memory = solve(Workspace::Memory);
        assert!(memory.1 > 10 && memory.3.len() > 2 && memory.3[1] > 0.05 * memory.3[0], "{:?}", memory.3);
        assert!(memory == solve(on_disk(folder.path())), "{quality:?}");
    }
}

#[test]
fn a_bake_in_files_goes_on_where_it_was_stopped_to_the_same_bits() {
    let (scene, radiance) = strips();
    let mut backend = lit(&scene, &radiance);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.exr.partial");
    let quality =
        Quality { gather: Gather { cosine: 128, ..GATHER }, error: Some(0.2), denoise: Some(Denoiser::Regression) };
    let open = || Checkpoints::open(&path, &identity_of(&scene, &radiance, &quality), &Silent).unwrap();
    let mut run = |workspace: Workspace, kept: &Checkpoints, progress: &dyn Progress| -> Result<_> {
        let texels = Texels::map(&mut backend, [LARGE; 2], workspace, &Silent)?;
        let solution = super::bake_texels(&mut backend, &texels, &quality, kept, progress)?;
        Ok((maps(&solution, &texels, Buried::Keep, 16), solution.rays, texels.valid() as u64))
    };
    let (whole, rays, texels) = run(Workspace::Memory, &Checkpoints::none(), &Silent).unwrap();
    let denoised = || {
        let mut names =
            std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.any(|name| name.contains("denoised"))
    };
    // 128 rays are three rounds: errors are told between them and at the end. Then the first block is denoised.
    let late = rays + 3 * texels + 1;
    for (limit, in_memory) in [(1, false), (rays / 2, true), (rays / 2, false), (late, false)] {
        let stop = Stop { limit, ..Stop::default() };
        assert!(matches!(run(on_disk(folder.path()), &open(), &stop), Err(Error::Cancelled)), "{limit} of {rays}");
        assert_eq!(denoised(), limit == late, "blocks are kept");
        let workspace = if in_memory { Workspace::Memory } else { on_disk(folder.path()) };
        assert!(run(workspace, &open(), &Silent).unwrap().0 == whole, "stopped after {limit} of {rays} rays");
        open().finish();
        assert!(!path.exists());
    }
}

#[test]
fn texels_too_close_together_for_the_memory_are_an_error_that_says_what_would_do() {
    let (scene, radiance) = strips();
    let mut backend = lit(&scene, &radiance);
    let folder = tempfile::tempdir().unwrap();
    let small = Workspace::Disk { folder: folder.path().to_owned(), memory: ByteSize(50 * POINT) };
    let texels = Texels::map(&mut backend, [LARGE; 2], small, &Silent).unwrap();
    let error = SpatialBlocks::new(&texels, scene.mesh(), denoise::REACH).err().unwrap().to_string();
    assert!(error.contains("more memory") && error.contains("KiB"), "{error}");
}

#[test]
fn what_a_bake_keeps_in_memory_follows_from_the_budget() {
    let (scene, _) = strips();
    let plan = |limit, side| workspace_within(limit, Path::new("x.partial"), scene.mesh(), 256, [side; 2]);
    assert_eq!(plan(ByteSize::gib(1), 512).unwrap(), Workspace::Memory);
    let Workspace::Disk { memory, .. } = plan(ByteSize::gib(1), 16384).unwrap() else { panic!("in memory") };
    assert!(memory < ByteSize::gib(1) && memory > ByteSize::mib(800), "{memory}");
    let error = plan(ByteSize::mib(64), 16384).unwrap_err().to_string();
    let least = error.split("about ").nth(1).and_then(|rest| rest.split(':').next()).unwrap();
    assert!(plan(ByteSize(least.parse::<ByteSize>().unwrap().0 + (1 << 20)), 16384).is_ok(), "{error}");
}

#[test]
fn bounces_that_do_not_fit_are_refused_with_a_size_that_does() {
    let (scene, _) = strips();
    let of_map =
        |limit, images, size| bounce_workspace_within(limit, Path::new("x.partial"), scene.mesh(), images, size);
    let beside = |limit, images, side: usize| of_map(limit, images, [side; 2]);
    let plan = |limit, side| beside(limit, 0, side);
    assert_eq!(plan(ByteSize::gib(1), 1024).unwrap(), Workspace::Memory);
    let Workspace::Disk { memory, .. } = plan(ByteSize::gib(1), 2048).unwrap() else { panic!("in memory") };
    assert!(memory < ByteSize::mib(720) && memory > ByteSize::mib(600), "{memory}");
    let error = plan(ByteSize::gib(1), 4096).unwrap_err().to_string();
    let width = |error: &str| -> usize {
        error.split("bake a map ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap()
    };
    let side = width(&error);
    assert!((2048..4096).contains(&side) && plan(ByteSize::gib(1), side).is_ok(), "{error}");
    // With other sides a map has twice the rows.
    let tall = |limit, width| of_map(limit, 0, [width, 2 * width]);
    let error = tall(ByteSize::mib(512), 2048).unwrap_err().to_string();
    let width = width(&error);
    assert!((1024..2048).contains(&width) && tall(ByteSize::mib(512), width).is_ok(), "{error}");
    let error = plan(ByteSize::mib(1), 64).unwrap_err().to_string();
    assert!(error.ends_with(": raise it"), "{error}");
    let error = beside(ByteSize::gib(1), 1 << 30, 64).unwrap_err().to_string();
    assert!(error.contains("triangles, read in 1.0 GiB,") && plan(ByteSize::gib(1), 64).is_ok(), "{error}");
}

#[test]
fn a_bake_goes_on_only_with_what_it_was_begun_with() {
    let (scene, radiance) = two_sheets();
    let mesh = scene.mesh();
    let backend = CpuBackend::new(scene.clone());
    let no_lights = Lights::none(mesh);
    let quality = Quality::denoised(Gather::new(8, 8, 1));
    let own = identity(&backend, (&radiance, &no_lights), None, [SIDE; 2], &quality);
    let again = CpuBackend::new(Scene::new(mesh.clone()).unwrap());
    assert_eq!(own, identity(&again, (&radiance.clone(), &no_lights.clone()), None, [SIDE; 2], &quality.clone()));
    let changed = |change: fn(&mut Mesh)| {
        let mut other = mesh.clone();
        change(&mut other);
        let backend = CpuBackend::new(Scene::new(other).unwrap());
        identity(&backend, (&radiance, &no_lights), None, [SIDE; 2], &quality)
    };
    let lit = |radiance: &Rgb, lights: &Lights, environment: Option<&Environment>| {
        identity(&backend, (radiance, lights), environment, [SIDE; 2], &quality)
    };
    let baked = |size: [usize; 2], quality: Quality| identity(&backend, (&radiance, &no_lights), None, size, &quality);
    let sky = |radiance: f32| Environment::constant([radiance; 3]).unwrap();
    let mut brighter = radiance.clone();
    brighter.data[77][2] += 0.5;
    let others = [
        changed(|mesh| mesh.positions[1].x += 1e-3),
        changed(|mesh| mesh.normals[1] = Vec3::X),
        changed(|mesh| mesh.uvs[1].y += 1e-3),
        changed(|mesh| mesh.triangles[0].swap(0, 1)),
        lit(&brighter, &no_lights, None),
        lit(&Rgb { width: SIDE / 2, height: 2 * SIDE, ..radiance.clone() }, &no_lights, None),
        lit(&radiance, &Lights { one_sided: true, ..no_lights.clone() }, None),
        lit(&radiance, &Lights::by_power(mesh, &vec![1.0; mesh.triangles.len()]), None),
        lit(&radiance, &no_lights, Some(&sky(1.0))),
        lit(&radiance, &no_lights, Some(&sky(2.0))),
        baked([SIDE, 2 * SIDE], quality),
        baked([SIDE; 2], Quality::denoised(Gather::new(8, 8, 2))),
        baked([SIDE; 2], Quality { error: Some(0.1), ..quality }),
        baked([SIDE; 2], Quality { denoise: None, ..quality }),
    ];
    let distinct: HashSet<&String> = others.iter().chain([&own]).collect();
    assert_eq!(distinct.len(), others.len() + 1, "{own} {others:?}");

    let surfaces = Surfaces {
        albedo: Rgb::filled(SIDE, SIDE, [0.5; 3]),
        emission: radiance,
        lights: vec![PunctualLight::Point { position: [0.0; 3], intensity: [1.0; 3], range: None }],
        environment: Some(Environment::new(Rgb::filled(4, 2, [1.0; 3])).unwrap()),
    };
    let own = surfaces.identity(&backend, &quality);
    assert_eq!(own, surfaces.clone().identity(&backend, &quality));
    let changed = |change: fn(&mut Surfaces)| {
        let mut other = surfaces.clone();
        change(&mut other);
        other.identity(&backend, &quality)
    };
    let others = [
        changed(|of| of.albedo.data[3][1] = 0.4),
        changed(|of| of.emission.data[3][1] = 9.0),
        changed(|of| {
            of.lights[0] = PunctualLight::Point { position: [0.0; 3], intensity: [1.0, 1.0, 2.0], range: None };
        }),
        changed(|of| of.lights.clear()),
        changed(|of| of.environment = None),
        changed(|of| of.environment = Some(Environment::new(Rgb::filled(4, 2, [2.0; 3])).unwrap())),
        surfaces.identity(&backend, &Quality::denoised(Gather::new(8, 8, 2))),
    ];
    assert!(others.iter().all(|other| *other != own), "{own} {others:?}");
}

#[test]
fn standard_errors_of_light_that_is_added_up_add_up_as_noise_does() {
    let (scene, radiance) = two_sheets();
    let mut backend = lit(&scene, &radiance);
    let atlas = Atlas::new(&mut backend, [SIDE, SIDE]).unwrap();
    let texels = Texels::of(&atlas);
    let quality = Quality { gather: GATHER, error: Some(0.0), denoise: None };
    let mut solution = bake_texels(&mut backend, &texels, &quality, &Checkpoints::none(), &Silent).unwrap();
    let other = solution.copy(&texels).unwrap();
    let [one, _] = [&solution, &other].map(|of| of.copy(&texels).unwrap().into_baked().unwrap());
    solution.add(&texels, &other).unwrap();
    let both = solution.into_baked().unwrap();
    let [one_errors, both_errors] = [&one, &both].map(|baked| baked.standard_error.as_ref().unwrap());
    assert!(one_errors.iter().any(|e| *e > 0.0));
    for (one, both) in one_errors.iter().zip(both_errors) {
        assert!((both - std::f32::consts::SQRT_2 * one).abs() <= 1e-6 * one, "{one} twice is {both}");
    }
    assert!(one.irradiance.iter().zip(&both.irradiance).all(|(one, both)| *both == one.map(|e| 2.0 * e)));
}

#[test]
fn errors_that_cannot_be_met_and_halves_of_one_ray_are_refused() {
    let (scene, radiance) = two_sheets();
    let mut backend = lit(&scene, &radiance);
    let atlas = Atlas::new(&mut backend, [SIDE, SIDE]).unwrap();
    let mut refused = |quality: &Quality| {
        bake(&mut backend, &atlas, quality, &Checkpoints::none(), &Silent).map(drop).unwrap_err().to_string()
    };
    for error in [f32::NAN, -0.1] {
        let said = refused(&Quality { gather: GATHER, error: Some(error), denoise: None });
        assert!(said.contains(&format!("asked for is {error}; expected")), "{said}");
    }
    let said = refused(&Quality::denoised(Gather::new(1, 8, 3)));
    assert!(said.contains("denoising") && said.contains("at least 2"), "{said}");
}
