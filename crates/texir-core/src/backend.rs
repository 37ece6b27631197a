//! The passes that bake and fit need.
