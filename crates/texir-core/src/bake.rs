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

/// An irradiance map with what is known about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Baked {
    /// E = ∫ L cosθ dω (full, not divided by π), linear RGB, padded by [`PADDING`] texels.
    pub irradiance: Rgb,
    /// Valid texels that are buried in other geometry: they hold a neighbour's value.
    pub buried: usize,
}

/// Bakes the irradiance of every valid texel from the TBL that the backend was given with [`Backend::set_tbl`]. Texels
/// that lie inside an object (a floor under a cupboard) would be black and bleed into what is seen beside it; they take
/// their nearest lit neighbour's value instead.
pub fn irradiance(backend: &mut dyn Backend, atlas: &Atlas, gather: Gather, progress: &dyn Progress) -> Result<Baked> {
    progress.start("irradiance", atlas.points.len() as u64 * u64::from(gather.cosine + gather.light), "rays");
    let gathered = backend.irradiance(&atlas.points, gather, progress)?;
    progress.finish();
    let lit: Vec<bool> = gathered.iter().map(|g| g.back_faces < BURIED).collect();
    let buried = lit.iter().filter(|l| !**l).count();
    let values: Vec<[f32; 3]> = gathered.iter().map(|g| g.irradiance).collect();
    Ok(Baked { irradiance: atlas.scatter_padded(&values, &lit, [0.0; 3], PADDING), buried })
}
