//! One file per command, each thin: arguments → library → what the user is told.

mod ablate;
mod bake;
mod bench;
mod corrections;
mod demo;
mod eval;
mod export;
mod fit;
mod hdr;
mod import;
mod inspect;
mod overlay;
mod render;
mod report;
mod tbl;

use std::io::Write;
use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use clap::builder::RangedI64ValueParser;
use clap::{Args, Subcommand};
use serde::Serialize;
use texir_core::atlas::LARGEST_SIDE;
use texir_core::backend::MOST_SAMPLES;
use texir_core::capture::{self, Capture, LoadOptions, Split};
use texir_core::checkpoint::Checkpoints;
use texir_core::error::Error;
use texir_core::render::Textures;

use crate::args::Config;
use crate::console::Console;
use crate::failure::Failure;

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make a synthetic flat, path-trace it and fit it: everything at once, without any input
    Demo(demo::Demo),
    /// Dry run: what is found in a capture (or in what import would make one of) and assumed of it, checks of cameras
    /// and atlas, cost of a fit
    Inspect(inspect::Inspect),
    /// Merge bracketed exposures of one view to a linear image
    Hdr(hdr::Hdr),
    /// Make a capture of what other programs write: COLMAP, nerfstudio, Blender, Matterport3D, lists of panoramas, ...
    Import(import::Import),
    /// Build the HDR texture (texture-based lighting) of a capture from its views
    Tbl(tbl::Tbl),
    /// Bake irradiance: what light arrives at every texel of the atlas
    Bake(bake::Bake),
    /// Fit materials to a capture: albedo, roughness, irradiance, a GLB, figures and a report
    Fit(fit::Fit),
    /// Fit with parts of the method left out, and compare: what each is worth on a capture
    Ablate(ablate::Ablate),
    /// Render the result of a fit from other cameras
    Render(render::Render),
    /// Compare the result of a fit with the truth, beside what true materials would reach
    Eval(eval::Eval),
    /// Write the scene of a fit anew, with its textures as they are now: after they were edited
    Export(export::Export),
    /// Write one self-contained HTML page about a fit
    Report(report::Report),
    /// Measure how fast this machine traces rays, by size of mesh and atlas
    Bench(bench::Bench),
}

/// What every command gets.
pub struct Session<'a> {
    /// Settings: the file's, under the typed ones.
    pub config: &'a Config,
    /// Where progress is shown.
    pub console: &'a Console,
    /// Results are printed as JSON.
    pub json: bool,
}

impl Session<'_> {
    /// Prints a result on standard output.
    fn print(&self, result: &impl Serialize, text: impl FnOnce() -> String) -> Result<(), Failure> {
        let text = if self.json {
            serde_json::to_string_pretty(result)
                .map_err(|e| Failure::new(format!("the result has no JSON form: {e}")))?
        } else {
            text()
        };
        match writeln!(std::io::stdout().lock(), "{text}") {
            // Whoever reads has read enough.
            Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
            Err(e) => Err(Failure::new(format!("the result cannot be written to standard output: {e}"))),
            Ok(()) => Ok(()),
        }
    }
}

/// Runs a command.
pub fn run(command: &Command, session: &Session<'_>) -> Result<(), Failure> {
    match command {
        Command::Demo(command) => command.run(session),
        Command::Inspect(command) => command.run(session),
        Command::Hdr(command) => command.run(session),
        Command::Import(command) => command.run(session),
        Command::Tbl(command) => command.run(session),
        Command::Bake(command) => command.run(session),
        Command::Fit(command) => command.run(session),
        Command::Ablate(command) => command.run(session),
        Command::Render(command) => command.run(session),
        Command::Eval(command) => command.run(session),
        Command::Export(command) => command.run(session),
        Command::Report(command) => command.run(session),
        Command::Bench(command) => command.run(session),
    }
}

/// A size of memory, as options have it.
fn bytes(text: &str) -> Result<ByteSize, String> {
    text.parse().map_err(|_| "expected a number with its unit, such as 512MiB, 2GiB or 1.5GB".to_owned())
}

