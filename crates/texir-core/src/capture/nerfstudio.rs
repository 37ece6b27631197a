//! nerfstudio's `transforms.json`, in and out, with texir's extra keys per frame.
//!
//! Poses are camera-to-world with OpenGL axes, which is what [`Camera`] holds. Paths are relative to the file's folder.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::files::{self, view_names};
use super::{Classes, Distortion, Shot, Split, View, pose};
use crate::atomic_file::write_atomic;
use crate::camera::{Camera, Projection};
use crate::error::{Error, Result};
use crate::text_file::read_text;

#[derive(Default, Deserialize, Serialize)]
struct Transforms {
    #[serde(flatten)]
    model: CameraModel,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    train_filenames: Option<Vec<String>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    val_filenames: Option<Vec<String>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    test_filenames: Option<Vec<String>>,
    /// texir's: a list of classes ([`Classes::open`]).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    classes: Option<String>,
    frames: Vec<Frame>,
}

/// May stand once for the file, in a frame, or be split between the two; the frame's value wins.
#[derive(Clone, Default, PartialEq, Deserialize, Serialize)]
#[serde(default)]
struct CameraModel {
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_model: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    w: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    h: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fl_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fl_y: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cx: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cy: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k2: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k3: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k4: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p2: Option<f64>,
    /// instant-ngp's: k1 to k4 are those of OPENCV_FISHEYE.
    #[serde(skip_serializing_if = "Option::is_none")]
    is_fisheye: Option<bool>,
}

impl Transforms {
    /// All paths to files.
    fn paths(&mut self) -> impl Iterator<Item = &mut String> {
        let lists = [&mut self.train_filenames, &mut self.val_filenames, &mut self.test_filenames];
        self.frames
            .iter_mut()
            .flat_map(Frame::paths)
            .chain(lists.into_iter().flatten().flatten())
            .chain(&mut self.classes)
    }
}

#[derive(Default, Deserialize, Serialize)]
struct Frame {
    file_path: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    semantic_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mask_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    room_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    albedo_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    roughness_path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    split: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    room_id: Option<u16>,
    #[serde(flatten)]
    model: CameraModel,
    transform_matrix: Vec<Vec<f64>>,
}

impl Frame {
    fn paths(&mut self) -> impl Iterator<Item = &mut String> {
        let Self { file_path, semantic_path, mask_path, room_path, albedo_path, roughness_path, .. } = self;
        let others = [semantic_path, mask_path, room_path, albedo_path, roughness_path];
        std::iter::once(file_path).chain(others.into_iter().flatten())
    }
}

/// Reads posed views without distortion. Only the file itself is read and checked; whether the images exist is the
/// caller's concern.
pub fn read_transforms(path: impl AsRef<Path>) -> Result<Vec<View>> {
    let path = path.as_ref();
    let folder = path.parent().unwrap_or(Path::new(""));
    let undistorted = |(index, shot): (usize, Shot)| match shot.distortion {
        None => Ok(shot.view),
        Some(distortion) => {
            let what = format!(
                "frames[{index}] ({}): {}; expected no distortion: undistort the images with `texir import`",
                relative(folder, &shot.view.image),
                distortion.describe()
            );
            Err(Error::file(path, what))
        }
    };
    read_shots(path)?.into_iter().enumerate().map(undistorted).collect()
}

