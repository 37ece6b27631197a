//! The result as one GLB.
