//! Texture-based lighting from the views: the radiance of every atlas texel, as the panoramas or photos show it.
//!
//! Each texel's surface point is projected into every view, tested for visibility, sampled (`sample.rs`) and blended
//! robustly over the views (`blend.rs`). Pixels that masks exclude are not used unless they show the light
//! (`photo.rs`); light sources are resolved below the size of pixels (`sources.rs`). Texels that no view sees are
//! filled along the surface from light sources (`unseen.rs`), as far as what these would light agrees (`witnesses.rs`),
//! and otherwise from their neighbourhood in space (`inpaint.rs`), and flagged. Views are read one at a time; memory is
//! that of the atlas, a band of it, and some 300 bytes for every pixel of all views that shows a light source.

mod blend;
pub mod blur;
pub mod exposure;
mod joined;
mod looks;
mod photo;
pub mod pose;
mod sample;
pub(crate) mod shown;
mod sources;
mod unseen;
mod witnesses;

use std::collections::HashMap;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::atlas::{Atlas, DEFAULT_SIDE};
use crate::backend::Backend;
use crate::camera::Camera;
use crate::capture::{Coverage, Tbl, View};
use crate::error::{Error, Result};
use crate::inpaint;
use crate::light_unit::{in_own_unit, scale};
use crate::progress::{Progress, Task};
use crate::raster::mean_of_channels;
use crate::scene::Scene;
use crate::surface::SurfacePoint;
use blend::Best;
use joined::Joined;
use photo::Photo;
use sample::Sampler;
use witnesses::Known;

/// Side of the atlas, texels, when nobody says: [`DEFAULT_SIDE`], or twice that where views have more pixels than such
/// an atlas has texels, as it would hold less than they show.
pub fn default_side(views: &[View]) -> usize {
    let pixels: usize = views.iter().map(|view| view.camera.pixels()).sum();
    if pixels > DEFAULT_SIDE * DEFAULT_SIDE { 2 * DEFAULT_SIDE } else { DEFAULT_SIDE }
}

/// How views are joined into a TBL.
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

/// Pixels' worth of a triangle that must be shown dark for it to be known as no source: of the back of a lampshade,
/// pixels at the rim may show a hundredth, and be mistaken in it.
const EVIDENT: f32 = 0.05;
/// Texels that are worked on at a time, at least: 80 MB of observations. All images are read again for each such band,
/// so that a band may take as much memory as the largest image with what its pixels show.
const BAND: usize = 1 << 18;
/// The observations of a texel are as large as so many pixels of an image with what they show.
const PIXELS_PER_TEXEL: usize = 8;

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
    let (views, unit) = in_own_unit(views, progress)?;
    let mut tbl = build_in(backend, &atlas, &views, options, progress)?;
    scale(&mut tbl.radiance, unit.recip());
    Ok(tbl)
}

/// [`build`] in an atlas that is there, from views in the [`unit`](fn@crate::light_unit::unit) of what they show.
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

/// What is known of light sources once they are told from what is beside them.
struct Separated {
    /// The mean over the channels above which a texel is a source.
    limit: f32,
    /// Texels beside sources that pixels show to be none.
    dark: Vec<usize>,
    /// Pixels' worth that views show of every texel, of those around sources.
    shown: Vec<f32>,
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

impl Fusion<'_> {
    /// The TBL from the radiance of the texels that are seen: light sources are separated from their surroundings, and
    /// unseen texels filled; first from `given` where it was inpainted, unless it shines there: an earlier fill may have
    /// spread a lamp's light over the ceiling behind it.
    fn complete(
        &self,
        backend: &mut dyn Backend,
        load: &mut dyn FnMut(usize) -> Result<Photo>,
        mut radiance: Vec<Option<[f32; 3]>>,
        given: Option<&Tbl>,
    ) -> Result<Tbl> {
        let Self { scene, atlas, options, .. } = *self;
        let joined = Joined::new(scene.mesh());
        let Separated { limit, dark, shown } = self.separate_sources(backend, load, &joined, &mut radiance)?;
        let seen: Vec<bool> = radiance.iter().map(Option::is_some).collect();
        for (radiance, &t) in radiance.iter_mut().zip(&atlas.texels).filter(|(radiance, _)| radiance.is_none()) {
            let filled = given.filter(|tbl| tbl.coverage.data[t as usize] == Coverage::Inpainted);
            *radiance =
                filled.map(|tbl| tbl.radiance.data[t as usize]).filter(|&value| mean_of_channels(value) <= limit);
        }
        let mut radiance = inpaint::fill(&atlas.points, &radiance, atlas.typical_texel(scene.mesh()));
        let mut known = seen.clone();
        dark.into_iter().for_each(|texel| known[texel] = true);
        let shines = |value: [f32; 3]| mean_of_channels(value) > limit;
        let dark: Vec<[f32; 3]> = radiance.iter().map(|&value| if shines(value) { [0.0; 3] } else { value }).collect();
        unseen::shine(scene.mesh(), &joined, atlas, limit, &known, &mut radiance);
        let known = Known { limit, shown: &shown, seen: &seen, dark: &dark };
        witnesses::dim(self, backend, &joined, &known, &mut radiance)?;
        let coverage: Vec<_> = seen.iter().map(|s| if *s { Coverage::Seen } else { Coverage::Inpainted }).collect();
        Ok(Tbl {
            radiance: atlas.scatter_padded(&radiance, &vec![true; radiance.len()], [0.0; 3], options.gutter),
            coverage: atlas.scatter(&coverage, Coverage::Outside),
        })
    }

