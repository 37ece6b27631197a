//! `texir tbl`: the HDR texture of a capture.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use texir_core::backend::Backend;
use texir_core::capture::{self, Capture, Coverage, Split, View};
use texir_core::scene::Scene;
use texir_core::tbl::{self, TblOptions};

use super::corrections::CorrectionArgs;
use crate::args::{FolderArgs, side};
use crate::checks::{check_exr, check_outputs};
use crate::device;
use crate::failure::Failure;
use crate::session::Session;

/// Arguments of `texir tbl`.
#[derive(Debug, Args)]
pub struct Tbl {
    #[command(flatten)]
    folder: FolderArgs,
    #[command(flatten)]
    corrections: CorrectionArgs,
    /// The HDR texture; its coverage mask goes beside it, as NAME_mask.png
    #[arg(short, long, value_name = "FILE", default_value = "hdr_texture.exr")]
    output: PathBuf,
    /// Side of the texture, texels [default: 1024, or 2048 where the training views have more pixels than that has
    /// texels]
    #[arg(long, value_name = "N", value_parser = side())]
    size: Option<usize>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary {
    output: PathBuf,
    width: usize,
    height: usize,
    seen: usize,
    inpainted: usize,
}

impl Tbl {
    /// Builds and writes the texture.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        check_exr(&self.output)?;
        let mut capture = self.folder.load(None, session)?;
        // The one that the folder has is not looked at, and may be made anew.
        capture.tbl = None;
        check_outputs(&[&self.output, &capture::Tbl::mask_path(&self.output)], &capture.files())?;
        self.corrections.apply(&mut capture, session)?;
        let mut backend = device::open(Scene::new(capture.mesh.clone())?, session)?;
        let texture = build(backend.as_mut(), &capture, self.size, session)?;
        texture.write(&self.output)?;
        let count = |coverage| texture.coverage.data.iter().filter(|c| **c == coverage).count();
        let summary = Summary {
            output: self.output.clone(),
            width: texture.radiance.width,
            height: texture.radiance.height,
            seen: count(Coverage::Seen),
            inpainted: count(Coverage::Inpainted),
        };
        session.print(&summary, || {
            let share = 100.0 * summary.seen as f64 / (summary.seen + summary.inpainted).max(1) as f64;
            format!("{}: {share:.1} % of the surface was seen, the rest is inpainted", summary.output.display())
        })
    }
}

/// The texture-based lighting of a capture's training views, with so many texels a side or as many as suit the views.
pub fn build(
    backend: &mut dyn Backend,
    capture: &Capture,
    size: Option<usize>,
    session: &Session<'_>,
) -> Result<capture::Tbl, Failure> {
    let views: Vec<View> = capture.views(Split::Train).cloned().collect();
    let side = size.unwrap_or_else(|| tbl::default_side(&views));
    Ok(tbl::build(backend, &views, [side, side], &TblOptions::default(), session.console)?)
}
