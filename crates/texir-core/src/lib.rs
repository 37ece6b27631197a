//! texir without a GPU dependency: captures, the BRDF and its adjoints, the fit, and the CPU twin of every kernel.
//!
//! Without the feature `files`, on by default, there are the passes, the CPU's backend and the bake alone, for programs
//! that have scenes of their own: no reader of any format is linked then.
//!
//! A bake in four steps: a [`scene::Scene`] of a [`mesh::Mesh`]; a [`backend::Backend`] that traces it
//! ([`cpu::CpuBackend`], or `texir_gpu`'s on a device of wgpu); the light, a texture of radiance in the mesh's atlas
//! and the [`lights::Lights`] in it; and [`bake`], for the texels of an [`atlas::Atlas`]. Radiance and irradiance are
//! linear; irradiance includes the cosine and is not divided by π.
//!
//! ```
//! use glam::{Vec2, Vec3};
//! use texir_core::atlas::Atlas;
//! use texir_core::backend::{Backend, Gather};
//! use texir_core::bake::{self, Buried};
//! use texir_core::checkpoint::Checkpoints;
//! use texir_core::cpu::CpuBackend;
//! use texir_core::lights::Lights;
//! use texir_core::mesh::Mesh;
//! use texir_core::progress::Silent;
//! use texir_core::raster::Rgb;
//! use texir_core::scene::Scene;
//!
//! # fn main() -> texir_core::error::Result<()> {
//! // A floor in the left half of the atlas, and a metre above it, facing down, a panel in the right half.
//! let mut mesh = Mesh::default();
//! for (height, normal, left) in [(0.0, Vec3::Z, 0.02), (1.0, Vec3::NEG_Z, 0.52)] {
//!     let base = mesh.positions.len() as u32;
//!     for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
//!         mesh.positions.push(Vec3::new(x, y, height));
//!         mesh.normals.push(normal);
//!         mesh.uvs.push(Vec2::new(left + 0.46 * x, 0.02 + 0.96 * y));
//!     }
//!     let (second, fourth) = if normal.z > 0.0 { (1, 3) } else { (3, 1) };
//!     mesh.triangles.extend([[base, base + second, base + 2], [base, base + 2, base + fourth]]);
//! }
//! let mut backend = CpuBackend::new(Scene::new(mesh)?);
//!
//! // The panel sends a radiance of 2, the floor nothing.
//! let (width, height) = (64, 32);
//! let sent = |texel: usize| if texel % width < width / 2 { [0.0; 3] } else { [2.0; 3] };
//! let radiance = Rgb::new(width, height, (0..width * height).map(sent).collect())?;
//! let atlas = Atlas::new(&mut backend, [width, height])?;
//! let lights = Lights::find(backend.scene(), &atlas, &radiance)?;
//! backend.set_tbl(&radiance, &lights)?;
//!
//! let gather = Gather::new(32, 32, 0); // cosine-distributed rays of a texel, rays to lights, seed
//! let baked = bake::denoised(&mut backend, &atlas, gather, &Checkpoints::none(), &Silent)?;
//! let irradiance = baked.map(&atlas, Buried::Fill)?;
//!
//! // In the middle of the floor, the panel fills 0.2394 of what a texel sees: E = π · 2 · 0.2394.
//! let middle = irradiance.data[16 * width + 16][0];
//! assert!((middle - 1.504).abs() < 0.05, "{middle}");
//! # Ok(())
//! # }
//! ```
//!
//! | | |
//! |---|---|
//! | [`mesh`], [`scene`], [`atlas`], [`surface`], [`raster`], [`texture`], [`camera`] | geometry and images |
//! | [`backend`], [`cpu`], [`progress`], [`checkpoint`], [`error`] | the passes, and what long work needs |
//! | [`lights`], [`environment`], [`punctual`], [`bake`], [`authored`], [`denoise`] | light |
//! | [`brdf`], [`diffuse`], [`specular_table`] | how surfaces scatter it |
//! | `capture`, `tbl`, `fit`, `eval`, `render`, `outputs`, `lightmap`, `hdr`, `image_io`, `mesh_io`, … (`files`) | from photos to materials |
//! | [`real`], [`rng`], [`neighbours`] | what the others are made of |
#![cfg_attr(test, allow(clippy::unwrap_used))]
// Items that only modules behind `files` use.
#![cfg_attr(not(feature = "files"), allow(dead_code))]

pub mod atlas;
pub mod atomic_file;
pub mod authored;
pub mod backend;
pub mod bake;
pub mod brdf;
pub mod camera;
#[cfg(feature = "files")]
pub mod capture;
pub mod checkpoint;
mod cholesky;
pub mod cpu;
#[cfg(feature = "files")]
pub mod decimate;
#[cfg(feature = "files")]
pub mod demo;
pub mod denoise;
pub mod diffuse;
#[cfg(feature = "files")]
mod disjoint_sets;
mod distribution;
pub mod environment;
pub mod error;
#[cfg(feature = "files")]
pub mod eval;
#[cfg(feature = "files")]
pub mod fit;
#[cfg(all(test, feature = "files"))]
mod fuzz;
#[cfg(feature = "files")]
pub mod glb;
#[cfg(feature = "files")]
pub mod hdr;
#[cfg(feature = "files")]
pub mod image_io;
#[cfg(feature = "files")]
mod inpaint;
#[cfg(feature = "files")]
pub mod lightmap;
pub mod lights;
pub mod mesh;
#[cfg(feature = "files")]
pub mod mesh_io;
#[cfg(feature = "files")]
pub mod metrics;
pub mod neighbours;
#[cfg(feature = "files")]
pub mod outputs;
pub mod progress;
pub mod punctual;
#[cfg(feature = "files")]
mod radiance_scale;
pub mod raster;
pub mod ray_origin;
pub mod real;
#[cfg(feature = "files")]
pub mod render;
pub mod rng;
#[cfg(feature = "files")]
pub mod rooms;
pub mod scene;
pub mod specular_albedo;
pub mod specular_table;
mod stats;
pub mod surface;
#[cfg(feature = "files")]
pub mod tbl;
#[cfg(feature = "files")]
pub mod text_file;
pub mod texture;
#[cfg(feature = "files")]
pub mod unwrap;

/// The versions whose types this crate's API has.
pub use {bytesize, glam, half};
