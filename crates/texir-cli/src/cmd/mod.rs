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

use clap::Subcommand;

use crate::failure::Failure;
use crate::session::Session;

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make a synthetic flat, path-trace it and fit it: everything at once, without any input
    Demo(demo::Demo),
    /// Dry run: report what a capture (or files to import) contains, check cameras, images and atlas, estimate a fit's
    /// cost
    Inspect(inspect::Inspect),
    /// Merge bracketed exposures of one view to a linear image
    Hdr(hdr::Hdr),
    /// Convert other programs' output to a capture: COLMAP, nerfstudio, Blender, glTF, Matterport3D, lists of
    /// panoramas, ...
    Import(import::Import),
    /// Build the HDR texture (texture-based lighting) of a capture from its views
    Tbl(tbl::Tbl),
    /// Bake irradiance: what light arrives at every texel of the atlas
    Bake(bake::Bake),
    /// Fit materials to a capture: albedo, roughness, irradiance, a GLB, figures and a report
    Fit(fit::Fit),
    /// Fit with parts of the method disabled and compare the results (ablation study)
    Ablate(ablate::Ablate),
    /// Render the result of a fit from other cameras
    Render(render::Render),
    /// Compare a fit with ground truth, next to the scores of the true materials
    Eval(eval::Eval),
    /// Rewrite a fit's scene.glb from its current textures, after editing them
    Export(export::Export),
    /// Write one self-contained HTML page about a fit
    Report(report::Report),
    /// Measure how fast this machine traces rays, by size of mesh and atlas
    Bench(bench::Bench),
}

impl Command {
    /// Whether it reads what a fit is set to.
    fn fits(&self) -> bool {
        matches!(self, Self::Demo(_) | Self::Inspect(_) | Self::Fit(_) | Self::Ablate(_))
    }
}

/// Runs a command.
pub fn run(command: &Command, session: &Session<'_>) -> Result<(), Failure> {
    if !command.fits() {
        session.config.check_set_without_fit()?;
    }
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
