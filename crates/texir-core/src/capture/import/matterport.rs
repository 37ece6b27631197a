//! A house of Matterport3D, as <https://github.com/niessner/Matterport/blob/master/data_organization.md> describes it:
//! either what the camera gave (`matterport_camera_poses`, `matterport_camera_intrinsics`; OpenCV axes, distorted),
//! whose HDR images have to be converted from JPEG XR first, or the undistorted photos
//! (`undistorted_camera_parameters`; OpenGL axes, image origin at the bottom). Metres, +Z up.

use std::path::{Path, PathBuf};

use glam::Vec3;

use super::{Importer, Source, numbers};
use crate::camera::{Camera, Projection};
use crate::capture::{Distortion, Shot, files};
use crate::capture::{Split, View};
use crate::error::{Error, Result};
use crate::image_io::read_size;
use crate::text_file::read_text;

/// See the module.
pub(super) struct Matterport;

const POSES: &str = "matterport_camera_poses";
const INTRINSICS: &str = "matterport_camera_intrinsics";
const UNDISTORTED: &str = "undistorted_camera_parameters";

impl Importer for Matterport {
    fn name(&self) -> &'static str {
        "matterport3d"
    }

    fn signature(&self) -> &'static str {
        "matterport_camera_poses/ with matterport_camera_intrinsics/, or undistorted_camera_parameters/"
    }

    fn detects(&self, folder: &Path) -> bool {
        folder.join(POSES).is_dir() || folder.join(UNDISTORTED).is_dir()
    }

    fn read(&self, folder: &Path) -> Result<Source> {
        let shots = if folder.join(POSES).is_dir() { camera_shots(folder)? } else { undistorted_shots(folder)? };
        Ok(Source {
            shots,
            mesh: mesh(folder),
            textures: Vec::new(),
            up: Some(Vec3::Z),
            metres_per_unit: Some(1.0),
            assumed: vec!["poses are Matterport3D's: camera-to-world, metres, +Z up".into()],
        })
    }
}

/// `matterport_mesh/<id>/<id>.obj`, or a mesh where other formats have theirs.
fn mesh(folder: &Path) -> Option<PathBuf> {
    let place = folder.join("matterport_mesh");
    let folders = std::fs::read_dir(&place).into_iter().flatten().flatten().map(|entry| entry.path());
    files::mesh(folder)
        .or_else(|| files::mesh(&place))
        .or_else(|| folders.filter(|p| p.is_dir()).find_map(|p| files::mesh(&p)))
}

/// `<panorama>_pose_<camera>_<yaw>.txt` with `<panorama>_intrinsics_<camera>.txt`.
fn camera_shots(folder: &Path) -> Result<Vec<Shot>> {
    let shot = |path: &PathBuf| {
        let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or_default();
        let parts = stem.split_once("_pose_").and_then(|(panorama, rest)| {
            let (camera, yaw) = rest.split_once('_')?;
            Some((panorama, camera, yaw))
        });
        let (panorama, camera, yaw) = parts
            .ok_or_else(|| Error::file(path, "has an unknown name; expected <panorama>_pose_<camera>_<yaw>.txt"))?;
        let pose = numbers::pose(path, "the pose", &numbers::parse(path, &read_text(path)?)?)?;
        let (intrinsics, distortion) =
            intrinsics(&folder.join(INTRINSICS).join(format!("{panorama}_intrinsics_{camera}.txt")))?;
        let camera_of_view =
            Camera { world_from_camera: super::frame::opengl_from_opencv(pose).as_mat4(), ..intrinsics };
        let linear =
            files::image(folder, &["matterport_hdr_images", "hdr"], &format!("{panorama}_j{camera}_{yaw}.exr"));
        let image = if linear.is_file() {
            linear
        } else {
            files::image(folder, &["matterport_color_images"], &format!("{panorama}_i{camera}_{yaw}.jpg"))
        };
        let name = format!("{panorama}_{camera}_{yaw}");
        Ok(Shot { distortion, ..View::new(name, camera_of_view, Split::Train, image).into() })
    };
    files::with_extensions(&folder.join(POSES), &["txt"]).iter().map(shot).collect()
}

