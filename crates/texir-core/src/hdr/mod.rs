//! Bracketed exposures merged to one linear image: EXIF exposure, the camera's response (known, or estimated from the
//! brackets), clipping, noise-optimal weights, ghosts.
//!
//! Shots are read one at a time, so that fifteen of 8192 × 4096 pixels need no more memory than one and the sums.

mod exposure;
mod merge;
mod response;

use std::path::{Path, PathBuf};

pub use self::exposure::read_exposure;
use self::response::Response;
use crate::error::{Error, Result};
use crate::image_io::{Encoded, TransferCurve, read_encoded, read_size};
use crate::progress::{Progress, Task};
use crate::raster::{Rgb, times};

/// Pixels whose brackets the response is estimated from.
const RESPONSE_SAMPLES: usize = 20_000;
/// Encoded values at and above this share of the largest are clipped, or will be with a little noise.
const CLIPPED: f32 = 0.985;
/// Encoded values at and below this are black.
const BLACK: f32 = 0.01;

/// One exposure of a series.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// 8 or 16-bit image.
    pub path: PathBuf,
    /// Light per radiance, relative: seconds · ISO / (100 · f-number²).
    pub exposure: f64,
}

/// How a camera's values stand for light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ResponseChoice {
    /// Estimate it from the brackets.
    Estimate,
    /// It is known.
    Known(TransferCurve),
}

/// A merged series.
#[derive(Clone, Debug)]
pub struct Merged {
    /// Linear radiance: full-scale light per exposure.
    pub radiance: Rgb,
    /// Pixels that are clipped in every shot: what they showed was brighter.
    pub clipped: usize,
    /// Pixels of which at least one shot showed something else than the others.
    pub ghosts: usize,
}

/// How noise grows with light, in units of a sensor's full scale: var = SHOT · light + READ. Typical for cameras at
/// base ISO (20,000 electrons at full scale, 5 of read noise); only their ratio matters to the weights.
mod noise {
    /// One electron.
    pub const SHOT: f64 = 1.0 / 20_000.0;
    /// The square of five electrons.
    pub const READ: f64 = 25.0 * SHOT * SHOT;
}

/// Variance of light as a share of full scale, shot and read noise alone.
fn sensor_variance(light: f64) -> f64 {
    noise::SHOT * light.max(0.0) + noise::READ
}

/// Merges shots of one pose; their order does not matter.
pub fn merge(shots: &[Frame], choice: ResponseChoice, progress: &dyn Progress) -> Result<Merged> {
    let [width, height] = check(shots)?;
    let positions = sample_positions(width, height);
    let samples = read_samples(shots, &positions, progress)?;
    let exposures: Vec<f64> = shots.iter().map(|shot| shot.exposure).collect();
    let response = match choice {
        ResponseChoice::Known(curve) => Response::known(curve),
        ResponseChoice::Estimate => Response::estimate(&samples, &exposures)?,
    };
    let order = merge::order(&samples, &exposures);
    let mut sums = merge::Sums::new(width, height);
    let task = Task::start(progress, "hdr: merging", shots.len() as u64, "shots");
    for index in order {
        progress.check()?;
        let shot = &shots[index];
        sums.add(&load(shot, [width, height])?, shot.exposure, &response);
        progress.advance(1);
    }
    drop(task);
    let (radiance, clipped, ghosts) = sums.finish();
    Ok(Merged { radiance, clipped, ghosts })
}

/// The size that all shots have.
fn check(shots: &[Frame]) -> Result<[usize; 2]> {
    let [first, rest @ ..] = shots else { return Err(Error::invalid("no shots; expected a bracketed series")) };
    for shot in shots {
        if !(shot.exposure > 0.0 && shot.exposure.is_finite()) {
            let what = format!("the exposure is {}; expected a positive number", shot.exposure);
            return Err(Error::file(&shot.path, what));
        }
    }
    if rest.iter().all(|shot| shot.exposure == first.exposure) {
        let what = format!("all {} shots have the same exposure; expected a bracketed series", shots.len());
        return Err(Error::file(&first.path, what));
    }
    let size = read_size(&first.path)?;
    for shot in rest {
        let found = read_size(&shot.path)?;
        if found != size {
            let what = format!("is {} pixels; expected {}, as {} has", times(found), times(size), first.path.display());
            return Err(Error::file(&shot.path, what));
        }
    }
    Ok(size)
}

fn load(shot: &Frame, size: [usize; 2]) -> Result<Encoded> {
    let encoded = read_encoded(&shot.path)?;
    if encoded.values.size() == size { Ok(encoded) } else { Err(changed(&shot.path)) }
}

fn changed(path: &Path) -> Error {
    Error::file(path, "changed its size while it was read")
}

/// Pixels spread evenly over the image, at irregular places: the additive recurrence of the golden ratio.
fn sample_positions(width: usize, height: usize) -> Vec<usize> {
    let pixels = width * height;
    let count = pixels.min(RESPONSE_SAMPLES);
    if count == pixels {
        return (0..pixels).collect();
    }
    let golden = 0.618_033_988_749_894_9_f64;
    (0..count).map(|i| (((i as f64 * golden).fract() * pixels as f64) as usize).min(pixels - 1)).collect()
}

/// The values of all shots at some pixels: `[pixel][shot]`.
fn read_samples(shots: &[Frame], positions: &[usize], progress: &dyn Progress) -> Result<Vec<Vec<[f32; 3]>>> {
    let mut samples = vec![Vec::with_capacity(shots.len()); positions.len()];
    let _task = Task::start(progress, "hdr: looking", shots.len() as u64, "shots");
    for shot in shots {
        progress.check()?;
        let values = read_encoded(&shot.path)?.values;
        for (sample, position) in samples.iter_mut().zip(positions) {
            sample.push(*values.data.get(*position).ok_or_else(|| changed(&shot.path))?);
        }
        progress.advance(1);
    }
    Ok(samples)
}

#[cfg(test)]
pub(crate) mod tests;
