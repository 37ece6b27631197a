//! `texir`: the command line, thin over the library.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod args;
mod cmd;
mod console;
mod device;
mod failure;
mod figures;
mod report;

use std::process::ExitCode;

use clap::Parser;

use crate::args::{Cli, Config};
use crate::cmd::Session;
use crate::console::{Console, Verbosity};
use crate::failure::Failure;

fn main() -> ExitCode {
    let cli = Cli::parse();
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
    let session = Session { config: &Config::resolve(common)?, console: &console, json: common.json };
    let result = cmd::run(&cli.command, &session);
    console.clear();
    result
}
