//! Bakes a scene that a program holds itself: a lamp over a floor, every bounce of its light.
//!
//! `cargo run --release -p texir-core --example lightmap` writes `lightmap.exr`.

use glam::{Vec2, Vec3};
use texir_core::authored::{Bounces, Surfaces, irradiance};
use texir_core::backend::Gather;
use texir_core::bake::{Buried, Denoiser, Quality, Texels, Workspace};
use texir_core::checkpoint::Checkpoints;
use texir_core::cpu::CpuBackend;
use texir_core::environment::Environment;
use texir_core::image_io::write_rgb;
use texir_core::mesh::Mesh;
use texir_core::progress::Silent;
use texir_core::punctual::PunctualLight;
use texir_core::raster::Rgb;
use texir_core::scene::Scene;

const SIZE: usize = 128;

fn main() -> texir_core::error::Result<()> {
    // A floor in the left half of the lightmap, a lamp that faces down in the right half.
    let mut mesh = Mesh::default();
    add_square(&mut mesh, 0.0, 2.0, Vec3::Y, 0.02);
    add_square(&mut mesh, 1.5, 0.5, Vec3::NEG_Y, 0.52);
    let mut backend = CpuBackend::new(Scene::new(mesh)?);
    let texels = Texels::map(&mut backend, [SIZE; 2], Workspace::Memory, &Silent)?;

    let is_lamp = |i: usize| i % SIZE >= SIZE / 2;
    let by_texel = |floor: [f32; 3], lamp: [f32; 3]| {
        Rgb::new(SIZE, SIZE, (0..SIZE * SIZE).map(|i| if is_lamp(i) { lamp } else { floor }).collect())
    };
    let surfaces = Surfaces {
        albedo: by_texel([0.6, 0.5, 0.4], [0.8; 3])?,
        emission: by_texel([0.0; 3], [1000.0, 900.0, 700.0])?,
        lights: vec![PunctualLight::Point { position: [0.8, 0.5, 0.0], intensity: [20.0; 3], range: None }],
        environment: Some(Environment::constant([5.0, 7.0, 10.0])?),
    };
    let gather = Gather::new(128, 128, 0);
    let bounces = Bounces {
        quality: Quality { gather, error: None, denoise: Some(Denoiser::Regression) },
        tolerance: 0.005,
        max_bounces: 64,
    };
    let solved = irradiance(&mut backend, &texels, &surfaces, &bounces, &Checkpoints::none(), &Silent)?;
    println!("mean irradiance by bounce, lux: {:.1?}", solved.series);
    write_rgb("lightmap.exr", &solved.solution.map(&texels, Buried::Fill)?)
}

/// A square of half-width `half` at `height`, facing `normal`, at column `u` of the lightmap.
fn add_square(mesh: &mut Mesh, height: f32, half: f32, normal: Vec3, u: f32) {
    let base = mesh.positions.len() as u32;
    for (x, z) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)] {
        mesh.positions.push(Vec3::new(half * x, height, half * z));
        mesh.normals.push(normal);
        mesh.uvs.push(Vec2::new(u + 0.23 * (x + 1.0), 0.02 + 0.23 * (z + 1.0)));
    }
    let order = if normal.y > 0.0 { [[0, 1, 2], [0, 2, 3]] } else { [[0, 2, 1], [0, 3, 2]] };
    mesh.triangles.extend(order.map(|t| t.map(|i| base + i)));
}
