//! A closed 3 × 3 × 2.5 m room with a box and a lamp under the ceiling, its truth, and four panoramas of it: three for
//! training, one held out. Every quad has a chart of its own, of one albedo and one roughness.

use std::f32::consts::{FRAC_1_PI, FRAC_PI_2};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use glam::{Mat4, Vec2, Vec3};
use tempfile::TempDir;
use texir_core::atlas::Atlas;
use texir_core::backend::{Backend, Gather};
use texir_core::bake::{self, Buried};
use texir_core::brdf::Masking;
use texir_core::camera::{Camera, Projection};
use texir_core::capture::nerfstudio::write_transforms;
use texir_core::capture::{Split, View};
use texir_core::checkpoint::Checkpoints;
use texir_core::cpu::CpuBackend;
use texir_core::diffuse::DiffuseModel;
use texir_core::image_io::{write_gray, write_png_labels, write_png_mask, write_rgb};
use texir_core::lights::Lights;
use texir_core::mesh::Mesh;
use texir_core::mesh_io::obj;
use texir_core::progress::Silent;
use texir_core::raster::{Gray, Labels, Mask, Raster, Rgb};
use texir_core::render::{Renderer, Textures};
use texir_core::scene::Scene;

/// Side of the atlas, texels.
pub const ATLAS: usize = 64;
/// Columns of a panorama.
pub const WIDTH: usize = 32;
/// Rows of a panorama.
pub const HEIGHT: usize = 16;
/// The training views, then the novel one.
pub const VIEWS: [&str; 4] = ["a", "b", "c", "novel"];

/// Charts along each side of the atlas.
const CHARTS: usize = 4;
/// Radiance of the lamp.
const LAMP: [f32; 3] = [12.0, 11.0, 9.0];
/// Light bounces in the room.
const BOUNCES: usize = 5;

/// What a quad is made of.
#[derive(Clone, Copy)]
struct Paint {
    class: u16,
    albedo: [f32; 3],
    roughness: f32,
    emission: [f32; 3],
}

/// Walls and ceiling.
fn shell(albedo: [f32; 3]) -> Paint {
    Paint { class: 1, albedo, roughness: 0.6, emission: [0.0; 3] }
}

/// Floor and box.
fn glossy(albedo: [f32; 3]) -> Paint {
    Paint { class: 2, albedo, roughness: 0.25, emission: [0.0; 3] }
}

/// A panorama with all that is known of it.
struct Picture {
    camera: Camera,
    image: Rgb,
    semantic: Labels,
    mask: Mask,
    albedo: Rgb,
    roughness: Gray,
}

/// Everything a capture holds.
struct Room {
    mesh: Mesh,
    albedo: Rgb,
    roughness: Gray,
    pictures: Vec<Picture>,
}

/// A capture folder of its own for each test.
pub struct Capture {
    folder: TempDir,
}

impl Capture {
    /// Writes the room to a new folder.
    pub fn new() -> Self {
        static ROOM: OnceLock<Room> = OnceLock::new();
        let capture = Self { folder: tempfile::tempdir().unwrap() };
        ROOM.get_or_init(Room::new).write(&capture.path());
        capture
    }

    /// The capture; what runs write goes beside it.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("capture")
    }

    /// A file of the capture.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    /// A place for output, beside the capture.
    pub fn out(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Names of what lies beside the capture.
    pub fn outputs(&self) -> Vec<String> {
        names(self.folder.path()).into_iter().filter(|name| name != "capture").collect()
    }

    /// Changes `transforms.json`.
    pub fn edit(&self, change: impl FnOnce(&mut serde_json::Value)) {
        let path = self.file("transforms.json");
        let mut document = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        change(&mut document);
        std::fs::write(path, document.to_string()).unwrap();
    }

    /// Changes `mesh.obj`, line by line.
    pub fn edit_mesh(&self, change: impl FnMut(&str) -> String) {
        let path = self.file("mesh.obj");
        let lines: Vec<String> = std::fs::read_to_string(&path).unwrap().lines().map(change).collect();
        std::fs::write(path, lines.join("\n") + "\n").unwrap();
    }
}

