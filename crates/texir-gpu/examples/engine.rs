//! A host program that owns its wgpu device and bakes irradiance with texir on it.
//!
//! `cargo run --release -p texir-gpu --example engine`
//!
//! The program makes the instance, the device and the queue, as an engine would; texir gets handles to them, keeps its
//! own buffers, and reports progress. The scene is a room in code whose ceiling has a lamp.

use std::error::Error;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{Vec2, Vec3};
use texir_core::atlas::Atlas;
use texir_core::backend::{Backend, Gather};
use texir_core::bake::{self, Buried};
use texir_core::checkpoint::Checkpoints;
use texir_core::lights::Lights;
use texir_core::mesh::Mesh;
use texir_core::progress::Progress;
use texir_core::raster::Rgb;
use texir_core::scene::Scene;
use texir_gpu::{Gpu, GpuBackend, required_features, required_limits, wgpu};

/// Columns and rows of the atlas.
const SIZE: usize = 96;

fn main() -> Result<(), Box<dyn Error>> {
    // The engine's own device, with at least what texir needs.
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions {
        power_preference: wgpu::PowerPreference::HighPerformance,
        ..Default::default()
    }))?;
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        label: Some("engine"),
        required_features: required_features(),
        required_limits: required_limits(&adapter),
        ..Default::default()
    }))?;

    let gpu = Gpu::from_device(device.clone(), queue.clone())?;
    let mut backend = GpuBackend::new(&gpu, Scene::new(room())?)?;
    let atlas = Atlas::new(&mut backend, [SIZE, SIZE])?;
    let radiance = emitted(&atlas)?;
    backend.set_tbl(&radiance, &Lights::find(backend.scene(), &atlas, &radiance)?)?;

    let gather = Gather::new(64, 64, 1);
    let console = Console::default();
    let baked = bake::irradiance(&mut backend, &atlas, gather, &Checkpoints::none(), &console)?;
    let irradiance = baked.map(&atlas, Buried::Fill)?;

    println!("device: {}", backend.name());
    println!("{} texels baked, {} million rays", atlas.points.len(), console.rays.into_inner() / 1_000_000);
    for (wall, name) in ["left", "right", "front", "back", "floor", "ceiling"].into_iter().enumerate() {
        let on_wall: Vec<f32> = (atlas.texels.iter().zip(&atlas.points))
            .filter(|(_, point)| point.triangle as usize / 2 == wall)
            .map(|(&texel, _)| irradiance.data[texel as usize][1])
            .collect();
        println!("{name:>8}: mean irradiance {:.3}", on_wall.iter().sum::<f32>() / on_wall.len().max(1) as f32);
    }
    Ok(())
}

/// A 4 × 3 × 2.5 m room seen from inside; each wall has a third of the atlas's columns and half of its rows.
fn room() -> Mesh {
    let size = Vec3::new(4.0, 3.0, 2.5);
    let mut mesh = Mesh::default();
    for wall in 0..6usize {
        let (axis, far) = (wall / 2, wall % 2);
        let base = mesh.positions.len() as u32;
        for (s, t) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            let mut unit = Vec3::ZERO;
            unit[axis] = far as f32;
            unit[(axis + 1) % 3] = s;
            unit[(axis + 2) % 3] = t;
            mesh.positions.push(unit * size);
            mesh.normals.push(Vec3::AXES[axis] * (1.0 - 2.0 * far as f32));
            let chart = Vec2::new((wall % 3) as f32, (wall / 3) as f32);
            mesh.uvs.push((chart + 0.05 + 0.9 * Vec2::new(s, t)) / Vec2::new(3.0, 2.0));
        }
        // Counter-clockwise from inside.
        let (second, fourth) = if far == 0 { (1, 3) } else { (3, 1) };
        mesh.triangles.push([base, base + second, base + 2]);
        mesh.triangles.push([base, base + 2, base + fourth]);
    }
    mesh
}

/// What leaves the surfaces: a dim room, and a square lamp on the ceiling.
fn emitted(atlas: &Atlas) -> texir_core::error::Result<Rgb> {
    let leaves: Vec<[f32; 3]> = (atlas.points.iter())
        .map(|point| {
            let [x, y, z] = point.position;
            let lamp = z > 2.4 && (x - 2.0).abs() < 0.5 && (y - 1.5).abs() < 0.5;
            if lamp { [20.0, 18.0, 15.0] } else { [0.2; 3] }
        })
        .collect();
    atlas.scatter(&leaves, [0.0; 3])
}

/// Progress as an engine would take it: counted, never cancelled.
#[derive(Default)]
struct Console {
    rays: AtomicU64,
}

impl Progress for Console {
    fn start(&self, task: &str, total: u64, unit: &str) {
        println!("{task}: {total} {unit}");
    }
    fn advance(&self, done: u64) {
        self.rays.fetch_add(done, Ordering::Relaxed);
    }
    fn finish(&self) {}
    fn warn(&self, message: &str) {
        eprintln!("warning: {message}");
    }
    fn cancelled(&self) -> bool {
        false
    }
}
