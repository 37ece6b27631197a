//! `texir bake scene.glb`: all the light of an authored scene, and the scene with its lightmap's coordinates.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use texir_core::authored::{self, BounceAlbedo, BounceLimit, Bounces, Model, Surfaces, write_lightmapped_glb};
use texir_core::backend::Backend;
use texir_core::bake::{Texels, Workspace, bounce_workspace_within};
use texir_core::checkpoint::Checkpoints;
use texir_core::environment::Environment;
use texir_core::glb::is_by_texir;
use texir_core::image_io::{read_rgb, sanitise_radiance};
use texir_core::lightmap::Profile;
use texir_core::progress::Progress;

use super::Bake;
use crate::args::not_negative;
use crate::checks::check_outputs;
use crate::device;
use crate::failure::{Context, Failure};
use crate::session::Session;

/// Columns of the lightmap where `--size` does not say.
const DEFAULT_SIZE: usize = 1024;
/// Share of all light that may be left out, where `--tolerance` does not say.
const TOLERANCE: f32 = 0.005;
/// Most bounces, where `--bounces` does not say.
const BOUNCES: u32 = 64;

/// Arguments for scenes with lights of their own.
#[derive(Debug, Args)]
#[command(next_help_heading = "Authored scenes (.glb, .gltf without --tbl)")]
pub struct Authored {
    /// Environment map: equirectangular .hdr or .exr, +Y up, +X at the centre
    #[arg(long, value_name = "FILE")]
    environment: Option<PathBuf>,
    /// Luminance of an environment value of 1, in nits
    #[arg(long, value_name = "NITS", default_value_t = 1.0, requires = "environment", value_parser = not_negative)]
    environment_nits: f32,
    /// Stop when further bounces would add less than this share of all light, and in 99 % of the map less than four
    /// times this share of the local light [default: 0.005]
    #[arg(long, value_name = "SHARE", value_parser = not_negative)]
    tolerance: Option<f32>,
    /// Maximum number of bounces; 0 bakes direct light only [default: 64]
    #[arg(long, value_name = "N")]
    bounces: Option<u32>,
    /// Also bounce specular reflection, as if diffuse: adds 0.02 (rough) to 0.09 (smooth) to a dielectric's albedo. For
    /// scenes of `texir fit` or measured base colours; without it surfaces are Lambertian
    #[arg(long)]
    specular: bool,
}

impl Authored {
    /// The panorama of light from far away.
    pub fn environment(&self) -> Option<&PathBuf> {
        self.environment.as_ref()
    }

