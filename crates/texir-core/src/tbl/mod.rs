//! Texture-based lighting from the views: the radiance of every atlas texel, as the panoramas or photos show it.
//!
//! Each texel's surface point is projected into every view, tested for visibility, sampled ([`sample`]) and blended
//! robustly over the views ([`blend`]); texels that no view sees are filled from their neighbourhood in space
//! ([`inpaint`]) and flagged. Pixels masked out of the fit are used all the same: emitters are masked, and they are the
//! light. Views are read one at a time; memory is bounded by the atlas and a band of it.

mod blend;
mod inpaint;
mod sample;

use std::path::Path;

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::backend::Backend;
use crate::camera::Camera;
use crate::capture::{Coverage, Tbl, View};
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::raster::{Raster, Rgb};
use crate::scene::Scene;
use crate::surface::{Hit, SurfacePoint};
use blend::Best;
use inpaint::{Known, Place};
use sample::Sampler;

/// How views are joined into a TBL.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TblOptions {
    /// Views that see a surface at a smaller cosine than this are not used for it.
    pub min_cosine: f32,
    /// Weight of pixels that straddle the edge of a surface, against 1 for the others.
    pub edge_weight: f32,
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
        Self { min_cosine: 0.1, edge_weight: 0.02, sharpness: 1.0, quantile: 0.5, tolerance: 0.1, gutter: 4 }
    }
}

/// Texels that are worked on at a time.
const BAND: usize = 1 << 19;

/// Fuses given images.
pub fn fuse(
    backend: &mut dyn Backend,
    scene: &Scene,
    cameras: &[Camera],
    load: &mut dyn FnMut(usize) -> Result<Rgb>,
    size: (usize, usize),
    options: &TblOptions,
    progress: &dyn Progress,
) -> Result<Tbl> {
    if cameras.is_empty() {
        return Err(Error::invalid("the TBL needs at least one view, none given"));
    }
    let (width, height) = size;
    let mesh = &scene.mesh;
    let hits = backend.texels(width, height)?;
    let covered: Vec<u32> = (0..hits.len() as u32).filter(|&i| hits[i as usize].is_hit()).collect();
    let mut radiance = Rgb::filled(width, height, [0.0; 3]);
    let mut coverage = Raster::filled(width, height, Coverage::Outside);
    progress.start("texture-based lighting", (covered.len() * cameras.len()) as u64, "texels");
    for band in covered.chunks(BAND) {
        let points: Vec<SurfacePoint> =
            band.par_iter().map(|&i| SurfacePoint::new(mesh, &hits[i as usize], None)).collect();
        let mut best = vec![Best::default(); band.len()];
        for (i, camera) in cameras.iter().enumerate() {
            progress.check()?;
            let image = load(i)?;
            let projected = backend.project(&points, camera)?;
            let sampler = Sampler::new(backend, mesh, camera, &image, options)?;
            best.par_iter_mut().enumerate().for_each(|(j, best)| {
                let area = texel_area(mesh, &hits[band[j] as usize], size);
                if let Some(observation) = sampler.observe(&points[j], &projected[j], area) {
                    best.add(observation);
                }
            });
            progress.advance(band.len() as u64);
        }
        for (&texel, best) in band.iter().zip(&best) {
            coverage.data[texel as usize] = Coverage::Inpainted;
            if let Some(blend) = best.blend(options) {
                radiance.data[texel as usize] = blend;
                coverage.data[texel as usize] = Coverage::Seen;
            }
        }
    }
    progress.finish();
    inpaint_unseen(mesh, &hits, &mut radiance, &coverage);
    fill_gutter(&mut radiance, &coverage, options.gutter);
    Ok(Tbl { radiance, coverage })
}

/// Area of a texel on the surface, m².
fn texel_area(mesh: &Mesh, hit: &Hit, size: (usize, usize)) -> f32 {
    let [a, b, c] = mesh.corners(hit.triangle);
    let [ua, ub, uc] = mesh.corner_uvs(hit.triangle);
    let world = (b - a).cross(c - a).length();
    let texels = (ub - ua).perp_dot(uc - ua).abs() * (size.0 * size.1) as f32;
    if texels > 0.0 { world / texels } else { 0.0 }
}

/// Fills the chart texels that no view sees.
fn inpaint_unseen(mesh: &Mesh, hits: &[Hit], radiance: &mut Rgb, coverage: &Raster<Coverage>) {
    let place = |i: usize| {
        let point = SurfacePoint::new(mesh, &hits[i], None);
        Place { position: Vec3::from(point.position), normal: Vec3::from(point.normal) }
    };
    let of = |kind: Coverage| (0..hits.len()).filter(move |&i| coverage.data[i] == kind);
    let unseen: Vec<usize> = of(Coverage::Inpainted).collect();
    let mut areas: Vec<f32> = of(Coverage::Seen).map(|i| texel_area(mesh, &hits[i], radiance.size())).collect();
    if unseen.is_empty() || areas.is_empty() {
        return;
    }
    let middle = areas.len() / 2;
    let (_, &mut typical, _) = areas.select_nth_unstable_by(middle, f32::total_cmp);
    let known = Known::new(of(Coverage::Seen).map(|i| (place(i), radiance.data[i])), typical.sqrt().max(1e-4));
    let places: Vec<Place> = unseen.iter().map(|&i| place(i)).collect();
    for (i, filled) in unseen.into_iter().zip(known.fill(&places)) {
        radiance.data[i] = filled;
    }
}

/// Repeats the radiance of chart borders for a few texels outwards, ring by ring.
fn fill_gutter(radiance: &mut Rgb, coverage: &Raster<Coverage>, rings: usize) {
    let (w, h) = radiance.size();
    let mut filled: Vec<bool> = coverage.data.iter().map(|&c| c != Coverage::Outside).collect();
    for _ in 0..rings {
        let ring: Vec<(usize, [f32; 3])> = (0..w * h)
            .into_par_iter()
            .filter(|&i| !filled[i])
            .filter_map(|i| {
                let (x, y) = (i % w, i / w);
                let around = (y.saturating_sub(1)..(y + 2).min(h))
                    .flat_map(|ny| (x.saturating_sub(1)..(x + 2).min(w)).map(move |nx| ny * w + nx))
                    .filter(|&n| filled[n]);
                let (sum, count) =
                    around.fold((Vec3::ZERO, 0.0), |(s, n), i| (s + Vec3::from(radiance.data[i]), n + 1.0));
                (count > 0.0).then(|| (i, (sum / count).into()))
            })
            .collect();
        for (i, value) in ring {
            radiance.data[i] = value;
            filled[i] = true;
        }
    }
}