/// Rays of a texel or a pixel, as options have them: the error of more is far below what images can tell.
fn rays() -> RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..=i64::from(MOST_SAMPLES))
}

/// What becomes of kept steps after an error: it is said where they are when a run was stopped; nothing stays where none
/// is kept.
fn goes_on(e: &Error, checkpoints: &Checkpoints, partial: &Path, session: &Session<'_>) {
    match (checkpoints.any(), e) {
        (false, _) => checkpoints.clone().finish(),
        (true, Error::Cancelled) => {
            session.console.note(&format!("{:>24}  {}", "to go on, run it again", partial.display()));
        }
        (true, _) => {}
    }
}

fn same(a: &Path, b: &Path) -> bool {
    a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b))
}

/// Errors where a folder that is to be written to has files that are read: before any work.
fn check_folder(folder: &Path, inputs: &[PathBuf]) -> Result<(), Failure> {
    let inside = |input: &&PathBuf| input.parent().is_some_and(|parent| same(parent, folder));
    inputs.iter().find(inside).map_or(Ok(()), |input| {
        let input = input.file_name().unwrap_or_default().display();
        Err(Failure::new(format!("{}: has {input} in it, which the output is made of", folder.display()))
            .help("give another folder, or one that does not exist yet"))
    })
}

/// Errors where a file that is to be written is one that is read, or a folder: before any work.
fn check_outputs(outputs: &[&Path], inputs: &[impl AsRef<Path>]) -> Result<(), Failure> {
    for output in outputs {
        if inputs.iter().any(|input| same(output, input.as_ref())) {
            return Err(Failure::new(format!("{}: the output would replace what it is made of", output.display()))
                .help("give --output another name or folder"));
        }
        if output.is_dir() {
            return Err(Failure::new(format!("{}: this is a folder; expected the name of a file", output.display()))
                .help("give --output another name"));
        }
    }
    Ok(())
}

/// Errors where what is written as OpenEXR alone is to have another ending.
fn check_exr(output: &Path) -> Result<(), Failure> {
    if output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr")) {
        return Ok(());
    }
    Err(Failure::new(format!("{}: the output is an OpenEXR; expected a name that ends in .exr", output.display())))
}

/// Errors where a map is to have a side that no map can have.
fn check_side(size: usize) -> Result<(), Failure> {
    if (1..=LARGEST_SIDE).contains(&size) {
        return Ok(());
    }
    Err(Failure::new(format!("--size is {size}; it must be at least 1 and at most {LARGEST_SIDE}")))
}

/// A capture folder, and what overrides its content.
#[derive(Clone, Debug, Args)]
pub struct CaptureArgs {
    /// Capture folder: transforms.json, mesh.obj, .glb or .ply, HDR images
    capture: PathBuf,
    /// Use this mesh instead of the folder's
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    /// Use this HDR texture instead of the folder's
    #[arg(long, value_name = "FILE")]
    tbl: Option<PathBuf>,
}

impl CaptureArgs {
    /// Whether parts of the folder are replaced.
    fn is_overridden(&self) -> bool {
        self.mesh.is_some() || self.tbl.is_some()
    }

    fn load(&self, session: &Session<'_>) -> Result<Capture, Failure> {
        let options = LoadOptions { mesh: self.mesh.clone(), tbl: self.tbl.clone() };
        Ok(capture::load(&self.capture, &options, session.console)?)
    }
}

/// A capture in a line.
fn describe(capture: &Capture) -> String {
    let of = |split| capture.views(split).count();
    let sizes: Vec<(usize, usize)> = capture.views.iter().map(|v| (v.camera.width, v.camera.height)).collect();
    let size = match sizes.first() {
        Some(first) if sizes.iter().all(|s| s == first) => format!("{} × {}", first.0, first.1),
        _ => "mixed sizes".to_owned(),
    };
    format!(
        "{} training and {} novel views of {size}, {} triangles",
        of(Split::Train),
        of(Split::Novel),
        capture.mesh.triangles.len()
    )
}

/// A fit's result in a line.
fn describe_textures(textures: &Textures) -> String {
    format!("a {} × {} atlas", textures.albedo.width, textures.albedo.height)
}
