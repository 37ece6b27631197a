//! The built-in synthetic flat.
