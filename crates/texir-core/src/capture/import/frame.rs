//! From a source's frame to texir's: metres, +Z against gravity.

use std::ops::RangeInclusive;

use glam::{DMat4, DQuat, DVec3, Vec3};

use super::{ImportOptions, Source, up};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::mesh::Mesh;

/// Metres that a unit of a source may be.
const UNITS: RangeInclusive<f64> = 1e-6..=1e6;

/// A rotation after a scaling: how what a source holds becomes what texir holds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Similarity {
    texir_from_source: DQuat,
    metres_per_unit: f64,
}

impl Similarity {
    /// What the user says, else what the format says, else what the cameras tell; adds to `assumed` how it came about.
    pub(super) fn of(source: &Source, options: &ImportOptions, assumed: &mut Vec<String>) -> Result<Self> {
        let (direction, why) = match (options.up, source.up) {
            (Some(up), _) => given(up, "as told")?,
            (None, Some(up)) => given(up, "the format's convention")?,
            (None, None) => up::from_cameras(source.shots.iter().map(|shot| &shot.view.camera))?,
        };
        let [x, y, z] = direction.to_array();
        assumed.push(format!("up is ({x:.3}, {y:.3}, {z:.3}) of the source ({why}); it becomes +Z"));
        let (metres_per_unit, why) = match (options.metres_per_unit, source.metres_per_unit) {
            (Some(length), _) => (length, "as told"),
            (None, Some(length)) => (length, "the format's convention"),
            (None, None) => (1.0, "nothing says otherwise: compare the extent of the mesh with the real one"),
        };
        if !UNITS.contains(&metres_per_unit) {
            let (least, most) = (UNITS.start(), UNITS.end());
            return Err(Error::invalid(format!(
                "metres per unit is {metres_per_unit}; expected {least:e} to {most:e}"
            )));
        }
        assumed.push(format!("a unit of the source is {metres_per_unit} m ({why})"));
        Ok(Self { texir_from_source: DQuat::from_rotation_arc(direction, DVec3::Z), metres_per_unit })
    }

    /// The same view in metres, +Z up.
    pub(super) fn place_camera(&self, camera: &Camera) -> Camera {
        let mut pose = camera.world_from_camera.as_dmat4();
        pose.w_axis = (pose.w_axis.truncate() * self.metres_per_unit).extend(1.0);
        Camera { world_from_camera: (DMat4::from_quat(self.texir_from_source) * pose).as_mat4(), ..*camera }
    }

    /// The same surface in metres, +Z up.
    pub(super) fn place_mesh(&self, mut mesh: Mesh) -> Mesh {
        if self.texir_from_source == DQuat::IDENTITY && self.metres_per_unit == 1.0 {
            return mesh;
        }
        for position in &mut mesh.positions {
            *position = (self.texir_from_source * (position.as_dvec3() * self.metres_per_unit)).as_vec3();
        }
        for normal in &mut mesh.normals {
            *normal = (self.texir_from_source * normal.as_dvec3()).as_vec3();
        }
        mesh
    }
}

fn given(up: Vec3, why: &'static str) -> Result<(DVec3, &'static str)> {
    let direction = up.as_dvec3().try_normalize();
    direction.map(|d| (d, why)).ok_or_else(|| Error::invalid(format!("up is {up}; expected a direction")))
}

/// The pose with OpenGL camera axes (y up, −z forward) of one with OpenCV's (y down, z forward).
pub(super) fn opengl_from_opencv(world_from_camera: DMat4) -> DMat4 {
    let DMat4 { x_axis, y_axis, z_axis, w_axis } = world_from_camera;
    DMat4::from_cols(x_axis, -y_axis, -z_axis, w_axis)
}
