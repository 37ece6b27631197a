//! What is up where no format says it: by the cameras, which are held level more or less.
//!
//! The axes of such a source mean something or nothing. Where somebody levelled it, one of them is up exactly, and the
//! mean of the cameras' ups is off by how they were held. As COLMAP leaves a model, its frame is roughly that of the
//! first camera: an axis near the mean is up as far as that one camera was level, which the mean of many knows better.
//! An axis is therefore taken only where the mean, for all that is known of it, may be it.

use glam::DVec3;

use crate::camera::Camera;
use crate::error::{Error, Result};

/// Degrees within which an axis is taken whatever the cameras say: levelled or not, the harm is small.
const NEAREST: f64 = 1.0;
/// Degrees beyond which none is.
const FARTHEST: f64 = 10.0;
/// Degrees by which each camera is held otherwise at least, in both directions: few may agree by chance, and copies of
/// one pose tell no more than it does.
const STEADIEST: f64 = 1.0;
/// By how many standard errors the mean may be off.
const STANDARD_ERRORS: f64 = 2.0;

/// The mean of the cameras' own up directions, or the axis that it may stand for; and which of them it is.
pub(super) fn from_cameras<'a>(cameras: impl Iterator<Item = &'a Camera> + Clone) -> Result<(DVec3, &'static str)> {
    let sum: DVec3 = cameras.clone().map(|camera| up_and_ahead(camera).0).sum();
    let mean = sum.try_normalize().ok_or_else(|| {
        Error::invalid("the cameras do not tell what is up, and neither does the format: say it with --up")
    })?;
    // A doubt that is no number counts as the largest.
    let doubt = Some(doubt(cameras, mean).to_degrees()).filter(|doubt| !doubt.is_nan());
    let doubt = doubt.map_or(FARTHEST, |doubt| doubt.clamp(NEAREST, FARTHEST));
    let axes = [DVec3::Z, DVec3::Y, DVec3::X, DVec3::NEG_Z, DVec3::NEG_Y, DVec3::NEG_X];
    let near = axes.into_iter().find(|axis| axis.angle_between(mean).to_degrees() < doubt);
    Ok(match near {
        Some(axis) => (axis, "the axis nearest to the cameras' mean up direction"),
        None => (mean, "the cameras' mean up direction; the format does not tell"),
    })
}

/// Where the camera's up is, and where it looks.
fn up_and_ahead(camera: &Camera) -> (DVec3, DVec3) {
    let pose = camera.world_from_camera;
    (pose.y_axis.truncate().as_dvec3(), -pose.z_axis.truncate().as_dvec3())
}