    /// An option that was given.
    pub fn given(&self) -> Option<&'static str> {
        let given = [
            ("--environment", self.environment.is_some()),
            ("--tolerance", self.tolerance.is_some()),
            ("--bounces", self.bounces.is_some()),
            ("--specular", self.specular),
        ];
        given.into_iter().find(|(_, given)| *given).map(|(option, _)| option)
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary {
    output: PathBuf,
    scene: PathBuf,
    width: usize,
    height: usize,
    /// Texels that were baked, other sides of surfaces included.
    texels: usize,
    /// Texels inside other geometry.
    buried: usize,
    rays: u64,
    /// Mean irradiance of the direct light and of every bounce, lux, over all texels that were baked.
    irradiance_by_bounce: Vec<f64>,
    /// Estimated share of all light that further bounces would add; absent after direct light alone, and where bounces
    /// do not fall off.
    remainder: Option<f64>,
    /// The same of the local light, 99th percentile over squares of the map.
    remainder_p99: f64,
}

/// Errors where the scene with its lightmap's coordinates, whose name nobody gave, would replace another.
fn check_scene(scene: &Path, read: &[&Path]) -> Result<(), Failure> {
    check_outputs(&[scene], read)?;
    if scene.exists() && !is_by_texir(scene) {
        return Err(Failure::new(format!(
            "{}: exists, and texir did not write it; expected room for the scene with its lightmap's coordinates, which goes \
             beside the map",
            scene.display()
        ))
        .help("give --output another name or folder, or move that file away"));
    }
    Ok(())
}

/// Bakes the scene that `bake.input` is; `read` are all files that it is made of.
pub fn run(bake: &Bake, read: &[&Path], session: &Session<'_>) -> Result<(), Failure> {
    let options = &bake.authored;
    let tolerance = options.tolerance.unwrap_or(TOLERANCE);
    check_scene(&bake.output.with_extension("glb"), read)?;
    let environment = options.environment.as_ref().map(|path| read_environment(path, options, session)).transpose()?;
    let reflected = if options.specular { BounceAlbedo::DiffuseAndSpecular } else { BounceAlbedo::Diffuse };
    let mut model = authored::read_gltf(&bake.input, bake.size.unwrap_or(DEFAULT_SIZE), reflected, session.console)?;
    let workspace = |model: &Model| match bake.max_memory {
        Some(limit) => {
            let materials = model.memory() + environment.as_ref().map_or(0, Environment::memory);
            bounce_workspace_within(limit, &bake.partial(), &model.mesh, materials, model.size)
        }
        None => Ok(Workspace::Memory),
    };
    // Errors come before anything is traced; other sides then take their own.
    workspace(&model)?;
    let told = model.find_sides(environment.as_ref(), session.console).context(bake.input.display())?;
    told.iter().for_each(|what| session.console.warn(&format!("{}: {what}", bake.input.display())));
    let workspace = workspace(&model)?;
    let [width, height] = model.lightmap_size();
    let scene = model.scene().context(bake.input.display())?;
    let mut backend = device::open(scene, session)?;
    let (texels, surfaces) =
        prepare(backend.as_mut(), &model, environment, workspace, (bake, session)).inspect_err(|_| bake.clean_up())?;
    let bounces =
        Bounces { quality: bake.quality(session), tolerance, max_bounces: options.bounces.unwrap_or(BOUNCES) };
    let identity = surfaces.identity(backend.as_ref(), &bounces.quality);
    let checkpoints = Checkpoints::open(&bake.partial(), &identity, session.console)?;
    let light = Light { texels, surfaces, bounces };
    let summary = bake_texels(backend.as_mut(), &model, light, &checkpoints, (bake, session))
        .inspect_err(|failure| session.note_resume(failure, &checkpoints, &bake.partial()))?;
    checkpoints.finish();
    session.print(&summary, || {
        let bounces = summary.irradiance_by_bounce.len() - 1;
        let left = match summary.remainder {
            Some(total) => {
                // Where light has only begun to arrive, how much more there will be is a guess.
                let worst_region = match summary.remainder_p99 {
                    share if share > 1.0 => "> 100".to_owned(),
                    share => format!("{:.1}", 100.0 * share),
                };
                format!(", {:.2} % of the light missing ({worst_region} % where it is worst)", 100.0 * total)
            }
            None if bounces > 0 => ", not converged".to_owned(),
            None => String::new(),
        };
        format!(
            "{}, {}: {width} × {height}, {} texels, {bounces} bounces{left}",
            summary.output.display(),
            summary.scene.display(),
            summary.texels,
        )
    })
}

/// What is to be solved for.
struct Light {
    texels: Texels<'static>,
    surfaces: Surfaces,
    bounces: Bounces,
}

/// Bakes direct light and bounces, and writes the map and the scene with it.
fn bake_texels(
    backend: &mut dyn Backend,
    model: &Model,
    light: Light,
    checkpoints: &Checkpoints,
    (bake, session): (&Bake, &Session<'_>),
) -> Result<Summary, Failure> {
    let Light { texels, surfaces, bounces } = light;
    let (options, console) = (&bake.authored, session.console);
    let solved = authored::irradiance(backend, &texels, &surfaces, &bounces, checkpoints, console)?;
    let limit = if options.bounces.is_some() { BounceLimit::Wanted } else { BounceLimit::Bound };
    let unfinished = solved.unfinished(model, bounces.tolerance, limit);
    for warning in unfinished.iter().chain(&solved.unlit()) {
        console.warn(&format!("{}: {warning}", bake.input.display()));
    }
    drop(surfaces);
    bake.write(&solved.solution, &texels, model.lightmap_size(), session)?;
    let attached = match bake.profile() {
        moz @ Profile::Moz => Some(moz.lightmap(&model.lightmap(&solved.solution, &texels, bake.buried())?)),
        _ => None,
    };
    let scene = bake.output.with_extension("glb");
    write_lightmapped_glb(&scene, &bake.input, model, attached.as_ref())?;
    let [width, height] = model.lightmap_size();
    Ok(Summary {
        output: bake.output.clone(),
        scene,
        width,
        height,
        texels: texels.valid(),
        buried: solved.solution.buried()?,
        rays: solved.solution.rays,
        remainder: Some(solved.remainder.total).filter(|share| share.is_finite()),
        remainder_p99: solved.remainder.worst_region,
        irradiance_by_bounce: solved.series,
    })
}

/// The texels of the map, and what is on them.
fn prepare(
    backend: &mut dyn Backend,
    model: &Model,
    environment: Option<Environment>,
    workspace: Workspace,
    (bake, session): (&Bake, &Session<'_>),
) -> Result<(Texels<'static>, Surfaces), Failure> {
    let texels = bake.map(backend, model.size, workspace, session)?;
    let surfaces = model.surfaces(backend, &texels, environment)?;
    surfaces.check(&texels).context(bake.input.display())?;
    if surfaces.is_dark() {
        return Err(Failure::new(format!("{}: the scene has no light sources", bake.input.display())).help(
            "give materials an emissive factor, add lights (KHR_lights_punctual), or an --environment panorama.hdr",
        ));
    }
    Ok((texels, surfaces))
}

fn read_environment(path: &PathBuf, options: &Authored, session: &Session<'_>) -> Result<Environment, Failure> {
    let mut radiance = read_rgb(path)?;
    let found = sanitise_radiance(&mut radiance, 0.0);
    if !found.is_clean() {
        session.console.warn(&format!("{}: {found}", path.display()));
    }
    radiance.data.iter_mut().flatten().for_each(|v| *v *= options.environment_nits);
    Environment::new(radiance).map_err(|e| Failure::new(format!("{}: {e}", path.display())))
}
