//! Cameras: equirectangular panoramas and pinholes. OpenGL axes: +X right, +Y up, looking along −Z.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use glam::{DMat3, DMat4, Mat4, Vec2, Vec3, Vec4};

use crate::error::{Error, Result};
use crate::real::{Real, V3};

/// How pixels map to directions in camera space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Full panorama: λ = 2π(u−½), φ = πv, direction (sin λ sin φ, cos φ, −cos λ sin φ); the image centre looks along
    /// −Z.
    Equirectangular,
    /// Direction normalize((x−cx)/fx, −(y−cy)/fy, −1); all in pixels.
    Pinhole {
        /// Focal length in x, pixels.
        fx: f32,
        /// Focal length in y, pixels.
        fy: f32,
        /// Principal point x, pixels.
        cx: f32,
        /// Principal point y, pixels.
        cy: f32,
    },
}

/// A rotation may differ from an orthonormal one by this much per entry of RᵀR: files with few digits, f32 arithmetic.
const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

/// A posed camera. Passes refuse one that fails [`Camera::check`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Pixel-to-direction model.
    pub projection: Projection,
    /// Image columns.
    pub width: usize,
    /// Image rows.
    pub height: usize,
    /// Rigid camera-to-world transform, metres.
    pub world_from_camera: Mat4,
}

impl Camera {
    /// The principal point of a pinhole, pixels, where it lies outside of the image: most likely of intrinsics for images
    /// of another size.
    pub fn centre_outside(&self) -> Option<[f32; 2]> {
        let Projection::Pinhole { cx, cy, .. } = self.projection else { return None };
        let inside = |at: f32, size: usize| (0.0..=size as f32).contains(&at);
        (!(inside(cx, self.width) && inside(cy, self.height))).then_some([cx, cy])
    }

    /// Errors on an image without pixels or with 2³² of them or more, on numbers of the projection that are not finite
    /// or focal lengths of 0, and on a pose that is not rigid: one that scales, shears or mirrors would be projected
    /// wrongly.
    pub fn check(&self) -> Result<()> {
        let Self { projection, width, height, world_from_camera: pose } = self;
        if !width.checked_mul(*height).is_some_and(|pixels| (1..=u32::MAX as usize).contains(&pixels)) {
            return Err(Error::invalid(format!(
                "the camera's image is {width}×{height} pixels; expected 1 to {} of them",
                u32::MAX
            )));
        }
        if let Projection::Pinhole { fx, fy, cx, cy } = *projection
            && !([fx, fy, cx, cy].iter().all(|v| v.is_finite()) && fx != 0.0 && fy != 0.0)
        {
            return Err(Error::invalid(format!(
                "the camera's pinhole has fx {fx}, fy {fy}, cx {cx}, cy {cy}; expected finite pixels, fx and fy not 0"
            )));
        }
        // An inverse may be off by rounding.
        let is_affine = (pose.row(3) - Vec4::W).abs().max_element() <= ORTHONORMAL_TOLERANCE as f32;
        if !pose.is_finite() || !is_affine {
            return Err(Error::invalid(format!(
                "the camera's world_from_camera is {pose}; expected finite numbers, and 0, 0, 0, 1 as its last row"
            )));
        }
        check_rigid(&pose.as_dmat4()).map_err(|what| Error::invalid(format!("the camera's world_from_camera {what}")))
    }

    /// The optical centre in world space.
    pub fn position(&self) -> Vec3 {
        self.world_from_camera.w_axis.truncate()
    }

    /// Unit world direction through continuous pixel coordinates (pixel centres at +0.5).
    pub fn direction(&self, x: f32, y: f32) -> Vec3 {
        self.direction_in(x, y).0.into()
    }

    /// [`Camera::direction`] through the centre of a pixel, by its index.
    pub(crate) fn direction_of(&self, pixel: usize) -> Vec3 {
        self.direction((pixel % self.width) as f32 + 0.5, (pixel / self.width) as f32 + 0.5)
    }

