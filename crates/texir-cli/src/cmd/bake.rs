//! `texir bake`: irradiance at every texel of the atlas.

mod authored;

use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use clap::{Args, ValueEnum};
use serde::Serialize;
use texir_core::atlas::{self, Atlas};
use texir_core::backend::{Backend, Gather};
use texir_core::bake::{self, BakedTexels, Buried, Denoiser, Quality, Texels, Workspace};
use texir_core::capture::{self, LoadOptions};
use texir_core::checkpoint::Checkpoints;
use texir_core::error::Error;
use texir_core::image_io::{BRIGHTEST_HALF, ImageRows, write_gray};
use texir_core::lightmap::{self, Profile};
use texir_core::lights::Lights;
use texir_core::mesh_io::read_mesh;
use texir_core::outputs::HDR_TEXTURE;
use texir_core::progress::{Progress, Task};
use texir_core::raster::Rgb;
use texir_core::scene::Scene;

use super::tbl;
use crate::args::{bytes, number, rays, side};
use crate::checks::check_outputs;
use crate::device;
use crate::failure::Failure;
use crate::session::Session;

/// Arguments of `texir bake`.
#[derive(Debug, Args)]
pub struct Bake {
    /// Capture folder, a mesh file together with --tbl, or an authored scene: a .glb or .gltf with lights of its own
    input: PathBuf,
    /// HDR texture: the radiance that leaves every texel of the mesh
    #[arg(long, value_name = "FILE")]
    tbl: Option<PathBuf>,
    /// Irradiance map (.exr, .hdr or .ktx2): E = ∫ L cosθ dω, divided by π only with some --profile; for an authored
    /// scene, NAME.glb with the lightmap UVs is written beside it
    #[arg(short, long, value_name = "FILE", default_value = "irradiance.exr")]
    output: PathBuf,
    /// Side of the map, texels [default: the HDR texture's; 1024 for authored scenes]
    #[arg(long, value_name = "N", value_parser = side())]
    size: Option<usize>,
    /// Rays per texel (a maximum with --error): half cosine-distributed, half towards lights; rounded up to a multiple
    /// of 4 (2 with --cosine-only) unless --no-denoise is used without --error and --error-map
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = rays())]
    spp: u32,
    /// Stop sampling a texel once its standard error is below this share of its luminance (0.02: 2 %), before denoising
    #[arg(long, value_name = "SHARE", value_parser = share_of_luminance)]
    error: Option<f32>,
    /// Write the standard error of every texel's luminance, before denoising, as NAME_error.exr beside the map
    #[arg(long)]
    error_map: bool,
    /// Do not aim rays at light sources: noisier near small lamps; best with --no-denoise, since denoising removes some
    /// of the light that few rays find
    #[arg(long)]
    cosine_only: bool,
    /// Skip denoising: unbiased, for measurements or high --spp
    #[arg(long)]
    no_denoise: bool,
    /// Denoise with Intel's Open Image Denoise, which sees the map as a picture, instead of with neighbours on the
    /// surface
    #[cfg(feature = "oidn")]
    #[arg(long, conflicts_with_all = ["no_denoise", "max_memory"])]
    oidn: bool,
    /// Fill up to four texels inside other geometry (floor under a cupboard) from lit neighbours, so that filtering
    /// does not bleed dark into visible texels
    #[arg(long)]
    fill_buried: bool,
    /// Memory limit, such as 2GiB; larger maps are baked in parts, through scratch files beside the output, with
    /// identical results [default: unlimited]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    max_memory: Option<ByteSize>,
    /// Target engine; decides whether a texel holds E or E/π (docs/baking.md) [default: E]
    #[arg(long, value_enum)]
    profile: Option<Engine>,
    #[command(flatten)]
    authored: authored::Authored,
}

/// What `--error` may be.
fn share_of_luminance(text: &str) -> Result<f32, String> {
    let wanted = "a share of a texel's luminance, above 0 and below 1: 0.02 is 2 %";
    number(text, |share| share > 0.0 && share < 1.0, wanted)
}

/// Engines with a convention of their own.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Engine {
    /// E/π, for `lightmap_exposure` 1
    Bevy,
    /// E/π, for LightmapGIData
    Godot,
    /// E/π, for the built-in pipeline
    Unity,
    /// E, for `lightMap`
    Three,
    /// E, attached to the GLB of an authored scene as MOZ_lightmap (Hubs)
    Moz,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary {
    output: PathBuf,
    width: usize,
    height: usize,
    texels: usize,
    /// Texels inside other geometry.
    buried: usize,
    rays: u64,
}

