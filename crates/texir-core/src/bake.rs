//! Irradiance bake: every texel gathers the texture-based lighting through the scene (the paper's IrT).

use crate::atlas::Atlas;
use crate::backend::{Backend, Gather};
use crate::error::Result;
use crate::progress::Progress;
use crate::raster::Rgb;

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

/// Bakes the irradiance of every valid texel from the TBL that the backend was given with [`Backend::set_tbl`].
pub fn irradiance(backend: &mut dyn Backend, atlas: &Atlas, gather: Gather, progress: &dyn Progress) -> Result<Baked> {
    progress.start("irradiance", atlas.points.len() as u64 * u64::from(gather.cosine + gather.light), "rays");
    let gathered = backend.irradiance(&atlas.points, gather, progress)?;
    progress.finish();
    Ok(Baked {
        irradiance: gathered.iter().map(|g| g.irradiance).collect(),
        buried: gathered.iter().map(|g| g.back_faces >= BURIED).collect(),
    })
}
