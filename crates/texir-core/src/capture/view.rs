//! The pixels of a view, read when asked for and checked against its camera.

use std::path::{Path, PathBuf};

use super::black::blank_black_areas;
use super::sharpen::sharpen;
use super::{Split, View};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::image_io::{self, is_encoded, read_gray, read_labels, read_mask, read_photo, read_rgb, sanitise_radiance};
use crate::progress::Progress;
use crate::raster::{Gray, Labels, Mask, Raster, Rgb, mean_pixel};

impl View {
    /// A view of which nothing but the image is known.
    pub fn new(name: String, camera: Camera, split: Split, image: PathBuf) -> Self {
        let (semantic, mask, room, albedo, roughness) = (None, None, None, None, None);
        Self {
            name,
            camera,
            split,
            image,
            scale: [1.0; 3],
            blur: 0.0,
            reduction: 1,
            semantic,
            classes: None,
            mask,
            room,
            room_id: None,
            albedo,
            roughness,
        }
    }

    /// The view with pixels `factor` times as wide, each the mean of those it covers; labels are those of most of them,
    /// masks keep what all of them keep, and columns and rows that do not fill a pixel are cut off. `None` where that
    /// would cut a panorama, which must stay whole.
    pub fn reduced(&self, factor: usize) -> Option<Self> {
        let camera = self.camera.reduced(factor)?;
        Some(Self { camera, reduction: self.reduction * factor, ..self.clone() })
    }

    /// Linear radiance without [`View::blur`], times [`View::scale`]. Negative channels are 0. Pixels with a non-finite
    /// channel, in exactly black areas (16 pixels or more) or of an entirely black image are NaN: cut-outs (a tripod),
    /// stitching gaps and failed writes must not pass for black paint. All of this is warned about.
    pub fn load_image(&self, progress: &dyn Progress) -> Result<Rgb> {
        self.image_with(f32::NAN, progress)
    }

    /// [`View::load_image`] with black for unknown pixels: for eyes and networks.
    pub fn load_picture(&self, progress: &dyn Progress) -> Result<Rgb> {
        self.image_with(0.0, progress)
    }

    fn image_with(&self, unknown: f32, progress: &dyn Progress) -> Result<Rgb> {
        let mut image = read_photo(&self.image)?;
        let found = sanitise_radiance(&mut image, f32::NAN);
        if !found.is_clean() {
            progress.warn(&format!("{}: {found}", self.image.display()));
        }
        let is_black = image.data.iter().flatten().all(|v| *v == 0.0);
        if is_black {
            progress.warn(&format!("{}: is black throughout, and left out", self.image.display()));
        }
        let cut_out = if is_black { 0 } else { blank_black_areas(&mut image) };
        if cut_out > 0 {
            progress.warn(&format!(
                "{}: {cut_out} pixels in areas that are exactly black are taken for unknown",
                self.image.display()
            ));
        }
        if self.blur > 0.0 {
            sharpen(&mut image, self.blur, self.camera.wraps());
        }
        let mut image = self.sized(&self.image, image, mean_pixel)?;
        for radiance in &mut image.data {
            let known = !is_black && radiance.iter().all(|v| v.is_finite());
            *radiance = std::array::from_fn(|c| if known { radiance[c] * self.scale[c] } else { unknown });
        }
        Ok(image)
    }

    /// Semantic class per pixel; 0 is "unknown".
    pub fn load_semantic(&self) -> Result<Option<Labels>> {
        let sized = |(path, labels): (&PathBuf, Labels)| self.sized(path, labels, most_frequent);
        self.semantic.as_ref().zip(self.read_semantic()?).map(sized).transpose()
    }

    /// [`View::load_semantic`] for an image that need not have the camera's size.
    pub fn read_semantic(&self) -> Result<Option<Labels>> {
        let read = |path: &PathBuf| match &self.classes {
            Some(classes) => classes.read(path),
            None => read_labels(path),
        };
        self.semantic.as_ref().map(read).transpose()
    }

