//! What a bake has in memory, and whether what it has of every texel goes to files instead.

use std::path::Path;

use bytesize::ByteSize;

use super::store::{POINT, Workspace};
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::scene::Scene;

/// Bytes that a valid texel takes where all of them are in memory, as measured.
const TEXEL: u64 = 212;

/// Bytes that a valid texel takes in a bake with bounces, as measured: what [`TEXEL`] counts, light so far, and the
/// last bounce's.
const BOUNCING: u64 = 360;

/// Bytes per texel of the map in a bake with bounces: albedo, emission, what a bounce sends on and the backend's copy,
/// and what is padded meanwhile.
const SURFACES: u64 = 64;

/// Bytes per texel of the HDR texture: itself, the backend's, and its texels while the lights among them are found.
const RADIANCE: u64 = 64;

/// The program, and what it does a piece at a time.
const BASE: u64 = 48 << 20;

/// Points of a neighbourhood with which work is not mostly at its borders: with [`POINT`] bytes each, what
/// docs/baking.md calls room to work in.
const FEWEST: u64 = 1 << 18;

/// The workspace that keeps a bake within `limit`: memory if a map of `[width, height]` texels, all of them valid, fits
/// beside the mesh and an HDR texture of `radiance` texels; else files in `folder`. Errors when even those leave too
/// little.
pub fn workspace_within(
    limit: ByteSize,
    folder: &Path,
    mesh: &Mesh,
    radiance: usize,
    [width, height]: [usize; 2],
) -> Result<Workspace> {
    let beside = BASE + Scene::memory(mesh) + radiance as u64 * RADIANCE;
    if beside + (width * height) as u64 * TEXEL <= limit.0 {
        return Ok(Workspace::Memory);
    }
    let least = ByteSize(beside + FEWEST * POINT);
    if least > limit {
        return Err(Error::invalid(format!(
            "the limit of memory is {limit}, but a bake of any size with {} triangles and an HDR texture of {radiance} texels needs about \
             {least}: raise it",
            mesh.triangles.len()
        )));
    }
    Ok(Workspace::Disk { folder: folder.to_owned(), memory: ByteSize(limit.0 - beside) })
}

/// [`workspace_within`] for a bake with bounces, which has what surfaces emit, reflect and send on in memory: what it
/// has of every texel besides goes to files where it does not fit. `materials` are the bytes of the scene as it was
/// read, and of an environment.
pub fn bounce_workspace_within(
    limit: ByteSize,
    folder: &Path,
    mesh: &Mesh,
    materials: u64,
    [width, height]: [usize; 2],
) -> Result<Workspace> {
    let (beside, texels) = (BASE + Scene::memory(mesh) + materials, (width * height) as u64);
    let whole = beside + texels * (SURFACES + BOUNCING);
    if whole <= limit.0 {
        return Ok(Workspace::Memory);
    }
    let work = FEWEST * POINT;
    // Small maps take less than files do.
    let least = ByteSize(whole.min(beside + texels * SURFACES + work));
    if least <= limit {
        let memory = ByteSize(limit.0 - beside - texels * SURFACES);
        return Ok(Workspace::Disk { folder: folder.to_owned(), memory });
    }
    // Maps of the same charts need memory by their area.
    let share = limit.0.saturating_sub(beside + work) as f64 / (texels * SURFACES) as f64;
    let widest = (width as f64 * share.sqrt()) as usize / 64 * 64;
    let advice = if widest > 0 { format!("raise it, or bake a map {widest} texels wide") } else { "raise it".into() };
    Err(Error::invalid(format!(
        "the limit of memory is {limit}, but all the light of a scene with {} triangles, read in {}, on a map of {width}×{height} texels \
         needs about {least}: {advice}",
        mesh.triangles.len(),
        ByteSize(materials)
    )))
}

/// What is wrong where so many texels lie so close together that they have to be in memory at once, in which `most`
/// fit.
pub(super) fn too_dense(texels: usize, most: usize) -> Error {
    let bytes = |texels: usize| ByteSize(texels as u64 * POINT);
    let more = bytes(texels.saturating_sub(most));
    Error::invalid(format!(
        "{texels} texels lie too close together to be gone through in {}: allow {more} more memory, or bake a smaller map, or one \
         without denoising and standard errors",
        bytes(most)
    ))
}
