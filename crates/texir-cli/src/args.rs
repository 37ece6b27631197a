//! Arguments that several commands have.

use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use clap::Args;
use clap::builder::{RangedI64ValueParser, RangedU64ValueParser};
use texir_core::atlas::MAX_SIDE;
use texir_core::backend::MAX_SAMPLES;
use texir_core::capture::{self, Capture, LoadOptions};

use crate::failure::Failure;
use crate::session::Session;

/// A capture folder, and another mesh for it.
#[derive(Clone, Debug, Args)]
pub struct FolderArgs {
    /// Capture folder: transforms.json, mesh.obj, .glb or .ply, HDR images
    pub capture: PathBuf,
    /// Use this mesh instead of the folder's
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
}

impl FolderArgs {
    /// Reads the folder, with another HDR texture for its own where one is given.
    pub fn load(&self, tbl: Option<&Path>, session: &Session<'_>) -> Result<Capture, Failure> {
        let options = LoadOptions { mesh: self.mesh.clone(), tbl: tbl.map(Path::to_owned) };
        Ok(capture::load(&self.capture, &options, session.console)?)
    }
}

/// A capture folder, and what overrides its content.
#[derive(Clone, Debug, Args)]
pub struct CaptureArgs {
    #[command(flatten)]
    pub folder: FolderArgs,
    /// Use this HDR texture instead of the folder's
    #[arg(long, value_name = "FILE")]
    pub tbl: Option<PathBuf>,
}

impl CaptureArgs {
    /// Whether parts of the folder are replaced.
    pub fn is_overridden(&self) -> bool {
        self.folder.mesh.is_some() || self.tbl.is_some()
    }

    /// Reads the folder.
    pub fn load(&self, session: &Session<'_>) -> Result<Capture, Failure> {
        self.folder.load(self.tbl.as_deref(), session)
    }
}

/// A size of memory, as options have it.
pub fn bytes(text: &str) -> Result<ByteSize, String> {
    text.parse().map_err(|_| "expected a number with its unit, such as 512MiB, 2GiB or 1.5GB".to_owned())
}

/// A number that is wanted finite and at least 0, as options have it.
pub fn not_negative(text: &str) -> Result<f32, String> {
    number(text, |value| (0.0..f32::INFINITY).contains(&value), "a number of at least 0")
}

/// A number for which `is_wanted` holds, as options have it; `wanted` says so.
pub fn number(text: &str, is_wanted: impl Fn(f32) -> bool, wanted: &str) -> Result<f32, String> {
    text.parse().ok().filter(|value| is_wanted(*value)).ok_or_else(|| format!("expected {wanted}"))
}

/// Side of a map, texels, as options have it.
pub fn side() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(1..=MAX_SIDE as u64)
}

/// Rays of a texel or a pixel, as options have them: the error of more is far below what images can tell.
pub fn rays() -> RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..=i64::from(MAX_SAMPLES))
}