impl Bake {
    /// Bakes and writes the map.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let quality = self.quality(session);
        lightmap::check_extension(&self.output)?;
        if !self.input.exists() {
            return Err(Failure::new(format!("{}: no such file or folder", self.input.display())));
        }
        let read: Vec<&Path> = [Some(&self.input), self.tbl.as_ref(), self.authored.environment()]
            .into_iter()
            .flatten()
            .map(PathBuf::as_path)
            .collect();
        self.check_outputs(&read)?;
        if self.is_authored() {
            return authored::run(self, &read, session);
        }
        if let Some(option) = self.authored.given() {
            return Err(Failure::new(format!(
                "{option} applies only to authored scenes; a capture's HDR texture already contains all light"
            ))
            .help("leave it out"));
        }
        if matches!(self.profile, Some(Engine::Moz)) {
            return Err(Failure::new(
                "--profile moz needs an authored scene, to whose .glb it attaches the map; captures and --tbl write no .glb",
            )
            .help("leave it out: a texel holds the same without it; or bake the .glb of the fit"));
        }
        let (scene, given) = self.load(session)?;
        let mut backend = device::open(scene, session)?;
        let scene = backend.scene().clone();
        let radiance = match given {
            Light::Texture(radiance) => radiance,
            Light::Views(capture) => tbl::build(backend.as_mut(), &capture, self.size, session)?.radiance,
        };
        let size @ [width, height] = self.size.map_or([radiance.width, radiance.height], |side| [side, side]);
        let workspace = match self.max_memory {
            Some(limit) => bake::workspace_within(limit, &self.partial(), scene.mesh(), radiance.data.len(), size)?,
            None => Workspace::Memory,
        };
        let shining = Atlas::new(backend.as_mut(), radiance.size())?;
        let lights = Lights::find(&scene, &shining, &radiance)?;
        drop(shining);
        backend.set_tbl(&radiance, &lights)?;
        let identity = bake::identity(backend.as_ref(), (&radiance, &lights), None, size, &quality);
        drop(radiance);
        let texels = self.map(backend.as_mut(), size, workspace, session).inspect_err(|_| self.clean_up())?;
        let checkpoints = Checkpoints::open(&self.partial(), &identity, session.console)?;
        let summary = self
            .bake(backend.as_mut(), texels, &quality, &checkpoints, session)
            .inspect_err(|failure| session.note_resume(failure, &checkpoints, &self.partial()))?;
        checkpoints.finish();
        let Summary { texels: valid, rays, .. } = summary;
        session.print(&summary, || {
            let mean = rays as f64 / valid as f64;
            format!("{}: {width} × {height}, {valid} texels, {mean:.0} rays each", summary.output.display())
        })
    }

    /// The texels of the map, with a warning where charts lie too close together in it.
    fn map(
        &self,
        backend: &mut dyn Backend,
        size: [usize; 2],
        workspace: Workspace,
        session: &Session<'_>,
    ) -> Result<Texels<'static>, Failure> {
        let texels = Texels::map(backend, size, workspace, session.console)?;
        let crowded = atlas::crowded(backend, size)?;
        crowded.iter().for_each(|what| session.console.warn(&format!("{}: {what}", self.input.display())));
        Ok(texels)
    }

    /// Where a bake ends before any step was kept: the folder of the steps, if it is there for files without a name, is
    /// empty.
    fn clean_up(&self) {
        // It may well not be there.
        let _ = std::fs::remove_dir(self.partial());
    }

    /// Bakes the light that the backend has, and writes the map.
    fn bake(
        &self,
        backend: &mut dyn Backend,
        texels: Texels<'_>,
        quality: &Quality,
        checkpoints: &Checkpoints,
        session: &Session<'_>,
    ) -> Result<Summary, Failure> {
        let solution = bake::bake_texels(backend, &texels, quality, checkpoints, session.console)?;
        self.write(&solution, &texels, texels.size(), session)?;
        let [width, height] = texels.size();
        Ok(Summary {
            output: self.output.clone(),
            width,
            height,
            texels: texels.valid(),
            buried: solution.buried()?,
            rays: solution.rays,
        })
    }

    /// Errors where the map, or what `--error-map` writes, would replace what it is made of.
    fn check_outputs(&self, inputs: &[impl AsRef<Path>]) -> Result<(), Failure> {
        check_outputs(&[&self.output], inputs)?;
        if self.error_map { check_outputs(&[&self.standard_error()], inputs) } else { Ok(()) }
    }

    /// How many rays, and what becomes of their noise.
    fn quality(&self, session: &Session<'_>) -> Quality {
        // Two halves of each kind of rays, where noise is told from what they differ by.
        let kinds = if self.cosine_only { 1 } else { 2 };
        let halved = self.error.is_some() || self.error_map || !self.no_denoise;
        let rays = if halved { self.spp.next_multiple_of(2 * kinds) } else { self.spp };
        let light = if self.cosine_only { 0 } else { rays / 2 };
        let gather = Gather::new(rays - light, light, session.config.fit.seed);
        let error = self.error.or(self.error_map.then_some(0.0));
        Quality { gather, error, denoise: self.denoiser() }
    }

    /// What removes the noise.
    fn denoiser(&self) -> Option<Denoiser> {
        #[cfg(feature = "oidn")]
        if self.oidn {
            return Some(Denoiser::OpenImageDenoise);
        }
        (!self.no_denoise).then_some(Denoiser::Regression)
    }

    /// Writes the map, the first rows of all that was baked, and what `--error-map` asks for, some rows at a time.
    fn write(
        &self,
        solution: &BakedTexels,
        texels: &Texels<'_>,
        size: [usize; 2],
        session: &Session<'_>,
    ) -> Result<(), Failure> {
        let (scale, console) = (self.profile().scale(), session.console);
        let ends_at_half = self.output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("ktx2"));
        let task = Task::start(console, "map", (size[0] * size[1]) as u64, "texels");
        let map = ImageRows::new(size, |rows| {
            console.check()?;
            console.advance((rows.len() * size[0]) as u64);
            let first = rows.start;
            let irradiance = solution.map_rows(texels, self.buried(), rows)?;
            if let Some(i) = irradiance.iter().position(|e| !e.iter().all(|v| v.is_finite())) {
                return Err(Error::invalid(format!(
                    "irradiance overflows at the texel in column {}, row {}: {:?}; expected radiance below about 1e30",
                    i % size[0],
                    first + i / size[0],
                    irradiance[i]
                )));
            }
            let texels: Vec<[f32; 3]> = irradiance.into_iter().map(|e| e.map(|v| v * scale)).collect();
            if ends_at_half && texels.iter().flatten().any(|v| *v > BRIGHTEST_HALF) {
                console.warn(&format!(
                    "{}: some texels exceed {BRIGHTEST_HALF}, the maximum of .ktx2 half floats, and are clamped to it; write .exr, \
                     or scale the scene's light down",
                    self.output.display()
                ));
            }
            Ok(texels)
        });
        let written = lightmap::write_lightmap(&self.output, map);
        console.check()?;
        written?;
        drop(task);
        self.write_standard_error(ImageRows::new(size, |rows| {
            Ok(solution.error_rows(texels, rows)?.into_iter().map(|e| [e * scale]).collect())
        }))
    }

    /// Writes what `--error-map` asks for, in the unit of the map.
    fn write_standard_error(&self, errors: ImageRows<'_, 1>) -> Result<(), Failure> {
        if self.error_map {
            write_gray(self.standard_error(), errors)?;
        }
        Ok(())
    }

    /// Where `--error-map` writes.
    fn standard_error(&self) -> PathBuf {
        let stem = self.output.file_stem().unwrap_or_default().to_string_lossy();
        self.output.with_file_name(format!("{stem}_error.exr"))
    }

    /// Where the results so far lie while the bake runs: beside the output.
    fn partial(&self) -> PathBuf {
        let mut name = self.output.as_os_str().to_owned();
        name.push(".partial");
        name.into()
    }

    /// Whether the input brings its own light: a glTF file without an HDR texture.
    fn is_authored(&self) -> bool {
        let extension = self.input.extension().unwrap_or_default().to_ascii_lowercase();
        self.tbl.is_none() && !self.input.is_dir() && (extension == "glb" || extension == "gltf")
    }

    fn buried(&self) -> Buried {
        if self.fill_buried { Buried::Fill } else { Buried::Keep }
    }

    fn profile(&self) -> Profile {
        self.profile.map_or(Profile::Irradiance, |engine| match engine {
            Engine::Bevy => Profile::Bevy,
            Engine::Godot => Profile::Godot,
            Engine::Unity => Profile::Unity,
            Engine::Three => Profile::Three,
            Engine::Moz => Profile::Moz,
        })
    }

    fn load(&self, session: &Session<'_>) -> Result<(Scene, Light), Failure> {
        if self.input.is_dir() {
            let options = LoadOptions { mesh: None, tbl: self.tbl.clone() };
            let capture = capture::load(&self.input, &options, session.console)?;
            // A map of irradiance by this name would be read as the capture's own light.
            let texture = capture.root.join(HDR_TEXTURE);
            self.check_outputs(&[&capture.files()[..], &[texture]].concat())?;
            let scene = Scene::new(capture.mesh.clone())?;
            let light = match &capture.tbl {
                Some(texture) => Light::Texture(capture::Tbl::read(texture, session.console)?.radiance),
                None => Light::Views(Box::new(capture)),
            };
            return Ok((scene, light));
        }
        let Some(texture) = &self.tbl else {
            return Err(Failure::new(format!("{}: a mesh alone has no light to gather", self.input.display()))
                .help("add --tbl hdr_texture.exr, or give a capture folder"));
        };
        let file = read_mesh(&self.input)?;
        file.warnings.iter().for_each(|warning| session.console.warn(warning));
        let tbl = capture::Tbl::read(texture, session.console)?;
        Ok((Scene::new(file.mesh)?, Light::Texture(tbl.radiance)))
    }
}

/// Where the light comes from.
enum Light {
    /// A given HDR texture.
    Texture(Rgb),
    /// The HDR texture is to be built from the views.
    Views(Box<capture::Capture>),
}
