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
/// What is seen tells of a view's motion where it tells of no motion so many times less than of others, by how far they
/// move it: between plain walls, a lamp alone would turn all of them about itself.
const EVEN: f64 = 10.0;
/// Predictions that are summed over at a time.
const BLOCK: usize = 4096;
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

/// The motion that minimises the weighted squares of the linearised residuals; `None` where they do not determine all
/// of it.
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
    if !(unevenness(&matrix, &shifts(camera, predictions))? <= EVEN) {
        return None;
    }
    cholesky::solve(&mut matrix, &mut right)?;
    Some(right.map(|[x]| x as f32))
}

/// How far motions shift what is predicted: the sum of JᵀJ over the directions in which it is seen, by metres and
/// radians as [`moved`] has them.
fn shifts(camera: &Camera, predictions: &[Prediction]) -> [f64; 36] {
    let camera_from_world = camera.world_from_camera.inverse();
    let of_block = |block: &[Prediction]| {
        let mut sum = [0.0; 36];
        for (position, _) in block {
            let at = camera_from_world.transform_point3(*position);
            let (direction, distance) = (at.normalize_or_zero(), at.length().max(f32::MIN_POSITIVE));
            let shift: [Vec3; 6] = std::array::from_fn(|k| match (k, Vec3::AXES[k % 3]) {
                (0..3, axis) => (direction * direction.dot(axis) - axis) / distance,
                (_, axis) => direction.cross(axis),
            });
            sum.iter_mut().enumerate().for_each(|(k, sum)| *sum += f64::from(shift[k / 6].dot(shift[k % 6])));
        }
        sum
    };
    // In a fixed order, for the same bits however many threads there are.
    let blocks: Vec<[f64; 36]> = predictions.par_chunks(BLOCK).map(of_block).collect();
    blocks.iter().fold([0.0; 36], |sum, block| std::array::from_fn(|k| sum[k] + block[k]))
}

/// How unevenly the `information` of motions is spread over them, by the squares of what they shift: the mean of its
/// eigenvalues relative to these, times that of their inverses; 1 where all are told alike. It is the same in whichever
/// units and axes. `None` where either is singular.
fn unevenness(information: &[f64; 36], shifts: &[f64; 36]) -> Option<f64> {
    let mean_eigenvalue = |mut over: [f64; 36], of: &[f64; 36]| -> Option<f64> {
        let mut of: [[f64; 6]; 6] = std::array::from_fn(|i| std::array::from_fn(|j| of[i * 6 + j]));
        cholesky::solve(&mut over, &mut of)?;
        Some((0..6).map(|i| of[i][i]).sum::<f64>() / 6.0)
    };
    Some(mean_eigenvalue(*shifts, information)? * mean_eigenvalue(*information, shifts)?)
}