/// Names in a folder, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

impl Room {
    fn new() -> Self {
        let (mesh, paints) = build();
        let mut backend = CpuBackend::new(Scene::new(mesh.clone()).unwrap());
        let textures = light(&mut backend, &paints);
        let pictures = cameras().map(|camera| shoot(&mut backend, &paints, &textures, camera)).into();
        let Textures { albedo, roughness, .. } = textures;
        Self { mesh, albedo, roughness, pictures }
    }

    fn write(&self, folder: &Path) {
        let view = |(picture, name): (&Picture, &&str)| {
            let file = |kind: &str, extension: &str| folder.join(kind).join(format!("{name}.{extension}"));
            write_rgb(file("hdr", "exr"), &picture.image).unwrap();
            write_png_labels(file("semantic", "png"), &picture.semantic).unwrap();
            write_png_mask(file("mask", "png"), &picture.mask).unwrap();
            write_rgb(file("albedo", "exr"), &picture.albedo).unwrap();
            write_gray(file("roughness", "exr"), &picture.roughness).unwrap();
            View {
                semantic: Some(file("semantic", "png")),
                mask: Some(file("mask", "png")),
                albedo: Some(file("albedo", "exr")),
                roughness: Some(file("roughness", "exr")),
                ..View::new(
                    (*name).to_owned(),
                    picture.camera,
                    if *name == "novel" { Split::Novel } else { Split::Train },
                    file("hdr", "exr"),
                )
            }
        };
        let views: Vec<View> = self.pictures.iter().zip(&VIEWS).map(view).collect();
        write_transforms(folder.join("transforms.json"), &views).unwrap();
        obj::write(folder.join("mesh.obj"), &self.mesh).unwrap();
        write_rgb(folder.join("albedo_tex.exr"), &self.albedo).unwrap();
        write_gray(folder.join("roughness_tex.exr"), &self.roughness).unwrap();
    }
}

/// The mesh, two triangles a quad, and each quad's paint.
fn build() -> (Mesh, Vec<Paint>) {
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    let white = shell([0.7, 0.7, 0.65]);
    let wood = glossy([0.4, 0.25, 0.15]);
    let blue = glossy([0.2, 0.3, 0.5]);
    let lamp = Paint { class: 0, albedo: [0.5; 3], roughness: 0.6, emission: LAMP };
    // A corner and two edges, whose cross product points to the visible side.
    let quads = [
        (Vec3::ZERO, 3.0 * x, 3.0 * y, wood),
        (Vec3::new(0.0, 3.0, 2.5), 3.0 * x, -3.0 * y, white),
        (Vec3::ZERO, 3.0 * y, 2.5 * z, shell([0.6, 0.2, 0.2])),
        (Vec3::new(3.0, 3.0, 0.0), -3.0 * y, 2.5 * z, shell([0.2, 0.5, 0.2])),
        (Vec3::new(3.0, 0.0, 0.0), -3.0 * x, 2.5 * z, white),
        (Vec3::new(0.0, 3.0, 0.0), 3.0 * x, 2.5 * z, white),
        (Vec3::new(2.0, 2.0, 0.7), 0.7 * x, 0.7 * y, blue),
        (Vec3::new(2.0, 2.0, 0.0), 0.7 * x, 0.7 * z, blue),
        (Vec3::new(2.7, 2.0, 0.0), 0.7 * y, 0.7 * z, blue),
        (Vec3::new(2.7, 2.7, 0.0), -0.7 * x, 0.7 * z, blue),
        (Vec3::new(2.0, 2.7, 0.0), -0.7 * y, 0.7 * z, blue),
        (Vec3::new(1.0, 2.0, 2.45), x, -y, lamp),
    ];
    let mut mesh = Mesh::default();
    for (chart, (corner, u, v, _)) in quads.iter().enumerate() {
        let base = mesh.positions.len() as u32;
        let origin = Vec2::new((chart % CHARTS) as f32, (chart / CHARTS) as f32);
        for (s, t) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(corner + s * u + t * v);
            mesh.normals.push(u.cross(*v).normalize());
            mesh.uvs.push((origin + 0.15 + 0.7 * Vec2::new(s, t)) / CHARTS as f32);
        }
        mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }
    (mesh, quads.map(|(_, _, _, paint)| paint).to_vec())
}

