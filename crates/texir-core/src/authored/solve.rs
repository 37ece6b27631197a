//! The light of an authored scene as a Neumann series: E = Σ_k E_k, where E_0 is what arrives directly and E_{k+1}
//! gathers what the surfaces make of E_k, TBL_{k+1} = albedo/π · E_k.

use std::f32::consts::PI;
use std::ops::Range;

use super::series::{Remainder, Series};
use super::{Surfaces, punctual};
use crate::atlas::{BAND, bands};
use crate::backend::{Backend, Gather, MAX_RADIANCE};
use crate::bake::{self, BakedTexels, Quality, Texels};
use crate::checkpoint::Checkpoints;
use crate::error::{Error, Result};
use crate::lights::Lights;
use crate::lights::find::Finder;
use crate::progress::{Progress, Task};
use crate::punctual::PunctualLight;
use crate::raster::Rgb;
use crate::rng::hash2;

/// A bounce brings less light than the one before, so that fewer rays suffice: in proportion to its share, but not
/// fewer than this share of the first gather's.
const FEWEST_RAYS: f64 = 1.0 / 16.0;

/// Below this share of the scene's mean irradiance there is as good as no light: a crack lets as much through.
const DARK: f32 = 0.01;

/// When to stop bouncing, and how to gather.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounces {
    /// That of the first gather; later ones take fewer rays, as they bring less light.
    pub quality: Quality,
    /// Bounces end when the estimated remainder is below this fraction of all light and, in all but 1 % of the map's
    /// squares, below four times this fraction of the local light.
    pub tolerance: f32,
    /// Maximum number of bounces; 0: direct light only.
    pub max_bounces: u32,
}

/// Irradiance with its bounces.
#[derive(Debug)]
pub struct Solved {
    /// E in full per valid texel: direct and indirect, from surfaces, punctual lights and environment.
    pub solution: BakedTexels,
    /// Mean of E_k over texels and channels, k = 0 the direct light.
    pub series: Vec<f64>,
    /// What the bounces left out would add.
    pub remainder: Remainder,
}

/// Solves the light of a scene at `texels`, of a map whose size the maps of `surfaces` have.
///
/// Replaces the backend's TBL and environment. With `checkpoints` of the same [`Surfaces::identity`], a bake that was
/// interrupted goes on where it was, to the same bits.
pub fn irradiance(
    backend: &mut dyn Backend,
    texels: &Texels<'_>,
    surfaces: &Surfaces,
    bounces: &Bounces,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Solved> {
    surfaces.check(texels)?;
    if !(bounces.tolerance >= 0.0) {
        return Err(Error::invalid(format!(
            "the tolerance of bounces is {}; expected a share of the light, 0 or more",
            bounces.tolerance
        )));
    }
    let mut solver = Solver { backend, texels, bounces, checkpoints, progress };

    solver.backend.set_environment(surfaces.environment.as_ref())?;
    let direct = solver.direct(surfaces);
    // The sky lights once; what surfaces make of it bounces. Nor does it stay where this ends early.
    solver.backend.set_environment(None)?;
    let mut last = direct?;

    let mut total = last.copy(texels)?;
    let mut series = Series::default();
    series.push(texels, &last, &total)?;
    if !(series.means[0] <= f64::from(MAX_RADIANCE)) {
        return Err(Error::invalid(format!(
            "the scene's light is too strong: {:e} on average; expected irradiance below {MAX_RADIANCE:e}",
            series.means[0]
        )));
    }
    for k in 1..=bounces.max_bounces {
        if series.remainder().is_within(bounces.tolerance) {
            break;
        }
        total.mark_lit_outside(texels, DARK * series.means.iter().sum::<f64>() as f32)?;
        let sent = reflected(&surfaces.albedo, |rows| last.filled_rows(texels, &total, rows))?;
        drop(last);
        let lights = finder(solver.backend, texels, &sent)?.one_sided();
        last = solver.gather((&sent, &lights), k, series.share())?;
        total.add(texels, &last)?;
        series.push(texels, &last, &total)?;
    }
    total.mark_lit_outside(texels, DARK * series.means.iter().sum::<f64>() as f32)?;
    Ok(Solved { solution: total, remainder: series.remainder(), series: series.means })
}

struct Solver<'a> {
    backend: &'a mut dyn Backend,
    texels: &'a Texels<'a>,
    bounces: &'a Bounces,
    checkpoints: &'a Checkpoints,
    progress: &'a dyn Progress,
}

