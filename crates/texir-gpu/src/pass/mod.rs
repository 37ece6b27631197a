//! The host side of every shader: one file per stem. A pass uploads, records, and reads back; when to wait is
//! [`crate::batch`]'s matter.

pub(crate) mod denoise;
pub(crate) mod device;
pub(crate) mod group_loss;
pub(crate) mod irradiance;
pub(crate) mod lookup;
pub(crate) mod mip;
pub(crate) mod primary;
pub(crate) mod project;
pub(crate) mod punctual;
pub(crate) mod radiance_loss;
pub(crate) mod shade;
pub(crate) mod shade_vjp;
pub(crate) mod specular_table;
pub(crate) mod texels;

/// Threads of a workgroup in the passes with one thread per item; their shaders have the same number.
pub(crate) const WORKGROUP: usize = 64;
