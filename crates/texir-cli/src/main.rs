//! `texir`: the command line, thin over the library.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod args;
mod checks;
mod cmd;
mod config;
mod console;
mod device;
mod failure;
mod figures;
mod report;
mod session;

use std::process::ExitCode;

use clap::{Arg, CommandFactory, FromArgMatches, Parser};

use crate::cmd::Command;
use crate::config::{Common, Config};
use crate::console::{Console, Verbosity};
use crate::device::FoundGpu;
use crate::failure::Failure;
use crate::session::Session;

/// Materials and light from posed HDR images of a scanned scene.
#[derive(Debug, Parser)]
#[command(name = "texir", version, propagate_version = true, max_term_width = 100)]
struct Cli {
    /// What to do.
    #[command(subcommand)]
    command: Command,
    /// Options of every command.
    #[command(flatten)]
    common: Common,
}

/// The command line. Negative numbers are values of options: it is these that tell what they expect.
fn command() -> clap::Command {
    let with_negative = |arg: Arg| {
        let is_option = !arg.is_positional() && arg.get_action().takes_values();
        if is_option { arg.allow_negative_numbers(true) } else { arg }
    };
    Cli::command().mut_args(with_negative).mut_subcommands(|command| command.mut_args(with_negative))
}

fn main() -> ExitCode {
    let cli = Cli::from_arg_matches(&command().get_matches()).unwrap_or_else(|error| error.exit());
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.interrupted() => {
            eprintln!("interrupted");
            ExitCode::from(console::INTERRUPTED)
        }
        Err(failure) => {
            eprintln!("{:?}", miette::Report::new(failure));
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<(), Failure> {
    let common = &cli.common;
    let verbosity = match (common.quiet, common.verbose) {
        (true, _) => Verbosity::Quiet,
        (_, true) => Verbosity::Verbose,
        _ => Verbosity::Normal,
    };
    let console = Console::new(verbosity)?;
    let (config, gpu) = (Config::resolve(common)?, FoundGpu::new());
    let session = Session { config: &config, console: &console, gpu: &gpu, json: common.json };
    let result = cmd::run(&cli.command, &session);
    console.clear();
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_consistent() {
        command().debug_assert();
    }
}
