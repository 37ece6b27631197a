//! Texture-based lighting from the views.
