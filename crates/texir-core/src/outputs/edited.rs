//! Textures as they come back from whatever edited them: checked before anything is rendered with them.

use std::ops::RangeInclusive;
use std::path::Path;

use bytemuck::Pod;

use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::raster::{Raster, times};

/// What albedo, roughness, metalness and confidence can be.
pub(super) const SHARE: RangeInclusive<f32> = 0.0..=1.0;
/// What light can be.
pub(super) const LIGHT: RangeInclusive<f32> = 0.0..=f32::MAX;

/// Errors where the texture from `path` has another shape than the atlas, whose size may differ: it is laid over all of
/// it.
pub(super) fn same_shape(path: &Path, [width, height]: [usize; 2], atlas: [usize; 2]) -> Result<()> {
    if width * atlas[1] == height * atlas[0] {
        return Ok(());
    }
    Err(Error::file(
        path,
        format!(
            "is {}; expected the atlas's {}, or another size of that shape: what was cut off or added would shift all \
             that is left",
            times([width, height]),
            times(atlas)
        ),
    ))
}

/// The texture from `path`, of pixels that are nothing but `f32` channels. Texels that are no numbers are an error:
/// nothing is known of what they should be. Values out of range are taken for the nearest one within, with a warning.
pub(super) fn checked<T: Pod>(
    path: &Path,
    mut texture: Raster<T>,
    range: RangeInclusive<f32>,
    progress: &dyn Progress,
) -> Result<Raster<T>> {
    let (width, texels) = (texture.width, texture.data.len());
    let channels = size_of::<T>() / size_of::<f32>();
    let values: &mut [f32] = bytemuck::cast_slice_mut(&mut texture.data);
    let place = |texel: usize| format!("the first in column {}, row {}", texel % width, texel / width);
    if let Some((count, first, _)) = texels_where(values, channels, |v| !v.is_finite()) {
        return Err(Error::file(
            path,
            format!(
                "{count} of {texels} texels are NaN or infinite, {}; expected numbers: correct them in the program that \
                 edited the texture, or run the fit again",
                place(first)
            ),
        ));
    }
    if let Some((count, first, value)) = texels_where(values, channels, |v| !range.contains(&v)) {
        let (low, high) = (*range.start(), *range.end());
        let expected = if high < f32::MAX { format!("{low} to {high}") } else { format!("{low} or more") };
        progress.warn(&format!(
            "{}: {count} of {texels} texels are out of range, {}, is {value}; expected {expected}: they are taken for the \
             nearest value within, correct them where that is not what was meant",
            path.display(),
            place(first)
        ));
        values.iter_mut().for_each(|v| *v = v.clamp(low, high));
    }
    Ok(texture)
}

/// How many texels have a channel that is `wrong`, the first of them and its value; `None` where there is none.
fn texels_where(values: &[f32], channels: usize, wrong: impl Fn(f32) -> bool) -> Option<(usize, usize, f32)> {
    let mut found = values.chunks_exact(channels).enumerate().filter_map(|(texel, values)| {
        let value = values.iter().copied().find(|v| wrong(*v))?;
        Some((texel, value))
    });
    let (first, value) = found.next()?;
    Some((1 + found.count(), first, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::tests::Warnings;

    fn check(pixels: [[f32; 3]; 4], range: RangeInclusive<f32>) -> (Result<Vec<[f32; 3]>>, Vec<String>) {
        let warnings = Warnings::default();
        let texture = Raster::new(2, 2, pixels.to_vec()).unwrap();
        let checked = checked(Path::new("albedo.exr"), texture, range, &warnings);
        (checked.map(|texture| texture.data), warnings.all())
    }

    #[test]
    fn texels_that_are_no_numbers_are_counted_and_the_first_is_named() {
        for nothing in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let (result, _) = check([[0.5; 3], [0.5; 3], [0.5, nothing, nothing], [nothing; 3]], SHARE);
            let error = result.unwrap_err().to_string();
            let expected = "2 of 4 texels are NaN or infinite, the first in column 0, row 1";
            assert!(error.contains("albedo.exr") && error.contains(expected), "{error}");
        }
    }

    #[test]
    fn values_out_of_range_are_limited_and_warned_about() {
        let pixels = [[0.5, 1.0, 0.0], [0.5, -0.25, 0.5], [1.5, 0.5, -1.0], [-0.0, 0.5, 0.5]];
        let (result, warnings) = check(pixels, SHARE);
        assert_eq!(result.unwrap(), [[0.5, 1.0, 0.0], [0.5, 0.0, 0.5], [1.0, 0.5, 0.0], [0.0, 0.5, 0.5]]);
        let expected =
            "albedo.exr: 2 of 4 texels are out of range, the first in column 1, row 0, is -0.25; expected 0 to 1";
        assert!(warnings.len() == 1 && warnings[0].starts_with(expected), "{warnings:?}");
        // Light may be as bright as it likes.
        let (result, warnings) = check([[0.5, 1e4, 0.0], [0.5; 3], [0.0; 3], [f32::MAX; 3]], LIGHT);
        assert!(result.is_ok() && warnings.is_empty(), "{warnings:?}");
        let (_, warnings) = check([[0.5, -1e-3, 0.0], [0.5; 3], [0.0; 3], [f32::MAX; 3]], LIGHT);
        assert!(warnings[0].contains("1 of 4") && warnings[0].contains("expected 0 or more"), "{warnings:?}");
    }
}
