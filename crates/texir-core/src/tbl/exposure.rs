//! Differences of exposure and white balance between views, from surfaces that several of them see.
//!
//! A view `v` shows texel `t` with ln L(v, t) = g(v) + x(t), per channel: its exposure, and the texel's own radiance.
//! Weighted least squares over all pairs has a closed form once the texels are eliminated; what views see differently
//! for other reasons (reflections, somebody who walks by) is weighed down and the system solved again. Surfaces reflect
//! most at grazing angles, at which a view sees much of what it shares with views from other rooms: that does not
//! count. Only differences between views can be found: the median of g is 0, so that most views stay nearly as they are
//! when a few differ.

use rayon::prelude::*;

use super::photo::Photo;
use super::sample::Sampler;
use super::{TblOptions, photo};
use crate::atlas::Atlas;
use crate::backend::Backend;
use crate::camera::Camera;
use crate::capture::View;
use crate::cholesky;
use crate::error::{Error, Result};
use crate::progress::{Progress, Task};
use crate::radiance_scale::normalised_views;

/// Side of the atlas whose texels are compared: tens of thousands of them.
const SIDE: usize = 256;
/// Scales of the Cauchy weights of successive solutions, in ln L: from differences between exposures to those between
/// reflections.
const SCALES: [f64; 10] = [2.0, 1.0, 0.5, 0.25, 0.12, 0.06, 0.05, 0.05, 0.05, 0.05];
/// Keeps the exposures of views that share no surface with others where they are, up to the normalisation: the weight
/// of that, in observations.
const ANCHOR: f64 = 1e-6;
/// Darker pixels hold noise, where views are about 1 bright.
const DARK: f32 = 1e-4;
/// Views whose exposures seem to differ by less (see [`difference`]) are taken to be exposed alike: reflections alone
/// make that of them.
pub const MIN_DIFFERENCE: f32 = 0.01;
/// Least cosine of the angle between a surface's normal and the view that exposures are told by.
pub(crate) const MIN_COSINE: f32 = 0.4;

/// ln L of one place in one view.
#[derive(Clone, Copy)]
pub(crate) struct Sighting {
    pub view: usize,
    pub log: [f64; 3],
}

/// Per-channel factors by which to multiply the views' radiance so that they agree with each other; their median is 1.
/// A view that shares no surface with others is moved by that normalisation alone.
pub fn solve(backend: &mut dyn Backend, views: &[View], progress: &dyn Progress) -> Result<Vec<[f32; 3]>> {
    let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    let (views, _) = normalised_views(views, progress)?;
    solve_photos(backend, &cameras, |i| photo(&views[i], progress), progress)
}

/// [`solve`] for photos that `load` gives by index.
pub(super) fn solve_photos(
    backend: &mut dyn Backend,
    cameras: &[Camera],
    load: impl FnMut(usize) -> Result<Photo>,
    progress: &dyn Progress,
) -> Result<Vec<[f32; 3]>> {
    let texels = sightings(backend, cameras, load, MIN_COSINE, progress)?;
    Ok(exposures(&texels, cameras.len())?.iter().map(|g| g.map(|g| (-g).exp() as f32)).collect())
}

