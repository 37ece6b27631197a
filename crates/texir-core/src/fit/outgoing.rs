//! The light that surfaces send, once their materials are known.
//!
//! What a texel of the HDR texture holds is what the views saw there, reflections of lamps and windows included, as if
//! the surface sent that everywhere; and where no view sees, behind curtains and under beds, what is seen nearby,
//! although it is mostly dark there. A surface of known material sends (d a + s) E/π, averaged over all directions: d
//! is what its diffuse model scatters at its roughness, over a Lambertian, and s what a dielectric of that roughness
//! reflects specularly of uniform light. Irradiance of that light relaxes TexIR's assumption that what is captured is
//! diffuse (Li et al. 2023, section 6).

use std::f32::consts::FRAC_1_PI;

use rayon::prelude::*;

use super::Materials;
use crate::atlas::Atlas;
use crate::bake::PADDING;
use crate::capture::{Coverage, Tbl};
use crate::error::Result;
use crate::raster::{Mask, Rgb};
use crate::specular_albedo::specular_albedo;

/// Radiance that every texel sends. Light sources, metals, and what is captured though none of the pixels fitted shows
/// it (`is_fitted`, per texel) send what was captured.
pub fn radiance(atlas: &Atlas, tbl: &Tbl, materials: &Materials, emitters: &Mask, is_fitted: &[bool]) -> Result<Rgb> {
    let sent = |(&t, is_fitted): (&u32, &bool)| -> [f32; 3] {
        let t = t as usize;
        let is_metal = materials.metallic.as_ref().is_some_and(|metallic| metallic.data[t] > 0.0);
        let is_only_captured = tbl.coverage.data[t] == Coverage::Seen && !is_fitted;
        if emitters.data[t] || is_metal || is_only_captured {
            return tbl.radiance.data[t];
        }
        reflected(materials, t)
    };
    let sent: Vec<[f32; 3]> = (&atlas.texels, is_fitted).into_par_iter().map(sent).collect();
    atlas.padded(&sent, PADDING)
}

