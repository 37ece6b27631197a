//! Light of what no view sees: behind curtains, under beds, in the gap beside a wardrobe.
//!
//! An HDR texture has something there, continued from what is seen nearby. But what cannot be seen is mostly in the dark, and
//! what faces it, in slits and corners, would get too much light and so too dark a material. Unseen surfaces reflect what
//! arrives like any other: L = ρ/π E, of an apparent albedo ρ = π L/E as it is seen nearby. What they send is gathered apart from
//! all other light, so that it can be gathered anew when their L has changed: one step of Jacobi's iteration of the radiosity
//! equation (Goral et al., SIGGRAPH 1984), which takes nearly all of the error; a second changed no figure.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;
use rayon::prelude::*;

use crate::atlas::Atlas;
use crate::backend::{Backend, Gather};
use crate::bake::{self, Baked, Buried, PADDING};
use crate::capture::{Coverage, Tbl};
use crate::checkpoint::Checkpoints;
use crate::error::Result;
use crate::inpaint;
use crate::lights::Lights;
use crate::progress::{Named, Progress};
use crate::raster::Rgb;
use crate::scene::Scene;

/// No apparent albedo is larger.
const WHITE: Vec3 = Vec3::splat(0.9);
/// Irradiance that is taken for none.
const DARK: f32 = 1e-6;

/// Irradiance of every texel, in full (not divided by π), and the light sources of the scene, with which `tbl` is left in the
/// backend. What `tbl` has where no view sees is replaced by what such surfaces reflect, found with twice `unseen_rays` per
/// texel; with none, it is taken as it is.
pub fn irradiance(
    backend: &mut dyn Backend,
    (scene, atlas): (&Scene, &Atlas),
    tbl: &mut Tbl,
    (gather, unseen_rays): (Gather, u32),
    checkpoints: &Checkpoints,
    progress: &dyn Progress,
) -> Result<(Rgb, Lights)> {
    let mut radiance: Vec<Vec3> = atlas.texels.iter().map(|&t| tbl.radiance.data[t as usize].into()).collect();
    let role = roles(atlas, tbl, &radiance);
    let is_unseen = |i: usize| unseen_rays > 0 && role[i] == Role::Unseen;
    if !(0..role.len()).any(is_unseen) {
        let lights = Lights::find(scene, atlas, &tbl.radiance);
        backend.set_tbl(&tbl.radiance, &lights)?;
        let baked = bake::denoised(backend, &scene.mesh, atlas, gather, checkpoints, progress)?;
        return Ok((baked.map(atlas, Buried::Fill), lights));
    }
    let only = |radiance: &[Vec3], shines: &dyn Fn(usize) -> bool| -> Rgb {
        let of = |(i, l): (usize, &Vec3)| if shines(i) { l.to_array() } else { [0.0; 3] };
        let values: Vec<[f32; 3]> = radiance.iter().enumerate().map(of).collect();
        atlas.scatter_padded(&values, &vec![true; values.len()], [0.0; 3], PADDING)
    };
    let shown = only(&radiance, &|i| !is_unseen(i));
    let lights = Lights::find(scene, atlas, &shown);
    backend.set_tbl(&shown, &lights)?;
    let Baked { irradiance: from_seen, buried, standard_error, rays } =
        bake::denoised(backend, &scene.mesh, atlas, gather, checkpoints, progress)?;
    let progress = &Named { progress, of: "of the unseen" };
    let few = Gather { cosine: unseen_rays, light: 0, ..gather };
    let plus = |unseen: Vec<[f32; 3]>| -> Vec<Vec3> {
        from_seen.par_iter().zip(unseen).map(|(a, b)| Vec3::from(*a) + Vec3::from(b)).collect()
    };
    let reflect = |total: &[Vec3], radiance: &mut [Vec3]| {
        let albedo = apparent_albedo(atlas, atlas.typical_texel(&scene.mesh), &role, radiance, total);
        for i in (0..role.len()).filter(|i| is_unseen(*i)) {
            radiance[i] = albedo[i] * total[i] * FRAC_1_PI;
        }
    };
    // As it was filled; noise of this goes into no texel, only into what many gather.
    backend.set_tbl(&only(&radiance, &is_unseen), &Lights::none(&scene.mesh))?;
    let as_filled = bake::irradiance(backend, atlas, few, &checkpoints.within("as-filled"), progress)?;
    reflect(&plus(as_filled.irradiance), &mut radiance);
    // As it reflects.
    backend.set_tbl(&only(&radiance, &is_unseen), &Lights::none(&scene.mesh))?;
    let as_reflected = bake::denoised(backend, &scene.mesh, atlas, few, &checkpoints.within("as-reflected"), progress)?;
    let total = plus(as_reflected.irradiance);
    reflect(&total, &mut radiance);
    tbl.radiance = only(&radiance, &|_| true);
    backend.set_tbl(&tbl.radiance, &lights)?;
    let irradiance = total.into_iter().map(|e| e.to_array()).collect();
    Ok((Baked { irradiance, buried, standard_error, rays }.map(atlas, Buried::Fill), lights))
}

/// What a texel is to the light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    /// A view sees what it reflects.
    Seen,
    /// No view sees what it reflects.
    Unseen,
    /// It shines, seen or not: a lamp's back was filled with its light.
    Source,
}

fn roles(atlas: &Atlas, tbl: &Tbl, radiance: &[Vec3]) -> Vec<Role> {
    let is_seen: Vec<bool> = atlas.texels.iter().map(|&t| tbl.coverage.data[t as usize] == Coverage::Seen).collect();
    let seen: Vec<_> = is_seen.iter().zip(radiance).map(|(seen, l)| seen.then(|| l.to_array())).collect();
    let limit = inpaint::source_limit(&seen);
    let role = |(is_seen, l): (&bool, &Vec3)| match inpaint::mean(l.to_array()) > limit {
        true => Role::Source,
        false if *is_seen => Role::Seen,
        false => Role::Unseen,
    };
    is_seen.iter().zip(radiance).map(role).collect()
}