/// Reads posed views and their lenses. Only the file itself is read and checked.
pub(super) fn read_shots(path: &Path) -> Result<Vec<Shot>> {
    let text = read_text(path)?;
    let mut file: Transforms = serde_json::from_str(&text)
        .map_err(|e| Error::file(path, format!("is no transforms.json as nerfstudio writes it: {e}")))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    file.paths().for_each(|name| *name = files::with_slashes(folder, name));
    if file.frames.is_empty() {
        return Err(Error::file(path, "frames is empty; expected at least one view"));
    }
    let names = names(path, &file.frames)?;
    check_lists(path, &file)?;
    let splits = SplitLists::new(&file);
    let classes = file.classes.as_ref().map(|name| Classes::open(name, folder)).transpose()?.map(Arc::new);
    let view = |(index, (frame, name)): (usize, (&Frame, String))| {
        let place = FrameLocation { path, index, file_path: &frame.file_path };
        let local = |file: &Option<String>| file.as_ref().map(|file| folder.join(file));
        let model = frame.model.or(&file.model);
        let view = View {
            semantic: local(&frame.semantic_path),
            classes: classes.clone(),
            mask: local(&frame.mask_path),
            room: local(&frame.room_path),
            room_id: frame.room_id,
            albedo: local(&frame.albedo_path),
            roughness: local(&frame.roughness_path),
            ..View::new(
                name,
                model.camera(&place, &frame.transform_matrix)?,
                splits.of(&place, frame)?,
                folder.join(&frame.file_path),
            )
        };
        Ok(Shot { distortion: model.distortion(&place)?, ..view.into() })
    };
    file.frames.iter().zip(names).enumerate().map(view).collect()
}

/// Where in the file something is wrong.
struct FrameLocation<'a> {
    path: &'a Path,
    index: usize,
    file_path: &'a str,
}

impl FrameLocation<'_> {
    fn error(&self, field: &str, what: impl std::fmt::Display) -> Error {
        Error::file(self.path, format!("frames[{}] ({}): {field} {what}", self.index, self.file_path))
    }
}

/// The views' names; each image may appear once.
fn names(path: &Path, frames: &[Frame]) -> Result<Vec<String>> {
    let mut taken = HashSet::new();
    for (index, frame) in frames.iter().enumerate() {
        let place = FrameLocation { path, index, file_path: &frame.file_path };
        if Path::new(&frame.file_path).file_stem().is_none() {
            return Err(place.error("file_path", "names no file; expected the view's image"));
        }
        if !taken.insert(frame.file_path.as_str()) {
            return Err(place.error("file_path", "is there a second time; expected each view once"));
        }
    }
    Ok(view_names(frames.iter().map(|frame| frame.file_path.as_str())))
}

/// A relative path without what stands for the folder itself.
fn plain(name: &str) -> &str {
    name.strip_prefix("./").unwrap_or(name)
}

/// Errors where a list names a file that is no frame's: that frame would be on the wrong side.
fn check_lists(path: &Path, file: &Transforms) -> Result<()> {
    if file.frames.iter().all(|frame| frame.split.is_some()) {
        return Ok(());
    }
    let frames: HashSet<&str> = file.frames.iter().map(|frame| plain(&frame.file_path)).collect();
    let lists = [
        ("train_filenames", &file.train_filenames),
        ("val_filenames", &file.val_filenames),
        ("test_filenames", &file.test_filenames),
    ];
    for (field, names) in lists {
        if let Some(name) = names.iter().flatten().find(|name| !frames.contains(plain(name))) {
            return Err(Error::file(path, format!("{field} has {name:?}; expected the file_path of a frame")));
        }
    }
    Ok(())
}

/// nerfstudio's lists of file names, for frames without a `split`.
struct SplitLists<'a> {
    train: Option<HashSet<&'a str>>,
    held_out: HashSet<&'a str>,
}

impl<'a> SplitLists<'a> {
    fn new(file: &'a Transforms) -> Self {
        let train = file.train_filenames.as_ref().map(|names| names.iter().map(|name| plain(name)).collect());
        let held_out =
            file.val_filenames.iter().chain(&file.test_filenames).flatten().map(|name| plain(name)).collect();
        Self { train, held_out }
    }

    /// The frame's own `split`; else, with a list of training files, whether it is on it; else whether it is on none of
    /// the lists of held-out files.
    fn of(&self, place: &FrameLocation, frame: &Frame) -> Result<Split> {
        let name = plain(&frame.file_path);
        let train = match (&frame.split, &self.train) {
            (Some(split), _) if split.starts_with("train") => true,
            (Some(split), _) if ["novel", "test", "val", "eval"].iter().any(|s| split.starts_with(s)) => false,
            (Some(split), _) => {
                let what =
                    format!("is {split:?}; expected \"train\", or \"novel\", \"test\" or \"val\" for held-out views");
                return Err(place.error("split", what));
            }
            (None, Some(train)) => train.contains(name),
            (None, None) => !self.held_out.contains(name),
        };
        Ok(if train { Split::Train } else { Split::Novel })
    }
}

