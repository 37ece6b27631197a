//! Mip-mapped textures.
