//! Mesh files in.
