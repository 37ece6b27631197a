//! Errors of the camera poses, from surfaces that several views see.
//!
//! Texels that other views see predict what a view shows of them. Gauss–Newton steps over the six degrees of freedom of
//! a rigid motion lessen the difference in logarithmic luminance (direct image alignment, Lucas and Kanade 1981; in
//! logarithms, so that lamps do not outweigh the room). A step sees no farther than a pixel or two, so views are first
//! compared in the widest pixels that tell of an error, and then in ever smaller ones. The mesh stays where it is:
//! cameras move against it. A view moves only where that lessens its difference; a view that is brighter than the
//! others throughout is taken to be exposed so, and what views see differently for other reasons is weighed down
//! (Cauchy weights). Where most views turn out to have been in place, as far as can be told, they stay there, and the
//! others are aligned with them.

mod align;

use std::sync::Arc;

use glam::{DVec2, Mat4, Vec3};
use rayon::prelude::*;

use self::align::{Prediction, align, residual, robust};
use super::photo;
use crate::atlas::Atlas;
use crate::backend::{Backend, Projected};
use crate::camera::Camera;
use crate::capture::View;
use crate::error::Result;
use crate::progress::{Progress, Task};
use crate::radiance_scale::radiance_scale;
use crate::raster::{Gray, mean_of_channels};
use crate::stats::{median, root_mean_square};
use crate::surface::SurfacePoint;

/// Side of the atlas whose texels are compared.
const SIDE: usize = 512;
/// Texels that are compared, at most.
const TEXELS: usize = 60_000;
/// Texels, likewise, in pixels that are wider than need be.
const FEW_TEXELS: usize = 20_000;
/// Texels, likewise, where it is only asked whether views are in place.
const FEWEST_TEXELS: usize = 6_000;
/// Narrower pixels are joined up to this width, radians: a tenth of one is less than a texel covers.
const FINEST: f32 = 4e-3;
/// Pixels are not made wider than this, radians: a room is only some dozens of them wide.
const COARSEST: f32 = 0.1;
/// Rows and columns of an image that are left at least.
const FEWEST_ROWS: usize = 16;
/// Wide pixels count where they move views by this many of them, root mean square: what else differs between views
/// moves them by less.
const TELLING: f32 = 0.6;
/// Most views are in place where half of them would move by less than so many pixels, root mean square over what each
/// sees: those of glossy rooms would move by nearly as much from where they truly are.
const IN_PLACE: f32 = 0.25;
/// A view that would move by so many is not, even if most are.
const OUT_OF_PLACE: f32 = 0.6;
/// Rounds, in pixels of one width, in which all views move against what the others show.
const ROUNDS: usize = 6;
/// Rounds where it is only asked whether views are in place.
const FEW_ROUNDS: usize = 4;
/// Surfaces that are seen at a smaller cosine are not compared: they move too far in the image.
const MIN_COSINE: f32 = 0.2;
/// Keeps the logarithm of black finite, where views are about 1 bright.
const BLACK: f32 = 1e-4;

/// The views' refined poses (camera to world). If the median view would move by less than 0.25 pixels RMS, all that
/// would move by less than 0.6 keep their pose.
pub fn refine(backend: &mut dyn Backend, views: &[View], progress: &dyn Progress) -> Result<Vec<Mat4>> {
    let (pictures, points) = (pictures(views, progress)?, points(backend)?);
    let refined = refine_pictures(backend, &pictures, &points, ROUNDS, progress)?;
    Ok(refined.iter().map(|picture| picture.camera.world_from_camera).collect())
}

