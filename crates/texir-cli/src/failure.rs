//! What a command ends with when it does not succeed: one message, its cause, what to do about it.

use std::fmt;

use miette::Diagnostic;

/// An error on its way to the user.
#[derive(Debug)]
pub struct Failure {
    what: String,
    help: Option<String>,
    source: Option<texir_core::error::Error>,
}

impl Failure {
    /// A failure of the command line itself.
    pub fn new(what: impl fmt::Display) -> Self {
        Self { what: what.to_string(), help: None, source: None }
    }

    /// Adds what to do about it.
    pub fn help(mut self, help: impl fmt::Display) -> Self {
        self.help = Some(help.to_string());
        self
    }

    /// True when the user asked to stop.
    pub fn interrupted(&self) -> bool {
        matches!(self.source, Some(texir_core::error::Error::Cancelled))
    }
}

/// Says what was being done when the library failed.
pub trait Context<T> {
    /// Wraps the error, which becomes the cause, in `doing`.
    fn context(self, doing: impl fmt::Display) -> Result<T, Failure>;
}

impl<T> Context<T> for texir_core::error::Result<T> {
    fn context(self, doing: impl fmt::Display) -> Result<T, Failure> {
        self.map_err(|source| Failure { what: doing.to_string(), help: None, source: Some(source) })
    }
}

impl From<texir_core::error::Error> for Failure {
    fn from(error: texir_core::error::Error) -> Self {
        Self {
            what: error.to_string(),
            help: None,
            source: matches!(error, texir_core::error::Error::Cancelled).then_some(error),
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what)
    }
}

impl std::error::Error for Failure {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.source.as_ref().map(|e| e as _)
    }
}

impl Diagnostic for Failure {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.help.as_ref().map(|h| Box::new(h) as _)
    }
}
