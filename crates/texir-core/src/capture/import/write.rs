//! A source as a capture folder.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use super::truth::{ALBEDO, Kind, ROUGHNESS, check_size, read_truth};
use super::{Import, ImportOptions};
use crate::atomic_file::{Stage, is_unfinished, write_atomic};
use crate::capture::Shot;
use crate::capture::lens::Undistortion;
use crate::capture::{View, nerfstudio};
use crate::error::{Error, Result};
use crate::image_io::{
    TransferCurve, check_whole, is_encoded, read_encoded, read_labels, read_mask, read_photo, read_rgb, read_size,
    write_png_labels, write_png_mask, write_rgb,
};
use crate::mesh_io::obj;
use crate::progress::{Progress, Task};
use crate::raster::{Labels, Mask, Raster, times};

/// The file that makes a folder a capture.
const TRANSFORMS: &str = "transforms.json";

/// What an import did to the images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Written {
    /// Views.
    pub views: usize,
    /// Views whose lens distortion was taken out.
    pub undistorted: usize,
    /// Views whose 8 or 16-bit values were decoded.
    pub decoded: usize,
    /// Views whose semantic ids are a model's.
    pub segmented: usize,
    /// Pixels of those that were clipped: their light is unknown.
    pub clipped_pixels: usize,
}

/// Errors unless `out` is a folder to come or an empty one: an import replaces nothing, least of all what it reads.
/// What a killed run left there unfinished is in nobody's way.
pub fn check_vacant(out: &Path) -> Result<()> {
    match names(out).find(|name| !is_unfinished(name)) {
        Some(first) => {
            let what = format!("holds {} already; expected a new or empty folder", first.display());
            Err(Error::file(out, what))
        }
        None => Ok(()),
    }
}

/// Names of what is in a folder, if it is one.
fn names(folder: &Path) -> impl Iterator<Item = OsString> {
    std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name())
}

/// Writes images (copied or linked where they need no change), textures, `mesh.obj` and `transforms.json`, to a folder
/// that is not there or [empty](check_vacant): all of it or nothing.
pub fn write(
    import: &Import,
    out: impl AsRef<Path>,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Written> {
    check_vacant(out.as_ref())?;
    // They stay: a disk that machines share may not tell whether somebody still writes to them.
    for name in names(out.as_ref()) {
        progress.warn(&format!(
            "{}: a run that was killed left it there, or one that goes on is writing to it: remove it once none is",
            out.as_ref().join(name).display()
        ));
    }
    let stage = Stage::new(out.as_ref())?;
    let out = &stage.folder();
    let task = Task::start(progress, "import: views", import.shots.len() as u64, "views");
    let job = Job { out, options };
    let converted = |shot: &Shot| {
        progress.check()?;
        let converted = job.convert(shot)?;
        progress.advance(1);
        Ok(converted)
    };
    let converted = import.shots.par_iter().map(converted).collect::<Result<Vec<_>>>()?;
    drop(task);
    for (name, file) in &import.textures {
        let to = out.join(name);
        // Readers go by the content, but people go by the name.
        if name.ends_with(".exr") && !is_exr(file) {
            write_rgb(to, &read_rgb(file)?)?;
        } else {
            job.bring(file, &to)?;
        }
    }
    obj::write(out.join("mesh.obj"), &import.mesh)?;
    let mut written = Written { views: converted.len(), ..Written::default() };
    for Converted { undistorted, clipped, .. } in &converted {
        written.undistorted += usize::from(*undistorted);
        written.decoded += usize::from(clipped.is_some());
        written.clipped_pixels += clipped.unwrap_or_default();
    }
    if written.clipped_pixels > 0 {
        progress.warn(&format!(
            "{}: {} pixels of {} encoded images are clipped: lamps and windows among them are darker than they were, and \
             the room is lit too dimly; merge bracketed exposures with `texir hdr` instead",
            stage.target().display(),
            written.clipped_pixels,
            written.decoded
        ));
    }
    let mut views: Vec<View> = converted.into_iter().map(|c| c.view).collect();
    if let Some(segmenter) = &options.segmenter {
        segmenter.label(&mut views, out, progress)?;
        written.segmented = views.len();
    }
    if let Some(classes) = views.iter().find_map(|view| view.classes.clone()) {
        let classes = Arc::new(classes.bring(out)?);
        views.iter_mut().for_each(|view| view.classes = Some(classes.clone()));
    }
    nerfstudio::write_transforms(out.join(TRANSFORMS), &views)?;
    // Another import may have come there meanwhile: the two would mix.
    check_vacant(stage.target())?;
    stage.place_all(TRANSFORMS)?;
    Ok(written)
}

fn is_exr(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr"))
}

struct Converted {
    view: View,
    undistorted: bool,
    /// Clipped pixels, of an encoded image.
    clipped: Option<usize>,
}

struct Job<'a> {
    out: &'a Path,
    options: &'a ImportOptions,
}

