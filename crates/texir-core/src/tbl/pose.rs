//! Small errors of the camera poses, from surfaces that several views see.
//!
//! Texels that other views see predict what a view shows of them. Gauss–Newton steps over the six degrees of freedom of
//! a rigid motion lessen the difference in logarithmic luminance (direct image alignment, Lucas and Kanade 1981; in
//! logarithms, so that lamps do not outweigh the room). The mesh stays where it is: cameras move against it. A view
//! moves only where that lessens its difference; a view that is brighter than the others throughout is taken to be
//! exposed so, and what views see differently for other reasons is weighed down (Cauchy weights).

use glam::{DVec2, Mat4, Quat, Vec3};
use rayon::prelude::*;

use super::photo;
use super::photo::Photo;
use crate::atlas::Atlas;
use crate::backend::Backend;
use crate::camera::Camera;
use crate::capture::View;
use crate::cholesky;
use crate::error::Result;
use crate::light_unit::in_own_unit;
use crate::progress::{Progress, Task};
use crate::raster::{Gray, mean_of_channels};
use crate::stats::median;
use crate::surface::SurfacePoint;

/// Side of the atlas whose texels are compared.
const SIDE: usize = 512;
/// Texels that are compared at most.
const TEXELS: usize = 60_000;
/// How often all views move against what the others show.
const ROUNDS: usize = 5;
/// Gauss–Newton steps of a view in a round.
const STEPS: usize = 3;
/// Difference of ln L at which a texel counts half.
const SCALE: f32 = 0.1;
/// Motion over which derivatives are taken, metres and radians: a fraction of a pixel.
const DELTA: f32 = 2e-3;
/// Surfaces that are seen at a smaller cosine are not compared: they move too far in the image.
const MIN_COSINE: f32 = 0.2;
/// Keeps the logarithm of black finite, where views are about 1 bright.
const BLACK: f32 = 1e-4;

/// A texel, and the ln L that other views show of it.
type Prediction = (Vec3, f32);

/// The views' poses (camera to world), refined.
pub fn refine(backend: &mut dyn Backend, views: &[View], progress: &dyn Progress) -> Result<Vec<Mat4>> {
    let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    let (views, _) = in_own_unit(views, progress)?;
    let refined = refine_photos(backend, cameras, |i| photo(&views[i], progress), progress)?;
    Ok(refined.iter().map(|camera| camera.world_from_camera).collect())
}

/// [`refine`] for photos that `load` gives by index.
pub(super) fn refine_photos(
    backend: &mut dyn Backend,
    mut cameras: Vec<Camera>,
    mut load: impl FnMut(usize) -> Result<Photo>,
    progress: &dyn Progress,
) -> Result<Vec<Camera>> {
    let atlas = Atlas::new(backend, [SIDE, SIDE])?;
    let points: Vec<SurfacePoint> = atlas.points.iter().step_by(atlas.points.len().div_ceil(TEXELS)).copied().collect();
    let _task = Task::start(progress, "camera poses", (ROUNDS * cameras.len()) as u64, "views");
    for _ in 0..ROUNDS {
        let mut shown: Vec<Vec<f32>> = Vec::with_capacity(cameras.len());
        for (view, camera) in cameras.iter().enumerate() {
            progress.check()?;
            let image = log_means(&load(view)?);
            let projected = backend.project(&points, camera)?;
            let log = |at: &crate::backend::Projected| match at.distance > 0.0 && at.cosine >= MIN_COSINE {
                true => image.bilinear(DVec2::from(at.pixel.map(f64::from)), camera.wraps()),
                false => f32::NAN,
            };
            shown.push(projected.iter().map(log).collect());
        }
        // Exposures of their own are no motion.
        let exposures: Vec<f32> = (0..cameras.len()).map(|view| exposure(&shown, view)).collect();
        for (logs, exposure) in shown.iter_mut().zip(exposures) {
            logs.iter_mut().for_each(|log| *log -= exposure);
        }
        for (view, camera) in cameras.iter_mut().enumerate() {
            progress.check()?;
            let mut predictions: Vec<Prediction> = (0..points.len())
                .into_par_iter()
                .filter(|&i| shown[view][i].is_finite())
                .filter_map(|i| Some((Vec3::from(points[i].position), others(&shown, view, i)?)))
                .collect();
            let image = log_means(&load(view)?);
            let mut brighter: Vec<f32> = predictions.iter().filter_map(|p| residual(camera, &image, p)).collect();
            let exposure = median(&mut brighter).unwrap_or(0.0);
            predictions.iter_mut().for_each(|(_, log)| *log += exposure);
            *camera = align(*camera, &image, &predictions);
            progress.advance(1);
        }
    }
    Ok(cameras)
}

