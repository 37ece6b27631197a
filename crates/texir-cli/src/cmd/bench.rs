//! `texir bench`: how fast this machine gathers, so that machines can be compared.

use std::collections::BinaryHeap;
use std::sync::Arc;
use std::time::Instant;

use clap::Args;
use serde::Serialize;
use texir_core::atlas::Atlas;
use texir_core::backend::{Backend, Gather};
use texir_core::demo::{Flat, FlatOptions};
use texir_core::lights::Lights;
use texir_core::mesh::Mesh;
use texir_core::progress::{Silent, Task};
use texir_core::rng::{hash, hash2, sobol2};
use texir_core::scene::Scene;
use texir_core::surface::{Hit, SurfacePoint};

use crate::device;
use crate::failure::Failure;
use crate::session::Session;

/// Triangles of the meshes, at least: the flat that they are cut from has 19 thousand.
const MESHES: [usize; 3] = [10_000, 100_000, 1_000_000];
/// Triangles of the mesh that `--large` adds.
const LARGE: usize = 10_000_000;
/// Cosine-distributed rays per point: as a bake of moderate quality.
const RAYS: u32 = 64;
/// Points of the first measurement; doubled until one takes [`LONG_ENOUGH`].
const POINTS: usize = 4096;
/// Most points of a measurement.
const MOST_POINTS: usize = 1 << 22;
/// Seconds after which a measurement is believed.
const LONG_ENOUGH: f64 = 1.0;
/// Sides of the atlases.
const ATLASES: [usize; 4] = [256, 512, 1024, 2048];
/// Side of the atlas that `--large` adds.
const LARGE_ATLAS: usize = 4096;
/// Rays per texel of the atlases.
const ATLAS_RAYS: u32 = 4;

/// Arguments of `texir bench`.
#[derive(Debug, Args)]
pub struct Bench {
    /// Measure with 10 million triangles and an atlas of 4096² as well: some minutes and some GB more
    #[arg(long)]
    large: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary {
    meshes: Vec<MeshRow>,
    atlases: Vec<AtlasRow>,
}

/// A built-in flat of a number of triangles.
#[derive(Serialize)]
struct MeshRow {
    triangles: usize,
    /// Seconds to build the hierarchy.
    build_seconds: f64,
    /// Memory of the hierarchy, without the triangles.
    bytes_per_triangle: f64,
    backends: Vec<BackendRow>,
}

#[derive(Serialize)]
struct BackendRow {
    /// Adapter or processor.
    name: String,
    /// Incoherent rays: hit, texture coordinates and texel included.
    rays_per_second: f64,
}

/// A bake of the smallest mesh's light into an atlas, by the first backend.
#[derive(Serialize)]
struct AtlasRow {
    side: usize,
    texels: usize,
    /// Seconds to find every texel's point.
    map_seconds: f64,
    /// Seconds to gather.
    gather_seconds: f64,
    /// Most memory that the process has used so far, where the system tells.
    peak_bytes: Option<u64>,
}

impl Bench {
    /// Measures and prints.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let flat =
            Flat::generate(&FlatOptions { seed: u64::from(session.config.fit.seed) + 1, ..FlatOptions::default() })?;
        let (mut meshes, mut atlases) = (Vec::new(), Vec::new());
        for triangles in MESHES.into_iter().chain(self.large.then_some(LARGE)) {
            session.console.note(&format!("{triangles} triangles"));
            let mut mesh = flat.mesh.clone();
            tessellate(&mut mesh, triangles);
            let start = Instant::now();
            let scene = Arc::new(Scene::new(mesh)?);
            let build_seconds = start.elapsed().as_secs_f64();
            let hierarchy = scene.nodes().len() + size_of_val(scene.primitives());
            let mut backends = device::open_all(&scene, session)?;
            for backend in &mut backends {
                backend.set_tbl(&flat.albedo, &Lights::none(scene.mesh()))?;
            }
            if let (true, Some(first)) = (meshes.is_empty(), backends.first_mut()) {
                let sides = ATLASES.into_iter().chain(self.large.then_some(LARGE_ATLAS));
                let rows = sides.map(|side| bake(first.as_mut(), side, session));
                atlases = rows.collect::<Result<_, _>>()?;
            }
            let rows = backends.iter_mut().map(|backend| {
                Ok(BackendRow { name: backend.name(), rays_per_second: rays_per_second(backend.as_mut())? })
            });
            meshes.push(MeshRow {
                triangles: scene.mesh().triangles.len(),
                build_seconds,
                bytes_per_triangle: hierarchy as f64 / scene.mesh().triangles.len() as f64,
                backends: rows.collect::<Result<_, Failure>>()?,
            });
        }
        let summary = Summary { meshes, atlases };
        session.print(&summary, || text(&summary))
    }
}

