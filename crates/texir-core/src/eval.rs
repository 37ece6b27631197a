//! The evaluation protocol.
