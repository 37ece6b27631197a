//! From views to a TBL: blend, separate light sources from what is beside them, fill what no view sees.

use std::collections::HashMap;

use rayon::prelude::*;

use super::blend::Best;
use super::connectivity::Connectivity;
use super::photo::Photo;
use super::receivers::{self, Known};
use super::sample::Sampler;
use super::{Fusion, sources, unseen};
use crate::backend::Backend;
use crate::camera::Camera;
use crate::capture::{Coverage, Tbl};
use crate::error::Result;
use crate::inpaint;
use crate::progress::Task;
use crate::raster::mean_of_channels;
use crate::surface::SurfacePoint;

/// Pixels' worth of a triangle that must be shown dark for it to be known as no source: of the back of a lampshade,
/// pixels at the rim may show a hundredth, and be mistaken in it.
const EVIDENT: f32 = 0.05;
/// Texels that are worked on at a time, at least: 80 MB of observations. All images are read again for each such band,
/// so that a band may take as much memory as the largest image with what its pixels show.
const BAND: usize = 1 << 18;
/// The observations of a texel are as large as so many pixels of an image with what they show.
const PIXELS_PER_TEXEL: usize = 8;

/// What is known of light sources once they are told from what is beside them.
struct Separated {
    /// The mean over the channels above which a texel is a source.
    limit: f32,
    /// Texels beside sources that pixels show to be none.
    dark_texels: Vec<usize>,
    /// Pixels' worth that views show of every texel, of those around sources.
    shown: Vec<f32>,
}

impl Fusion<'_> {
    /// The TBL from the radiance of the texels that are seen: light sources are separated from their surroundings, and
    /// unseen texels filled; first from `given` where it was inpainted, unless it shines there: an earlier fill may
    /// have spread a lamp's light over the ceiling behind it.
    pub fn complete(
        &self,
        backend: &mut dyn Backend,
        load: &mut dyn FnMut(usize) -> Result<Photo>,
        mut radiance: Vec<Option<[f32; 3]>>,
        given: Option<&Tbl>,
    ) -> Result<Tbl> {
        let Self { scene, atlas, options, .. } = *self;
        let connectivity = Connectivity::new(scene.mesh());
        let Separated { limit, dark_texels, shown } =
            self.separate_sources(backend, load, &connectivity, &mut radiance)?;
        let seen: Vec<bool> = radiance.iter().map(Option::is_some).collect();
        let mut radiance = self.fill_unseen(radiance, given, limit);
        let emits = |value: [f32; 3]| mean_of_channels(value) > limit;
        let without_sources: Vec<[f32; 3]> =
            radiance.iter().map(|&value| if emits(value) { [0.0; 3] } else { value }).collect();
        let mut is_known = seen.clone();
        dark_texels.into_iter().for_each(|texel| is_known[texel] = true);
        unseen::shine(scene.mesh(), &connectivity, atlas, limit, &is_known, &mut radiance);
        let known = Known { limit, shown: &shown, seen: &seen, dark: &without_sources };
        receivers::dim(self, backend, &connectivity, &known, &mut radiance)?;
        let coverage: Vec<_> = seen.iter().map(|s| if *s { Coverage::Seen } else { Coverage::Inpainted }).collect();
        Ok(Tbl {
            radiance: atlas.padded(&radiance, options.gutter)?,
            coverage: atlas.scatter(&coverage, Coverage::Outside)?,
        })
    }

    /// The radiance of all texels, unseen ones as `given` has them where it was inpainted and does not emit, or from
    /// around them.
    fn fill_unseen(&self, mut radiance: Vec<Option<[f32; 3]>>, given: Option<&Tbl>, limit: f32) -> Vec<[f32; 3]> {
        let Self { scene, atlas, .. } = *self;
        for (radiance, &t) in radiance.iter_mut().zip(&atlas.texels).filter(|(radiance, _)| radiance.is_none()) {
            let filled = given.filter(|tbl| tbl.coverage.data[t as usize] == Coverage::Inpainted);
            *radiance =
                filled.map(|tbl| tbl.radiance.data[t as usize]).filter(|&value| mean_of_channels(value) <= limit);
        }
        inpaint::fill(&atlas.points, &radiance, atlas.typical_texel(scene.mesh()))
    }

    /// The blend of all views at each point; nothing where none sees it. Pixels that are not finite are not used.
    pub fn blend(
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
                let projected = backend.project(points, camera)?;
                progress.advance(points.len() as u64);
                // Most views of a large capture see none of these.
                if projected.iter().all(|at| at.distance <= 0.0) {
                    continue;
                }
                let photo = load(i)?;
                let sampler = Sampler::new(backend, camera, &photo, options)?;
                best.par_iter_mut().zip(points).zip(&projected).for_each(|((best, point), at)| {
                    let area = atlas.texel_area(scene.mesh(), point.triangle);
                    if let Some(observation) = sampler.observe(point, at, area) {
                        best.add(observation);
                    }
                });
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
        connectivity: &Connectivity,
        radiance: &mut [Option<[f32; 3]>],
    ) -> Result<Separated> {
        let found = sources::resolve(self, backend, load, connectivity, radiance)?;
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
        let dark_texels = beside.iter().copied().filter(|&texel| dark_parts[&triangle(texel)] > EVIDENT).collect();
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
        Ok(Separated { limit: found.limit, dark_texels, shown })
    }
}
