//! What host and device must agree on, compared with what naga makes of the WGSL: every struct that crosses, every
//! constant that both have, and what kernels ask of a device.

use std::mem::offset_of;

use texir_core::backend::{Gathered, Projected, RoughnessGradient};
use texir_core::brdf::{DIELECTRIC_F0, Masking};
use texir_core::environment::{BrightPixel, BrightRow};
use texir_core::neighbours::{Entry, FAR, NEAR};
use texir_core::rng::{BELOW_ONE, MORTON_SIDE};
use texir_core::scene::trace::BACK_FACE_BIAS;
use texir_core::scene::{DITHER_BLOCK, MAX_LEVELS, MOST_SHEETS, SLAB_ROUNDING};
use texir_core::specular_table::{LOBES, NODES, STRATA};
use texir_core::surface::{Hit, SurfacePoint};
use texir_core::texture::Tap;

use crate::gpu::{STORAGE_BUFFERS, THREADS};
use crate::pass::denoise::{DenoiseParams, Estimate};
use crate::pass::device::{Material, MaterialGrad, PunctualLight, ShadePoint, Shaded};
use crate::pass::group_loss::GroupLossParams;
use crate::pass::irradiance::IrradianceParams;
use crate::pass::lookup::LookupParams;
use crate::pass::mip::MipParams;
use crate::pass::primary::{CameraUniform, EQUIRECTANGULAR, PrimaryParams};
use crate::pass::project::ProjectParams;
use crate::pass::punctual::PunctualParams;
use crate::pass::radiance_loss::RadianceLossParams;
use crate::pass::shade::ShadeParams;
use crate::pass::shade_vjp::ShadeVjpParams;
use crate::pass::specular_table::SpecularTableParams;
use crate::pass::texels::TexelsParams;
use crate::pass::{WORKGROUP, specular_table};
use crate::scene::{BvhStorage, IN_PARTS, LightGrid, LightPrimitive, MIRRORED, SceneOpacity, TEXTURE_COLUMNS};
use crate::wgsl::{Composed, SHADERS, Variant};

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
    let variant =
        Variant { hierarchy: BvhStorage::Buffers, opacity: SceneOpacity::Opaque, roughness: RoughnessGradient::Exact };
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
        ("project", "SurfacePoint", host!(SurfacePoint { position, triangle, normal, index })),
        ("irradiance", "SurfacePoint", host!(SurfacePoint { position, triangle, normal, index })),
        ("project", "Projected", host!(Projected { pixel, cosine, distance })),
        ("shade", "ShadePoint", host!(ShadePoint { position, index, normal, view, irradiance })),
        ("specular_table", "ShadePoint", host!(ShadePoint { position, index, normal, view, irradiance })),
        ("shade", "Material", host!(Material { albedo, roughness, metallic })),
        ("shade", "Shaded", host!(Shaded { radiance, specular_scale, roughness_jacobian })),
        ("shade_vjp", "MaterialGrad", host!(MaterialGrad { albedo, roughness, metallic })),
        ("irradiance", "LightPrimitive", host!(LightPrimitive { primitive, part, cluster, pdf_area })),
        (
            "irradiance",
            "LightGrid",
            host!(LightGrid {
                origin,
                per_metre,
                size,
                clusters,
                first_cell,
                first_cluster,
                first_member,
                first_cdf,
                one_sided
            }),
        ),
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
                residual_radius,
                tolerance,
                curvature,
                residual_threshold,
                loss_sigmas,
                ridge,
                min_normal_cosine,
                max_plane_distance,
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
                environment_samples,
                seed,
                part,
                parts,
                width,
                environment_rows
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
        ("irradiance", "BrightRow", host!(BrightRow { end, cdf })),
        ("irradiance", "BrightPixel", host!(BrightPixel { pixel, cdf })),
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

