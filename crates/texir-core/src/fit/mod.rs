//! The fit: from a capture to albedo and roughness textures.
//!
//! rooms → texture-based lighting → irradiance → materials, in one of two modes: [`paper`] or [`full`].

pub mod adam;
pub mod adjacency;
pub mod diffused;
pub mod emitters;
pub mod full;
#[cfg(test)]
mod lit_square;
pub mod memory;
pub mod paper;
pub mod settings;

use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Instant;

use adjacency::Adjacency;
use glam::Vec3;

use crate::atlas::Atlas;
use crate::backend::{Backend, Gather};
use crate::bake::{self, Baked};
use crate::brdf::Masking;
use crate::capture::survey::Survey;
use crate::capture::{Capture, Coverage, Split, Tbl, View};
use crate::checkpoint::Checkpoints;
use crate::diffuse::DiffuseModel;
use crate::error::{Error, Result};
use crate::lights::Lights;
use crate::progress::Progress;
use crate::raster::{Gray, Mask, Raster, Rgb};
use crate::render::Textures;
use crate::rooms::{self, FloorPlan, RoomOptions};
use crate::tbl::{self, TblOptions};
pub use paper::stages::{EpochLog, Stage};
pub use settings::{FitSettings, Mode};

/// What both modes start from: the light of the scene, and where its texels are.
pub struct Ground<'a> {
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
pub struct Materials {
    /// Linear albedo.
    pub albedo: Rgb,
    /// Perceptual roughness.
    pub roughness: Gray,
    /// 1 where the surface is metal, 0 elsewhere; full mode tells when asked.
    pub metallic: Option<Gray>,
    /// Irradiance E with which the materials explain the images.
    pub irradiance: Rgb,
    /// The diffuse model that albedo belongs to,
    pub diffuse: DiffuseModel,
    /// and the shadowing–masking term that roughness does.
    pub masking: Masking,
    /// How well the views know the roughness, 0 (a guess) to 1; full mode tells.
    pub confidence: Option<Gray>,
}

/// What a fit yields, all in the same atlas.
#[derive(Clone, Debug)]
pub struct FitResult {
    /// Materials, irradiance, and emission: where the TBL is a light source, what is left of it without what is reflected.
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

/// Fits a capture, whose mesh the backend's scene has; `log` receives one entry per epoch of paper mode. With `checkpoints` of
/// the same [`identity`], a fit goes on where an earlier one was stopped, and ends with the same bits.
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
    let started = Instant::now();
    let mut timings = Timings { last: started, entries: Vec::new() };

    // First, as it takes a second and refuses meshes in other units than metres.
    let cameras: Vec<Vec3> = capture.views.iter().map(|v| v.camera.position()).collect();
    let plan = rooms::detect(&scene.mesh, &cameras, &RoomOptions::default())?;
    timings.mark("rooms");

    let training: Vec<View> = capture.views(Split::Train).cloned().collect();
    let Lighting { mut tbl, atlas, training, views, unit } =
        lighting(backend, (capture.tbl.as_deref(), training), settings, progress)?;
    timings.mark("texture-based lighting");

    let adjacency = Adjacency::new(&scene.mesh, &atlas);
    let lights = Lights::find(&scene, &atlas, &tbl.radiance)?;
    backend.set_tbl(&tbl.radiance, &lights)?;
    let texel = atlas.typical_texel(&scene.mesh);
    let rays = settings.irradiance_rays(texel);
    let gather = Gather::new(rays - rays / 2, rays / 2, settings.seed);
    // Where it is gathered again it only has to tell what light surfaces send, and most of that is known from the views.
    let bake = if settings.bakes() > 1 { bake::thinned } else { bake::denoised };
    let irradiance = outside(bake(backend, &atlas, gather, checkpoints, progress)?, &atlas);
    timings.mark("irradiance");

    let light = (&tbl, &irradiance);
    let emitters = emitters::find(backend, (&atlas, &adjacency), light, &training, settings.emitter_ratio, progress)?;
    if emission(&tbl.radiance, &emitters).all(|e| e == [0.0; 3]) {
        return Err(Error::invalid(
            "no light source was found: no texel of the HDR texture is brighter than its surroundings can make it. \
             Check the exposure of the images, or lower the setting emitter_ratio",
        ));
    }
    let ground = Ground {
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
        Mode::Paper => (paper::fit(backend, &ground, irradiance, &views, settings, progress, log)?, None),
        Mode::Full => full::fit(backend, &ground, irradiance, &views, &settings.full, progress)?,
    };
    if let Some(radiance) = relit {
        tbl.radiance = radiance;
    }
    let mut emission = emitted((&tbl.radiance, &emitters), &materials);
    let Materials { albedo, roughness, metallic, mut irradiance, diffuse, masking, confidence } = materials;
    if let Some(what) = too_bright(&albedo, &emitters, &tbl) {
        progress.warn(&format!("{}: {what}", capture.root.display()));
    }
    // Back in the capture's unit; powers of two are exact.
    for map in [&mut emission, &mut irradiance, &mut tbl.radiance] {
        scale(map, unit.recip());
    }
    let textures = Textures { albedo, roughness, metallic, irradiance, emission, diffuse, masking };
    timings.mark("materials");