/// (d a + s) E/π of texel `t`: what a dielectric of its material sends of the light that reaches it.
pub fn reflected(materials: &Materials, t: usize) -> [f32; 3] {
    let (albedo, irradiance) = (materials.albedo.data[t], materials.irradiance.data[t]);
    let roughness = materials.roughness.data[t];
    let (d, s) = (materials.diffuse.albedo_factor(roughness), specular_albedo(materials.masking, roughness));
    std::array::from_fn(|c| (d * albedo[c] + s) * irradiance[c] * FRAC_1_PI)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;

    use super::*;
    use crate::authored::{self, Bounces, Surfaces};
    use crate::backend::{Backend, Gather};
    use crate::bake::{self, Buried, Denoiser, Quality, Texels};
    use crate::brdf::Masking;
    use crate::checkpoint::Checkpoints;
    use crate::cpu::CpuBackend;
    use crate::diffuse::DiffuseModel;
    use crate::lights::Lights;
    use crate::progress::Silent;
    use crate::raster::{Gray, Raster};
    use crate::scene::Scene;
    use crate::tbl::tests::room;

    const ROUGHNESS: f32 = 0.5;

    /// What surfaces of [`materials`] reflect specularly.
    fn specular() -> f32 {
        specular_albedo(Masking::default(), ROUGHNESS)
    }

    fn materials(albedo: Rgb, irradiance: Rgb, metallic: Option<Gray>) -> Materials {
        let roughness = Gray::filled(albedo.width, albedo.height, ROUGHNESS);
        let (diffuse, masking) = (DiffuseModel::default(), Masking::default());
        Materials { albedo, roughness, metallic, irradiance, diffuse, masking, confidence: None }
    }

    #[test]
    fn lamps_metals_and_what_the_fit_does_not_show_send_what_was_captured() {
        let atlas = Atlas { width: 5, height: 1, texels: (0..5).collect(), points: Vec::new(), inside: Vec::new() };
        let map = |data: [f32; 5]| Rgb { width: 5, height: 1, data: data.map(|v| [v; 3]).to_vec() };
        let mut coverage = Raster::filled(5, 1, Coverage::Seen);
        coverage.data[4] = Coverage::Inpainted;
        let tbl = Tbl { radiance: map([5.0, 7.0, 3.0, 2.0, 4.0]), coverage };
        let metallic = Gray { width: 5, height: 1, data: vec![0.0, 0.0, 1.0, 0.0, 0.0] };
        let emitters = Mask { width: 5, height: 1, data: vec![false, true, false, false, false] };
        let materials = materials(map([0.5 - specular(); 5]), map([std::f32::consts::TAU; 5]), Some(metallic));
        let sent = radiance(&atlas, &tbl, &materials, &emitters, &[true, true, true, false, false]).unwrap();
        for (found, expected) in sent.data.iter().zip([1.0, 7.0, 3.0, 2.0, 1.0]) {
            assert!((found[0] - expected).abs() < 1e-5, "{:?}", sent.data);
        }
    }

    #[test]
    fn a_wall_that_no_view_sees_and_a_floor_of_highlights_light_the_room_by_what_they_reflect() {
        const ALBEDO: f32 = 0.54;
        let scene = Arc::new(Scene::new(room()).unwrap());
        let mut backend = CpuBackend::new(scene.clone());
        let atlas = Atlas::new(&mut backend, [96, 64]).unwrap();
        let map = |value: &dyn Fn(usize) -> f32| -> Rgb {
            let values: Vec<[f32; 3]> = (0..atlas.texels.len()).map(|i| [value(i); 3]).collect();
            atlas.padded(&values, PADDING).unwrap()
        };
        let near_lamp = |p: Vec3| p.z > 2.4 && (p.x - 2.0).abs() < 0.5 && (p.y - 1.5).abs() < 0.5;
        let is_lamp: Vec<bool> = atlas.points.iter().map(|p| near_lamp(p.position.into())).collect();
        let emission = |i: usize| if is_lamp[i] { 30.0 } else { 0.0 };
        let surfaces = Surfaces {
            albedo: map(&|_| ALBEDO + specular()),
            emission: map(&emission),
            lights: Vec::new(),
            environment: None,
        };
        let gather = Gather::new(64, 64, 3);
        let bounces = Bounces {
            quality: Quality { gather, error: None, denoise: Some(Denoiser::Regression) },
            tolerance: 1e-3,
            max_bounces: 30,
        };
        let none = Checkpoints::none();
        let texels = Texels::of(&atlas);
        let truth = authored::irradiance(&mut backend, &texels, &surfaces, &bounces, &none, &Silent).unwrap();
        let truth: Vec<f32> = truth.solution.into_baked().unwrap().irradiance.iter().map(|e| e[0]).collect();

        // The wall at x = 0 is not seen, and was taken to be three times as bright as it is; the floor's half at y <
        // 1.5 m shines twice as bright towards the views as on average.
        let hidden = |i: usize| atlas.points[i].normal[0] > 0.5;
        let glossy = |i: usize| atlas.points[i].normal[2] > 0.5 && atlas.points[i].position[1] < 1.5;
        let reflected = |i: usize| (ALBEDO + specular()) * FRAC_1_PI * truth[i];
        let captured = map(&|i| {
            emission(i)
                + reflected(i)
                    * if hidden(i) {
                        3.0
                    } else if glossy(i) {
                        2.0
                    } else {
                        1.0
                    }
        });
        let mut bake = |radiance: &Rgb| {
            backend.set_tbl(radiance, &Lights::find(&scene, &atlas, radiance).unwrap()).unwrap();
            let baked = bake::denoised(&mut backend, &atlas, gather, &none, &Silent).unwrap();
            baked.map(&atlas, Buried::Fill).unwrap()
        };
        let error = |e: &Rgb| {
            let off = |i: usize| (e.data[atlas.texels[i] as usize][0] / truth[i] - 1.0).abs();
            let dark: Vec<f32> = (0..truth.len()).filter(|i| !is_lamp[*i] && !hidden(*i)).map(off).collect();
            dark.iter().sum::<f32>() / dark.len() as f32
        };
        let first = bake(&captured);
        // Where views see, a E/π is what they see, whatever irradiance they are explained with.
        let at = |i: usize| first.data[atlas.texels[i] as usize][0];
        let albedo = map(&|i| if hidden(i) { ALBEDO } else { ALBEDO * truth[i] / at(i) });
        let materials = materials(albedo, first.clone(), None);
        let emitters = atlas.scatter(&is_lamp, false).unwrap();
        let seen = |i: usize| if hidden(i) { Coverage::Inpainted } else { Coverage::Seen };
        let coverage: Vec<Coverage> = (0..truth.len()).map(seen).collect();
        let tbl = Tbl { radiance: captured, coverage: atlas.scatter(&coverage, Coverage::Outside).unwrap() };
        let is_fitted: Vec<bool> = coverage.iter().map(|c| *c == Coverage::Seen).collect();
        let second = bake(&radiance(&atlas, &tbl, &materials, &emitters, &is_fitted).unwrap());
        let (before, after) = (error(&first), error(&second));
        assert!(before > 0.2 && after < 0.05, "{before} {after}");
    }
}
