//! One view against what others predict of it: Gauss–Newton over the rigid motions of its camera.

use glam::{Mat4, Quat, Vec3};
use rayon::prelude::*;

use crate::camera::Camera;
use crate::cholesky;
use crate::raster::Gray;

/// Gauss–Newton steps of a view in a round.
const STEPS: usize = 3;
/// Difference of ln L at which a texel counts half.
const SCALE: f32 = 0.1;
/// Motion over which derivatives are taken, metres and radians, in widths of a pixel.
const DELTA: f32 = 1.0 / 6.0;

/// A texel, and the ln L that other views show of it.
pub(super) type Prediction = (Vec3, f32);

/// Moves a camera until it shows what is predicted, as well as a few steps allow.
pub(super) fn align(mut camera: Camera, image: &Gray, predictions: &[Prediction]) -> Camera {
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
pub(super) fn residual(camera: &Camera, image: &Gray, &(position, log): &Prediction) -> Option<f32> {
    let residual = image.bilinear(camera.project(position)?.as_dvec2(), camera.wraps()) - log;
    residual.is_finite().then_some(residual)
}

/// The mean robust difference.
fn difference(camera: &Camera, image: &Gray, predictions: &[Prediction]) -> f64 {
    let costs = predictions.iter().filter_map(|p| residual(camera, image, p)).map(robust);
    let (sum, count) = costs.fold((0.0, 0u32), |(sum, count), cost| (sum + cost, count + 1));
    sum / f64::from(count)
}

/// What a difference of ln L counts (Cauchy).
pub(super) fn robust(difference: f32) -> f64 {
    f64::from((difference / SCALE).powi(2)).ln_1p()
}

/// The motion that minimises the weighted squares of the linearised residuals; `None` where they do not determine it.
fn gauss_newton(camera: &Camera, image: &Gray, predictions: &[Prediction]) -> Option<[f32; 6]> {
    let delta = DELTA * camera.pixel_angle();
    let steps: [[Camera; 2]; 6] = std::array::from_fn(|k| {
        [delta, -delta].map(|delta| moved(camera, std::array::from_fn(|i| if i == k { delta } else { 0.0 })))
    });
    let row = |p: &Prediction| -> Option<([f64; 6], f64, f64)> {
        let r = residual(camera, image, p)?;
        let mut jacobian = [0.0; 6];
        for (derivative, [ahead, behind]) in jacobian.iter_mut().zip(&steps) {
            *derivative = f64::from((residual(ahead, image, p)? - residual(behind, image, p)?) / (2.0 * delta));
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