    /// Which pixels of `image`, which [`View::load_image`] gave, may be used: those that are known and that the mask
    /// keeps.
    pub fn usable(&self, image: &Rgb) -> Result<Mask> {
        match self.load_mask()? {
            Some(mask) => mask.and(&image.finite()),
            None => Ok(image.finite()),
        }
    }

    /// Pixels that the mask keeps.
    pub fn load_mask(&self) -> Result<Option<Mask>> {
        self.load(self.mask.as_deref(), read_mask, |kept| kept.iter().all(|kept| *kept))
    }

    /// Room id per pixel; 0 is "unknown".
    pub fn load_room(&self) -> Result<Option<Labels>> {
        self.load(self.room.as_deref(), read_labels, most_frequent)
    }

    /// Ground-truth albedo, linear.
    pub fn load_albedo(&self) -> Result<Option<Rgb>> {
        self.load(self.albedo.as_deref(), read_rgb, mean_pixel)
    }

    /// Ground-truth perceptual roughness.
    pub fn load_roughness(&self) -> Result<Option<Gray>> {
        self.load(self.roughness.as_deref(), read_gray, |values| values.iter().sum::<f32>() / values.len() as f32)
    }

    /// Every file that belongs to the view, with the field of `transforms.json` that names it.
    pub fn files(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        let optional = [
            ("semantic_path", &self.semantic),
            ("mask_path", &self.mask),
            ("room_path", &self.room),
            ("albedo_path", &self.albedo),
            ("roughness_path", &self.roughness),
        ];
        let present = optional.into_iter().filter_map(|(field, path)| Some((field, path.as_deref()?)));
        std::iter::once(("file_path", self.image.as_path())).chain(present)
    }

    /// Compares the sizes of all files with the camera's, and checks that the files are whole: a fit comes to some of
    /// them only after its longest steps.
    pub(super) fn check_files(&self) -> Result<()> {
        for (field, path) in self.files() {
            if !path.is_file() {
                let what = if path.exists() { "is no file" } else { "does not exist" };
                let what = format!("{what}, but is the {field} of view {:?}; expected an image", self.name);
                return Err(Error::file(path, what));
            }
            self.check_size(field, path, image_io::read_size(path)?)?;
            image_io::check_whole(path)?;
        }
        self.load_semantic()?;
        self.load_room()?;
        // These are read by the evaluation alone. What is encoded is refused there.
        if self.albedo.as_deref().map(is_encoded).transpose()? == Some(true) {
            self.load_albedo()?;
        }
        if self.roughness.as_deref().map(is_encoded).transpose()? == Some(true) {
            self.load_roughness()?;
        }
        Ok(())
    }

    fn load<'a, T: Copy>(
        &self,
        path: Option<&'a Path>,
        read: impl Fn(&'a Path) -> Result<Raster<T>>,
        one: impl Fn(&[T]) -> T,
    ) -> Result<Option<Raster<T>>> {
        path.map(|path| self.sized(path, read(path)?, one)).transpose()
    }

    /// What a file holds, at the size of the camera; `one` makes one pixel of several.
    fn sized<T: Copy>(&self, path: &Path, raster: Raster<T>, one: impl Fn(&[T]) -> T) -> Result<Raster<T>> {
        self.check_size("image", path, raster.size())?;
        Ok(raster.reduced(self.reduction, one))
    }

    fn check_size(&self, field: &str, path: &Path, [width, height]: [usize; 2]) -> Result<()> {
        let camera = &self.camera;
        if (width / self.reduction, height / self.reduction) == (camera.width, camera.height) {
            return Ok(());
        }
        Err(Error::file(
            path,
            format!(
                "{field} of view {:?} is {width}×{height} pixels; expected {}×{}, the w and h of its camera: give the \
                 image that was registered, or scale w, h, fl_x, fl_y, cx and cy alike",
                self.name, camera.width, camera.height
            ),
        ))
    }
}

/// The label that most pixels have; the lowest of several.
fn most_frequent(labels: &[u16]) -> u16 {
    let count = |label: u16| labels.iter().filter(|l| **l == label).count();
    labels.iter().copied().max_by_key(|&label| (count(label), std::cmp::Reverse(label))).unwrap_or(0)
}