/// Rough misalignment of each view, in its own pixels, RMS; `None` below 0.6 pixels of an image that is reduced to
/// pixels of 0.2° where its own are narrower. Costs a fraction of [`refine`].
pub fn out_of_place(backend: &mut dyn Backend, views: &[View], progress: &dyn Progress) -> Result<Vec<Option<f32>>> {
    let (pictures, points) = (pictures(views, progress)?, some_of(&points(backend)?, FEWEST_TEXELS));
    let refined = refine_pictures(backend, &pictures, &points, FEW_ROUNDS, progress)?;
    let moved = apart(backend, &points, &pictures, &refined)?;
    let told = |((pixels, picture), view): ((f32, &Picture), &View)| {
        (pixels >= OUT_OF_PLACE).then(|| pixels * picture.camera.pixel_angle() / view.camera.pixel_angle())
    };
    Ok(moved.into_iter().zip(&pictures).zip(views).map(told).collect())
}

/// What a view shows.
#[derive(Clone, Debug)]
pub(super) struct Picture {
    pub camera: Camera,
    /// ln of the mean of the channels; NaN where a pixel must not be used.
    log: Arc<Gray>,
}

impl Picture {
    /// What a camera sees: the mean of the channels, times `scale` about 1.
    pub(super) fn new(camera: Camera, means: &Gray, scale: f32) -> Self {
        Self { camera, log: Arc::new(means.map(|mean| (scale * mean + BLACK).ln())) }
    }

    /// The same in pixels 2^`level` times as wide, or as wide as is possible up to that.
    fn at(&self, level: u32) -> Self {
        let width = self.camera.pixel_angle() * (1 << level) as f32;
        let (factor, camera) = reduced(&self.camera, COARSEST.min(width));
        let mean = |logs: &[f32]| logs.iter().sum::<f32>() / logs.len() as f32;
        Self { camera, log: Arc::new(Gray::clone(&self.log).reduced(factor, mean)) }
    }

    /// The same from where another camera is.
    fn posed_as(&self, other: &Camera) -> Self {
        let camera = Camera { world_from_camera: other.world_from_camera, ..self.camera };
        Self { camera, log: self.log.clone() }
    }

    /// ln L of the points, from where they are seen well; NaN elsewhere.
    fn show(&self, backend: &mut dyn Backend, points: &[SurfacePoint]) -> Result<Vec<f32>> {
        let log = |at: &Projected| match at.distance > 0.0 && at.cosine >= MIN_COSINE {
            true => self.log.bilinear(DVec2::from(at.pixel.map(f64::from)), self.camera.wraps()),
            false => f32::NAN,
        };
        Ok(backend.project(points, &self.camera)?.iter().map(log).collect())
    }
}

/// A camera with pixels as wide as can be, up to so many radians and as [`FEWEST_ROWS`] allows; how many times as wide
/// they are.
fn reduced(camera: &Camera, width: f32) -> (usize, Camera) {
    let rows = camera.width.min(camera.height) / FEWEST_ROWS;
    let most = ((width / camera.pixel_angle()) as usize).clamp(1, rows.max(1));
    let possible = (1..=most).rev().find_map(|factor| Some((factor, camera.reduced(factor)?)));
    possible.unwrap_or((1, *camera))
}

/// What the views show, in the smallest pixels that are compared.
fn pictures(views: &[View], progress: &dyn Progress) -> Result<Vec<Picture>> {
    let _task = Task::start(progress, "what views show", views.len() as u64, "views");
    let mut seen = Vec::with_capacity(views.len());
    for view in views {
        progress.check()?;
        let (factor, camera) = reduced(&view.camera, FINEST);
        let photo = photo(view.reduced(factor).as_ref().unwrap_or(view), progress)?;
        seen.push((camera, photo.image.map(|radiance| mean_of_channels(*radiance))));
        progress.advance(1);
    }
    let all = || seen.iter().flat_map(|(_, means)| &means.data).filter(|mean| mean.is_finite());
    let scale = radiance_scale(all().map(|mean| f64::from(*mean)).sum::<f64>() / all().count() as f64);
    Ok(seen.into_iter().map(|(camera, means)| Picture::new(camera, &means, scale)).collect())
}

/// Surface points that views are compared at.
pub(super) fn points(backend: &mut dyn Backend) -> Result<Vec<SurfacePoint>> {
    Ok(some_of(&Atlas::new(backend, [SIDE, SIDE])?.points, TEXELS))
}

