//! Texture-based lighting from the views: the radiance of every atlas texel, as the panoramas or photos show it.
//!
//! Each texel's surface point is projected into every view, tested for visibility, sampled (`sample.rs`) and blended
//! robustly over the views (`blend.rs`). Pixels that masks exclude are not used unless they show the light
//! (`photo.rs`); light sources are resolved below the size of pixels (`sources.rs`). Texels that no view sees are
//! filled along the surface from light sources (`unseen.rs`), as far as what these would light agrees (`receivers.rs`),
//! and otherwise from their neighbourhood in space (`inpaint.rs`), and flagged. Views are read one at a time; memory is
//! that of the atlas, a band of it, and some 300 bytes for every pixel of all views that shows a light source.

mod blend;
pub mod blur;
mod connectivity;
pub mod exposure;
mod fusion;
mod photo;
pub mod pose;
mod receivers;
mod sample;
pub(crate) mod shown;
mod source_pixels;
mod sources;
mod unseen;

use serde::{Deserialize, Serialize};

use crate::atlas::{Atlas, DEFAULT_SIDE};
use crate::backend::Backend;
use crate::camera::Camera;
use crate::capture::{Coverage, Tbl, View};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::radiance_scale::{normalised_views, scale};
use crate::scene::Scene;
use photo::Photo;

/// Side of the atlas, texels, when nobody says: [`DEFAULT_SIDE`], or twice that where views have more pixels than such
/// an atlas has texels, as it would hold less than they show.
pub fn default_side(views: &[View]) -> usize {
    let pixels: usize = views.iter().map(|view| view.camera.pixels()).sum();
    if pixels > DEFAULT_SIDE * DEFAULT_SIDE { 2 * DEFAULT_SIDE } else { DEFAULT_SIDE }
}

/// How views are fused into a TBL.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TblOptions {
    /// Views that see a surface at a smaller cosine than this are not used for it.
    pub min_cosine: f32,
    /// Exponent of a view's resolution (cosθ/d² × pixels per steradian) in its weight: 0 counts all views alike, high
    /// values take the sharpest only.
    pub sharpness: f32,
    /// The quantile of the views' logarithmic luminance taken for diffuse: highlights only ever add light.
    pub quantile: f32,
    /// Difference of logarithmic luminance from it at which an observation counts half.
    pub tolerance: f32,
    /// Texels around the charts that repeat the nearest chart texel's radiance, for lookups at chart borders.
    pub gutter: usize,
}

impl Default for TblOptions {
    fn default() -> Self {
        Self { min_cosine: 0.1, sharpness: 1.0, quantile: 0.3, tolerance: 0.05, gutter: 4 }
    }
}

impl TblOptions {
    /// Errors on settings out of range.
    fn check(&self) -> Result<()> {
        let ranges = [
            ("min_cosine", self.min_cosine, 0.0..=1.0),
            ("sharpness", self.sharpness, 0.0..=4.0),
            ("quantile", self.quantile, 0.0..=1.0),
            ("tolerance", self.tolerance, 1e-3..=1e6),
        ];
        match ranges.iter().find(|(_, value, range)| !range.contains(value)) {
            None => Ok(()),
            Some((name, value, range)) => Err(Error::invalid(format!(
                "TblOptions::{name} is {value}; expected {} to {}",
                range.start(),
                range.end()
            ))),
        }
    }
}

/// Builds the TBL of a `size` (columns, rows) atlas from `views`, the ones meant for training: every texel's radiance
/// and whether it was seen. Around the charts, [`TblOptions::gutter`] texels repeat what is inside and stay
/// [`Coverage::Outside`]. The backend's TBL is another one afterwards.
pub fn build(
    backend: &mut dyn Backend,
    views: &[View],
    size: [usize; 2],
    options: &TblOptions,
    progress: &dyn Progress,
) -> Result<Tbl> {
    let atlas = Atlas::new(backend, [size[0], size[1]])?;
    let (views, factor) = normalised_views(views, progress)?;
    let mut tbl = build_in(backend, &atlas, &views, options, progress)?;
    scale(&mut tbl.radiance, factor.recip());
    Ok(tbl)
}

/// [`build`] in an atlas that is there, from views by the [scale](crate::radiance_scale::radiance_scale) of what they
/// show.
pub(crate) fn build_in(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    views: &[View],
    options: &TblOptions,
    progress: &dyn Progress,
) -> Result<Tbl> {
    let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    fuse(backend, atlas, &cameras, |i| photo(&views[i], progress), options, progress)
}

/// What may be used of a view.
fn photo(view: &View, progress: &dyn Progress) -> Result<Photo> {
    Ok(Photo::new(view.load_image(progress)?, view.load_mask()?))
}

/// [`build`] from images that `load` gives by index.
fn fuse(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    cameras: &[Camera],
    mut load: impl FnMut(usize) -> Result<Photo>,
    options: &TblOptions,
    progress: &dyn Progress,
) -> Result<Tbl> {
    options.check()?;
    let scene = backend.scene().clone();
    let fusion = Fusion { scene: &scene, atlas, cameras, options, progress };
    let radiance = fusion.blend(backend, &mut load, &atlas.points)?;
    if radiance.iter().all(Option::is_none) {
        return Err(Error::invalid(format!(
            "none of the {} views sees the mesh: check the camera poses (camera to world, metres, the mesh's frame) and \
             that the mesh's faces point into the rooms",
            cameras.len()
        )));
    }
    fusion.complete(backend, &mut load, radiance, None)
}

/// A TBL, of the size of `atlas`, whose light sources are made to explain the pixels of `views`, as those of [`build`]
/// are. The backend's is another one afterwards.
pub fn resolve_sources(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    tbl: &Tbl,
    views: &[View],
    progress: &dyn Progress,
) -> Result<Tbl> {
    let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    let scene = backend.scene().clone();
    let fusion = Fusion { scene: &scene, atlas, cameras: &cameras, options: &TblOptions::default(), progress };
    let seen = |&t: &u32| (tbl.coverage.data[t as usize] == Coverage::Seen).then(|| tbl.radiance.data[t as usize]);
    let radiance = atlas.texels.iter().map(seen).collect();
    fusion.complete(backend, &mut |i| photo(&views[i], progress), radiance, Some(tbl))
}

/// What the views are fused into, and how.
struct Fusion<'a> {
    /// The backend's.
    scene: &'a Scene,
    atlas: &'a Atlas,
    cameras: &'a [Camera],
    options: &'a TblOptions,
    progress: &'a dyn Progress,
}

#[cfg(test)]
pub(crate) mod tests;