/// π L/E, continued from what is seen.
fn apparent_albedo(atlas: &Atlas, texel: f32, role: &[Role], radiance: &[Vec3], total: &[Vec3]) -> Vec<Vec3> {
    let known: Vec<Option<[f32; 3]>> = (role, radiance, total)
        .into_par_iter()
        .map(|(role, l, e)| {
            let is_lit = *role == Role::Seen && e.min_element() > DARK;
            is_lit.then(|| (PI * l / e).min(WHITE).to_array())
        })
        .collect();
    inpaint::fill(&atlas.points, &known, texel).into_iter().map(Vec3::from).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::authored::{self, Bounces, Surfaces};
    use crate::bake::Quality;
    use crate::cpu::CpuBackend;
    use crate::progress::Silent;
    use crate::raster::Raster;
    use crate::tbl::tests::room;

    const ALBEDO: f32 = 0.6;

    #[test]
    fn a_wall_that_no_view_sees_sends_what_it_reflects() {
        let scene = Scene::new(room()).unwrap();
        let mut backend = CpuBackend::new(&scene);
        let atlas = Atlas::new(&mut backend, &scene, 96, 64).unwrap();
        let near_lamp = |p: Vec3| p.z > 2.4 && (p.x - 2.0).abs() < 0.5 && (p.y - 1.5).abs() < 0.5;
        let emission: Vec<f32> =
            atlas.points.iter().map(|p| if near_lamp(p.position.into()) { 30.0 } else { 0.0 }).collect();
        let map = |value: &dyn Fn(usize) -> f32| -> Rgb {
            let values: Vec<[f32; 3]> = (0..atlas.texels.len()).map(|i| [value(i); 3]).collect();
            atlas.scatter_padded(&values, &vec![true; values.len()], [0.0; 3], PADDING)
        };
        let surfaces = Surfaces {
            albedo: map(&|_| ALBEDO),
            emission: map(&|i| emission[i]),
            lights: Vec::new(),
            environment: None,
        };
        let gather = Gather { cosine: 64, light: 64, seed: 3, part: 0 };
        let quality = Quality { gather, error: None, denoise: true };
        let bounces = Bounces { quality, tolerance: 1e-3, most: 30 };
        let none = Checkpoints::none();
        let truth = authored::irradiance(&mut backend, &scene, &atlas, &surfaces, &bounces, &none, &Silent).unwrap();
        let truth: Vec<f32> = truth.baked.irradiance.iter().map(|e| e[0]).collect();

        // The wall at x = 0 is not seen, and was taken to be three times as bright as it is.
        let hidden: Vec<bool> = atlas.points.iter().map(|p| Vec3::from(p.normal).x > 0.5).collect();
        let reflected = |i: usize| ALBEDO * FRAC_1_PI * truth[i];
        let coverage: Vec<Coverage> =
            hidden.iter().map(|h| if *h { Coverage::Inpainted } else { Coverage::Seen }).collect();
        let filled = Tbl {
            radiance: map(&|i| (emission[i] + reflected(i)) * if hidden[i] { 3.0 } else { 1.0 }),
            coverage: atlas.scatter(&coverage, Coverage::Outside),
        };
        let mut errors = |unseen_rays: u32| {
            let mut tbl = filled.clone();
            let ground = (&scene, &atlas);
            let (found, _) = irradiance(&mut backend, ground, &mut tbl, (gather, unseen_rays), &none, &Silent).unwrap();
            let mean = |raster: &Rgb, expected: &dyn Fn(usize) -> f32, of: &dyn Fn(usize) -> bool| {
                let of_texel = |i: usize| raster.data[atlas.texels[i] as usize][0] / expected(i) - 1.0;
                let chosen: Vec<f32> = (0..truth.len()).filter(|i| of(*i)).map(of_texel).collect();
                chosen.iter().map(|e| e.abs()).sum::<f32>() / chosen.len() as f32
            };
            let beside = |i: usize| !hidden[i] && atlas.points[i].position[0] < 1.0 && emission[i] == 0.0;
            (mean(&found, &|i| truth[i], &beside), mean(&tbl.radiance, &reflected, &|i| hidden[i]))
        };
        let (light, wall) = errors(32);
        assert!(light < 0.05 && wall < 0.06, "{light} {wall}");
        // Negative control: as it was filled.
        let (light, wall) = errors(0);
        assert!(light > 0.4 && (wall - 2.0).abs() < 0.01, "{light} {wall}");
    }

    #[test]
    fn the_back_of_a_lamp_goes_on_shining() {
        let texel = |seen: bool, l: f32| (if seen { Coverage::Seen } else { Coverage::Inpainted }, Vec3::splat(l));
        let of = [texel(true, 1.0), texel(true, 0.9), texel(false, 1.5), texel(false, 20.0), texel(true, 20.0)];
        let atlas = Atlas { width: 5, height: 1, texels: (0..5).collect(), points: Vec::new(), inside: Vec::new() };
        let tbl = Tbl {
            radiance: Raster { width: 5, height: 1, data: of.iter().map(|(_, l)| l.to_array()).collect() },
            coverage: Raster { width: 5, height: 1, data: of.iter().map(|(coverage, _)| *coverage).collect() },
        };
        let radiance: Vec<Vec3> = of.iter().map(|(_, l)| *l).collect();
        let expected = [Role::Seen, Role::Seen, Role::Unseen, Role::Source, Role::Source];
        assert_eq!(roles(&atlas, &tbl, &radiance), expected);
    }
}
