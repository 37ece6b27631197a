//! Ctrl-C: the run stops soon, says so by its exit code, leaves no output, and can be taken up again.
#![cfg(unix)]

use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::room::Capture;
use crate::texir::{command, succeed};

/// Stops a fit with `settings` as soon as `step` is kept, takes it up again, and compares with a fit that was not
/// stopped.
fn interrupt(settings: &[&str], step: &str) -> (Capture, PathBuf) {
    let capture = Capture::new();
    let (input, out, whole) = (capture.path(), capture.out("out"), capture.out("whole"));
    let fit = |out: &Path| -> Vec<OsString> {
        let always = ["--backend", "cpu", "--no-eval", "--set", "fit.atlas_size=64"];
        let named: [&OsStr; 4] = ["fit".as_ref(), input.as_ref(), "-o".as_ref(), out.as_ref()];
        named.into_iter().chain(always.iter().chain(settings).map(OsStr::new)).map(OsStr::to_owned).collect()
    };
    let mut child = command(&fit(&out)).stderr(Stdio::piped()).spawn().unwrap();
    while !capture.out("out.partial").join(step).exists() {
        assert!(child.try_wait().unwrap().is_none(), "the fit ended without keeping a step");
        std::thread::sleep(Duration::from_millis(2));
    }
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let said: Vec<String> = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said:?}");
    assert!(said.iter().any(|line| line.contains("interrupted")), "{said:?}");
    assert_eq!(capture.outputs(), ["out.partial"]);

    succeed(&fit(&out));
    succeed(&fit(&whole));
    assert_eq!(capture.outputs(), ["out", "whole"], "the kept steps are gone");
    for file in ["albedo.exr", "roughness.exr", "irradiance.exr"] {
        let [resumed, uninterrupted] = [&out, &whole].map(|folder| std::fs::read(folder.join(file)).unwrap());
        assert!(resumed == uninterrupted, "{file} differs");
    }
    (capture, out)
}

#[test]
fn an_interrupted_fit_leaves_no_output_and_goes_on_to_the_same_bits() {
    interrupt(&["--set", "fit.full.lobe_samples=256"], "round-1-view-0.safetensors");
}

#[test]
fn an_interrupted_fit_in_paper_mode_goes_on_with_the_next_epoch() {
    let (_capture, out) =
        interrupt(&["--mode", "paper", "--set", "fit.paper.optimiser.epochs=100"], "stage-I.safetensors");
    let epochs = std::fs::read_to_string(out.join("log.jsonl")).unwrap().lines().count();
    assert_eq!(epochs, 300, "the log has the epochs of both runs");
}
