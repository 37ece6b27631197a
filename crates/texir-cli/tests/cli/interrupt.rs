//! Ctrl-C: the run stops soon, says so by its exit code, and leaves nothing behind.
#![cfg(unix)]

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use crate::room::Capture;
use crate::texir::command;

#[test]
fn an_interrupted_fit_leaves_nothing_behind() {
    let capture = Capture::new();
    let (input, out) = (capture.path(), capture.out("out"));
    let arguments = ["fit".as_ref(), input.as_os_str(), "-o".as_ref(), out.as_os_str(), "--backend".as_ref()];
    // Hours of work, had it not been stopped.
    let long = ["cpu", "--mode", "paper", "--set", "fit.atlas_size=64", "--set", "fit.optimiser.epochs=1000000"]
        .map(AsRef::as_ref);
    let mut child = command(&[&arguments[..], &long[..]].concat()).stderr(Stdio::piped()).spawn().unwrap();
    let mut errors = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(errors.any(|line| line.contains("runs on")), "the fit began");
    assert_eq!(capture.outputs().len(), 1, "the staging folder is there: {:?}", capture.outputs());
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let rest: Vec<String> = errors.collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest:?}");
    assert!(rest.iter().any(|line| line.contains("interrupted")), "{rest:?}");
    assert_eq!(capture.outputs(), [""; 0]);
}
