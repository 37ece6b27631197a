//! The command line end to end: the built binary, run as a user runs it, on a capture of one room made in code.
#![allow(clippy::unwrap_used, reason = "a test may end where it finds something missing")]

mod authored;
mod bad_input;
mod commands;
mod import;
mod interrupt;
mod room;
mod survey;
mod texir;