    /// The blend of all views at each point; nothing where none sees it. Pixels that are not finite are not used.
    fn blend(
        &self,
        backend: &mut dyn Backend,
        load: &mut dyn FnMut(usize) -> Result<Photo>,
        points: &[SurfacePoint],
    ) -> Result<Vec<Option<[f32; 3]>>> {
        let Self { scene, atlas, cameras, options, progress } = *self;
        let mut blended = Vec::with_capacity(points.len());
        let _task = Task::start(progress, "texture-based lighting", (points.len() * cameras.len()) as u64, "texels");
        let largest = cameras.iter().map(Camera::pixels).max().unwrap_or(0);
        for points in points.chunks(BAND.max(largest / PIXELS_PER_TEXEL)) {
            let mut best = vec![Best::default(); points.len()];
            for (i, camera) in cameras.iter().enumerate() {
                progress.check()?;
                let photo = load(i)?;
                let projected = backend.project(points, camera)?;
                let sampler = Sampler::new(backend, camera, &photo, options)?;
                best.par_iter_mut().zip(points).zip(&projected).for_each(|((best, point), at)| {
                    let area = atlas.texel_area(scene.mesh(), point.triangle);
                    if let Some(observation) = sampler.observe(point, at, area) {
                        best.add(observation);
                    }
                });
                progress.advance(points.len() as u64);
            }
            blended.par_extend(best.par_iter().map(|best| best.blend(options)));
        }
        Ok(blended)
    }

    /// Light sources get the radiance that explains the pixels, and what is beside them is blended anew without the
    /// pixels that mix the two; it counts as unseen where there are no others.
    fn separate_sources(
        &self,
        backend: &mut dyn Backend,
        load: &mut dyn FnMut(usize) -> Result<Photo>,
        joined: &Joined,
        radiance: &mut [Option<[f32; 3]>],
    ) -> Result<Separated> {
        let found = sources::resolve(self, backend, load, joined, radiance)?;
        let mut beside = Vec::new();
        let triangle = |texel: usize| self.atlas.points[texel].triangle;
        let mut dark_parts: HashMap<u32, f32> = HashMap::new();
        for ((&texel, &resolved), &shown) in found.texels.iter().zip(&found.radiance).zip(&found.shown) {
            let texel = texel as usize;
            if mean_of_channels(resolved) > found.limit {
                radiance[texel] = Some(resolved);
            } else {
                beside.push(texel);
                *dark_parts.entry(triangle(texel)).or_default() += shown;
            }
        }
        let dark = beside.iter().copied().filter(|&texel| dark_parts[&triangle(texel)] > EVIDENT).collect();
        let mut load_unmixed = |view: usize| {
            let mut photo = load(view)?;
            found.mixed[view].iter().for_each(|&pixel| photo.image.data[pixel] = [f32::NAN; 3]);
            Ok(photo)
        };
        let points: Vec<SurfacePoint> = beside.iter().map(|&i| self.atlas.points[i]).collect();
        for (i, blended) in beside.into_iter().zip(self.blend(backend, &mut load_unmixed, &points)?) {
            radiance[i] = blended;
        }
        let mut shown = vec![0.0; radiance.len()];
        found.texels.iter().zip(&found.shown).for_each(|(&texel, &of_texel)| shown[texel as usize] = of_texel);
        Ok(Separated { limit: found.limit, dark, shown })
    }
}

#[cfg(test)]
pub(crate) mod tests;