    Ok(FitResult { textures, confidence, tbl, plan, timings: timings.entries })
}

/// Views are this bright on average, about, for light to be computed with in half floats and shared exponents.
const USUAL: RangeInclusive<f64> = 1e-3..=1e3;

/// What light is multiplied with while a fit goes on: 1, unless views of this mean radiance are in a unit of which numbers here hold too
/// little; a power of two.
fn unit(radiance: f64) -> f32 {
    let is_usual = USUAL.contains(&radiance) || !(radiance > 0.0 && radiance.is_finite());
    // The inverse is a number as well.
    if is_usual { 1.0 } else { (-radiance.log2()).round().clamp(-120.0, 120.0).exp2() as f32 }
}

fn scale(map: &mut Rgb, factor: f32) {
    if factor != 1.0 {
        map.data.iter_mut().for_each(|pixel| *pixel = pixel.map(|v| v * factor));
    }
}

/// What to tell the user where much of the surface that views see would have to reflect all light: there must be more of it.
fn too_bright(albedo: &Rgb, emitters: &Mask, tbl: &Tbl) -> Option<String> {
    /// Albedo from here on is more than paint has.
    const WHITE: f32 = 0.97;
    const SHARE: f64 = 0.1;
    let seen =
        tbl.coverage.data.iter().zip(&emitters.data).map(|(coverage, emits)| *coverage == Coverage::Seen && !emits);
    let [mut all, mut white] = [0u64; 2];
    for (albedo, _) in albedo.data.iter().zip(seen).filter(|(_, seen)| *seen) {
        all += 1;
        white += u64::from(albedo.iter().any(|a| *a >= WHITE));
    }
    let share = white as f64 / all.max(1) as f64;
    (share > SHARE).then(|| {
        format!(
            "{:.0} % of the surface that views see would have to reflect nearly all light: light is missing. Are lamps clipped in the images, \
             turned around or missing in the mesh, or are there holes that light comes through? (`texir inspect`)",
            100.0 * share
        )
    })
}

/// What a fit sets out with.
struct Lighting {
    tbl: Tbl,
    atlas: Atlas,
    /// The training views,
    training: Vec<View>,
    /// and as the fit of materials reads them.
    views: Vec<View>,
    /// What all of its light was multiplied with: see [`unit`].
    unit: f32,
}

/// The texture-based lighting that a capture brings, if it has the size that is asked for; else that of its training views.
fn lighting(
    backend: &mut dyn Backend,
    (given, mut training): (Option<&Path>, Vec<View>),
    settings: &FitSettings,
    progress: &dyn Progress,
) -> Result<Lighting> {
    let given = given.map(|path| Tbl::read(path, progress)).transpose()?;
    let size = match (settings.atlas_size, &given) {
        (0, Some(tbl)) => tbl.radiance.size(),
        (0, None) => {
            let side = memory::default_side(&training, &backend.scene().mesh, settings);
            (side, side)
        }
        (size, _) => (size, size),
    };
    if let Some(tbl) = given.as_ref().filter(|tbl| tbl.radiance.size() != size) {
        progress.warn(&format!(
            "the HDR texture has {:?} texels, and fit.atlas_size asks for {size:?}: it is not used, but made anew of the views",
            tbl.radiance.size()
        ));
    }
    let given = given.filter(|tbl| tbl.radiance.size() == size);
    let is_given = given.is_some();
    let atlas = Atlas::new(backend, size.0, size.1)?;
    // Before the first long step: what does not fit in memory is refused.
    let mut views = memory::affordable(&training, (&backend.scene().mesh, &atlas), settings, progress)?;
    let survey = Survey::new(backend, &training, progress)?;
    survey.warnings().iter().for_each(|what| progress.warn(what));
    let unit = unit(survey.radiance());
    training.iter_mut().chain(&mut views).for_each(|view| view.scale = view.scale.map(|factor| factor * unit));
    let mut tbl = match given {
        Some(mut tbl) => {
            scale(&mut tbl.radiance, unit);
            tbl
        }
        None => tbl::build_in(backend, &atlas, &training, &TblOptions::default(), progress)?,
    };
    if is_given && settings.mode == Mode::Full && settings.full.resolve_sources {
        tbl = tbl::resolve_sources(backend, &atlas, &tbl, &training, progress)?;
    }
    Ok(Lighting { tbl, atlas, training, views, unit })
}

/// What a fit depends on, in one line each: as long as none of it changes, [`Checkpoints`] hold. Files are known by their
/// size and the time they were written.
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

