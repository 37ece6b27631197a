//! The fit.