/// How far gravity may be from the mean of the cameras' ups, radians; infinite or NaN where they do not tell.
///
/// Each camera is held a little otherwise, which leaves the mean off by a standard error. But cameras may also be held
/// alike, as when all look down. Where they look all around, the mean is free of such a tilt; where they look one way,
/// their ups agree, and are all off. Hence the fit by least squares of up = gravity + tilt · heading: the mean has the
/// tilt as far as it has a heading, and so it has the tilt's own standard error, which grows without bound as headings
/// become one. Then, and of one camera, the mean knows nothing better than an axis nearby.
fn doubt<'a>(cameras: impl Iterator<Item = &'a Camera>, mean: DVec3) -> f64 {
    let (mut count, mut squares, mut along, mut headings) = (0.0, 0.0, 0.0, DVec3::ZERO);
    for (up, ahead) in cameras.map(up_and_ahead) {
        let off = up.reject_from_normalized(mean);
        let heading = ahead.reject_from_normalized(mean).normalize_or_zero();
        count += 1.0;
        squares += off.length_squared();
        along += off.dot(heading);
        headings += heading;
    }
    let one_way = (headings / count).length_squared().min(1.0);
    let around = 1.0 - one_way;
    let tilt = along / (count * around);
    // Of what the fit leaves, in one of two directions. Gravity takes two numbers, the tilt one; NaN is the least.
    let variance = f64::max((squares - tilt * along) / (2.0 * count - 3.0), STEADIEST.to_radians().powi(2));
    let standard_error = (variance / count * (2.0 + one_way / around)).sqrt();
    one_way.sqrt() * tilt.abs() + STANDARD_ERRORS * standard_error
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{FRAC_PI_2, TAU};

    use glam::{Mat4, Quat, Vec3};

    use super::*;
    use crate::camera::Projection;

    /// Cameras that look around over `fan` degrees, `down` degrees below the horizon, each held a little otherwise (up
    /// to 3° up or down, 2° to a side), in a world whose up is `up`.
    fn cameras(count: usize, fan: f32, down: f32, up: DVec3) -> Vec<Camera> {
        let world_from_level = Quat::from_rotation_arc(Vec3::Z, up.as_vec3());
        let camera = |i: usize| {
            let yaw = (fan / 360.0 * TAU) * i as f32 / count as f32;
            let pitch = 3.0 * (TAU * 0.618 * i as f32).sin() - down;
            let roll = 2.0 * (TAU * 0.382 * i as f32 + 1.0).cos();
            let held = Quat::from_rotation_z(yaw)
                * Quat::from_rotation_x(FRAC_PI_2 + pitch.to_radians())
                * Quat::from_rotation_z(roll.to_radians());
            let projection = Projection::Pinhole { fx: 5.0, fy: 5.0, cx: 4.0, cy: 2.0 };
            Camera { projection, width: 8, height: 4, world_from_camera: Mat4::from_quat(world_from_level * held) }
        };
        (0..count).map(camera).collect()
    }

    /// A direction so many degrees from −Y, where COLMAP's frames have up, about an axis that is none of the cameras'.
    fn off_axis(degrees: f64) -> DVec3 {
        let (sin, cos) = degrees.to_radians().sin_cos();
        DVec3::new(0.8 * sin, -cos, 0.6 * sin)
    }

    /// What the cameras tell, and how many degrees that is from `up`.
    #[track_caller]
    fn told(count: usize, fan: f32, down: f32, up: DVec3) -> (DVec3, f64) {
        let (told, _) = from_cameras(cameras(count, fan, down, up).iter()).unwrap();
        (told, told.angle_between(up).to_degrees())
    }

    #[test]
    fn many_cameras_know_better_than_an_axis_that_is_one_of_theirs() {
        for degrees in [3.0, 6.0, 9.0] {
            for (fan, down) in [(360.0, 0.0), (360.0, 8.0), (180.0, 0.0)] {
                let (told, off) = told(16, fan, down, off_axis(degrees));
                assert!(off < 1.0, "{told} is {off}° off: {degrees}°, a fan of {fan}°, {down}° down");
            }
        }
    }

    #[test]
    fn an_axis_that_the_mean_may_be_is_up() {
        for (count, fan, down) in [(1, 0.0, 8.0), (2, 90.0, 5.0), (4, 360.0, 8.0), (16, 360.0, 0.0), (16, 360.0, 8.0)] {
            assert_eq!(told(count, fan, down, DVec3::NEG_Y).0, DVec3::NEG_Y, "{count}, {fan}°, {down}° down");
        }
    }

    #[test]
    fn a_tilt_that_all_cameras_have_is_no_reason_to_leave_an_axis() {
        // At a spot, along a wall, into a corner, and over half a turn.
        for fan in [0.0, 10.0, 90.0, 180.0] {
            let mean: DVec3 = cameras(16, fan, 8.0, DVec3::Z).iter().map(|camera| up_and_ahead(camera).0).sum();
            assert!(mean.angle_between(DVec3::Z).to_degrees() > 4.5, "a fan of {fan}° tells of no tilt");
            assert_eq!(told(16, fan, 8.0, DVec3::Z).0, DVec3::Z, "a fan of {fan}°");
        }
        // Negative control: nobody who means to be level holds a camera like that.
        assert!(told(16, 0.0, 15.0, DVec3::Z).1 > FARTHEST);
    }
}
