//! Every struct that crosses to the device, compared with what naga makes of its WGSL declaration.

use std::mem::offset_of;

use texir_core::backend::{Gathered, Material, MaterialGrad, Projected, ShadePoint, Shaded};
use texir_core::lights::LightDensity;
use texir_core::neighbours::Entry;
use texir_core::punctual::PunctualLight;
use texir_core::surface::{Hit, SurfacePoint};
use texir_core::texture::Tap;

use crate::pass::denoise::{DenoiseParams, Estimate};
use crate::pass::group_loss::GroupLossParams;
use crate::pass::irradiance::IrradianceParams;
use crate::pass::lookup::LookupParams;
use crate::pass::mip::MipParams;
use crate::pass::primary::{CameraUniform, PrimaryParams};
use crate::pass::project::ProjectParams;
use crate::pass::punctual::PunctualParams;
use crate::pass::radiance_loss::RadianceLossParams;
use crate::pass::shade::ShadeParams;
use crate::pass::shade_vjp::ShadeVjpParams;
use crate::pass::specular_table::SpecularTableParams;
use crate::pass::texels::TexelsParams;
use crate::scene::{LightGrid, LightTriangle};
use crate::wgsl::{RoughnessVariant, SHADERS, Variant};

/// Size and named field offsets of a struct; padding has no name.
#[derive(Debug, PartialEq)]
struct Layout {
    size: usize,
    fields: Vec<(String, usize)>,
}

macro_rules! host {
    ($host:ty { $($field:ident),* $(,)? }) => {
        Layout {
            size: size_of::<$host>(),
            fields: vec![$((stringify!($field).to_owned(), offset_of!($host, $field))),*],
        }
    };
}

/// The declaration of `name` in the composed shader.
fn wgsl(shader: &str, name: &str) -> Layout {
    let variant = Variant { fetch_texture: false, roughness: RoughnessVariant::Exact };
    let module = SHADERS.compose(shader, variant).unwrap().module;
    let (_, ty) = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name)).unwrap();
    let naga::TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is no struct") };
    let fields = members.iter().map(|m| (m.name.clone().unwrap(), m.offset as usize));
    Layout { size: *span as usize, fields: fields.filter(|(n, _)| !n.starts_with("pad")).collect() }
}

#[test]
fn host_structs_have_the_layout_of_their_wgsl() {
    let all = [
        ("primary", "Hit", host!(Hit { triangle, u, v, t })),
        ("texels", "Hit", host!(Hit { triangle, u, v, t })),
        ("project", "SurfacePoint", host!(SurfacePoint { position, triangle, normal, sequence })),
        ("irradiance", "SurfacePoint", host!(SurfacePoint { position, triangle, normal, sequence })),
        ("project", "Projected", host!(Projected { pixel, cosine, distance })),
        ("shade", "ShadePoint", host!(ShadePoint { position, sequence, normal, view, irradiance })),
        ("specular_table", "ShadePoint", host!(ShadePoint { position, sequence, normal, view, irradiance })),
        ("shade", "Material", host!(Material { albedo, roughness, metallic })),
        ("shade", "Shaded", host!(Shaded { radiance, specular_scale, d_roughness })),
        ("shade_vjp", "MaterialGrad", host!(MaterialGrad { albedo, roughness, metallic })),
        ("irradiance", "LightTriangle", host!(LightTriangle { primitive, cumulative })),
        ("irradiance", "LightDensity", host!(LightDensity { per_area, cluster })),
        ("irradiance", "LightGrid", host!(LightGrid { origin, per_metre, size, clusters })),
        ("irradiance", "Gathered", host!(Gathered { irradiance, back_faces })),
        ("lookup", "Tap", host!(Tap { texel, weight })),
        ("denoise", "Entry", host!(Entry { position, index, normal, cell })),
        ("denoise", "Estimate", host!(Estimate { a, apart, b })),
        (
            "denoise",
            "DenoiseParams",
            host!(DenoiseParams {
                first,
                end,
                first_cell,
                texel,
                radius,
                guide_radius,
                noise_radius,
                miss_radius,
                tolerance,
                curvature,
                significant,
                ridge,
                same_way,
                beside,
                tiny
            }),
        ),
        ("group_loss", "GroupLossParams", host!(GroupLossParams { channels, quantile, jobs, share })),
        (
            "irradiance",
            "IrradianceParams",
            host!(IrradianceParams {
                count,
                first_sample,
                end_sample,
                cosine_samples,
                light_samples,
                sky_samples,
                seed,
                part,
                width,
                sky_rows
            }),
        ),
        ("lookup", "LookupParams", host!(LookupParams { rows, channels, first_tap, taps })),
        (
            "mip",
            "MipParams",
            host!(MipParams {
                fine_offset,
                fine_width,
                fine_height,
                coarse_offset,
                coarse_width,
                coarse_height,
                channels,
            }),
        ),
        ("primary", "PrimaryParams", host!(PrimaryParams { first, count })),
        ("project", "ProjectParams", host!(ProjectParams { count, clear_share })),
        (
            "punctual",
            "PunctualLight",
            host!(PunctualLight { position, distant, direction, inverse_range, intensity, cone_scale, cone_offset }),
        ),
        ("punctual", "PunctualParams", host!(PunctualParams { count, clear_share })),
        ("radiance_loss", "RadianceLossParams", host!(RadianceLossParams { count, share })),
        ("shade", "ShadeParams", host!(ShadeParams { count, first_sample, end_sample, samples, seed })),
        ("shade_vjp", "ShadeVjpParams", host!(ShadeVjpParams { count })),
        (
            "specular_table",
            "SpecularTableParams",
            host!(SpecularTableParams {
                count,
                first_sample,
                end_sample,
                lobe_samples,
                cosine_samples,
                light_samples,
                seed,
                f0,
                masking,
                lobes,
                nodes,
            }),
        ),
        (
            "texels",
            "TexelsParams",
            host!(TexelsParams { width, height, first_row, rows_begin, rows_end, first_candidate, candidates, reach }),
        ),
        ("primary", "Camera", host!(CameraUniform { right, kind, up, width, back, height, position, fx, fy, cx, cy })),
    ];
    for (shader, name, host) in all {
        assert_eq!(host, wgsl(shader, name), "{name} of {shader}.wgsl");
    }
}

#[test]
fn every_parameter_block_is_covered() {
    // Uniform blocks are where host and shader drift apart: none may be missing above.
    let source = include_str!("layouts.rs");
    for shader in SHADERS.passes() {
        for variant in Variant::all() {
            let module = SHADERS.compose(shader, variant).unwrap().module;
            for (_, global) in module.global_variables.iter() {
                if global.space == naga::AddressSpace::Uniform {
                    let name = module.types[global.ty].name.clone().unwrap();
                    assert!(source.contains(&format!("\"{name}\"")), "{name} of {shader}.wgsl is not compared");
                }
            }
        }
    }
}

#[test]
fn a_field_that_moved_is_noticed() {
    #[repr(C)]
    struct Swapped {
        triangle: u32,
        v: f32,
        u: f32,
        t: f32,
    }
    assert_ne!(host!(Swapped { triangle, u, v, t }), wgsl("primary", "Hit"));
    #[repr(C)]
    struct Tight {
        position: [f32; 3],
        triangle: u32,
        normal: [f32; 3],
    }
    assert_ne!(host!(Tight { position, triangle, normal }), wgsl("project", "SurfacePoint"));
}