/// What photos that `load` gives by index show of the texels that two of them see at `min_cosine` or more.
pub(super) fn sightings(
    backend: &mut dyn Backend,
    cameras: &[Camera],
    mut load: impl FnMut(usize) -> Result<Photo>,
    min_cosine: f32,
    progress: &dyn Progress,
) -> Result<Vec<Vec<Sighting>>> {
    let atlas = Atlas::new(backend, [SIDE, SIDE])?;
    let scene = backend.scene().clone();
    let options = TblOptions { min_cosine, ..TblOptions::default() };
    let mut texels: Vec<Vec<Sighting>> = vec![Vec::new(); atlas.points.len()];
    let _task = Task::start(progress, "exposures", cameras.len() as u64, "views");
    for (view, camera) in cameras.iter().enumerate() {
        progress.check()?;
        let photo = load(view)?;
        let projected = backend.project(&atlas.points, camera)?;
        let sampler = Sampler::new(backend, camera, &photo, &options)?;
        texels.par_iter_mut().zip(&atlas.points).zip(&projected).for_each(|((texel, point), at)| {
            let seen = sampler.observe(point, at, atlas.texel_area(scene.mesh(), point.triangle));
            if let Some(seen) = seen.filter(|seen| !seen.masked && seen.radiance.iter().all(|r| *r > DARK)) {
                texel.push(Sighting { view, log: seen.radiance.map(|r| f64::from(r).ln()) });
            }
        });
        progress.advance(1);
    }
    texels.retain(|texel| texel.len() > 1);
    if texels.is_empty() {
        return Err(Error::invalid(
            "exposures cannot be told: no surface is seen by two views, neither black nor masked",
        ));
    }
    Ok(texels)
}

/// How much views differ, in ln, root mean square over views and channels, by the logarithm of each one's brightness
/// over the middle one's; 0 without any.
pub fn difference(exposures: impl IntoIterator<Item = [f32; 3]>) -> f32 {
    let (sum, count) = exposures.into_iter().flatten().fold((0.0, 0.0), |(sum, n), e| (sum + e * e, n + 1.0f32));
    (sum / count.max(1.0)).sqrt()
}

/// By how much each of `views` is brighter than the middle one, in ln, per channel, from what they show of `places`.
pub(crate) fn exposures(places: &[Vec<Sighting>], views: usize) -> Result<Vec<[f64; 3]>> {
    let mut exposure = vec![[0.0; 3]; views];
    for scale in SCALES {
        exposure = least_squares(places, &exposure, scale)?;
    }
    let middle: [f64; 3] = std::array::from_fn(|c| middle(exposure.iter().map(|g| g[c]).collect()));
    Ok(exposure.iter().map(|g| std::array::from_fn(|c| g[c] - middle[c])).collect())
}

/// The median, of an even number the mean of both; 0 of none.
fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
    (at(values.len().saturating_sub(1) / 2) + at(values.len() / 2)) / 2.0
}

/// One weighted solution. The weights follow from how far the sightings of a place are from their median under the
/// exposures so far.
fn least_squares(places: &[Vec<Sighting>], so_far: &[[f64; 3]], scale: f64) -> Result<Vec<[f64; 3]>> {
    let n = so_far.len();
    let mut matrix = vec![0.0; n * n];
    let mut right = vec![[0.0; 3]; n];
    for place in places {
        let rest = |s: &Sighting, c: usize| s.log[c] - so_far[s.view][c];
        let middle: [f64; 3] = std::array::from_fn(|c| middle(place.iter().map(|s| rest(s, c)).collect()));
        let weight = |s: &Sighting| {
            let off = (0..3).map(|c| ((rest(s, c) - middle[c]) / scale).powi(2)).sum::<f64>() / 3.0;
            1.0 / (1.0 + off)
        };
        let weights: Vec<f64> = place.iter().map(weight).collect();
        let total: f64 = weights.iter().sum();
        let mean: [f64; 3] =
            std::array::from_fn(|c| place.iter().zip(&weights).map(|(s, w)| w * s.log[c]).sum::<f64>() / total);
        for (a, wa) in place.iter().zip(&weights) {
            matrix[a.view * n + a.view] += wa;
            for (b, wb) in place.iter().zip(&weights) {
                matrix[a.view * n + b.view] -= wa * wb / total;
            }
            (0..3).for_each(|c| right[a.view][c] += wa * (a.log[c] - mean[c]));
        }
    }
    (0..n).for_each(|i| matrix[i * n + i] += ANCHOR);
    let unusable = || Error::invalid("exposures cannot be told: the views' images hold no usable light");
    cholesky::solve(&mut matrix, &mut right).ok_or_else(unusable)?;
    Ok(right)
}