/// Irradiance of an atlas. What texels inside other geometry gather is no light of the room: they have none, but for the rim, which takes
/// what is lit beside it.
fn outside(mut baked: Baked, atlas: &Atlas) -> Rgb {
    baked.irradiance.iter_mut().zip(&baked.buried).filter(|(_, inside)| **inside).for_each(|(e, _)| *e = [0.0; 3]);
    baked.map(atlas, bake::Buried::Fill)
}

/// What leaves light sources, `radiance` where `emitters` are, and 0 elsewhere; by texel.
fn emission(radiance: &Rgb, emitters: &Mask) -> impl Iterator<Item = [f32; 3]> {
    radiance.data.iter().zip(&emitters.data).map(|(&l, &is_source)| if is_source { l } else { [0.0; 3] })
}

/// What light sources emit: what leaves them less the a E/π that they reflect.
fn emitted((radiance, emitters): (&Rgb, &Mask), materials: &Materials) -> Rgb {
    let of_texel = |(t, outgoing): (usize, [f32; 3])| -> [f32; 3] {
        let diffuse = 1.0 - materials.metallic.as_ref().map_or(0.0, |map| map.data[t]);
        let (albedo, irradiance) = (&materials.albedo.data[t], &materials.irradiance.data[t]);
        std::array::from_fn(|c| {
            (outgoing[c] - diffuse * albedo[c] * irradiance[c] * std::f32::consts::FRAC_1_PI).max(0.0)
        })
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
    use std::sync::Mutex;

    use bytesize::ByteSize;

    use super::*;
    use crate::fit::lit_square::{LitSquare, SIDE};

    #[test]
    fn light_of_unusual_brightness_is_brought_to_about_one_and_back() {
        assert_eq!([1e-3, 0.3, 1.0, 1e3, 0.0, f64::NAN, f64::INFINITY].map(unit), [1.0; 7]);
        for radiance in [1e-300, 1e-30, 1e-4, 2e3, 1e30, 1e300] {
            let unit = unit(radiance);
            assert!(unit.is_normal() && unit.recip().is_normal() && unit * unit.recip() == 1.0, "{radiance}: {unit}");
        }
        for radiance in [1e-30, 1e-4, 2e3, 1e30] {
            assert!((0.7..1.5).contains(&(radiance * f64::from(unit(radiance)))), "{radiance}");
        }
    }

    #[test]
    fn surfaces_that_would_reflect_all_light_are_told_where_they_are_many() {
        let told = |white: usize, coverage: Coverage| {
            let albedo = Rgb::new(10, 10, (0..100).map(|i| [0.5, if i < white { 0.98 } else { 0.5 }, 0.5]).collect());
            let tbl = Tbl { radiance: Rgb::filled(10, 10, [1.0; 3]), coverage: Raster::filled(10, 10, coverage) };
            too_bright(&albedo.unwrap(), &Mask::filled(10, 10, false), &tbl)
        };
        assert!(told(20, Coverage::Seen).unwrap().starts_with("20 % of the surface"));
        // Negative controls: a few, and what no view sees.
        assert_eq!(told(5, Coverage::Seen), None);
        assert_eq!(told(20, Coverage::Inpainted), None);
    }

    /// Takes down what is begun.
    #[derive(Default)]
    struct Begun(Mutex<Vec<String>>);

    impl Progress for Begun {
        fn start(&self, task: &str, _: u64, _: &str) {
            self.0.lock().unwrap().push(task.to_owned());
        }
        fn advance(&self, _: u64) {}
        fn finish(&self) {}
        fn warn(&self, _: &str) {}
        fn cancelled(&self) -> bool {
            false
        }
    }

    #[test]
    fn too_little_memory_is_refused_before_anything_is_begun() {
        let square = LitSquare::new();
        let views = square.views(&Rgb::filled(SIDE, SIDE, [1.0; 3]), (16, 8));
        let begun = |max_memory| {
            let settings = FitSettings { atlas_size: SIDE, max_memory, ..FitSettings::default() };
            let progress = Begun::default();
            let lit = lighting(&mut square.backend(), (None, views.clone()), &settings, &progress);
            (lit.map(|lit| lit.views.len()).map_err(|e| e.to_string()), progress.0.into_inner().unwrap())
        };
        let (refused, tasks) = begun(ByteSize(1));
        assert!(refused.unwrap_err().contains("max_memory is 1 B") && tasks.is_empty(), "{tasks:?}");
        // Negative control.
        let (lit, tasks) = begun(ByteSize::gib(1));
        assert!(lit == Ok(5) && tasks.contains(&"texture-based lighting".to_owned()), "{tasks:?}");
    }

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
        // Half of the irradiance; nothing of a metal's; never less than nothing.
        assert_eq!(
            emitted((&map([2.0, 1.0, 0.1]), &emitters), &materials).data,
            [[1.5, 0.5, 0.0], [2.0, 1.0, 0.1], [0.0; 3]]
        );
    }
}
