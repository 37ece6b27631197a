//! The radiance of light sources, finer than the pixels that show them.
//!
//! A texture made of pixels is dimmest where it matters most: a pixel at the rim of a lamp shows lamp and ceiling, a lamp of
//! few pixels is all rim, and irradiance falls short of what the lamp sends out. But the mesh knows which share of a pixel
//! the lamp covers. So the texels of lamps and of what is seen beside them are sought whose mixture is what the views show:
//! a sparse robust least-squares problem, Σ_t w_t L_t = I over the pixels that show light sources, with w_t a texel's share
//! of the pixel. What pixels do not resolve is drawn to be smooth, relative to its brightness, within a light source and
//! within its surroundings, never across.

use glam::Vec3A;
use rayon::prelude::*;

use super::adjacency::Adjacency;
use super::least_squares::{NormalEquations, conjugate_gradients};
use crate::atlas::{Atlas, TexelIndex};
use crate::backend::Backend;
use crate::capture::View;
use crate::error::Result;
use crate::progress::Progress;
use crate::raster::{Mask, Rgb, luminance};
use crate::scene::Scene;
use crate::texture::{Rows, Tap, merge};

/// Sub-pixels of a pixel, per axis.
const AXIS: usize = 4;
/// Noise of a pixel, as a share of its radiance.
const NOISE: f32 = 0.05;
/// Weight of a relative difference between neighbours, where a pixel of noise 1 has weight 1.
const SMOOTHNESS: f32 = 20.0;
/// Weight of the given radiance.
const PRIOR: f32 = 1e-3;
/// Re-weightings, and steps of conjugate gradients between two.
const ROUNDS: usize = 4;
const ITERATIONS: u32 = 40;

/// The texture-based lighting with the texels of light sources, and those seen in one pixel with them, resolved.
pub fn resolve(
    backend: &mut dyn Backend,
    scene: &Scene,
    (atlas, adjacency): (&Atlas, &Adjacency),
    (radiance, emitters): (&Rgb, &Mask),
    views: &[View],
    progress: &dyn Progress,
) -> Result<Rgb> {
    let sightings = Sightings::collect(backend, scene, atlas, emitters, views, progress)?;
    let glows = |t: u32| emitters.data[atlas.texels[t as usize] as usize];
    // Unknowns: every texel of a light source, and every texel that a pixel shows with one.
    let mut unknown: Vec<u32> = (0..atlas.texels.len() as u32).filter(|&t| glows(t)).collect();
    unknown.extend(sightings.rows.taps.iter().map(|tap| tap.texel));
    unknown.sort_unstable();
    unknown.dedup();
    let number = |t: u32| unknown.binary_search(&t).ok().map(|i| i as u32);
    let mut rows = sightings.rows;
    rows.taps.iter_mut().for_each(|tap| tap.texel = number(tap.texel).unwrap_or(0));

    let edges: Vec<[u32; 2]> = unknown
        .iter()
        .flat_map(|&a| adjacency.around(a).filter(move |&b| a < b && glows(a) == glows(b)).map(move |b| [a, b]))
        .filter_map(|[a, b]| Some([number(a)?, number(b)?]))
        .collect();

    let given: Vec<Vec3A> =
        unknown.iter().map(|&t| Vec3A::from(radiance.data[atlas.texels[t as usize] as usize])).collect();
    let dark = 0.1 * given.iter().map(|x| brightness(*x)).sum::<f32>() / given.len().max(1) as f32;
    let columns = rows.transposed(unknown.len());
    let mut solved = given.clone();
    for _ in 0..ROUNDS {
        progress.check()?;
        let seen = multiply(&rows, &solved);
        let weight: Vec<f32> = (&seen, &sightings.radiance)
            .into_par_iter()
            .map(|(seen, shown)| {
                let sigma = NOISE * (brightness(*shown) + 0.1 * dark);
                1.0 / (sigma * sigma + ((*seen - *shown).length_squared() / 3.0) / 4.0)
            })
            .collect();
        let scale: Vec<f32> = solved.iter().map(|x| 1.0 / (brightness(*x) + dark).powi(2)).collect();
        let system = System { rows: &rows, columns: &columns, weight, edges: &edges, scale };
        let weighted: Vec<Vec3A> =
            sightings.radiance.iter().zip(&system.weight).map(|(shown, weight)| *shown * *weight).collect();
        let mut right = multiply(&columns, &weighted);
        (&mut right, &given, &system.scale).into_par_iter().for_each(|(r, x, s)| *r += PRIOR * *s * *x);
        conjugate_gradients(&system, &mut solved, &right, ITERATIONS);
        solved.iter_mut().for_each(|x| *x = x.max(Vec3A::ZERO));
    }
    let mut resolved = radiance.clone();
    for (&t, x) in unknown.iter().zip(&solved) {
        resolved.data[atlas.texels[t as usize] as usize] = x.to_array();
    }
    Ok(resolved)
}

fn brightness(radiance: Vec3A) -> f32 {
    luminance(&radiance.to_array())
}

/// What the views show of light sources.
struct Sightings {
    /// Shares of the texels, per pixel.
    rows: Rows,
    /// Radiance of each pixel.
    radiance: Vec<Vec3A>,
}