    /// [`Camera::direction`] in any scalar.
    pub fn direction_in<R: Real>(&self, x: R, y: R) -> V3<R> {
        let local = match self.projection {
            Projection::Equirectangular => {
                let lambda = R::of(TAU) * (x / R::of(self.width as f64) - R::of(0.5));
                let phi = R::of(PI) * y / R::of(self.height as f64);
                V3([lambda.sin() * phi.sin(), phi.cos(), -lambda.cos() * phi.sin()])
            }
            Projection::Pinhole { fx, fy, cx, cy } => {
                let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|p| R::of(f64::from(p)));
                V3([(x - cx) / fx, -(y - cy) / fy, R::of(-1.0)])
            }
        };
        let m = self.world_from_camera;
        let [i, j, k] = [m.x_axis, m.y_axis, m.z_axis].map(|a| V3::of(a.truncate().to_array()));
        (i * local.0[0] + j * local.0[1] + k * local.0[2]).normalize()
    }

    /// Continuous pixel coordinates of a world point; `None` behind a pinhole or outside the image.
    pub fn project(&self, point: Vec3) -> Option<Vec2> {
        self.project_in(V3(point.to_array())).map(Into::into)
    }

    /// [`Camera::project`] in any scalar.
    pub fn project_in<R: Real>(&self, point: V3<R>) -> Option<[R; 2]> {
        let m = self.world_from_camera;
        let from_centre = point - V3::of(self.position().to_array());
        // The inverse of a rigid rotation is its transpose.
        let V3([x, y, z]) =
            V3([m.x_axis, m.y_axis, m.z_axis].map(|a| V3::of(a.truncate().to_array()).dot(from_centre)));
        let (width, height) = (R::of(self.width as f64), R::of(self.height as f64));
        let (px, py) = match self.projection {
            Projection::Equirectangular => {
                // acos(y / length), without its loss of digits at the poles.
                let polar = (x * x + z * z).sqrt().atan2(y);
                ((x.atan2(-z) / R::of(TAU) + R::of(0.5)) * width, polar / R::of(PI) * height)
            }
            Projection::Pinhole { fx, fy, cx, cy } => {
                if !(z < R::of(0.0)) {
                    return None;
                }
                let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|p| R::of(f64::from(p)));
                (cx - fx * x / z, cy + fy * y / z)
            }
        };
        let inside = |p: R, size: R| p >= R::of(0.0) && p <= size;
        (inside(px, width) && inside(py, height)).then_some([px, py])
    }

    /// The same view with `factor` pixels for each along both axes.
    pub fn supersampled(&self, factor: usize) -> Self {
        let scale = factor as f32;
        let projection = match self.projection {
            Projection::Equirectangular => Projection::Equirectangular,
            Projection::Pinhole { fx, fy, cx, cy } => {
                Projection::Pinhole { fx: fx * scale, fy: fy * scale, cx: cx * scale, cy: cy * scale }
            }
        };
        Self { projection, width: self.width * factor, height: self.height * factor, ..*self }
    }

    /// Index of part `k`, row by row, of a pixel of the view that this one was [`supersampled`](Self::supersampled)
    /// from.
    pub(crate) fn sub_pixel(&self, factor: usize, pixel: usize, k: usize) -> usize {
        let width = self.width / factor;
        let (x, y) = (pixel % width * factor, pixel / width * factor);
        (y + k / factor) * self.width + x + k % factor
    }

    /// The same view with one pixel for `factor` along both axes; columns and rows that do not fill one are cut off.
    /// `None` where a panorama would not stay whole, no pixel would be left, or `factor` is 0.
    pub fn reduced(&self, factor: usize) -> Option<Self> {
        let (width, height) = (self.width.checked_div(factor)?, self.height.checked_div(factor)?);
        if width == 0 || height == 0 {
            return None;
        }
        let projection = match self.projection {
            Projection::Equirectangular if (width * factor, height * factor) != (self.width, self.height) => {
                return None;
            }
            Projection::Equirectangular => Projection::Equirectangular,
            Projection::Pinhole { fx, fy, cx, cy } => {
                let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|p| p / factor as f32);
                Projection::Pinhole { fx, fy, cx, cy }
            }
        };
        Some(Self { projection, width, height, ..*self })
    }

    /// The angle between neighbouring pixels at the middle of the image, radians.
    pub fn pixel_angle(&self) -> f32 {
        match self.projection {
            Projection::Equirectangular => std::f32::consts::TAU / self.width as f32,
            Projection::Pinhole { fx, .. } => 1.0 / fx,
        }
    }

    /// Pixels per radian along the image's axes, near row `y`: the columns of a panorama crowd towards its poles (1/sin
    /// φ).
    pub fn pixels_per_radian(&self, y: f32) -> Vec2 {
        match self.projection {
            Projection::Equirectangular => {
                let rows = self.height as f32 / PI as f32;
                let columns = self.width as f32 / TAU as f32;
                let sin = (y / rows).sin();
                Vec2::new(columns / sin.max(1.0 / self.width as f32), rows)
            }
            Projection::Pinhole { fx, fy, .. } => Vec2::new(fx.abs(), fy.abs()),
        }
    }

    /// Solid angle of a pixel, steradians.
    pub fn solid_angle(&self, pixel: usize) -> f32 {
        let (x, y) = ((pixel % self.width) as f32, (pixel / self.width) as f32);
        let across = self.direction(x + 1.0, y + 0.5) - self.direction(x, y + 0.5);
        let down = self.direction(x + 0.5, y + 1.0) - self.direction(x + 0.5, y);
        across.cross(down).length()
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Whether the image's left and right side meet.
    pub(crate) fn wraps(&self) -> bool {
        self.projection == Projection::Equirectangular
    }

    /// Index of the pixel in a column and a row, which may lie outside: `None`, but for columns where the image
    /// [wraps](Self::wraps).
    pub(crate) fn pixel(&self, column: i64, row: i64) -> Option<usize> {
        let (width, height) = (self.width as i64, self.height as i64);
        let column = if self.wraps() { column.rem_euclid(width) } else { column };
        ((0..width).contains(&column) && (0..height).contains(&row)).then_some((row * width + column) as usize)
    }

    /// All of its rows.
    pub fn rows(&self) -> Range<usize> {
        0..self.height
    }
}

