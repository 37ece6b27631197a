//! Arguments that several commands have.

use std::path::PathBuf;

use bytesize::ByteSize;
use clap::Args;
use clap::builder::RangedI64ValueParser;
use texir_core::backend::MOST_SAMPLES;
use texir_core::capture::{self, Capture, LoadOptions};

use crate::failure::Failure;
use crate::session::Session;

/// A capture folder, and what overrides its content.
#[derive(Clone, Debug, Args)]
pub struct CaptureArgs {
    /// Capture folder: transforms.json, mesh.obj, .glb or .ply, HDR images
    pub capture: PathBuf,
    /// Use this mesh instead of the folder's
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
    /// Use this HDR texture instead of the folder's
    #[arg(long, value_name = "FILE")]
    pub tbl: Option<PathBuf>,
}

impl CaptureArgs {
    /// Whether parts of the folder are replaced.
    pub fn is_overridden(&self) -> bool {
        self.mesh.is_some() || self.tbl.is_some()
    }

    /// Reads the folder.
    pub fn load(&self, session: &Session<'_>) -> Result<Capture, Failure> {
        let options = LoadOptions { mesh: self.mesh.clone(), tbl: self.tbl.clone() };
        Ok(capture::load(&self.capture, &options, session.console)?)
    }
}

/// A size of memory, as options have it.
pub fn bytes(text: &str) -> Result<ByteSize, String> {
    text.parse().map_err(|_| "expected a number with its unit, such as 512MiB, 2GiB or 1.5GB".to_owned())
}

/// Rays of a texel or a pixel, as options have them: the error of more is far below what images can tell.
pub fn rays() -> RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..=i64::from(MOST_SAMPLES))
}