/// Four places at eye height, each looking another way.
fn cameras() -> [Camera; VIEWS.len()] {
    [(0.8, 0.8), (2.2, 0.7), (0.9, 2.1), (1.5, 1.4)].map(|(x, y)| Camera {
        projection: Projection::Equirectangular,
        width: WIDTH,
        height: HEIGHT,
        world_from_camera: Mat4::from_translation(Vec3::new(x, y, 1.5))
            * Mat4::from_rotation_z(x + y)
            * Mat4::from_rotation_x(FRAC_PI_2),
    })
}

/// True textures with the light of all bounces.
fn light(backend: &mut CpuBackend, paints: &[Paint]) -> Textures {
    let atlas = Atlas::new(backend, [ATLAS, ATLAS]).unwrap();
    let side = ATLAS / CHARTS;
    let of_chart = |i: usize| paints.get(i / ATLAS / side * CHARTS + i % ATLAS / side);
    let texels = Raster::new(ATLAS, ATLAS, (0..ATLAS * ATLAS).map(of_chart).collect()).unwrap();
    let albedo = texels.map(|paint| paint.map_or([0.0; 3], |p| p.albedo));
    let roughness = texels.map(|paint| paint.map_or(1.0, |p| p.roughness));
    let emission = texels.map(|paint| paint.map_or([0.0; 3], |p| p.emission));
    let lights = Lights::find(backend.scene(), &atlas, &emission).unwrap();
    let mut irradiance = Rgb::filled(ATLAS, ATLAS, [0.0; 3]);
    for bounce in 0..BOUNCES {
        let radiance = outgoing(&albedo, &irradiance, &emission);
        backend.set_tbl(&radiance, &lights).unwrap();
        let gather = Gather::new(32, 32, bounce as u32);
        irradiance = bake::irradiance(backend, &atlas, gather, &Checkpoints::none(), &Silent)
            .unwrap()
            .map(&atlas, Buried::Fill)
            .unwrap();
    }
    Textures {
        albedo,
        roughness,
        metallic: None,
        irradiance,
        emission,
        diffuse: DiffuseModel::Lambert,
        masking: Masking::Smith,
    }
}

/// Emission + a/π · E.
fn outgoing(albedo: &Rgb, irradiance: &Rgb, emission: &Rgb) -> Rgb {
    let of_texel =
        |i: usize| std::array::from_fn(|c| emission.data[i][c] + albedo.data[i][c] * FRAC_1_PI * irradiance.data[i][c]);
    Rgb::new(ATLAS, ATLAS, (0..ATLAS * ATLAS).map(of_texel).collect()).unwrap()
}

fn shoot(backend: &mut CpuBackend, paints: &[Paint], textures: &Textures, camera: Camera) -> Picture {
    let hits = backend.primary(&camera, camera.rows()).unwrap();
    let seen: Vec<Paint> = hits.iter().map(|hit| paints[hit.triangle as usize / 2]).collect();
    let seen = Raster::new(WIDTH, HEIGHT, seen).unwrap();
    let radiance = outgoing(&textures.albedo, &textures.irradiance, &textures.emission);
    let mut renderer = Renderer::new(backend, &radiance, 256, 1).unwrap();
    let shown = renderer.mipmapped(textures).unwrap();
    Picture {
        camera,
        image: renderer.render(&camera, &shown, &Silent).unwrap(),
        semantic: seen.map(|paint| paint.class),
        mask: seen.map(|paint| paint.class != 0),
        albedo: seen.map(|paint| paint.albedo),
        roughness: seen.map(|paint| paint.roughness),
    }
}