/// Points here and there, `most` of them.
fn some_of(points: &[SurfacePoint], most: usize) -> Vec<SurfacePoint> {
    points.iter().step_by(points.len().div_ceil(most)).copied().collect()
}

/// Pictures, compared at `points`, with their cameras refined in so many `rounds` per width of their pixels.
pub(super) fn refine_pictures(
    backend: &mut dyn Backend,
    pictures: &[Picture],
    points: &[SurfacePoint],
    rounds: usize,
    progress: &dyn Progress,
) -> Result<Vec<Picture>> {
    let widest = pictures.iter().map(|picture| reduced(&picture.camera, COARSEST).0).max().unwrap_or(1);
    let coarsest = widest.ilog2();
    let moves = (coarsest as usize + 2) * rounds * pictures.len();
    let _task = Task::start(progress, "camera poses", moves as u64, "views");
    let few = some_of(points, FEW_TEXELS);
    let mut best = Compared::new(backend, &few, pictures.to_vec())?;
    let mut were_out = false;
    for level in (1..=coarsest).rev() {
        let wide: Vec<Picture> = best.pictures.iter().map(|picture| picture.at(level)).collect();
        let mut compared = Compared::new(backend, &few, wide.clone())?;
        compared.rounds(rounds, backend, progress)?;
        let pixels = apart(backend, &few, &wide, &compared.pictures)?;
        // Finer levels lessen the errors of coarser ones.
        if !were_out && root_mean_square(&pixels) < TELLING {
            continue;
        }
        let moved = pictures.iter().zip(&compared.pictures).map(|(picture, moved)| picture.posed_as(&moved.camera));
        let moved = Compared::new(backend, &few, moved.collect())?;
        if moved.difference() < best.difference() {
            (best, were_out) = (moved, true);
        }
    }
    let mut free = Compared::new(backend, points, best.pictures)?;
    free.rounds(rounds, backend, progress)?;
    let moved = apart(backend, points, pictures, &free.pictures)?;
    if !median(&mut moved.clone()).is_some_and(|pixels| pixels < IN_PLACE) {
        return Ok(free.pictures);
    }
    let held: Vec<bool> = moved.iter().map(|pixels| *pixels < OUT_OF_PLACE).collect();
    let kept = pictures.iter().zip(free.pictures).zip(&held);
    let kept = kept.map(|((given, moved), held)| if *held { given.clone() } else { moved }).collect();
    let mut anchored = Compared { held, ..Compared::new(backend, points, kept)? };
    anchored.rounds(rounds, backend, progress)?;
    Ok(anchored.pictures)
}

/// How many of its pixels lie between where a picture shows what it sees and where it would show that as another that
/// is posed otherwise; for each of `before`, root mean square.
fn apart(
    backend: &mut dyn Backend,
    points: &[SurfacePoint],
    before: &[Picture],
    after: &[Picture],
) -> Result<Vec<f32>> {
    let of_picture = |(Picture { camera: a, .. }, Picture { camera: b, .. }): (&Picture, &Picture)| {
        let [from_a, from_b] = [a, b].map(|camera| camera.world_from_camera.inverse());
        let angle = |point: &SurfacePoint| {
            let [a, b] = [from_a, from_b].map(|camera| camera.transform_point3(point.position.into()).normalize());
            a.distance(b)
        };
        let projected = backend.project(points, a)?;
        let seen = projected.iter().zip(points).filter(|(at, _)| at.distance > 0.0);
        let angles: Vec<f32> = seen.map(|(_, point)| angle(point)).collect();
        Ok(root_mean_square(&angles) / a.pixel_angle())
    };
    before.iter().zip(after).map(of_picture).collect()
}