/// That the upper left of the matrix is a rotation; what is wrong with it otherwise, as the end of a sentence.
pub(crate) fn check_rigid(matrix: &DMat4) -> Result<(), String> {
    let rotation = DMat3::from_mat4(*matrix);
    let determinant = rotation.determinant();
    let lengths = [rotation.x_axis, rotation.y_axis, rotation.z_axis].map(|axis| axis.length());
    // Relative to the lengths of the axes, so that a tiny but proper scale is not mistaken for a singular matrix.
    let spanned = determinant / lengths.iter().product::<f64>();
    if spanned.is_nan() || spanned.abs() <= 1e-6 {
        return Err(format!(
            "is singular (determinant {determinant:.3e}); expected a rotation and a translation, camera to world"
        ));
    }
    if determinant < 0.0 {
        return Err(format!(
            "mirrors (determinant {determinant:.3}); expected a rotation of determinant +1: flip one axis, as when \
             converting from a left-handed frame"
        ));
    }
    let difference = rotation.transpose() * rotation - DMat3::IDENTITY;
    let largest = difference.to_cols_array().into_iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    if largest > ORTHONORMAL_TOLERANCE {
        return Err(format!(
            "is not rigid: its axes have the lengths {:.4}, {:.4}, {:.4} and RᵀR differs from 1 by {largest:.2e}; expected \
             an orthonormal rotation: take the scale and the shear out of it",
            lengths[0], lengths[1], lengths[2]
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_that_project_wrongly_are_refused() {
        let pinhole = Projection::Pinhole { fx: 40.0, fy: -42.0, cx: 33.0, cy: 15.0 };
        let turned = Mat4::from_rotation_translation(glam::Quat::from_rotation_y(0.7), Vec3::new(1.0, -2.0, 0.5));
        let good = Camera { projection: pinhole, width: 64, height: 32, world_from_camera: turned };
        good.check().unwrap();
        Camera { world_from_camera: turned.inverse(), ..good }.check().unwrap();
        let posed = |pose: Mat4| Camera { world_from_camera: pose, ..good };
        let lens = |fx: f32, cx: f32| Camera { projection: Projection::Pinhole { fx, fy: 1.0, cx, cy: 0.0 }, ..good };
        for (bad, what) in [
            (posed(turned * Mat4::from_scale(Vec3::splat(2.0))), "world_from_camera is not rigid"),
            (posed(turned * Mat4::from_scale(Vec3::new(1.0, 1.0, -1.0))), "world_from_camera mirrors"),
            (posed(Mat4::ZERO), "0, 0, 0, 1 as its last row"),
            (posed(turned.transpose()), "0, 0, 0, 1 as its last row"),
            (posed(Mat4::from_translation(Vec3::NAN)), "expected finite numbers"),
            (Camera { width: 0, ..good }, "0×32 pixels"),
            (Camera { width: usize::MAX, ..good }, "expected 1 to 4294967295"),
            (lens(0.0, 0.0), "fx 0"),
            (lens(1.0, f32::INFINITY), "cx inf"),
        ] {
            let error = bad.check().unwrap_err().to_string();
            assert!(error.contains(what), "{error}; expected {what}");
        }
    }

    #[test]
    fn a_view_is_not_reduced_to_nothing() {
        let projection = Projection::Pinhole { fx: 40.0, fy: 40.0, cx: 2.0, cy: 1.0 };
        let camera = Camera { projection, width: 4, height: 2, world_from_camera: Mat4::IDENTITY };
        assert_eq!([0, 3, 5].map(|factor| camera.reduced(factor)), [None; 3]);
        assert_eq!(camera.reduced(2).map(|camera| [camera.width, camera.height]), Some([2, 1]));
    }

    #[test]
    fn projection_inverts_direction() {
        let pose = Mat4::from_rotation_translation(
            glam::Quat::from_euler(glam::EulerRot::XYZ, 1.2, 0.3, -0.8),
            Vec3::new(1.0, -2.0, 0.5),
        );
        for projection in [Projection::Equirectangular, Projection::Pinhole { fx: 40.0, fy: 42.0, cx: 33.0, cy: 15.0 }]
        {
            let camera = Camera { projection, width: 64, height: 32, world_from_camera: pose };
            for (x, y) in [(0.5, 0.5), (31.5, 16.5), (63.5, 31.5), (10.25, 20.75)] {
                let point = camera.position() + camera.direction(x, y) * 3.0;
                let back = camera.project(point).unwrap();
                assert!((back - Vec2::new(x, y)).length() < 1e-3, "{projection:?} ({x}, {y}) came back as {back}");
            }
        }
    }

    #[test]
    fn the_panorama_centre_looks_along_minus_z_and_u_grows_to_the_right() {
        let camera = Camera {
            projection: Projection::Equirectangular,
            width: 256,
            height: 128,
            world_from_camera: Mat4::IDENTITY,
        };
        assert!((camera.direction(128.0, 64.0) - Vec3::NEG_Z).length() < 1e-6);
        assert!((camera.direction(192.0, 64.0) - Vec3::X).length() < 1e-6);
        assert!((camera.direction(128.0, 0.0) - Vec3::Y).length() < 1e-6);
    }
}
