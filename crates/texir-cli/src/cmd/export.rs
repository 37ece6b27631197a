//! `texir export`: the scene of a fit, with its textures as they are now.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use texir_core::outputs::{FitOutput, SCENE};

use crate::checks::check_outputs;
use crate::failure::Failure;
use crate::session::Session;

/// Arguments of `texir export`.
#[derive(Debug, Args)]
pub struct Export {
    /// Output folder of `texir fit`, whose textures may have been edited since
    #[arg(value_name = "FIT")]
    out: PathBuf,
    /// The scene [default: scene.glb in the folder]
    #[arg(short, long, value_name = "FILE.glb")]
    output: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary {
    scene: PathBuf,
}

impl Export {
    /// Writes the scene.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let scene = self.output.clone().unwrap_or_else(|| self.out.join(SCENE));
        if scene.extension().is_none_or(|e| !e.eq_ignore_ascii_case("glb")) {
            return Err(Failure::new(format!("-o {}: expected a file that ends in .glb", scene.display())));
        }
        let output = FitOutput::load(&self.out, session.console)?;
        check_outputs(&[&scene], &[] as &[PathBuf])?;
        output.write_scene(&scene)?;
        session.print(&Summary { scene: scene.clone() }, || scene.display().to_string())
    }
}
