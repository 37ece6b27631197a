//! Indices of texels, pixels and groups of them, in 32 bits: half of what `Option<u32>` takes, and there are millions.

/// No texel, no pixel, no group.
pub const NONE: u32 = u32::MAX;
