//! Irradiance bake: every texel gathers the texture-based lighting through the scene (the paper's IrT).

use std::hash::{DefaultHasher, Hash, Hasher};

use bytemuck::cast_slice;

use crate::atlas::Atlas;
use crate::backend::{Backend, Gather, Gathered};
use crate::checkpoint::Checkpoints;
use crate::denoise::denoise;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::raster::Rgb;
use crate::rng::hash;
use crate::surface::SurfacePoint;

/// Rings of padding around the charts of a baked map.
pub const PADDING: usize = 4;

/// Rays of a tile, after which it is kept: some seconds' work on a processor.
const TILE_RAYS: usize = 1 << 23;

/// A texel lies inside an object when this share of its rays meets the backs of triangles.
const BURIED: f32 = 0.5;

/// Irradiance per valid texel of an atlas, with what is known about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Baked {
    /// E = ∫ L cosθ dω (full, not divided by π), linear RGB.
    pub irradiance: Vec<[f32; 3]>,
    /// Texels inside other geometry, as a floor under a cupboard.
    pub buried: Vec<bool>,
}

/// What a map holds at texels inside other geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Buried {
    /// What they gathered.
    Keep,
    /// Their nearest lit neighbour's value: theirs is not seen, but bleeds into what is seen beside it where a lookup
    /// interpolates.
    Fill,
}

impl Baked {
    /// The atlas, padded by [`PADDING`] texels around the charts.
    pub fn map(&self, atlas: &Atlas, buried: Buried) -> Rgb {
        let known: Vec<bool> = self.buried.iter().map(|inside| !inside || buried == Buried::Keep).collect();
        atlas.scatter_padded(&self.irradiance, &known, [0.0; 3], PADDING)
    }
}

/// Bakes the irradiance of every valid texel from the TBL that the backend was given with [`Backend::set_tbl`]; unbiased.
/// With `checkpoints` of the same [`identity`], a bake that was interrupted goes on where it was, to the same bits.
pub fn irradiance(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    gather: Gather,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Baked> {
    progress.start("irradiance", rays(atlas, gather), "rays");
    let gathered = in_tiles(backend, &atlas.points, gather, TILE_RAYS, checkpoints, progress)?;
    progress.finish();
    Ok(Baked {
        irradiance: gathered.iter().map(|g| g.irradiance).collect(),
        buried: gathered.iter().map(buried).collect(),
    })
}

/// Bakes as [`irradiance`] does, with the same number of rays, and removes most of the noise: see [`denoise`].
pub fn denoised(
    backend: &mut dyn Backend,
    mesh: &Mesh,
    atlas: &Atlas,
    gather: Gather,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Baked> {
    if gather.cosine < 2 {
        return Err(Error::invalid("denoising compares two halves of the rays: at least 2 must be cosine-distributed"));
    }
    progress.start("irradiance", rays(atlas, gather), "rays");
    let second = Gather { cosine: gather.cosine / 2, light: gather.light / 2, seed: hash(gather.seed) };
    let first = Gather { cosine: gather.cosine - second.cosine, light: gather.light - second.light, ..gather };
    let mut half =
        |name, gather| in_tiles(backend, &atlas.points, gather, TILE_RAYS, &checkpoints.within(name), progress);
    let [a, b] = [half("first", first)?, half("second", second)?];
    progress.finish();
    let buried: Vec<bool> = a.iter().map(buried).collect();
    let halves = [a, b].map(|half| half.iter().map(|g| g.irradiance).collect());
    let irradiance = denoise(&atlas.points, &halves, &buried, atlas.typical_texel(mesh));
    Ok(Baked { irradiance, buried })
}

/// What a bake depends on: as long as none of it changes, its [`Checkpoints`] hold.
pub fn identity(mesh: &Mesh, radiance: &Rgb, settings: impl Hash) -> String {
    let mut hasher = DefaultHasher::new();
    let vectors: [&[u8]; 2] = [cast_slice(&mesh.positions), cast_slice(&mesh.normals)];
    let (uvs, texels): (&[u8], &[u8]) = (cast_slice(&mesh.uvs), cast_slice(&radiance.data));
    (vectors, uvs, &mesh.triangles, radiance.size(), texels, settings).hash(&mut hasher);
    format!("texir {}\nbake {:016x}\n", env!("CARGO_PKG_VERSION"), hasher.finish())
}

/// Gathers at points, a tile of about `tile_rays` rays after another; how points are cut changes nothing, as a point's
/// samples depend on it alone.
fn in_tiles(
    backend: &mut dyn Backend,
    points: &[SurfacePoint],
    gather: Gather,
    tile_rays: usize,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Vec<Gathered>> {
    let rays = (gather.cosine + gather.light) as usize;
    let mut all = Vec::with_capacity(points.len());
    for (number, tile) in points.chunks((tile_rays / rays.max(1)).max(1)).enumerate() {
        let mut known = true;
        all.extend(checkpoints.array(&format!("tile-{number}"), || {
            known = false;
            backend.irradiance(tile, gather, progress)
        })?);
        if known {
            progress.advance((tile.len() * rays) as u64);
        }
    }
    Ok(all)
}

fn rays(atlas: &Atlas, gather: Gather) -> u64 {
    atlas.points.len() as u64 * u64::from(gather.cosine + gather.light)
}

fn buried(gathered: &Gathered) -> bool {
    gathered.back_faces >= BURIED
}

#[cfg(test)]
mod tests;
