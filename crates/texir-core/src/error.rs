//! The one error type of the crate: it names the file, the field and the value, and says what to do.

use std::path::{Path, PathBuf};

/// What went wrong, in words a user can act on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read, parsed or written.
    #[error("{}: {what}", path.display())]
    File {
        /// The offending file.
        path: PathBuf,
        /// What is wrong with it: field, value found, value expected, what to do.
        what: String,
    },
    /// Input that is not tied to one file is unusable: an empty mesh, a setting out of range.
    #[error("{0}")]
    Invalid(String),
    /// The device that runs the passes failed, or cannot run them.
    #[error("{0}")]
    Device(String),
    /// The caller asked to stop through [`crate::progress::Progress::cancelled`].
    #[error("interrupted")]
    Cancelled,
}

impl Error {
    /// An error about one file.
    pub fn file(path: impl AsRef<Path>, what: impl std::fmt::Display) -> Self {
        Self::File { path: path.as_ref().to_owned(), what: what.to_string() }
    }

    /// A file could not be read, for a reason that its reader gives.
    pub(crate) fn cannot_read(path: impl AsRef<Path>, reason: impl std::fmt::Display) -> Self {
        Self::file(path, format!("cannot be read: {reason}"))
    }

    /// A file could not be written, for a reason that its writer gives.
    pub(crate) fn cannot_write(path: impl AsRef<Path>, reason: impl std::fmt::Display) -> Self {
        Self::file(path, format!("cannot be written: {reason}"))
    }

    /// An error about input that is not one file.
    pub fn invalid(what: impl std::fmt::Display) -> Self {
        Self::Invalid(what.to_string())
    }

    /// A failure of the device behind a [`crate::backend::Backend`].
    pub fn device(what: impl std::fmt::Display) -> Self {
        Self::Device(what.to_string())
    }
}

/// Result with the crate's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Names in one message.
const NAMED: usize = 5;

/// The first of some names, and how many more there are.
pub(crate) fn listed(names: &[String]) -> String {
    match names.split_at_checked(NAMED) {
        Some((first, more @ [_, ..])) => format!("{} and {} more", first.join(", "), more.len()),
        _ => names.join(", "),
    }
}