/// Pictures beside each other.
struct Compared<'a> {
    points: &'a [SurfacePoint],
    pictures: Vec<Picture>,
    /// By how much each picture is brighter than the others, in ln L: that is no motion.
    exposures: Vec<f32>,
    /// ln L of the points in each picture, but for its exposure.
    shown: Vec<Vec<f32>>,
    /// Which pictures stay where they are.
    held: Vec<bool>,
}

impl<'a> Compared<'a> {
    fn new(backend: &mut dyn Backend, points: &'a [SurfacePoint], pictures: Vec<Picture>) -> Result<Self> {
        let shown = pictures.iter().map(|picture| picture.show(backend, points)).collect::<Result<Vec<_>>>()?;
        let exposures = (0..pictures.len()).map(|view| exposure(&shown, view)).collect();
        let held = vec![false; pictures.len()];
        let mut compared = Self { points, pictures, exposures, shown, held };
        (0..compared.shown.len()).for_each(|view| compared.bring_to_one_exposure(view));
        Ok(compared)
    }

    fn bring_to_one_exposure(&mut self, view: usize) {
        self.shown[view].iter_mut().for_each(|log| *log -= self.exposures[view]);
    }

    /// The mean difference, robustly, between what a picture shows of a point and what the others show.
    fn difference(&self) -> f64 {
        let views = 0..self.pictures.len();
        let of_view = |view: usize| -> Vec<f64> {
            let difference = |i: usize| Some(robust(self.shown[view][i] - others(&self.shown, view, i)?));
            shown_in(&self.shown[view]).filter_map(difference).collect()
        };
        let all: Vec<f64> = views.flat_map(of_view).collect();
        all.iter().sum::<f64>() / all.len() as f64
    }

    fn rounds(&mut self, rounds: usize, backend: &mut dyn Backend, progress: &dyn Progress) -> Result<()> {
        (0..rounds).try_for_each(|_| self.round(backend, progress))
    }

    /// Moves one picture after the other to where it shows what the others show.
    fn round(&mut self, backend: &mut dyn Backend, progress: &dyn Progress) -> Result<()> {
        for view in 0..self.pictures.len() {
            progress.check()?;
            progress.advance(1);
            if self.held[view] {
                continue;
            }
            let Picture { camera, log } = &self.pictures[view];
            let mut predictions = self.predictions(view);
            let mut brighter: Vec<f32> = predictions.iter().filter_map(|p| residual(camera, log, p)).collect();
            let exposure = median(&mut brighter).unwrap_or(0.0);
            predictions.iter_mut().for_each(|(_, log)| *log += exposure);
            self.pictures[view].camera = align(*camera, log, &predictions);
            self.shown[view] = self.pictures[view].show(backend, self.points)?;
            self.bring_to_one_exposure(view);
        }
        Ok(())
    }

    /// What a picture should show of the points that it does show.
    fn predictions(&self, view: usize) -> Vec<Prediction> {
        let others = |i: usize| Some((Vec3::from(self.points[i].position), others(&self.shown, view, i)?));
        shown_in(&self.shown[view]).filter_map(others).collect()
    }
}

/// The points of which this picture shows ln L.
fn shown_in(logs: &[f32]) -> impl ParallelIterator<Item = usize> {
    (0..logs.len()).into_par_iter().filter(|&i| logs[i].is_finite())
}

/// The median of the ln L that the other views show of point `i`, if any does.
fn others(shown: &[Vec<f32>], view: usize, i: usize) -> Option<f32> {
    let others = shown.iter().enumerate().filter(|(other, _)| *other != view).map(|(_, logs)| logs[i]);
    median(&mut others.filter(|log| log.is_finite()).collect::<Vec<f32>>())
}

/// By how much a view is brighter than the others, in ln L: the median over the points that it shows with them.
fn exposure(shown: &[Vec<f32>], view: usize) -> f32 {
    let brighter = |i: usize| Some(shown[view][i] - others(shown, view, i)?);
    median(&mut shown_in(&shown[view]).filter_map(brighter).collect::<Vec<f32>>()).unwrap_or(0.0)
}
