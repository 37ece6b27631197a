//! Cameras: equirectangular panoramas and pinholes. OpenGL axes: +X right, +Y up, looking along −Z.

use glam::{DMat4, Mat4, Vec2, Vec3};

/// How pixels map to directions in camera space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Full panorama: λ = 2π(u−½), φ = πv, direction (sin λ sin φ, cos φ, −cos λ sin φ); the image centre looks along −Z.
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

/// A posed camera.
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
    /// The optical centre in world space.
    pub fn position(&self) -> Vec3 {
        self.world_from_camera.w_axis.truncate()
    }

    /// Unit world direction through continuous pixel coordinates (pixel centres at +0.5).
    pub fn direction(&self, x: f32, y: f32) -> Vec3 {
        let local = match self.projection {
            Projection::Equirectangular => {
                let lambda = std::f32::consts::TAU * (x / self.width as f32 - 0.5);
                let phi = std::f32::consts::PI * y / self.height as f32;
                Vec3::new(lambda.sin() * phi.sin(), phi.cos(), -lambda.cos() * phi.sin())
            }
            Projection::Pinhole { fx, fy, cx, cy } => Vec3::new((x - cx) / fx, -(y - cy) / fy, -1.0),
        };
        self.world_from_camera.transform_vector3(local).normalize()
    }

    /// Continuous pixel coordinates of a world point; `None` behind a pinhole or outside the image.
    pub fn project(&self, point: Vec3) -> Option<Vec2> {
        let local = self.camera_from_world().transform_point3(point);
        let pixel = match self.projection {
            Projection::Equirectangular => {
                let length = local.length();
                let u = local.x.atan2(-local.z) / std::f32::consts::TAU + 0.5;
                let v = (local.y / length).clamp(-1.0, 1.0).acos() / std::f32::consts::PI;
                Vec2::new(u.rem_euclid(1.0) * self.width as f32, v * self.height as f32)
            }
            Projection::Pinhole { fx, fy, cx, cy } => {
                if !(local.z < 0.0) {
                    return None;
                }
                Vec2::new(cx - fx * local.x / local.z, cy + fy * local.y / local.z)
            }
        };
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x <= self.width as f32 && pixel.y <= self.height as f32;
        inside.then_some(pixel)
    }

    /// The inverse pose.
    pub fn camera_from_world(&self) -> Mat4 {
        let inverse: DMat4 = self.world_from_camera.as_dmat4().inverse();
        inverse.as_mat4()
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }
}
