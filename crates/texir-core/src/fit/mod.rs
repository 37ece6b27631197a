//! The fit: from a capture to albedo and roughness textures.
//!
//! rooms → texture-based lighting → irradiance → materials, in one of two modes: that of the paper, or full.

mod adam;
mod adjacency;
mod emitters;
mod full;
mod index;
#[cfg(test)]
mod lit_square;
pub mod memory;
mod outgoing;
mod paper;
mod prepare;
pub mod settings;
mod warnings;

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;
use std::time::Instant;

use adjacency::Adjacency;
use glam::Vec3;
use prepare::{Prepared, prepare};
use rayon::prelude::*;

use crate::atlas::Atlas;
use crate::backend::{Backend, Gather};
use crate::bake::{self, Baked};
use crate::brdf::Masking;
use crate::capture::{Capture, Split, Tbl, View};
use crate::checkpoint::Checkpoints;
use crate::diffuse::DiffuseModel;
use crate::error::{Error, Result};
use crate::lights::Lights;
use crate::progress::Progress;
use crate::radiance_scale::scale;
use crate::raster::{Gray, Mask, Raster, Rgb};
use crate::render::Textures;
use crate::rooms::{self, FloorPlan, RoomOptions};
use crate::surface::SurfacePoint;
pub use paper::{EpochLog, Stage};
pub use settings::{FitSettings, Mode};

/// What both modes start from: the light of the scene, and where its texels are.
struct FitContext<'a> {
    /// The texels of the backend's scene.
    pub atlas: &'a Atlas,
    /// Edge of a typical one on the surface, metres.
    pub texel: f32,
    /// Which of them are neighbours.
    pub adjacency: &'a Adjacency,
    /// The texture-based lighting, as captured.
    pub tbl: &'a Tbl,
    /// Its light sources, as sampled.
    pub lights: &'a Lights,
    /// How irradiance is gathered.
    pub gather: Gather,
    /// Texels that are light sources.
    pub emitters: &'a Mask,
    /// Rooms, for views that bring none.
    pub plan: &'a FloorPlan,
    /// Seed of the run.
    pub seed: u32,
    /// Steps that were done before.
    pub checkpoints: &'a Checkpoints,
}

/// What a mode yields, in the atlas.
struct Materials {
    /// Linear albedo.
    pub albedo: Rgb,
    /// Perceptual roughness.
    pub roughness: Gray,
    /// 1 where the surface is metal, 0 elsewhere; full mode tells when asked.
    pub metallic: Option<Gray>,
    /// Irradiance E with which the materials explain the images.
    pub irradiance: Rgb,
    /// The diffuse model that albedo belongs to.
    pub diffuse: DiffuseModel,
    /// The shadowing–masking term that roughness belongs to.
    pub masking: Masking,
    /// How well the views know the roughness, 0 (a guess) to 1; full mode tells.
    pub confidence: Option<Gray>,
}

/// What a fit yields, all in the same atlas.
#[derive(Clone, Debug)]
pub struct FitResult {
    /// Materials, irradiance, and emission: where the TBL is a light source, what is left of it without what is
    /// reflected.
    pub textures: Textures,
    /// How well the views know the roughness, 0 (a guess) to 1; full mode tells.
    pub confidence: Option<Gray>,
    /// The texture-based lighting: as captured, or as surfaces send it by the materials that full mode found.
    pub tbl: Tbl,
    /// The rooms that were found.
    pub plan: FloorPlan,
    /// Seconds by step.
    pub timings: Vec<(String, f64)>,
}

