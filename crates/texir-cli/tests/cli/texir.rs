//! Running the binary.

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// What a run said.
#[derive(Debug)]
pub struct Said {
    /// Exit code.
    pub code: Option<i32>,
    /// Standard output.
    pub out: String,
    /// Standard error.
    pub err: String,
}

/// Settings that make a fit of the room in paper mode a matter of a second.
const QUICK: [&str; 8] = [
    "--set",
    "fit.atlas_size=64",
    "--set",
    "fit.paper.optimiser.epochs=2",
    "--set",
    "fit.irradiance_samples=32",
    "--set",
    "fit.paper.specular_samples=4",
];

/// The binary with arguments.
pub fn command<A: AsRef<OsStr>>(arguments: &[A]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_texir"));
    command.args(arguments).env("NO_COLOR", "1").stdin(Stdio::null());
    command
}

/// Runs to the end.
pub fn run<A: AsRef<OsStr>>(arguments: &[A]) -> Said {
    said(&command(arguments).output().unwrap())
}

/// Runs to the end and demands success.
#[track_caller]
pub fn succeed<A: AsRef<OsStr>>(arguments: &[A]) -> Said {
    let said = run(arguments);
    assert_eq!(said.code, Some(0), "{said:#?}");
    said
}

/// What a finished run said.
pub fn said(output: &Output) -> Said {
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    Said { code: output.status.code(), out: text(&output.stdout), err: text(&output.stderr) }
}

/// Text without spaces and without the reporter's bars: it breaks lines at the terminal's width, within paths as well.
fn squeezed(text: &str) -> String {
    text.chars().filter(|c| !c.is_whitespace() && !"│".contains(*c)).collect()
}

impl Said {
    /// Standard error holds all of these.
    #[track_caller]
    pub fn complains(&self, parts: &[&str]) {
        let said = squeezed(&self.err);
        for part in parts {
            assert!(said.contains(&squeezed(part)), "{part:?} is not in: {}", self.err);
        }
    }
}

/// `fit CAPTURE -o OUT` in paper mode, quickly.
pub fn fit(capture: &Path, out: &Path, more: &[&str]) -> Vec<OsString> {
    quickly("fit", capture, out, &[&["--set", "fit.mode=\"paper\""], more].concat())
}

/// A command that fits CAPTURE to OUT, with few texels and rays.
pub fn quickly(command: &str, capture: &Path, out: &Path, more: &[&str]) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = vec![command.into(), capture.into(), "-o".into(), out.into()];
    arguments.extend(QUICK.iter().chain(more).map(OsString::from));
    arguments
}
