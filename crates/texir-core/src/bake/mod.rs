//! Irradiance bake: every texel gathers the texture-based lighting through the scene (the paper's IrT).

mod estimate;

use std::hash::{DefaultHasher, Hash, Hasher};

use bytemuck::cast_slice;

use crate::atlas::Atlas;
use crate::backend::{Backend, Gather, Gathered};
use crate::checkpoint::Checkpoints;
use crate::denoise::denoise;
use crate::error::Result;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::raster::Rgb;
use crate::surface::SurfacePoint;
use estimate::Estimate;

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
    /// Standard error of the luminance of E before denoising, in the unit of E: estimated from a texel's neighbours. Where
    /// [`Quality::error`] asked for it.
    pub standard_error: Option<Vec<f32>>,
    /// Rays traced.
    pub rays: u64,
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

/// How a map is baked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Rays of a texel, at most.
    pub gather: Gather,
    /// A texel takes no more rays once its [`Baked::standard_error`] is below this share of its irradiance; 0 takes all.
    pub error: Option<f32>,
    /// Removes most of the noise: see [`denoise`].
    pub denoise: bool,
}

impl Hash for Quality {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.gather, self.error.map(f32::to_bits), self.denoise).hash(state);
    }
}

/// Bakes the irradiance of every valid texel from the TBL that the backend was given with [`Backend::set_tbl`].
/// With `checkpoints` of the same [`identity`], a bake that was interrupted goes on where it was, to the same bits.
pub fn bake(
    backend: &mut dyn Backend,
    mesh: &Mesh,
    atlas: &Atlas,
    quality: &Quality,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Baked> {
    if quality.error.is_none() && !quality.denoise {
        return irradiance(backend, atlas, quality.gather, checkpoints, progress);
    }
    let texel = atlas.typical_texel(mesh);
    let points = &atlas.points;
    let estimate = Estimate::sample(backend, points, texel, quality.gather, quality.error, checkpoints, progress)?;
    let [a, b] = &estimate.halves;
    let buried: Vec<bool> = a.iter().zip(b).map(|(a, b)| (a.back_faces + b.back_faces) / 2.0 >= BURIED).collect();
    let irradiance = if quality.denoise {
        let halves = [a, b].map(|half| half.iter().map(|g| g.irradiance).collect());
        denoise(points, &halves, &buried, texel)
    } else {
        (0..points.len()).map(|i| estimate.mean(i).to_array()).collect()
    };
    let standard_error = quality.error.map(|_| estimate.standard_errors(points, texel));
    Ok(Baked { irradiance, buried, standard_error, rays: estimate.rays() })
}

/// [`bake`] of a fixed number of rays, as they come: unbiased.
pub fn irradiance(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    gather: Gather,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Baked> {
    let rays = atlas.points.len() as u64 * rays_of(gather);
    progress.start("irradiance", rays, "rays");
    let gathered = in_tiles(backend, &atlas.points, gather, TILE_RAYS, checkpoints, progress)?;
    progress.finish();
    Ok(Baked {
        irradiance: gathered.iter().map(|g| g.irradiance).collect(),
        buried: gathered.iter().map(|g| g.back_faces >= BURIED).collect(),
        standard_error: None,
        rays,
    })
}

/// [`bake`] of a fixed number of rays, with most of the noise removed.
pub fn denoised(
    backend: &mut dyn Backend,
    mesh: &Mesh,
    atlas: &Atlas,
    gather: Gather,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Baked> {
    bake(backend, mesh, atlas, &Quality { gather, error: None, denoise: true }, checkpoints, progress)
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
    let rays = rays_of(gather) as usize;
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

/// Rays of one point.
fn rays_of(gather: Gather) -> u64 {
    u64::from(gather.cosine) + u64::from(gather.light)
}

#[cfg(test)]
mod tests;
