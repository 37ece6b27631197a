//! Every struct that crosses to the device, compared with what naga makes of its WGSL declaration.

use std::mem::offset_of;

use texir_core::backend::{Gathered, Material, MaterialGrad, Projected, ShadePoint, Shaded};
use texir_core::environment::{BrightPixel, BrightRow};
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

/// Shader, name and host layout of every struct that both know.
fn all() -> Vec<(&'static str, &'static str, Layout)> {
    vec![
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
        ("irradiance", "LightDensity", host!(LightDensity { per_area, cluster, front_only })),
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
                chance,
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
                first_item,
                end_item,
                first_sample,
                end_sample,
                cosine_samples,
                light_samples,
                sky_samples,
                seed,
                part,
                parts,
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
        ("irradiance", "BrightRow", host!(BrightRow { end, cumulative })),
        ("irradiance", "BrightPixel", host!(BrightPixel { pixel, cumulative })),
        ("primary", "PrimaryParams", host!(PrimaryParams { first, count })),
        ("project", "ProjectParams", host!(ProjectParams { count, clear_share })),
        (
            "punctual",
            "PunctualLight",
            host!(PunctualLight { position, distant, direction, inverse_range, intensity, cone_scale, cone_offset }),
        ),
        ("punctual", "PunctualParams", host!(PunctualParams { count, clear_share })),
        ("radiance_loss", "RadianceLossParams", host!(RadianceLossParams { count, share })),
        ("shade", "ShadeParams", host!(ShadeParams { first_item, end_item, first_sample, end_sample, samples, seed })),
        ("shade_vjp", "ShadeVjpParams", host!(ShadeVjpParams { count })),
        (
            "specular_table",
            "SpecularTableParams",
            host!(SpecularTableParams {
                first_item,
                end_item,
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
    ]
}

#[test]
fn host_structs_have_the_layout_of_their_wgsl() {
    for (shader, name, host) in all() {
        assert_eq!(host, wgsl(shader, name), "{name} of {shader}.wgsl");
    }
}

/// Structs of buffers that one kernel leaves for another, and the host never sees.
const ON_DEVICE: [&str; 3] = ["Smoothed", "Noise", "Fitted"];

/// The struct that a variable holds, or holds an array of.
fn held(module: &naga::Module, ty: naga::Handle<naga::Type>) -> Option<String> {
    match &module.types[ty].inner {
        naga::TypeInner::Array { base, .. } => held(module, *base),
        naga::TypeInner::Struct { .. } => module.types[ty].name.clone(),
        _ => None,
    }
}

#[test]
fn every_struct_that_is_bound_is_covered() {
    let compared: Vec<&str> = all().into_iter().map(|(_, name, _)| name).collect();
    for shader in SHADERS.passes() {
        for variant in Variant::all() {
            let module = SHADERS.compose(shader, variant).unwrap().module;
            for (_, global) in module.global_variables.iter().filter(|(_, global)| global.binding.is_some()) {
                let Some(name) = held(&module, global.ty) else { continue };
                let known = compared.contains(&&*name) || ON_DEVICE.contains(&&*name);
                assert!(known, "{name} of {shader}.wgsl is not compared");
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