impl CameraModel {
    fn or(&self, file: &Self) -> Self {
        Self {
            camera_model: self.camera_model.clone().or_else(|| file.camera_model.clone()),
            w: self.w.or(file.w),
            h: self.h.or(file.h),
            fl_x: self.fl_x.or(file.fl_x),
            fl_y: self.fl_y.or(file.fl_y),
            cx: self.cx.or(file.cx),
            cy: self.cy.or(file.cy),
            k1: self.k1.or(file.k1),
            k2: self.k2.or(file.k2),
            k3: self.k3.or(file.k3),
            k4: self.k4.or(file.k4),
            p1: self.p1.or(file.p1),
            p2: self.p2.or(file.p2),
            is_fisheye: self.is_fisheye.or(file.is_fisheye),
        }
    }

    fn camera(&self, place: &FrameLocation, rows: &[Vec<f64>]) -> Result<Camera> {
        let projection = match self.camera_model.as_deref() {
            Some("EQUIRECTANGULAR") => Projection::Equirectangular,
            Some("PINHOLE" | "SIMPLE_PINHOLE" | "OPENCV" | "OPENCV_FISHEYE") => self.pinhole(place)?,
            // A perspective camera to nerfstudio, as instant-ngp writes them; but a panorama has its fl_x, too.
            None if self.fl_x.is_some() && self.w != self.h.map(|h| 2.0 * h) => self.pinhole(place)?,
            other => {
                let found = other.unwrap_or("missing");
                let what = format!("is {found}; expected EQUIRECTANGULAR, PINHOLE, OPENCV or OPENCV_FISHEYE");
                return Err(place.error("camera_model", what));
            }
        };
        let (width, height) = (size(place, "w", self.w)?, size(place, "h", self.h)?);
        if projection == Projection::Equirectangular && width != 2 * height {
            let what = format!("are {width}×{height}; expected a full panorama, twice as wide as high");
            return Err(place.error("w, h", what));
        }
        let world_from_camera = pose::from_rows(rows).map_err(|e| place.error("transform_matrix", e))?.as_mat4();
        if !world_from_camera.is_finite() {
            return Err(place.error("transform_matrix", format!("has the rows {rows:?}; expected metres")));
        }
        Ok(Camera { projection, width, height, world_from_camera })
    }

    /// The lens: nerfstudio's OPENCV takes k4 for the coefficient of r⁸, and its fisheye is OpenCV's.
    fn distortion(&self, place: &FrameLocation) -> Result<Option<Distortion>> {
        let [k1, k2, k3, k4, p1, p2] =
            [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2].map(Option::unwrap_or_default);
        let distortion = match self.camera_model.as_deref() {
            Some("EQUIRECTANGULAR") => None,
            Some("OPENCV_FISHEYE") => Some(Distortion::Fisheye { k: [k1, k2, k3, k4] }),
            None if self.is_fisheye == Some(true) => Some(Distortion::Fisheye { k: [k1, k2, k3, k4] }),
            _ => Distortion::radial([k1, k2, k3, k4], [0.0; 3], [p1, p2]),
        };
        match distortion {
            Some(d) if !d.is_finite() => Err(place.error("k1 to p2", "are not all finite; expected numbers")),
            distortion => Ok(distortion),
        }
    }

