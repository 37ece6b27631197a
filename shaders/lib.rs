//! The WGSL sources of texir's passes, one file per pass, and under `shared/` what they import by name. They are a
//! crate of their own so that packages have them: `texir-gpu` composes and runs them.

macro_rules! sources {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!($name, ".wgsl")))),*]
    };
}

/// All sources by name, as files are called without their ending: `shade`, or `shared/bvh`.
pub const SOURCES: &[(&str, &str)] = sources![
    "denoise",
    "group_loss",
    "irradiance",
    "lookup",
    "mip",
    "primary",
    "project",
    "punctual",
    "radiance_loss",
    "shade",
    "shade_vjp",
    "specular_table",
    "texels",
    "shared/brdf",
    "shared/bvh",
    "shared/camera",
    "shared/environment",
    "shared/fetch_buffer",
    "shared/fetch_texture",
    "shared/hit",
    "shared/light_sampling",
    "shared/lighting",
    "shared/lobe",
    "shared/math",
    "shared/micromaps",
    "shared/opaque",
    "shared/rng",
    "shared/roughness_authors",
    "shared/roughness_exact",
    "shared/sampling",
    "shared/shading",
    "shared/shadow_sharp",
    "shared/shadow_translucent",
];
