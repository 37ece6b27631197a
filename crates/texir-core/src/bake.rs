//! Irradiance bake: every texel gathers the texture-based lighting through the scene (the paper's IrT).

use crate::atlas::Atlas;
use crate::backend::{Backend, Gather, Gathered};
use crate::denoise::denoise;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::raster::Rgb;
use crate::rng::hash;

/// Rings of padding around the charts of a baked map.
pub const PADDING: usize = 4;

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
pub fn irradiance(backend: &mut dyn Backend, atlas: &Atlas, gather: Gather, progress: &dyn Progress) -> Result<Baked> {
    progress.start("irradiance", rays(atlas, gather), "rays");
    let gathered = backend.irradiance(&atlas.points, gather, progress)?;
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
    progress: &dyn Progress,
) -> Result<Baked> {
    if gather.cosine < 2 {
        return Err(Error::invalid("denoising compares two halves of the rays: at least 2 must be cosine-distributed"));
    }
    progress.start("irradiance", rays(atlas, gather), "rays");
    let second = Gather { cosine: gather.cosine / 2, light: gather.light / 2, seed: hash(gather.seed) };
    let first = Gather { cosine: gather.cosine - second.cosine, light: gather.light - second.light, ..gather };
    let [a, b] =
        [backend.irradiance(&atlas.points, first, progress)?, backend.irradiance(&atlas.points, second, progress)?];
    progress.finish();
    let buried: Vec<bool> = a.iter().map(buried).collect();
    let halves = [a, b].map(|half| half.iter().map(|g| g.irradiance).collect());
    let irradiance = denoise(&atlas.points, &halves, &buried, atlas.typical_texel(mesh));
    Ok(Baked { irradiance, buried })
}

fn rays(atlas: &Atlas, gather: Gather) -> u64 {
    atlas.points.len() as u64 * u64::from(gather.cosine + gather.light)
}

fn buried(gathered: &Gathered) -> bool {
    gathered.back_faces >= BURIED
}