/// Splits the longest edges, again and again, until there are so many triangles: all of about one size, on the same
/// surface.
fn tessellate(mesh: &mut Mesh, triangles: usize) {
    let longest = |mesh: &Mesh, t: u32| {
        let corners = mesh.corners(t);
        let length = |k: usize| corners[k].distance_squared(corners[(k + 1) % 3]);
        let edge = (0..3).max_by(|&a, &b| length(a).total_cmp(&length(b))).unwrap_or(0);
        // Lengths are positive, so that their bits are in their order.
        (length(edge).to_bits(), t, edge)
    };
    let mut queue: BinaryHeap<_> = (0..mesh.triangles.len() as u32).map(|t| longest(mesh, t)).collect();
    while mesh.triangles.len() < triangles {
        let Some((_, t, edge)) = queue.pop() else { return };
        let [a, b, c] = [0, 1, 2].map(|k| mesh.triangles[t as usize][(edge + k) % 3]);
        let middle = mesh.positions.len() as u32;
        let between = [a as usize, b as usize];
        mesh.positions.push(mesh.positions[between[0]].midpoint(mesh.positions[between[1]]));
        mesh.normals.push((mesh.normals[between[0]] + mesh.normals[between[1]]).normalize_or_zero());
        mesh.uvs.push(mesh.uvs[between[0]].midpoint(mesh.uvs[between[1]]));
        let added = mesh.triangles.len() as u32;
        mesh.triangles[t as usize] = [a, middle, c];
        mesh.triangles.push([middle, b, c]);
        queue.extend([longest(mesh, t), longest(mesh, added)]);
    }
}

/// Gathers at points all over the mesh, more and more of them until it takes long enough to be measured.
fn rays_per_second(backend: &mut dyn Backend) -> Result<f64, Failure> {
    let scene = backend.scene().clone();
    let mesh = scene.mesh();
    let point = |i: u32| {
        let triangle = hash(i) % mesh.triangles.len() as u32;
        let [u, v] = sobol2(i, 1).map(|x| x / 2.0);
        SurfacePoint { index: i, ..SurfacePoint::new(mesh, &Hit { triangle, u, v, t: 0.0 }, None) }
    };
    let mut count = POINTS;
    loop {
        let points: Vec<SurfacePoint> = (0..count as u32).map(point).collect();
        // The first call compiles the kernel and finds out how much a dispatch may hold.
        backend.irradiance(&points[..POINTS], Gather::new(RAYS, 0, 0), &Silent)?;
        let start = Instant::now();
        backend.irradiance(&points, Gather::new(RAYS, 0, hash2(1, count as u32)), &Silent)?;
        let seconds = start.elapsed().as_secs_f64();
        if seconds >= LONG_ENOUGH || count >= MOST_POINTS {
            return Ok((count as u64 * u64::from(RAYS)) as f64 / seconds);
        }
        count *= 2;
    }
}

/// Maps and gathers an atlas.
fn bake(backend: &mut dyn Backend, side: usize, session: &Session<'_>) -> Result<AtlasRow, Failure> {
    let start = Instant::now();
    let atlas = Atlas::new(backend, [side, side])?;
    let map_seconds = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let task =
        Task::start(session.console, &format!("{side}²"), atlas.points.len() as u64 * u64::from(ATLAS_RAYS), "rays");
    backend.irradiance(&atlas.points, Gather::new(ATLAS_RAYS, 0, 0), session.console)?;
    drop(task);
    let gather_seconds = start.elapsed().as_secs_f64();
    Ok(AtlasRow { side, texels: atlas.texels.len(), map_seconds, gather_seconds, peak_bytes: peak_bytes() })
}

/// Most memory that this process has used; known on Linux.
fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(1024 * line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?)
}

fn text(summary: &Summary) -> String {
    let mut lines = vec![format!("{:>10}  {:>8}  {:>10}  {:>10}  on", "triangles", "build", "bytes each", "M rays/s")];
    for mesh in &summary.meshes {
        for backend in &mesh.backends {
            lines.push(format!(
                "{:>10}  {:>6.1} s  {:>10.1}  {:>10.2}  {}",
                mesh.triangles,
                mesh.build_seconds,
                mesh.bytes_per_triangle,
                backend.rays_per_second / 1e6,
                backend.name
            ));
        }
    }
    lines.push(String::new());
    lines.push(format!("{:>10}  {:>9}  {:>8}  {:>8}  {:>10}", "atlas", "texels", "map", "gather", "peak"));
    for atlas in &summary.atlases {
        let peak = atlas.peak_bytes.map_or("-".to_owned(), |bytes| format!("{} MiB", bytes >> 20));
        lines.push(format!(
            "{:>10}  {:>9}  {:>6.2} s  {:>6.2} s  {:>10}",
            format!("{0}²", atlas.side),
            atlas.texels,
            atlas.map_seconds,
            atlas.gather_seconds,
            peak
        ));
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tessellating_keeps_the_surface() {
        let flat = Flat::generate(&FlatOptions { atlas: 256, ..FlatOptions::default() }).unwrap();
        let area = |mesh: &Mesh| (0..mesh.triangles.len() as u32).map(|t| f64::from(mesh.area(t))).sum::<f64>();
        let mut mesh = flat.mesh.clone();
        tessellate(&mut mesh, 2 * flat.mesh.triangles.len() + 1);
        assert_eq!(mesh.triangles.len(), 2 * flat.mesh.triangles.len() + 1);
        assert!((area(&mesh) / area(&flat.mesh) - 1.0).abs() < 1e-5);
        let largest = |mesh: &Mesh| (0..mesh.triangles.len() as u32).map(|t| mesh.area(t)).fold(0.0, f32::max);
        assert!(largest(&mesh) < largest(&flat.mesh));
        assert_eq!(mesh.bounds(), flat.mesh.bounds());
    }
}
