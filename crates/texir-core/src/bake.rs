//! Irradiance bake: every texel gathers the texture-based lighting through the scene (the paper's IrT).

use crate::atlas::Atlas;
use crate::backend::{Backend, Sampling};
use crate::error::Result;
use crate::progress::Progress;
use crate::raster::Rgb;

/// Rings of padding around the charts of a baked map.
pub const PADDING: usize = 4;

/// Bakes E = ∫ L cosθ dω (full, not divided by π) at every valid texel of the atlas, from the TBL that the backend was
/// given with [`Backend::set_tbl`]. Linear RGB, padded by [`PADDING`] texels.
pub fn irradiance(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    sampling: Sampling,
    progress: &dyn Progress,
) -> Result<Rgb> {
    progress.start("irradiance", atlas.points.len() as u64 * u64::from(sampling.samples), "rays");
    let values = backend.irradiance(&atlas.points, sampling, progress)?;
    progress.finish();
    Ok(atlas.scatter_padded(&values, [0.0; 3], PADDING))
}
