//! The TBL on disk: an EXR of radiance, and beside it `<stem>_mask.png` with how each texel came to be known.

use std::path::{Path, PathBuf};

use super::{Coverage, Tbl};
use crate::error::{Error, Result};
use crate::image_io::{read_labels, read_rgb, sanitise_radiance, write_png_labels, write_rgb};
use crate::progress::Progress;
use crate::raster::times;

const SEEN: u16 = 255;
const INPAINTED: u16 = 128;
const OUTSIDE: u16 = 0;

impl Tbl {
    /// Where the coverage of the HDR texture at `path` is kept.
    pub fn mask_path(path: &Path) -> PathBuf {
        let mut name = path.file_stem().unwrap_or_default().to_owned();
        name.push("_mask.png");
        path.with_file_name(name)
    }

    /// Reads an HDR texture and its mask. Without a mask, texels with any light count as seen and black ones as outside
    /// the charts.
    pub fn read(path: impl AsRef<Path>, progress: &dyn Progress) -> Result<Self> {
        let path = path.as_ref();
        let mut radiance = read_rgb(path)?;
        let [width, height] = radiance.size();
        if width != height {
            // An atlas may have any sides; views and skies, which were given in its place, are twice as wide as high.
            progress.warn(&format!(
                "{}: is {width}×{height} texels, and atlases are square as a rule: is it the HDR texture of this mesh, and not a view?",
                path.display()
            ));
        }
        let found = sanitise_radiance(&mut radiance, 0.0);
        if !found.is_clean() {
            progress.warn(&format!("{}: {found}", path.display()));
        }
        let mask_path = Self::mask_path(path);
        if !mask_path.is_file() {
            let coverage = radiance.map(|rgb| if *rgb == [0.0; 3] { Coverage::Outside } else { Coverage::Seen });
            return Ok(Self { radiance, coverage });
        }
        let levels = read_labels(&mask_path)?;
        if levels.size() != radiance.size() {
            return Err(Error::file(
                &mask_path,
                format!(
                    "is {} texels; expected {}, as {} has",
                    times(levels.size()),
                    times(radiance.size()),
                    path.display()
                ),
            ));
        }
        if let Some(level) = levels.data.iter().find(|level| ![SEEN, INPAINTED, OUTSIDE].contains(level)) {
            return Err(Error::file(
                &mask_path,
                format!(
                    "has the level {level}; expected {SEEN} (seen), {INPAINTED} (inpainted) or {OUTSIDE} (outside)"
                ),
            ));
        }
        let coverage = levels.map(|level| match *level {
            SEEN => Coverage::Seen,
            INPAINTED => Coverage::Inpainted,
            _ => Coverage::Outside,
        });
        Ok(Self { radiance, coverage })
    }

    /// Writes the HDR texture to `path`, its mask first: where there is a texture, there is its mask.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let levels = self.coverage.map(|coverage| match coverage {
            Coverage::Seen => SEEN,
            Coverage::Inpainted => INPAINTED,
            Coverage::Outside => OUTSIDE,
        });
        write_png_labels(Self::mask_path(path), &levels)?;
        write_rgb(path, &self.radiance)
    }
}