impl Sightings {
    fn collect(
        backend: &mut dyn Backend,
        scene: &Scene,
        atlas: &Atlas,
        emitters: &Mask,
        views: &[View],
        progress: &dyn Progress,
    ) -> Result<Self> {
        let index = TexelIndex::new(atlas);
        let mesh = &scene.mesh;
        let mut all = Self { rows: Rows { offsets: vec![0], taps: Vec::new() }, radiance: Vec::new() };
        progress.start("light sources", views.len() as u64, "views");
        for view in views {
            progress.check()?;
            let image = view.load_image(progress)?;
            let fine = view.camera.supersampled(AXIS);
            let hits = backend.primary(&fine)?;
            let pixels: Vec<(usize, Vec<Tap>)> = (0..view.camera.pixels())
                .into_par_iter()
                .filter_map(|pixel| {
                    let corner = pixel / view.camera.width * AXIS * fine.width + pixel % view.camera.width * AXIS;
                    let seen = || (0..AXIS * AXIS).map(|k| &hits[corner + k / AXIS * fine.width + k % AXIS]);
                    let glows = seen().any(|hit| hit.is_hit() && emitters.data[emitters.nearest(hit.uv(mesh))]);
                    if !glows || seen().any(|hit| !hit.is_hit()) {
                        return None;
                    }
                    let mut taps: Vec<Tap> = seen().flat_map(|hit| index.bilinear(hit.uv(mesh))).collect();
                    merge(&mut taps);
                    (!taps.is_empty()).then_some((pixel, taps))
                })
                .collect();
            for (pixel, taps) in pixels {
                all.radiance.push(Vec3A::from(image.data[pixel]));
                all.rows.taps.extend(taps);
                all.rows.offsets.push(all.rows.taps.len() as u32);
            }
            progress.advance(1);
        }
        progress.finish();
        Ok(all)
    }
}

/// A sparse matrix times a vector.
fn multiply(rows: &Rows, x: &[Vec3A]) -> Vec<Vec3A> {
    let row = |i: usize| rows.row(i).iter().map(|tap| x[tap.texel as usize] * tap.weight).sum();
    (0..rows.len()).into_par_iter().map(row).collect()
}

/// The normal equations of one re-weighting.
struct System<'a> {
    rows: &'a Rows,
    columns: &'a Rows,
    /// Per pixel.
    weight: Vec<f32>,
    edges: &'a [[u32; 2]],
    /// Per texel, 1/L²: differences are relative.
    scale: Vec<f32>,
}

impl System<'_> {
    fn edge(&self, [a, b]: [u32; 2]) -> f32 {
        SMOOTHNESS * self.scale[a as usize].min(self.scale[b as usize])
    }
}

impl NormalEquations for System<'_> {
    fn apply(&self, x: &[Vec3A]) -> Vec<Vec3A> {
        let mut seen = multiply(self.rows, x);
        seen.par_iter_mut().zip(&self.weight).for_each(|(seen, weight)| *seen *= *weight);
        let mut out = multiply(self.columns, &seen);
        out.iter_mut().zip(x).zip(&self.scale).for_each(|((out, x), scale)| *out += PRIOR * *scale * *x);
        for &[a, b] in self.edges {
            let pull = self.edge([a, b]) * (x[a as usize] - x[b as usize]);
            out[a as usize] += pull;
            out[b as usize] -= pull;
        }
        out
    }

    fn diagonal(&self) -> Vec<Vec3A> {
        let square = |tap: &Tap| tap.weight * tap.weight * self.weight[tap.texel as usize];
        let mut out: Vec<f32> = (0..self.columns.len())
            .into_par_iter()
            .map(|t| self.columns.row(t).iter().map(square).sum::<f32>() + PRIOR * self.scale[t])
            .collect();
        for &[a, b] in self.edges {
            out[a as usize] += self.edge([a, b]);
            out[b as usize] += self.edge([a, b]);
        }
        out.into_iter().map(Vec3A::splat).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::lit_square::{LitSquare, SIDE};
    use crate::progress::Silent;

    #[test]
    fn a_lamp_of_few_pixels_gets_back_what_blending_took() {
        let square = LitSquare::new();
        let lamp: Vec<usize> = [(2, 2), (3, 2), (2, 3), (3, 3)].map(|(x, y)| y * SIDE + x).to_vec();
        let mut truth = Rgb::filled(SIDE, SIDE, [0.3; 3]);
        let mut emitters = Mask::filled(SIDE, SIDE, false);
        for &t in &lamp {
            truth.data[t] = [20.0, 18.0, 12.0];
            emitters.data[t] = true;
        }
        // As blended: the lamp dimmed, its surroundings glowing.
        let mut blended = truth.clone();
        for y in 1..5 {
            for x in 1..5 {
                blended.data[y * SIDE + x] = if emitters.data[y * SIDE + x] { [9.0, 8.0, 6.0] } else { [4.0; 3] };
            }
        }
        let views = square.views(&truth, (32, 16));
        let surface = (&square.atlas, &square.adjacency);
        let resolved =
            resolve(&mut square.backend(), &square.scene, surface, (&blended, &emitters), &views, &Silent).unwrap();
        let worst = |texels: &mut dyn Iterator<Item = usize>, image: &Rgb| {
            texels.map(|t| (luminance(&image.data[t]) / luminance(&truth.data[t])).ln().abs()).fold(0.0, f32::max)
        };
        let beside = || (0..SIDE * SIDE).filter(|&t| !emitters.data[t]);
        assert!(worst(&mut lamp.iter().copied(), &resolved) < 0.05);
        assert!(worst(&mut beside(), &resolved) < 0.2, "the glow is gone");
        assert!(worst(&mut lamp.iter().copied(), &blended) > 0.5 && worst(&mut beside(), &blended) > 2.0);
        let nobody =
            resolve(&mut square.backend(), &square.scene, surface, (&blended, &emitters), &[], &Silent).unwrap();
        assert!(worst(&mut lamp.iter().copied(), &nobody) > 0.5, "without views nothing is known");
    }
}
