//! texir without a GPU dependency: captures, the BRDF and its adjoints, the fit, and the CPU twin of every kernel.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod atlas;
pub mod atomic_file;
pub mod authored;
pub mod backend;
pub mod bake;
pub mod brdf;
pub mod camera;
pub mod capture;
pub mod checkpoint;
mod cholesky;
pub mod cpu;
pub mod decimate;
pub mod demo;
pub mod denoise;
pub mod diffuse;
pub mod environment;
pub mod error;
pub mod eval;
pub mod fit;
#[cfg(test)]
mod fuzz;
pub mod glb;
pub mod hdr;
mod hierarchy;
pub mod image_io;
mod inpaint;
pub mod lightmap;
pub mod lights;
pub mod mesh;
pub mod mesh_io;
pub mod metrics;
pub mod neighbours;
pub mod outputs;
pub mod progress;
pub mod punctual;
pub mod raster;
pub mod real;
pub mod render;
pub mod rng;
pub mod rooms;
pub mod scene;
pub mod specular_table;
pub mod surface;
pub mod tbl;
pub mod texture;
pub mod unwrap;