/// `width height fx fy cx cy k1 k2 p1 p2 k3`.
fn intrinsics(path: &Path) -> Result<(Camera, Option<Distortion>)> {
    let found = numbers::parse(path, &read_text(path)?)?;
    let [width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3] = found[..] else {
        return Err(Error::file(
            path,
            format!("has {} numbers; expected 11: width height fx fy cx cy k1 k2 p1 p2 k3", found.len()),
        ));
    };
    let size = |v: f64| (1.0..=65535.0).contains(&v) && v.fract() == 0.0;
    if !(size(width) && size(height) && fx > 0.0 && fy > 0.0 && found.iter().all(|v| v.is_finite())) {
        return Err(Error::file(
            path,
            format!("has {found:?}; expected whole sizes, focal lengths above 0, finite numbers"),
        ));
    }
    let projection = Projection::Pinhole { fx: fx as f32, fy: fy as f32, cx: cx as f32, cy: cy as f32 };
    let camera =
        Camera { projection, width: width as usize, height: height as usize, world_from_camera: glam::Mat4::IDENTITY };
    Ok((camera, Distortion::radial([k1, k2, k3, 0.0], [0.0; 3], [p1, p2])))
}

/// `<house>.conf`: `intrinsics_matrix` lines, each good for the `scan` lines after it.
fn undistorted_shots(folder: &Path) -> Result<Vec<Shot>> {
    let path = files::only(&folder.join(UNDISTORTED), &["conf"]).ok_or_else(|| {
        Error::file(folder.join(UNDISTORTED), "does not hold exactly one .conf; expected the house's")
    })?;
    let text = read_text(&path)?;
    let (mut matrix, mut shots) = (None, Vec::new());
    for (number, line) in (1..).zip(text.lines()) {
        let wrong = |what: &str| Error::file(&path, format!("line {number}: {what}"));
        let (command, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        match command {
            "intrinsics_matrix" => {
                let [fx, _, cx, _, fy, cy, ..] = numbers::parse(&path, rest)?[..] else {
                    return Err(wrong("intrinsics_matrix has too few numbers; expected 9"));
                };
                if !(fx > 0.0 && fy > 0.0 && (fx + fy + cx + cy).is_finite()) {
                    return Err(wrong("intrinsics_matrix is unusable; expected finite numbers, focal lengths above 0"));
                }
                matrix = Some([fx, fy, cx, cy]);
            }
            "scan" => {
                let [fx, fy, cx, cy] = matrix.ok_or_else(|| wrong("scan comes before any intrinsics_matrix"))?;
                let (_depth, rest) = rest.trim().split_once(' ').ok_or_else(|| wrong("scan names no images"))?;
                let (colour, rest) = rest.trim().split_once(' ').ok_or_else(|| wrong("scan has no matrix"))?;
                let pose = numbers::pose(&path, &format!("line {number}: the matrix"), &numbers::parse(&path, rest)?)?;
                let image = files::image(folder, &["hdr", "undistorted_color_images"], colour);
                let [width, height] = read_size(&image)?;
                // Their image origin is at the bottom.
                let cy = height as f64 - cy;
                let projection = Projection::Pinhole { fx: fx as f32, fy: fy as f32, cx: cx as f32, cy: cy as f32 };
                let camera = Camera { projection, width, height, world_from_camera: pose.as_mat4() };
                let name = Path::new(colour).file_stem().unwrap_or_default().to_string_lossy().into_owned();
                shots.push(View::new(name, camera, Split::Train, image).into());
            }
            _ => {}
        }
    }
    let names = files::view_names(shots.iter().map(|shot: &Shot| shot.view.name.as_str()));
    shots.iter_mut().zip(names).for_each(|(shot, name)| shot.view.name = name);
    Ok(shots)
}