impl Solver<'_> {
    /// What emission, sky and lights without extent bring themselves.
    fn direct(&mut self, surfaces: &Surfaces) -> Result<BakedTexels> {
        let lights = finder(self.backend, self.texels, &surfaces.emission)?.one_sided();
        let mut direct = self.gather((&surfaces.emission, &lights), 0, 1.0)?;
        self.add_punctual(&mut direct, &surfaces.lights)?;
        Ok(direct)
    }

    /// Adds E from the punctual lights.
    fn add_punctual(&mut self, direct: &mut BakedTexels, lights: &[PunctualLight]) -> Result<()> {
        if lights.is_empty() {
            return Ok(());
        }
        let Gather { cosine, light, .. } = self.bounces.quality.gather;
        let subsamples = punctual::subsamples(cosine.saturating_add(light), lights.len());
        let rays = self.texels.valid() as u64 * lights.len() as u64 * u64::from(subsamples);
        direct.rays += rays;
        let _task = Task::start(self.progress, "punctual lights", rays, "rays");
        let (size, checkpoints) = (self.texels.size(), self.checkpoints.within("punctual"));
        direct.add_exact(self.texels, |number, points| {
            let mut known = true;
            let found = checkpoints.array(&format!("piece-{number}"), points.len(), || {
                known = false;
                punctual::irradiance(self.backend, size, points, lights, subsamples, self.progress)
            })?;
            if known {
                self.progress.check()?;
                self.progress.advance(points.len() as u64 * lights.len() as u64 * u64::from(subsamples));
            }
            Ok(found)
        })
    }

    /// E from surfaces of radiance `tbl`, with the lights in it, with a `share` of the rays; `bounce` draws other
    /// samples.
    fn gather(&mut self, (tbl, lights): (&Rgb, &Lights), bounce: u32, share: f64) -> Result<BakedTexels> {
        // Two, of which errors are told, unless it was one from the start.
        let scaled = |n: u32| ((f64::from(n) * share.clamp(FEWEST_RAYS, 1.0)).ceil() as u32).max(n.min(2));
        let Quality { gather: Gather { cosine, light, seed, .. }, error, denoise } = self.bounces.quality;
        let gather = Gather::new(scaled(cosine), scaled(light), hash2(seed, bounce));
        // Variance in proportion to the light that a bounce brings: that of the sum is then at most `error` squared.
        let error = error.map(|error| error / share.clamp(f64::MIN_POSITIVE, 1.0).sqrt() as f32);
        let quality = Quality { gather, error, denoise };
        self.backend.set_tbl(tbl, lights)?;
        let checkpoints = self.checkpoints.within(&format!("bounce-{bounce}"));
        bake::bake_texels(self.backend, self.texels, &quality, &checkpoints, self.progress)
    }
}

/// Finds lights in a map of radiance.
fn finder<'a>(backend: &'a dyn Backend, texels: &Texels<'_>, tbl: &'a Rgb) -> Result<Finder<'a>> {
    let mut finder = Finder::new(backend.scene(), tbl, texels.valid());
    texels.points().try_for_each(|points| points.and_then(|points| finder.take(&points)))?;
    Ok(finder)
}

/// Outgoing radiance of Lambertian surfaces: albedo/π · E, of which `irradiance` tells some rows.
fn reflected(albedo: &Rgb, irradiance: impl Fn(Range<usize>) -> Result<Vec<[f32; 3]>>) -> Result<Rgb> {
    let mut sent = Rgb { width: albedo.width, height: albedo.height, data: Vec::with_capacity(albedo.data.len()) };
    for rows in bands(albedo.width, albedo.height, BAND) {
        let albedo = &albedo.data[rows.start * albedo.width..];
        let texel = |(a, e): (&[f32; 3], [f32; 3])| [0, 1, 2].map(|c| a[c] / PI * e[c]);
        sent.data.extend(albedo.iter().zip(irradiance(rows)?).map(texel));
    }
    Ok(sent)
}
