//! One file per command.

use clap::Subcommand;

use crate::args::Config;
use crate::console::Console;
use crate::failure::Failure;

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// A
    Inspect { path: std::path::PathBuf },
}

/// Runs a command.
pub fn run(_command: &Command, _config: &Config, _json: bool, _console: &Console) -> Result<(), Failure> {
    Ok(())
}
