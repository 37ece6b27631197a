//! The light of an authored scene as a Neumann series: E = Σ_k E_k, where E_0 is what arrives directly and E_{k+1} gathers
//! what the surfaces make of E_k, TBL_{k+1} = albedo/π · E_k.

use std::f32::consts::PI;

use super::Surfaces;
use crate::atlas::Atlas;
use crate::backend::{Backend, Gather};
use crate::bake::{self, Baked, PADDING, Quality};
use crate::checkpoint::Checkpoints;
use crate::error::{Error, Result};
use crate::lights::Lights;
use crate::progress::Progress;
use crate::raster::Rgb;
use crate::rng::hash2;
use crate::scene::Scene;

/// A bounce brings less light than the one before, so that fewer rays suffice: in proportion to its share, but not fewer
/// than this share of the first gather's.
const FEWEST_RAYS: f64 = 1.0 / 16.0;

/// When to stop bouncing, and how to gather.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounces {
    /// That of the first gather; later ones take fewer rays, as they bring less light.
    pub quality: Quality,
    /// Bounces end when what the further ones would add is below this share of all light.
    pub tolerance: f32,
    /// Bounces end here even so; 0 leaves direct light alone.
    pub most: u32,
}

/// Irradiance with its bounces.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// E in full per valid texel of the atlas: direct and indirect, from surfaces, punctual lights and environment.
    pub baked: Baked,
    /// Mean of E_k over texels and channels, k = 0 the direct light.
    pub series: Vec<f64>,
    /// Estimated share of all light that the bounces left out would add.
    pub remainder: f64,
}

/// Solves the light of a scene at the texels of `atlas`, whose size the maps of `surfaces` have.
///
/// Replaces the backend's TBL and environment. With `checkpoints` of the same [`Surfaces::identity`], a bake that was
/// interrupted goes on where it was, to the same bits.
pub fn irradiance(
    backend: &mut dyn Backend,
    scene: &Scene,
    atlas: &Atlas,
    surfaces: &Surfaces,
    bounces: &Bounces,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<Solved> {
    check(atlas, surfaces)?;
    let mut solver = Solver { backend, scene, atlas, bounces, checkpoints, rays: 0, progress };

    solver.backend.set_environment(surfaces.environment.as_ref())?;
    let punctual = solver.punctual(surfaces)?;
    let Baked { irradiance: mut total, buried, standard_error, .. } = solver.gather(&surfaces.emission, 0, 1.0)?;
    let mut standard_error = standard_error;
    add(&mut total, &punctual);
    // The sky lights once; what surfaces make of it bounces.
    solver.backend.set_environment(None)?;

    let mut last = total.clone();
    let mut series = vec![mean(&last, &buried)];
    let mut remainder = remainder_of(&series);
    for k in 1..=bounces.most {
        if remainder <= f64::from(bounces.tolerance) {
            break;
        }
        let share = series.last().copied().unwrap_or(0.0) / series[0];
        let reflected = reflected(&surfaces.albedo, &atlas.scatter_padded(&last, &visible(&buried), [0.0; 3], PADDING));
        let bounce = solver.gather(&reflected, k, share)?;
        last = bounce.irradiance;
        add(&mut total, &last);
        for (sum, error) in standard_error.iter_mut().flatten().zip(bounce.standard_error.iter().flatten()) {
            *sum = sum.hypot(*error);
        }
        series.push(mean(&last, &buried));
        remainder = remainder_of(&series);
    }
    let baked = Baked { irradiance: total, buried, standard_error, rays: solver.rays };
    Ok(Solved { baked, series, remainder })
}

struct Solver<'a> {
    backend: &'a mut dyn Backend,
    scene: &'a Scene,
    atlas: &'a Atlas,
    bounces: &'a Bounces,
    checkpoints: &'a Checkpoints,
    rays: u64,
    progress: &'a dyn Progress,
}

