//! What every command gets, and how it says what came out.

use std::io::Write;
use std::path::Path;

use serde::Serialize;
use texir_core::checkpoint::Checkpoints;

use crate::config::Config;
use crate::console::Console;
use crate::device::FoundGpu;
use crate::failure::Failure;

/// What every command gets.
pub struct Session<'a> {
    /// Settings: the file's, under the typed ones.
    pub config: &'a Config,
    /// Where progress is shown.
    pub console: &'a Console,
    /// What runs the passes, once it was sought.
    pub gpu: &'a FoundGpu,
    /// Results are printed as JSON.
    pub json: bool,
}

impl Session<'_> {
    /// Prints a result on standard output.
    pub fn print(&self, result: &impl Serialize, text: impl FnOnce() -> String) -> Result<(), Failure> {
        let text = if self.json {
            serde_json::to_string_pretty(result)
                .map_err(|e| Failure::new(format!("the result has no JSON form: {e}")))?
        } else {
            text()
        };
        match writeln!(std::io::stdout().lock(), "{text}") {
            // Whoever reads has read enough.
            Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
            Err(e) => Err(Failure::new(format!("the result cannot be written to standard output: {e}"))),
            Ok(()) => Ok(()),
        }
    }

    /// What becomes of kept steps after an error: it is said where they are when a run was stopped; nothing stays where
    /// none is kept.
    pub fn note_resume(&self, failure: &Failure, checkpoints: &Checkpoints, partial: &Path) {
        if !checkpoints.any() {
            checkpoints.clone().finish();
        } else if failure.interrupted() {
            self.console.note(&format!("{:>24}  {}", "run again to resume", partial.display()));
        }
    }
}
