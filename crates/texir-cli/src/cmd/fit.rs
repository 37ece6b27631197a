//! `texir fit`: from a capture to relightable materials.

use std::io::Write;
use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use clap::{Args, ValueEnum};
use serde::Serialize;
use texir_core::atomic_file::write_atomic;
use texir_core::capture::Capture;
use texir_core::checkpoint::Checkpoints;
use texir_core::eval::{Evaluation, check_sizes};
use texir_core::fit::{self, EpochLog, FitResult};
use texir_core::outputs::{CORRECTIONS, FitOutput, LOG, REPORT, ROOMS, RUN, Run, SCENE, SETTINGS, Staging};
use texir_core::scene::Scene;

use super::corrections::CorrectionArgs;
use super::{eval, report};
use crate::args::{CaptureArgs, bytes};
use crate::checks::check_folder;
use crate::cmd::report::describe;
use crate::config::Config;
use crate::device;
use crate::failure::Failure;
use crate::figures;
use crate::session::Session;

/// Arguments of `texir fit`.
#[derive(Debug, Args)]
pub struct Fit {
    #[command(flatten)]
    capture: CaptureArgs,
    #[command(flatten)]
    corrections: CorrectionArgs,
    /// Folder for textures, scene.glb, metrics and report
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Fitting method: texir's own or the paper's three stages [default: full]
    #[arg(long, value_name = "MODE")]
    mode: Option<Mode>,
    /// Detect segments of bare metal (twice the light samples); otherwise everything is a dielectric
    #[arg(long)]
    metallic: bool,
    /// Memory limit, such as 2GiB; views are read at reduced resolution to stay within it [default: 8GiB]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    max_memory: Option<ByteSize>,
    /// Leave out the evaluation and the report
    #[arg(long)]
    no_eval: bool,
}

/// [`fit::Mode`] as it is typed.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Mode {
    /// Light samples drawn once, robust least squares, a scan over roughness
    Full,
    /// The three stages of TexIR (Li et al. 2023)
    Paper,
}

impl From<Mode> for fit::Mode {
    fn from(mode: Mode) -> Self {
        match mode {
            Mode::Full => Self::Full,
            Mode::Paper => Self::Paper,
        }
    }
}

/// What `--json` prints where nothing is evaluated.
#[derive(Serialize)]
struct Written {
    output: PathBuf,
    scene: PathBuf,
}

impl Fit {
    /// Fits, evaluates, reports.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let mut config = session.config.clone();
        config.fit.mode = self.mode.map_or(config.fit.mode, fit::Mode::from);
        config.fit.full.metallic.enabled |= self.metallic;
        config.fit.max_memory = self.max_memory.unwrap_or(config.fit.max_memory);
        config.fit.validate()?;
        config.check_set()?;
        let session = &Session { config: &config, ..*session };
        let staging = Staging::new(&self.output)?;
        let mut capture = self.capture.load(session)?;
        check_folder(&self.output, &capture.files())?;
        if !self.no_eval {
            check_sizes(&capture)?;
        }
        if let Some(corrections) = self.corrections.apply(&mut capture, session)? {
            corrections.write(&staging.folder().join(CORRECTIONS))?;
        }
        let output = write(staging, &capture, session)?;
        if self.no_eval {
            let written = Written { output: self.output.clone(), scene: self.output.join(SCENE) };
            return session.print(&written, || written.output.display().to_string());
        }
        let evaluation = evaluate(&self.output, &output, &capture, eval::RAYS, session)?;
        session
            .print(&evaluation, || format!("{}\n\n{}", figures::text(&evaluation), self.output.join(REPORT).display()))
    }
}

/// Evaluates what was fitted, beside it; where that is stopped, says how it goes on.
pub fn evaluate(
    out: &Path,
    output: &FitOutput,
    capture: &Capture,
    rays: u32,
    session: &Session<'_>,
) -> Result<Evaluation, Failure> {
    report::publish(out, output, capture, rays, session).inspect_err(|_| {
        let what = format!("the fit is saved; run texir report {} to evaluate it", out.display());
        session.console.note(&format!("{:>24}  {what}", "not evaluated"));
    })
}

/// Fits a capture and puts the result where `staging` leads.
pub fn write(staging: Staging, capture: &Capture, session: &Session<'_>) -> Result<FitOutput, Failure> {
    session.console.note(&format!("{:>24}  {}", "capture", describe(capture)));
    let mut backend = device::open(Scene::new(capture.mesh.clone())?, session)?;
    let mut log: Vec<EpochLog> = Vec::new();
    let fitting = &session.config.fit;
    let partial = staging.partial();
    let checkpoints =
        Checkpoints::open(&partial, &fit::identity(capture, fitting, backend.as_ref())?, session.console)?;
    let FitResult { textures, confidence, tbl, plan, timings } =
        fit::fit(backend.as_mut(), capture, fitting, &checkpoints, session.console, &mut |epoch| log.push(*epoch))
            .map_err(Failure::from)
            .inspect_err(|failure| session.note_resume(failure, &checkpoints, &partial))?;
    let run = Run {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        capture: absolute(&capture.root),
        backend: backend.name(),
        timings,
    };
    drop(backend);
    let output = FitOutput { mesh: capture.mesh.clone(), tbl, textures, confidence };
    let folder = &staging.folder();
    output.save(folder)?;
    output.write_scene(&folder.join(SCENE))?;
    let cameras: Vec<_> = capture.views.iter().map(|v| v.camera.position()).collect();
    plan.write_png(&folder.join(ROOMS), &cameras)?;
    let settings = settings(session.config)?;
    write_atomic(folder.join(SETTINGS), |sink| sink.write_all(settings.as_bytes()))?;
    write_atomic(folder.join(LOG), |sink| -> Result<(), serde_json::Error> {
        log.iter().try_for_each(|epoch| {
            serde_json::to_writer(&mut *sink, epoch)?;
            sink.write_all(b"\n").map_err(serde_json::Error::io)
        })
    })?;
    write_atomic(folder.join(RUN), |sink| serde_json::to_writer_pretty(sink, &run))?;
    staging.commit()?;
    checkpoints.finish();
    Ok(output)
}

/// `config` as `settings.toml` holds it.
pub fn settings(config: &Config) -> Result<String, Failure> {
    toml::to_string_pretty(config).map_err(|e| Failure::new(format!("the settings have no TOML form: {e}")))
}

/// The path as it will be found from anywhere.
pub fn absolute(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}