impl Job<'_> {
    fn convert(&self, shot: &Shot) -> Result<Converted> {
        let view = &shot.view;
        if !view.image.exists() {
            let what = "does not exist, but is an image that the cameras' file names: bring it, or leave it out there";
            return Err(Error::file(&view.image, what));
        }
        let size = read_size(&view.image)?;
        let expected = [view.camera.width, view.camera.height];
        if size != expected {
            let what = format!(
                "is {} pixels; expected {}, the size in the camera's intrinsics: give the image that was registered",
                times(size),
                times(expected)
            );
            return Err(Error::file(&view.image, what));
        }
        let lens = match shot.distortion {
            None => None,
            Some(distortion) => Some(Undistortion::new(&view.camera, distortion).ok_or_else(|| {
                let of_others = view.camera.centre_outside().map_or(String::new(), |[cx, cy]| {
                    let size = times(size);
                    format!(" (cx, cy: the principal point ({cx}, {cy}) lies outside of {size} pixels: is it that of larger images?)")
                });
                let what = format!("cannot be undistorted with {}: no pixel is left{of_others}", distortion.describe());
                Error::file(&view.image, what)
            })?),
        };
        let lens = lens.as_ref();
        let file = |kind: &str, extension: &str| self.out.join(kind).join(format!("{}.{extension}", view.name));
        let (image, own_opacity, clipped) = self.radiance(view, lens, &file)?;
        let opaque = match &shot.opacity {
            Some(path) => read_encoded(path)?.opaque,
            None => own_opacity,
        };
        let semantic = match self.options.segmenter {
            Some(_) => None,
            None => view.read_semantic()?,
        };
        let truth = |kind: &Kind, from: Option<&Path>, to: PathBuf| {
            from.map(|from| self.truth(kind, from, lens, size, to)).transpose()
        };
        Ok(Converted {
            view: View {
                name: view.name.clone(),
                camera: lens.map_or(view.camera, |lens| lens.pinhole),
                image,
                semantic: self.labels(semantic, lens, size, file("semantic", "png"))?,
                mask: self.mask(view.mask.as_deref(), opaque, lens, size, file("mask", "png"))?,
                room: self.labels(
                    view.room.as_deref().map(read_labels).transpose()?,
                    lens,
                    size,
                    file("room", "png"),
                )?,
                albedo: truth(&ALBEDO, view.albedo.as_deref(), file("albedo", "exr"))?,
                roughness: truth(&ROUGHNESS, view.roughness.as_deref(), file("roughness", "exr"))?,
                ..view.clone()
            },
            undistorted: lens.is_some(),
            clipped,
        })
    }

    /// The image's new place, where an encoded one is opaque, and how many of its pixels are clipped.
    fn radiance(
        &self,
        view: &View,
        lens: Option<&Undistortion>,
        file: &impl Fn(&str, &str) -> PathBuf,
    ) -> Result<(PathBuf, Option<Mask>, Option<usize>)> {
        let (image, opaque, clipped) = if is_encoded(&view.image)? {
            let encoded = read_encoded(&view.image)?;
            let (image, clipped) = encoded.decode(self.curve(&view.image)?);
            (image, encoded.opaque, Some(clipped))
        } else if let Some(lens) = lens {
            let to = file("hdr", "exr");
            write_rgb(&to, &lens.smooth(&read_photo(&view.image)?))?;
            return Ok((to, None, None));
        } else {
            let extension = view.image.extension().and_then(|e| e.to_str()).unwrap_or("exr");
            let to = file("hdr", extension);
            self.bring(&view.image, &to)?;
            return Ok((to, None, None));
        };
        let to = file("hdr", "exr");
        write_rgb(&to, &lens.map_or_else(|| image.clone(), |lens| lens.smooth(&image)))?;
        Ok((to, opaque, clipped))
    }

    fn curve(&self, path: &Path) -> Result<TransferCurve> {
        self.options.curve.ok_or_else(|| {
            Error::file(
                path,
                "holds 8 or 16-bit values, whose encoding is unknown and whose lamps are clipped; expected linear OpenEXR, \
                 Radiance HDR or float TIFF: merge bracketed exposures with `texir hdr`, or as a last resort say how they \
                 are encoded (--curve srgb, linear or gamma=2.2)",
            )
        })
    }

    /// Ids at the size of the image: files of another size (segmentation at half resolution) are spread.
    fn labels(
        &self,
        labels: Option<Labels>,
        lens: Option<&Undistortion>,
        size: [usize; 2],
        to: PathBuf,
    ) -> Result<Option<PathBuf>> {
        let Some(labels) = labels else { return Ok(None) };
        let labels = spread(&labels, size);
        write_png_labels(&to, &lens.map_or_else(|| labels.clone(), |lens| lens.nearest(&labels)))?;
        Ok(Some(to))
    }

    /// A pixel is used when both the mask and the image's own transparency let it through.
    fn mask(
        &self,
        from: Option<&Path>,
        opaque: Option<Mask>,
        lens: Option<&Undistortion>,
        size: [usize; 2],
        to: PathBuf,
    ) -> Result<Option<PathBuf>> {
        let mask = match (from.map(read_mask).transpose()?, opaque) {
            (None, None) => return Ok(None),
            (Some(one), None) | (None, Some(one)) => spread(&one, size),
            (Some(mask), Some(opaque)) => {
                let mut mask = spread(&mask, size);
                mask.data.iter_mut().zip(&opaque.data).for_each(|(used, opaque)| *used &= opaque);
                mask
            }
        };
        write_png_mask(&to, &lens.map_or_else(|| mask.clone(), |lens| lens.nearest(&mask)))?;
        Ok(Some(to))
    }

    /// Ground truth at its new place.
    fn truth(
        &self,
        kind: &Kind,
        from: &Path,
        lens: Option<&Undistortion>,
        size: [usize; 2],
        to: PathBuf,
    ) -> Result<PathBuf> {
        check_size(from, size)?;
        if lens.is_none() && !is_encoded(from)? {
            self.bring(from, &to)?;
            return Ok(to);
        }
        let truth = read_truth(kind, from)?;
        let truth = match lens {
            Some(lens) => lens.smooth(&truth),
            None => truth,
        };
        (kind.write)(&to, &truth)?;
        Ok(to)
    }

    /// Copies or links a file.
    fn bring(&self, from: &Path, to: &Path) -> Result<()> {
        check_whole(from)?;
        if self.options.link {
            return link(from, to);
        }
        let mut source = std::fs::File::open(from).map_err(|e| Error::cannot_read(from, e))?;
        write_atomic(to, |sink| std::io::copy(&mut source, sink).map(drop))
    }
}

#[cfg(unix)]
fn link(from: &Path, to: &Path) -> Result<()> {
    let from = from.canonicalize().map_err(|e| Error::file(from, format!("cannot be found: {e}")))?;
    let linked = to.parent().map_or(Ok(()), std::fs::create_dir_all);
    let linked = linked.and_then(|()| std::os::unix::fs::symlink(&from, to));
    linked.map_err(|e| Error::file(to, format!("cannot be linked to {}: {e}", from.display())))
}

#[cfg(not(unix))]
fn link(_: &Path, to: &Path) -> Result<()> {
    Err(Error::file(to, "cannot be a link on this system: leave out --link"))
}

/// The nearest values at another size.
fn spread<T: Copy>(raster: &Raster<T>, [width, height]: [usize; 2]) -> Raster<T> {
    let value = |i: usize| *raster.at(i % width * raster.width / width, i / width * raster.height / height);
    Raster { width, height, data: (0..width * height).map(value).collect() }
}
