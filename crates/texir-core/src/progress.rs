//! Progress and cancellation of long work: the library reports, the host program shows and stops.

use std::fmt;
#[cfg(test)]
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::error::{Error, Result};

/// Receives progress of long work and answers whether to go on. All methods may be called from any thread. Work begins
/// with [`Task::start`], which sees to its end.
pub trait Progress: Sync {
    /// A task of `total` units begins (rays, steps, texels: `unit` says which).
    fn start(&self, task: &str, total: u64, unit: &str);
    /// `done` further units of the current task are finished.
    fn advance(&self, done: u64);
    /// The current task ended.
    fn finish(&self);
    /// A warning that the user must see.
    fn warn(&self, message: &str);
    /// True once the user asked to stop.
    fn cancelled(&self) -> bool;

    /// [`Error::Cancelled`] once the user asked to stop.
    fn check(&self) -> Result<()> {
        if self.cancelled() { Err(Error::Cancelled) } else { Ok(()) }
    }
}

/// A task that goes on until this is dropped, so that an error on the way leaves none behind. Tasks may nest:
/// [`Progress::advance`] is of the innermost one.
#[must_use = "the task ends when this is dropped"]
pub struct Task<'a>(&'a dyn Progress);

impl fmt::Debug for Task<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Task").finish_non_exhaustive()
    }
}

impl<'a> Task<'a> {
    /// Begins a task of `total` units.
    pub fn start(progress: &'a dyn Progress, task: &str, total: u64, unit: &str) -> Self {
        progress.start(task, total, unit);
        Self(progress)
    }
}

impl Drop for Task<'_> {
    fn drop(&mut self) {
        self.0.finish();
    }
}

/// Shows nothing and never cancels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn start(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, _: u64) {}
    fn finish(&self) {}
    fn warn(&self, _: &str) {}
    fn cancelled(&self) -> bool {
        false
    }
}

/// Forwards warnings and cancellation, but reports no task or progress.
pub(crate) struct Uncounted<'a>(pub &'a dyn Progress);

impl Progress for Uncounted<'_> {
    fn start(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, _: u64) {}
    fn finish(&self) {}
    fn warn(&self, message: &str) {
        self.0.warn(message);
    }
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// Appends a suffix to the names of tasks, for passes that run several times for different purposes.
pub struct Named<'a> {
    /// Where it is reported.
    pub progress: &'a dyn Progress,
    /// What follows the name of a task.
    pub of: &'a str,
}

impl fmt::Debug for Named<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Named").field("of", &self.of).finish_non_exhaustive()
    }
}

impl Progress for Named<'_> {
    fn start(&self, task: &str, total: u64, unit: &str) {
        self.progress.start(&format!("{task} {}", self.of), total, unit);
    }
    fn advance(&self, done: u64) {
        self.progress.advance(done);
    }
    fn finish(&self) {
        self.progress.finish();
    }
    fn warn(&self, message: &str) {
        self.progress.warn(message);
    }
    fn cancelled(&self) -> bool {
        self.progress.cancelled()
    }
}

/// Wants to stop once it was asked some times whether to go on.
#[cfg(test)]
pub(crate) struct Impatient {
    patience: usize,
    asked: AtomicUsize,
}

#[cfg(test)]
impl Impatient {
    /// Says `times` that work may go on.
    pub fn after(times: usize) -> Self {
        Self { patience: times, asked: AtomicUsize::new(0) }
    }
}

#[cfg(test)]
impl Progress for Impatient {
    fn start(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, _: u64) {}
    fn finish(&self) {}
    fn warn(&self, _: &str) {}
    fn cancelled(&self) -> bool {
        self.asked.fetch_add(1, Ordering::Relaxed) >= self.patience
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts the tasks that have not ended.
    #[derive(Default)]
    struct Open(AtomicUsize);

    impl Progress for Open {
        fn start(&self, _: &str, _: u64, _: &str) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
        fn advance(&self, _: u64) {}
        fn finish(&self) {
            self.0.fetch_sub(1, Ordering::Relaxed);
        }
        fn warn(&self, _: &str) {}
        fn cancelled(&self) -> bool {
            true
        }
    }

    #[test]
    fn an_error_leaves_no_task_open() {
        let open = Open::default();
        let work = || -> Result<()> {
            let _outer = Task::start(&open, "outer", 2, "steps");
            let named = Named { progress: &open, of: "of it" };
            let _inner = Task::start(&named, "inner", 1, "steps");
            assert_eq!(open.0.load(Ordering::Relaxed), 2);
            open.check()
        };
        assert!(matches!(work(), Err(Error::Cancelled)));
        assert_eq!(open.0.load(Ordering::Relaxed), 0);
    }
}