    fn pinhole(&self, place: &FrameLocation) -> Result<Projection> {
        let focal = |field, value: Option<f64>| match value {
            Some(v) if v > 0.0 && v.is_finite() => Ok(v as f32),
            _ => Err(place.error(field, format!("is {}; expected a focal length in pixels", shown(value)))),
        };
        let centre = |field, value: Option<f64>| match value {
            Some(v) if v.is_finite() => Ok(v as f32),
            _ => Err(place.error(field, format!("is {}; expected the principal point in pixels", shown(value)))),
        };
        Ok(Projection::Pinhole {
            fx: focal("fl_x", self.fl_x)?,
            fy: focal("fl_y", self.fl_y)?,
            cx: centre("cx", self.cx)?,
            cy: centre("cy", self.cy)?,
        })
    }

    fn of(camera: &Camera) -> Self {
        let (w, h) = (camera.width as f64, camera.height as f64);
        let (name, [fl_x, fl_y, cx, cy]) = match camera.projection {
            // nerfstudio wants intrinsics for panoramas as well: half the turn per width, the image's centre.
            Projection::Equirectangular => ("EQUIRECTANGULAR", [w / 2.0, h, w / 2.0, h / 2.0]),
            Projection::Pinhole { fx, fy, cx, cy } => ("PINHOLE", [fx, fy, cx, cy].map(f64::from)),
        };
        Self {
            camera_model: Some(name.to_owned()),
            w: Some(w),
            h: Some(h),
            fl_x: Some(fl_x),
            fl_y: Some(fl_y),
            cx: Some(cx),
            cy: Some(cy),
            ..Self::default()
        }
    }
}

fn shown(value: Option<f64>) -> String {
    value.map_or("missing".to_owned(), |v| v.to_string())
}

/// Images are no longer on a side, pixels.
const LARGEST_SIZE: u16 = u16::MAX;

fn size(place: &FrameLocation, field: &str, value: Option<f64>) -> Result<usize> {
    match value {
        Some(v) if v >= 1.0 && v <= f64::from(LARGEST_SIZE) && v.fract() == 0.0 => Ok(v as usize),
        _ => {
            let found = shown(value);
            let what =
                format!("is {found}; expected the image's size, a whole number of pixels of 1 to {LARGEST_SIZE}");
            Err(place.error(field, what))
        }
    }
}

/// Writes views as `transforms.json`: what [`read_transforms`] reads back, and nerfstudio too. Paths under the file's
/// folder are written relative to it; other relative paths are taken to be so already.
pub fn write_transforms(path: impl AsRef<Path>, views: &[View]) -> Result<()> {
    let path = path.as_ref();
    let folder = path.parent().unwrap_or(Path::new(""));
    let local = |file: &PathBuf| relative(folder, file);
    // What all views share is written once.
    let shared = views.first().map(|v| CameraModel::of(&v.camera)).unwrap_or_default();
    let frame = |view: &View| {
        let model = CameraModel::of(&view.camera);
        Frame {
            file_path: local(&view.image),
            semantic_path: view.semantic.as_ref().map(local),
            mask_path: view.mask.as_ref().map(local),
            room_path: view.room.as_ref().map(local),
            albedo_path: view.albedo.as_ref().map(local),
            roughness_path: view.roughness.as_ref().map(local),
            split: Some(if view.split == Split::Train { "train" } else { "novel" }.to_owned()),
            room_id: view.room_id,
            model: if model == shared { CameraModel::default() } else { model },
            transform_matrix: pose::to_rows(view.camera.world_from_camera),
        }
    };
    let of_split = |split| views.iter().filter(|v| v.split == split).map(|v| local(&v.image)).collect();
    let file = Transforms {
        train_filenames: Some(of_split(Split::Train)),
        test_filenames: Some(of_split(Split::Novel)),
        val_filenames: None,
        classes: views.first().and_then(|view| Some(view.classes.as_ref()?.name.clone())),
        frames: views.iter().map(frame).collect(),
        model: shared,
    };
    write_atomic(path, |sink| serde_json::to_writer_pretty(sink, &file))
}

/// `file` as seen from `folder`, with `/` between its parts.
fn relative(folder: &Path, file: &Path) -> String {
    let inner = file.strip_prefix(folder).unwrap_or(file);
    inner.to_string_lossy().replace(std::path::MAIN_SEPARATOR, "/")
}