/// Fits a capture, whose mesh the backend's scene has; `log` receives one entry per epoch of paper mode. With
/// `checkpoints` of the same [`identity`], a fit goes on where an earlier one was stopped, and ends with the same bits.
pub fn fit(
    backend: &mut dyn Backend,
    capture: &Capture,
    settings: &FitSettings,
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
    log: &mut dyn FnMut(&EpochLog),
) -> Result<FitResult> {
    settings.validate()?;
    let scene = backend.scene().clone();
    if *scene.mesh() != capture.mesh {
        return Err(Error::invalid(format!(
            "{}: its mesh is not the backend's; make the backend with the scene of this capture",
            capture.root.display()
        )));
    }
    let started = Instant::now();
    let mut timings = Timings { last: started, entries: Vec::new() };

    // First, as it takes a second and refuses meshes in other units than metres.
    let cameras: Vec<Vec3> = capture.views.iter().map(|v| v.camera.position()).collect();
    let plan = rooms::detect(scene.mesh(), &cameras, &RoomOptions::default())?;
    timings.mark("rooms");

    let training: Vec<View> = capture.views(Split::Train).cloned().collect();
    let Prepared { mut tbl, atlas, training, views, scale: factor } =
        prepare(backend, (capture.tbl.as_deref(), training), settings, progress)?;
    timings.mark("texture-based lighting");

    let adjacency = Adjacency::new(scene.mesh(), &atlas);
    let lights = Lights::find(&scene, &atlas, &tbl.radiance)?;
    backend.set_tbl(&tbl.radiance, &lights)?;
    let texel = atlas.typical_texel(scene.mesh());
    let rays = settings.irradiance_rays(texel);
    let gather = Gather::new(rays - rays / 2, rays / 2, settings.seed);
    // Where it is gathered again it only has to tell what light surfaces send, and most of that is known from the
    // views.
    let bake = if settings.bakes() > 1 { bake::thinned } else { bake::denoised };
    let irradiance = without_buried(bake(backend, &atlas, gather, checkpoints, progress)?, &atlas)?;
    timings.mark("irradiance");

    let light = (&tbl, &irradiance);
    let room = |point: &SurfacePoint| plan.room_of(point.position.into(), point.normal.into());
    let room_of_texel: Vec<u16> = atlas.points.par_iter().map(room).collect();
    let surface = (&atlas, &adjacency, &room_of_texel[..]);
    let emitters = emitters::find(backend, surface, light, &training, settings.emitter_ratio, progress)?;
    drop(room_of_texel);
    if emission(&tbl.radiance, &emitters).all(|e| e == [0.0; 3]) {
        return Err(Error::invalid(format!(
            "no light source was found: no texel of the HDR texture is {} times as bright as it could reflect. Turn the \
             faces of lamps into the room, close windows with a surface, merge shorter exposures where lamps are \
             clipped, or lower the setting fit.emitter_ratio",
            settings.emitter_ratio
        )));
    }
    let context = FitContext {
        atlas: &atlas,
        texel,
        adjacency: &adjacency,
        tbl: &tbl,
        lights: &lights,
        gather,
        emitters: &emitters,
        plan: &plan,
        seed: settings.seed,
        checkpoints,
    };
    let (materials, relit) = match settings.mode {
        Mode::Paper => (paper::fit(backend, &context, irradiance, &views, &settings.paper, progress, log)?, None),
        Mode::Full => full::fit(backend, &context, irradiance, &views, &settings.full, progress)?,
    };
    if let Some(radiance) = relit {
        tbl.radiance = radiance;
    }
    let mut emission = padded(&emitted((&tbl.radiance, &emitters), &materials), &atlas)?;
    let Materials { albedo, roughness, metallic, mut irradiance, diffuse, masking, confidence } = materials;
    if let Some(what) = warnings::too_bright(&albedo, &emitters, &tbl) {
        progress.warn(&format!("{}: {what}", capture.root.display()));
    }
    // Back in the capture's unit; powers of two are exact.
    for map in [&mut emission, &mut irradiance, &mut tbl.radiance] {
        scale(map, factor.recip());
    }
    let textures = Textures { albedo, roughness, metallic, irradiance, emission, diffuse, masking };
    timings.mark("materials");

    Ok(FitResult { textures, confidence, tbl, plan, timings: timings.entries })
}

/// What a fit depends on, in one line each: as long as none of it changes, [`Checkpoints`] hold. Files are known by
/// their size and the time they were written.
pub fn identity(capture: &Capture, settings: &FitSettings, backend: &dyn Backend) -> Result<String> {
    let mut hasher = DefaultHasher::new();
    bytemuck::cast_slice::<_, u8>(&capture.mesh.positions).hash(&mut hasher);
    bytemuck::cast_slice::<_, u8>(&capture.mesh.normals).hash(&mut hasher);
    bytemuck::cast_slice::<_, u8>(&capture.mesh.uvs).hash(&mut hasher);
    capture.mesh.triangles.hash(&mut hasher);
    let mut known = |file: &PathBuf| -> Result<()> {
        let known = file.metadata().map_err(|e| Error::cannot_read(file, e))?;
        (known.len(), known.modified().ok()).hash(&mut hasher);
        Ok(())
    };
    if let Some(texture) = &capture.tbl {
        known(texture)?;
        let mask = Tbl::mask_path(texture);
        mask.is_file().then(|| known(&mask)).transpose()?;
    }
    for view in &capture.views {
        let files = [Some(&view.image), view.semantic.as_ref(), view.mask.as_ref(), view.room.as_ref()];
        files.into_iter().flatten().try_for_each(&mut known)?;
    }
    format!("{:?}", (&capture.tbl, &capture.views)).hash(&mut hasher);
    let (version, name, captured) = (env!("CARGO_PKG_VERSION"), backend.name(), hasher.finish());
    Ok(format!("texir {version}\n{name}\ncapture {captured:016x}\n{settings:?}\n"))
}

