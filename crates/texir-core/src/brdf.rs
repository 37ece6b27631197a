//! The BRDF.
