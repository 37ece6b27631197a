//! `texir inspect`: a dry run. What was found in a capture and what is assumed of it, whether its cameras and its atlas
//! make sense, and what a fit will cost.

mod findings;
mod text;
mod warnings;

use std::path::PathBuf;

use clap::Args;
use texir_core::capture::Capture;
use texir_core::capture::import;
use texir_core::cpu::CpuBackend;
use texir_core::scene::Scene;

use self::findings::{Findings, Origin};
use super::import::SourceArgs;
use super::overlay;
use crate::args::{CaptureArgs, FolderArgs};
use crate::checks::check_folder;
use crate::failure::Failure;
use crate::session::Session;

/// Rows of the table of cameras, unless all are asked for.
const ROWS: usize = 30;

/// Arguments of `texir inspect`.
#[derive(Debug, Args)]
pub struct Inspect {
    #[command(flatten)]
    capture: CaptureArgs,
    #[command(flatten)]
    source: SourceArgs,
    /// Write every view with the mesh's edges drawn over it; edges that miss the photo's show a wrong pose, scale or
    /// mesh
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
}

impl Inspect {
    /// Looks, and says what was seen.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let (capture, origin) = self.open(session)?;
        if let Some(folder) = &self.overlay {
            if !origin.is_capture {
                return Err(Failure::new(
                    "--overlay needs a capture: lenses and 8-bit images have to be converted first",
                )
                .help("make one with `texir import`"));
            }
            check_folder(folder, &capture.files())?;
            let mut backend = CpuBackend::new(Scene::new(capture.mesh.clone())?);
            overlay::write(&mut backend, &capture.views, folder, session.console)?;
        }
        let findings = Findings::of(&capture, origin, session)?;
        let rows = if session.console.is_verbose() { usize::MAX } else { ROWS };
        session.print(&findings, || text::text(&findings, rows))
    }

    /// A capture as every command loads it; other programs' files as they would be after an import.
    fn open(&self, session: &Session<'_>) -> Result<(Capture, Origin), Failure> {
        let FolderArgs { capture: folder, mesh } = &self.capture.folder;
        if !self.source.any_given() && import::is_capture(folder)? {
            return Ok((self.capture.load(session)?, Origin::of_capture()));
        }
        let source = import::read(folder, &self.source.options(mesh.clone()), session.console)?;
        Ok((source.preview(), Origin::of_import(&source)))
    }
}