/// Irradiance of an atlas, 0 at buried texels (inside other geometry), as theirs is no light of the room; but their rim
/// is filled from the lit texels beside it.
fn without_buried(mut baked: Baked, atlas: &Atlas) -> Result<Rgb> {
    baked.irradiance.iter_mut().zip(&baked.buried).filter(|(_, inside)| **inside).for_each(|(e, _)| *e = [0.0; 3]);
    baked.map(atlas, bake::Buried::Fill)
}

/// A map with what lies at the rims of charts continued beyond them.
fn padded(map: &Rgb, atlas: &Atlas) -> Result<Rgb> {
    let values: Vec<[f32; 3]> = atlas.texels.iter().map(|&texel| map.data[texel as usize]).collect();
    atlas.padded(&values, bake::PADDING)
}

/// What leaves light sources, `radiance` where `emitters` are, and 0 elsewhere; by texel.
fn emission(radiance: &Rgb, emitters: &Mask) -> impl Iterator<Item = [f32; 3]> {
    radiance.data.iter().zip(&emitters.data).map(|(&l, &is_source)| if is_source { l } else { [0.0; 3] })
}

/// What light sources emit: what leaves them less what they reflect ([`outgoing::reflected`]), metals aside.
fn emitted((radiance, emitters): (&Rgb, &Mask), materials: &Materials) -> Rgb {
    let of_texel = |(t, sent): (usize, [f32; 3])| -> [f32; 3] {
        let dielectric = 1.0 - materials.metallic.as_ref().map_or(0.0, |map| map.data[t]);
        let reflected = outgoing::reflected(materials, t);
        std::array::from_fn(|c| (sent[c] - dielectric * reflected[c]).max(0.0))
    };
    Raster { data: emission(radiance, emitters).enumerate().map(of_texel).collect(), ..*radiance }
}

/// A stopwatch that names its laps.
struct Timings {
    last: Instant,
    entries: Vec<(String, f64)>,
}

impl Timings {
    fn mark(&mut self, what: &str) {
        let now = Instant::now();
        self.entries.push((what.to_owned(), (now - self.last).as_secs_f64()));
        self.last = now;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::specular_albedo::specular_albedo;

    #[test]
    fn what_a_lamp_reflects_is_not_emitted() {
        let map = |value: [f32; 3]| Rgb::filled(3, 1, value);
        let emitters = Mask { width: 3, height: 1, data: vec![true, true, false] };
        let materials = Materials {
            albedo: map([0.5; 3]),
            roughness: Gray::filled(3, 1, 0.5),
            metallic: Some(Gray { width: 3, height: 1, data: vec![0.0, 1.0, 0.0] }),
            irradiance: map([std::f32::consts::PI; 3]),
            diffuse: DiffuseModel::default(),
            masking: Masking::default(),
            confidence: None,
        };
        // Half of the irradiance diffusely, and what the surface mirrors; nothing of a metal's; never less than nothing.
        let mirrored = specular_albedo(materials.masking, 0.5);
        assert!((0.02..0.06).contains(&mirrored), "{mirrored}");
        let diffuse = 0.5 * materials.diffuse.albedo_factor(0.5);
        let emitted = emitted((&map([2.0, 1.0, 0.1]), &emitters), &materials).data;
        for (found, sent) in emitted[0].iter().zip([2.0, 1.0]) {
            assert!((found - (sent - diffuse - mirrored)).abs() < 1e-6, "{emitted:?}");
        }
        assert_eq!((emitted[0][2], &emitted[1..]), (0.0, &[[2.0, 1.0, 0.1], [0.0; 3]][..]));
    }

    #[test]
    fn what_is_inside_other_geometry_has_no_light_but_for_the_rim() {
        let square = lit_square::LitSquare::new();
        let atlas = &square.atlas;
        // The left half is buried, and gathered nonsense.
        let inside: Vec<bool> =
            atlas.texels.iter().map(|t| *t as usize % lit_square::SIDE < lit_square::SIDE / 2).collect();
        let baked = Baked {
            irradiance: inside.iter().map(|inside| if *inside { [9.0; 3] } else { [1.0; 3] }).collect(),
            buried: inside.clone(),
            standard_error: None,
            rays: 0,
        };
        let map = without_buried(baked, atlas).unwrap();
        assert!(map.data.iter().flatten().all(|e| *e <= 1.0), "nonsense is left");
        let beside = lit_square::SIDE / 2 - 1;
        assert_eq!(map.data[3 * lit_square::SIDE + beside], [1.0; 3], "the rim takes what is lit beside it");
    }
}
