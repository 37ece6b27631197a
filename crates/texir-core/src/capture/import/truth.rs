//! Ground truth of views: what a fit is compared with, pixel by pixel.

use std::path::Path;

use crate::error::{Error, Result};
use crate::image_io::{TransferCurve, is_encoded, read_encoded, read_gray, read_rgb, read_size, write_gray, write_rgb};
use crate::raster::{Rgb, times};

/// A kind of ground truth. In memory it has three channels, whether it means them or not.
pub(super) struct Kind {
    /// How files of 8 and 16 bits encode it.
    curve: TransferCurve,
    linear: fn(&Path) -> Result<Rgb>,
    /// Writes it as OpenEXR.
    pub(super) write: fn(&Path, &Rgb) -> Result<()>,
}

/// Three channels; encoded, in sRGB.
pub(super) const ALBEDO: Kind =
    Kind { curve: TransferCurve::Srgb, linear: |from| read_rgb(from), write: |to, albedo| write_rgb(to, albedo) };

/// One channel; encoded, by its value.
pub(super) const ROUGHNESS: Kind = Kind {
    curve: TransferCurve::Linear,
    linear: |from| Ok(read_gray(from)?.map(|value| [*value; 3])),
    write: |to, roughness| write_gray(to, &roughness.map(|[value, ..]| *value)),
};

/// Ground truth, linear, however the file holds it.
pub(super) fn read_truth(kind: &Kind, from: &Path) -> Result<Rgb> {
    if is_encoded(from)? { Ok(read_encoded(from)?.decode(kind.curve).0) } else { (kind.linear)(from) }
}

/// Errors unless ground truth has the size of its image. It is not spread to it, as ids are: what that changes would
/// pass for an error of the fit.
pub(super) fn check_size(from: &Path, size: [usize; 2]) -> Result<()> {
    let found = read_size(from)?;
    if found == size {
        return Ok(());
    }
    let what =
        format!("is ground truth of {} pixels; expected {}, as its image has: resize it", times(found), times(size));
    Err(Error::file(from, what))
}
