//! The fit in paper mode: three stages of gradient descent ([`stages`]) over the views ([`views`]).

mod stages;
mod views;

use std::time::Instant;

pub use self::stages::{EpochLog, Stage};
use self::stages::{Optimisation, Textures};
use super::{FitContext, Materials, emission};
use crate::backend::Backend;
use crate::bake;
use crate::brdf::Masking;
use crate::capture::View;
use crate::diffuse::DiffuseModel;
use crate::error::Result;
use crate::fit::settings::PaperSettings;
use crate::inpaint;
use crate::lights::Lights;
use crate::progress::Progress;
use crate::raster::{Gray, Raster, Rgb};
use crate::texture::Pyramid;
use views::{FitView, Surroundings};

/// Fits the materials. The backend holds the full TBL and its lights, before and after; `irradiance` is E per texel.
pub fn fit(
    backend: &mut dyn Backend,
    context: &FitContext<'_>,
    irradiance: Rgb,
    training: &[View],
    settings: &PaperSettings,
    progress: &dyn Progress,
    log: &mut dyn FnMut(&EpochLog),
) -> Result<Materials> {
    let FitContext { atlas, .. } = *context;
    if training.iter().all(|view| view.semantic.is_none()) {
        progress.warn(
            "no view has semantic classes: everything counts as one class, within which roughness is propagated; full mode \
             makes segments from geometry and colour",
        );
    }
    let pyramid = atlas.pyramid();
    let surroundings = Surroundings {
        context,
        irradiance: &irradiance,
        pyramid: &pyramid,
        footprint_samples: settings.footprint_samples,
    };
    let sources = Raster { data: emission(&context.tbl.radiance, context.emitters).collect(), ..context.tbl.radiance };
    backend.set_tbl(&sources, &Lights::none(backend.scene().mesh()))?;
    drop(sources);
    let views = surroundings.prepare(backend, training, progress)?;
    backend.set_tbl(&context.tbl.radiance, context.lights)?;
    let texels = atlas.width * atlas.height;
    let mut textures = Textures {
        albedo: vec![settings.parameters.albedo_start; 3 * texels],
        roughness: vec![settings.parameters.roughness_start; texels],
    };
    Optimisation {
        backend,
        pyramid: &pyramid,
        views: &views,
        settings,
        seed: context.seed,
        progress,
        log,
        started: Instant::now(),
        checkpoints: context.checkpoints,
    }
    .run(&mut textures)?;
    let (albedo, roughness) = complete(backend, context, &pyramid, &views, &textures)?;
    Ok(Materials {
        albedo,
        roughness,
        metallic: None,
        irradiance,
        diffuse: DiffuseModel::Lambert,
        masking: Masking::Schlick,
        confidence: None,
    })
}

/// The fitted textures with the texels that no pixel sees filled from their surroundings, and padded: they would keep
/// the values that the fit started from.
fn complete(
    backend: &mut dyn Backend,
    context: &FitContext<'_>,
    pyramid: &Pyramid,
    views: &[FitView],
    textures: &Textures,
) -> Result<(Rgb, Gray)> {
    let FitContext { atlas, texel, .. } = *context;
    let mut seen = vec![false; atlas.width * atlas.height];
    for view in views {
        let weight = backend.lookup_vjp(pyramid, &vec![1.0; view.points.len()], 1, &view.footprints)?;
        seen.iter_mut().zip(weight).for_each(|(seen, weight)| *seen |= weight > 0.0);
    }
    let known = |value: &dyn Fn(usize) -> [f32; 3]| -> Vec<Option<[f32; 3]>> {
        atlas.texels.iter().map(|&t| seen[t as usize].then(|| value(t as usize))).collect()
    };
    let albedo = known(&|t| textures.albedo.as_chunks::<3>().0[t]);
    let albedo = inpaint::fill(&atlas.points, &albedo, texel);
    let roughness = known(&|t| [textures.roughness[t]; 3]);
    let roughness: Vec<f32> = inpaint::fill(&atlas.points, &roughness, texel).iter().map(|r| r[0]).collect();
    Ok((atlas.padded(&albedo, bake::PADDING)?, atlas.padded(&roughness, bake::PADDING)?))
}
