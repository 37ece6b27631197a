//! The fit.

pub mod adam;
pub mod settings;