/// Shader, name and host value of every constant that both have.
fn constants() -> Vec<(&'static str, &'static str, f64)> {
    vec![
        ("primary", "TEXTURE_COLUMNS", TEXTURE_COLUMNS.into()),
        ("primary", "WORKGROUP", WORKGROUP as f64),
        ("primary", "IN_PARTS", IN_PARTS.into()),
        ("primary", "MIRRORED", MIRRORED.into()),
        ("primary", "DITHER_BLOCK", DITHER_BLOCK.into()),
        ("punctual", "MOST_SHEETS", MOST_SHEETS.into()),
        ("primary", "STACK_SIZE", (MAX_LEVELS + 1) as f64),
        ("primary", "BACK_FACE_BIAS", BACK_FACE_BIAS),
        ("primary", "SLAB_ROUNDING", SLAB_ROUNDING.into()),
        ("primary", "NO_TRIANGLE", Hit::NONE.into()),
        ("primary", "EQUIRECTANGULAR", EQUIRECTANGULAR.into()),
        ("shade", "DIELECTRIC_F0", DIELECTRIC_F0),
        ("irradiance", "BELOW_ONE", BELOW_ONE.into()),
        ("irradiance", "MORTON_SIDE", MORTON_SIDE.into()),
        ("group_loss", "THREADS", THREADS.into()),
        ("denoise", "NEAR_COLUMNS", NEAR as f64),
        ("denoise", "COLUMNS", FAR as f64),
        ("specular_table", "NODES", NODES as f64),
        ("specular_table", "STRATA", STRATA as f64),
        ("specular_table", "LOBES", LOBES.len() as f64),
        ("specular_table", "LANES", specular_table::SHAPE.threads_per_item.into()),
        ("specular_table", "FROM_LOBES", specular_table::FROM_LOBES.into()),
        ("specular_table", "FROM_COSINE", specular_table::FROM_COSINE.into()),
        ("specular_table", "FROM_LIGHTS", specular_table::FROM_LIGHTS.into()),
        ("specular_table", "SMITH", f64::from(Masking::Smith as u32)),
    ]
}

/// A number that the composed shader calls `name`.
fn constant(module: &naga::Module, name: &str) -> Option<f64> {
    let (_, constant) = module.constants.iter().find(|(_, constant)| constant.name.as_deref() == Some(name))?;
    match module.global_expressions[constant.init] {
        naga::Expression::Literal(naga::Literal::U32(value)) => Some(value.into()),
        naga::Expression::Literal(naga::Literal::F32(value)) => Some(value.into()),
        _ => None,
    }
}

#[test]
fn constants_that_both_have_are_the_same() {
    let variant = Variant {
        hierarchy: BvhStorage::Textures,
        opacity: SceneOpacity::Translucent,
        roughness: RoughnessGradient::Exact,
    };
    for (shader, name, host) in constants() {
        let module = SHADERS.compose(shader, variant).unwrap().module;
        assert_eq!(constant(&module, name).map(|value| value as f32), Some(host as f32), "{name} of {shader}.wgsl");
    }
}

/// Visits every entry point of every pass, in every variant.
fn entry_points(mut visit: impl FnMut(&Composed, usize)) {
    for shader in SHADERS.passes() {
        for variant in Variant::all() {
            let composed = SHADERS.compose(shader, variant).unwrap();
            (0..composed.module.entry_points.len()).for_each(|entry| visit(&composed, entry));
        }
    }
}

#[test]
fn workgroups_are_as_large_as_the_host_counts_them() {
    let mut sizes = std::collections::BTreeSet::new();
    entry_points(|composed, entry| {
        let entry = &composed.module.entry_points[entry];
        // Of `texels`, the host says how large they are.
        if entry.workgroup_size_overrides.is_none() {
            assert_eq!(entry.workgroup_size[1..], [1, 1], "{}", entry.name);
            sizes.insert(entry.workgroup_size[0]);
        }
    });
    assert_eq!(sizes.into_iter().collect::<Vec<_>>(), [WORKGROUP as u32, THREADS]);
}

#[test]
fn kernels_bind_as_many_storage_buffers_as_devices_are_asked_for() {
    let mut most = 0;
    entry_points(|composed, entry| {
        let usage = composed.info.get_entry_point(entry);
        let is_bound = |(handle, global): &(naga::Handle<naga::GlobalVariable>, &naga::GlobalVariable)| {
            matches!(global.space, naga::AddressSpace::Storage { .. }) && !usage[*handle].is_empty()
        };
        most = most.max(composed.module.global_variables.iter().filter(is_bound).count());
    });
    assert_eq!(most, STORAGE_BUFFERS as usize);
}
