//! What the user sees while work goes on: progress bars on a terminal, a line every few seconds elsewhere, warnings,
//! and Ctrl-C as a request to stop.

use std::collections::BTreeSet;
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use texir_core::progress::Progress;

use crate::failure::Failure;

/// Exit code after Ctrl-C, as shells have it: 128 + SIGINT.
pub const INTERRUPTED: u8 = 130;

/// Time between two lines of progress where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// A task shorter than this leaves no line behind.
const WORTH_A_LINE: Duration = Duration::from_secs(1);

/// How much is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verbosity {
    /// Errors and warnings.
    Quiet,
    /// Progress and what was found.
    Normal,
    /// Every detail.
    Verbose,
}

/// Standard error as the user sees it. Tasks may nest; the innermost one is shown and advanced.
pub struct Console {
    verbosity: Verbosity,
    terminal: bool,
    cancelled: Arc<AtomicBool>,
    tasks: Mutex<Vec<Task>>,
    warned: Mutex<BTreeSet<String>>,
}

struct Task {
    name: String,
    unit: String,
    bar: ProgressBar,
    started: Instant,
    last_line: Instant,
}

impl Console {
    /// A console that Ctrl-C asks to stop: the first time at the next opportunity, the second time at once.
    pub fn new(verbosity: Verbosity) -> Result<Self, Failure> {
        let cancelled = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&cancelled);
        ctrlc::set_handler(move || {
            if flag.swap(true, Ordering::Relaxed) {
                std::process::exit(INTERRUPTED.into());
            }
            // A closed standard error is no reason to fail.
            let _ = writeln!(std::io::stderr(), "\nstopping … (Ctrl-C again quits at once)");
        })
        .map_err(|e| Failure::new(format!("Ctrl-C cannot be handled: {e}")))?;
        let terminal = std::io::stderr().is_terminal();
        Ok(Self { verbosity, terminal, cancelled, tasks: Mutex::default(), warned: Mutex::default() })
    }

    /// Says something, unless quiet.
    pub fn note(&self, message: &str) {
        if self.verbosity >= Verbosity::Normal {
            self.line(message);
        }
    }

    /// Whether every detail is asked for.
    pub fn is_verbose(&self) -> bool {
        self.verbosity == Verbosity::Verbose
    }

    /// Says a detail, when asked to be verbose.
    pub fn detail(&self, message: &str) {
        if self.is_verbose() {
            self.line(message);
        }
    }

    /// Ends all bars, before an error is shown.
    pub fn clear(&self) {
        self.tasks().drain(..).for_each(|task| task.bar.finish_and_clear());
    }

    /// Writes a line above the bar.
    fn line(&self, message: &str) {
        let print = || {
            let _ = writeln!(std::io::stderr(), "{message}");
        };
        match self.tasks().last() {
            Some(task) => task.bar.suspend(print),
            None => print(),
        }
    }

    fn tasks(&self) -> MutexGuard<'_, Vec<Task>> {
        // Bars hold no invariant that a panic elsewhere could break.
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Progress for Console {
    fn start(&self, task: &str, total: u64, unit: &str) {
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden());
        if self.terminal && self.verbosity >= Verbosity::Normal {
            bar.set_style(style());
            bar.set_prefix(task.to_owned());
            bar.set_message(unit.to_owned());
            bar.set_draw_target(ProgressDrawTarget::stderr());
            bar.enable_steady_tick(Duration::from_millis(250));
        }
        let now = Instant::now();
        let mut tasks = self.tasks();
        if let Some(outer) = tasks.last() {
            outer.bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        tasks.push(Task { name: task.to_owned(), unit: unit.to_owned(), bar, started: now, last_line: now });
    }

    fn advance(&self, done: u64) {
        let mut tasks = self.tasks();
        let Some(task) = tasks.last_mut() else { return };
        task.bar.inc(done);
        if !self.terminal && self.verbosity >= Verbosity::Normal && task.last_line.elapsed() >= LINE_EVERY {
            task.last_line = Instant::now();
            let _ = writeln!(std::io::stderr(), "{}", task.plain_line());
        }
    }

    fn finish(&self) {
        let mut tasks = self.tasks();
        let Some(task) = tasks.pop() else { return };
        task.bar.finish_and_clear();
        let took = task.started.elapsed();
        let outer_shown = self.terminal && self.verbosity >= Verbosity::Normal;
        if let Some(outer) = tasks.last().filter(|_| outer_shown) {
            outer.bar.set_draw_target(ProgressDrawTarget::stderr());
        }
        drop(tasks);
        // What was interrupted is not done.
        if took >= WORTH_A_LINE && !self.cancelled() {
            self.note(&format!("{:>24}  {}", task.name, seconds(took)));
        }
    }

    /// Says it once: a view is read by several steps.
    fn warn(&self, message: &str) {
        if self.warned.lock().unwrap_or_else(PoisonError::into_inner).insert(message.to_owned()) {
            self.line(&format!("warning: {message}"));
        }
    }

    fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

impl Task {
    fn plain_line(&self) -> String {
        let (done, total) = (self.bar.position(), self.bar.length().unwrap_or(0));
        let share = if total > 0 { done as f64 / total as f64 } else { 0.0 };
        let mut line =
            format!("{}: {:.0} %, {} of {} {}", self.name, share * 100.0, count(done), count(total), self.unit);
        if let Some(left) = remaining(self.started.elapsed(), share) {
            line += &format!(", about {} left", seconds(left));
        }
        line
    }
}

/// Time left at the mean rate so far.
fn remaining(elapsed: Duration, share: f64) -> Option<Duration> {
    let total = elapsed.as_secs_f64() / share;
    (share > 0.0 && total.is_finite()).then(|| Duration::from_secs_f64((total - elapsed.as_secs_f64()).max(0.0)))
}

fn style() -> ProgressStyle {
    // The key writers' results are dropped: a bar that cannot be drawn must not stop the work.
    ProgressStyle::with_template("{prefix:>24} [{bar:32}] {percent:>3} %  {done} of {total} {msg}  {left}")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .with_key("done", |state: &ProgressState, out: &mut dyn std::fmt::Write| {
            let _ = out.write_str(&count(state.pos()));
        })
        .with_key("total", |state: &ProgressState, out: &mut dyn std::fmt::Write| {
            let _ = out.write_str(&count(state.len().unwrap_or(0)));
        })
        .with_key("left", |state: &ProgressState, out: &mut dyn std::fmt::Write| {
            if let Some(left) = remaining(state.elapsed(), f64::from(state.fraction())) {
                let _ = write!(out, "{} left", seconds(left));
            }
        })
        .progress_chars("━╸ ")
}

/// A count in three digits or so: 512, 34 k, 1.2 M, 3.4 G.
pub fn count(n: u64) -> String {
    match n {
        0..10_000 => n.to_string(),
        10_000..1_000_000 => format!("{} k", n / 1000),
        1_000_000..1_000_000_000 => format!("{:.1} M", n as f64 / 1e6),
        _ => format!("{:.1} G", n as f64 / 1e9),
    }
}

/// A duration as a person says it: 0.4 s, 12 s, 3 min 20 s.
pub fn seconds(duration: Duration) -> String {
    let s = duration.as_secs_f64();
    match s {
        ..10.0 => format!("{s:.1} s"),
        ..60.0 => format!("{s:.0} s"),
        _ => format!("{} min {:02} s", duration.as_secs() / 60, duration.as_secs() % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_read_well() {
        assert_eq!(count(512), "512");
        assert_eq!(count(34_567), "34 k");
        assert_eq!(count(1_234_567), "1.2 M");
        assert_eq!(count(3_400_000_000), "3.4 G");
        assert_eq!(seconds(Duration::from_millis(420)), "0.4 s");
        assert_eq!(seconds(Duration::from_secs(42)), "42 s");
        assert_eq!(seconds(Duration::from_secs(200)), "3 min 20 s");
    }

    #[test]
    fn the_estimate_is_linear() {
        assert_eq!(remaining(Duration::from_secs(30), 0.25), Some(Duration::from_secs(90)));
        assert_eq!(remaining(Duration::from_secs(30), 0.0), None);
        assert_eq!(remaining(Duration::from_secs(30), 1.0), Some(Duration::ZERO));
    }
}
