//! texir without a GPU dependency: captures, the BRDF and its adjoints, the fit, and the CPU twin of every kernel.
//!
//! Without the feature `files`, on by default, there are the passes, the CPU's backend and the bake alone, for programs that have
//! scenes of their own: no reader of any format is linked then.
#![cfg_attr(test, allow(clippy::unwrap_used))]
// What modules that are left out have alone use of.
#![cfg_attr(not(feature = "files"), allow(dead_code))]

pub mod atlas;
pub mod atomic_file;
#[cfg(feature = "files")]
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
mod hierarchy;
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
pub mod raster;
pub mod real;
#[cfg(feature = "files")]
pub mod render;
pub mod rng;
#[cfg(feature = "files")]
pub mod rooms;
pub mod scene;
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

/// The version whose types this crate's API has.
pub use glam;