/// The median of the ln L that the other views show of point `i`, if any does.
fn others(shown: &[Vec<f32>], view: usize, i: usize) -> Option<f32> {
    let others = shown.iter().enumerate().filter(|(other, _)| *other != view).map(|(_, logs)| logs[i]);
    median(&mut others.filter(|log| log.is_finite()).collect::<Vec<f32>>())
}

/// By how much a view is brighter than the others, in ln L: the median over the points that it shows with them.
fn exposure(shown: &[Vec<f32>], view: usize) -> f32 {
    let brighter = |i: usize| Some(shown[view][i] - others(shown, view, i)?).filter(|brighter| brighter.is_finite());
    median(&mut (0..shown[view].len()).filter_map(brighter).collect::<Vec<f32>>()).unwrap_or(0.0)
}

/// ln of the mean of the channels; NaN where a pixel must not be used.
fn log_means(photo: &Photo) -> Gray {
    photo.image.map(|radiance| (mean_of_channels(*radiance) + BLACK).ln())
}

/// Moves a camera until it shows what is predicted, as well as a few steps allow.
fn align(mut camera: Camera, image: &Gray, predictions: &[Prediction]) -> Camera {
    let mut error = difference(&camera, image, predictions);
    for _ in 0..STEPS {
        let Some(motion) = gauss_newton(&camera, image, predictions) else { break };
        let candidate = moved(&camera, motion);
        let new = difference(&candidate, image, predictions);
        // An error that is not a number moves nothing.
        if !(new < error) {
            break;
        }
        (camera, error) = (candidate, new);
    }
    camera
}

/// The camera after a motion in its own frame: metres along its axes, then radians about them.
fn moved(camera: &Camera, [x, y, z, a, b, c]: [f32; 6]) -> Camera {
    let motion = Mat4::from_rotation_translation(Quat::from_scaled_axis(Vec3::new(a, b, c)), Vec3::new(x, y, z));
    Camera { world_from_camera: camera.world_from_camera * motion, ..*camera }
}

/// What the camera shows of a prediction, less the prediction, in ln L.
fn residual(camera: &Camera, image: &Gray, &(position, log): &Prediction) -> Option<f32> {
    let residual = image.bilinear(camera.project(position)?.as_dvec2(), camera.wraps()) - log;
    residual.is_finite().then_some(residual)
}

/// The mean robust difference (Cauchy).
fn difference(camera: &Camera, image: &Gray, predictions: &[Prediction]) -> f64 {
    let robust = |p: &Prediction| residual(camera, image, p).map(|r| f64::from((r / SCALE).powi(2)).ln_1p());
    let (sum, count) =
        predictions.iter().filter_map(robust).fold((0.0, 0u32), |(sum, count), cost| (sum + cost, count + 1));
    sum / f64::from(count)
}

/// The motion that minimises the weighted squares of the linearised residuals; `None` where they do not determine it.
fn gauss_newton(camera: &Camera, image: &Gray, predictions: &[Prediction]) -> Option<[f32; 6]> {
    let steps: [[Camera; 2]; 6] = std::array::from_fn(|k| {
        [DELTA, -DELTA].map(|delta| moved(camera, std::array::from_fn(|i| if i == k { delta } else { 0.0 })))
    });
    let row = |p: &Prediction| -> Option<([f64; 6], f64, f64)> {
        let r = residual(camera, image, p)?;
        let mut jacobian = [0.0; 6];
        for (derivative, [ahead, behind]) in jacobian.iter_mut().zip(&steps) {
            *derivative = f64::from((residual(ahead, image, p)? - residual(behind, image, p)?) / (2.0 * DELTA));
        }
        Some((jacobian, f64::from(r), 1.0 / (1.0 + f64::from(r / SCALE).powi(2))))
    };
    let rows: Vec<_> = predictions.par_iter().filter_map(row).collect();
    let (mut matrix, mut right) = ([0.0; 36], [[0.0]; 6]);
    for (jacobian, r, weight) in rows {
        for i in 0..6 {
            for j in 0..6 {
                matrix[i * 6 + j] += weight * jacobian[i] * jacobian[j];
            }
            right[i][0] -= weight * jacobian[i] * r;
        }
    }
    cholesky::solve(&mut matrix, &mut right)?;
    Some(right.map(|[x]| x as f32))
}