impl Solver<'_> {
    /// E from the punctual lights.
    fn punctual(&mut self, surfaces: &Surfaces) -> Result<Vec<[f32; 3]>> {
        let rays = self.atlas.points.len() as u64 * surfaces.lights.len() as u64;
        self.rays += rays;
        self.progress.start("punctual lights", rays, "rays");
        let irradiance = self.backend.punctual(&self.atlas.points, &surfaces.lights, self.progress)?;
        self.progress.finish();
        Ok(irradiance)
    }

    /// E from surfaces of radiance `tbl` with a `share` of the rays; `bounce` draws other samples.
    fn gather(&mut self, tbl: &Rgb, bounce: u32, share: f64) -> Result<Baked> {
        // Two, of which errors are told, unless it was one from the start.
        let scaled = |n: u32| ((f64::from(n) * share.clamp(FEWEST_RAYS, 1.0)).ceil() as u32).max(n.min(2));
        let Quality { gather: Gather { cosine, light, seed, .. }, error, denoise } = self.bounces.quality;
        let gather = Gather::new(scaled(cosine), scaled(light), hash2(seed, bounce));
        // Variance in proportion to the light that a bounce brings: that of the sum is then at most `error` squared.
        let error = error.map(|error| error / share.clamp(f64::MIN_POSITIVE, 1.0).sqrt() as f32);
        let quality = Quality { gather, error, denoise };
        self.backend.set_tbl(tbl, &Lights::find(self.scene, self.atlas, tbl))?;
        let checkpoints = self.checkpoints.within(&format!("bounce-{bounce}"));
        let baked = bake::bake(self.backend, &self.scene.mesh, self.atlas, &quality, &checkpoints, self.progress)?;
        self.rays += baked.rays;
        Ok(baked)
    }
}

/// Outgoing radiance of Lambertian surfaces: albedo/π · E.
fn reflected(albedo: &Rgb, irradiance: &Rgb) -> Rgb {
    let texel = |(a, e): (&[f32; 3], &[f32; 3])| [0, 1, 2].map(|c| a[c] / PI * e[c]);
    let data = albedo.data.iter().zip(&irradiance.data).map(texel).collect();
    Rgb { width: albedo.width, height: albedo.height, data }
}

/// Texels that light leaves again: those inside other geometry take their neighbours' value.
fn visible(buried: &[bool]) -> Vec<bool> {
    buried.iter().map(|inside| !inside).collect()
}

fn add(sum: &mut [[f32; 3]], other: &[[f32; 3]]) {
    for (sum, other) in sum.iter_mut().zip(other) {
        *sum = [sum[0] + other[0], sum[1] + other[1], sum[2] + other[2]];
    }
}

fn mean(irradiance: &[[f32; 3]], buried: &[bool]) -> f64 {
    let seen = || irradiance.iter().zip(buried).filter(|(_, inside)| !**inside);
    let sum: f64 = seen().flat_map(|(e, _)| e).map(|v| f64::from(*v)).sum();
    sum / (3 * seen().count()).max(1) as f64
}

/// What a series lacks as a share of its sum, if it goes on like its last two members: geometrically.
fn remainder_of(series: &[f64]) -> f64 {
    let sum: f64 = series.iter().sum();
    match series {
        [.., before, last] if last < before => last * last / (before - last) / sum,
        [.., last] if *last == 0.0 => 0.0,
        _ => f64::INFINITY,
    }
}

fn check(atlas: &Atlas, surfaces: &Surfaces) -> Result<()> {
    for (name, map) in [("albedo", &surfaces.albedo), ("emission", &surfaces.emission)] {
        if map.size() != (atlas.width, atlas.height) {
            let (width, height) = map.size();
            return Err(Error::invalid(format!(
                "the {name} map is {width}×{height} texels; expected {}×{} as the lightmap",
                atlas.width, atlas.height
            )));
        }
    }
    let channel = |map: &Rgb, good: fn(&f32) -> bool| map.data.iter().flatten().all(good);
    if !channel(&surfaces.albedo, |v| (0.0..=1.0).contains(v)) {
        return Err(Error::invalid("the albedo map leaves [0, 1]; expected linear reflectances"));
    }
    if !channel(&surfaces.emission, |v| *v >= 0.0 && v.is_finite()) {
        return Err(Error::invalid("the emission map is negative or not finite; expected radiance"));
    }
    surfaces.lights.iter().try_for_each(crate::punctual::PunctualLight::check)
}
