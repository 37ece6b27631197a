//! How blurred the images of a capture are, from surfaces that several views see.
//!
//! A pixel is taken for the mean of what it covers. Lenses, stitching and resampling spread it further. A view that is
//! much nearer to a surface shows what the pixel of a farther one should hold: P, the mean of what it sees within that
//! pixel. A narrow point spread of variance v (square pixels, along each axis) makes it I = P + v/2 ∇²P, so that v is
//! the slope of I − P over ∇²P/2. What views see differently for other reasons (reflections) has nothing to do with
//! ∇²P, and is weighed down.

use std::sync::Arc;

use glam::{DVec2, Vec3};
use rayon::prelude::*;

use super::photo;
use super::photo::Photo;
use super::shown::pixels_per_steradian;
use crate::backend::{Backend, Projected};
use crate::camera::Camera;
use crate::capture::View;
use crate::error::Result;
use crate::progress::{Progress, Task};
use crate::radiance_scale::normalised_views;
use crate::raster::{Gray, mean_of_channels};
use crate::scene::Scene;
use crate::stats::median;
use crate::surface::{Hit, SurfacePoint};

/// The widest point spread that can be undone, square pixels: images hold little of what is finer.
pub const WIDEST: f32 = 1.0;

/// Narrower point spreads, square pixels, are not told from none.
pub const SHARP: f32 = 0.06;

/// Points within a pixel along each axis.
const AXIS: usize = 2;
/// Variance of these points, less than that of all of the pixel, in square pixels: (1 − 1/AXIS²)/12 for 1/12.
const POINTS: f32 = -1.0 / 48.0;
/// Variance of a pixel that is read bilinearly: its own, and 1/6 on average.
const READ: f32 = 1.0 / 12.0 + 1.0 / 6.0;
/// A nearer view has at least this many pixels for one of the farther.
const NEARER: f32 = 4.0;
/// Surfaces that are seen at a smaller cosine are not compared.
const MIN_COSINE: f32 = 0.1;
/// Pixels of a panorama that are narrower than this beside their height are not compared: at its poles.
const NARROW: f32 = 0.5;
/// Scales of the Cauchy weights of successive solutions, relative to a pixel's radiance.
const SCALES: [f32; 5] = [0.3, 0.1, 0.05, 0.05, 0.05];
/// A slope of a larger standard error is not known: where surfaces are plain, and noise is all that is to be seen.
const UNSURE: f32 = 0.02;
/// Fewer pixels say nothing.
const ENOUGH: usize = 500;
/// More pixels say no more.
const PLENTY: usize = 50_000;
/// Pixels of the views that are compared, altogether: 256 MB.
const PIXELS: usize = 1 << 26;
/// Keeps quotients of black finite, where views are about 1 bright.
const BLACK: f32 = 1e-4;

/// Variance of the images' point spread beyond the pixel's own, at least 0, in square pixels per axis; `None` where too
/// few surfaces with edges or texture are seen from near and far. Of large captures only the first views are used.
pub fn measure(backend: &mut dyn Backend, views: &[View], progress: &dyn Progress) -> Result<Option<f32>> {
    let mut pixels = 0;
    let within = |view: &&View| {
        pixels += view.camera.pixels();
        pixels <= PIXELS
    };
    let views: Vec<View> = views.iter().take_while(within).cloned().collect();
    let (views, _) = normalised_views(&views, progress)?;
    let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
    measure_photos(backend, &cameras, |i| photo(&views[i], progress), progress)
}

/// [`measure`] for photos that `load` gives by index.
pub(super) fn measure_photos(
    backend: &mut dyn Backend,
    cameras: &[Camera],
    mut load: impl FnMut(usize) -> Result<Photo>,
    progress: &dyn Progress,
) -> Result<Option<f32>> {
    if cameras.len() < 2 {
        return Ok(None);
    }
    let _task = Task::start(progress, "sharpness", cameras.len() as u64, "views");
    let gray = |i: usize| {
        progress.check()?;
        Ok(load(i)?.image.map(|radiance| mean_of_channels(*radiance)))
    };
    let images: Vec<Gray> = (0..cameras.len()).map(gray).collect::<Result<_>>()?;
    let mut comparisons = Vec::new();
    for (far, (camera, image)) in cameras.iter().zip(&images).enumerate() {
        progress.check()?;
        let points = Points::new(backend, camera)?;
        for (_, near) in cameras.iter().zip(&images).enumerate().filter(|(near, _)| *near != far) {
            comparisons.extend(points.compare(backend, image, near)?);
        }
        progress.advance(1);
        if comparisons.len() >= PLENTY {
            break;
        }
    }
    Ok((comparisons.len() >= ENOUGH).then(|| variance(&comparisons)).flatten().map(|variance| variance.max(0.0)))
}

/// What a pixel shows beside what a nearer view predicts.
struct Comparison {
    /// I − P, relative to the mean of the two.
    difference: f32,
    /// ∇²P/2, likewise.
    curvature: f32,
    /// ∇²(P + I)/2, likewise: see [`variance`].
    instrument: f32,
    /// Area of a pixel of the nearer view, in pixels of this one.
    ratio: f32,
}

/// What a view sees through [`AXIS`]² points of each of its pixels.
struct Points<'a> {
    scene: Arc<Scene>,
    camera: &'a Camera,
    /// The view with a pixel for each point.
    fine: Camera,
    /// By pixel of that.
    hits: Vec<Hit>,
}

impl<'a> Points<'a> {
    fn new(backend: &mut dyn Backend, camera: &'a Camera) -> Result<Self> {
        let fine = camera.supersampled(AXIS);
        let hits = backend.primary(&fine, fine.rows())?;
        Ok(Self { scene: backend.scene().clone(), camera, fine, hits })
    }

    /// The points of a pixel; `None` where one of them meets no surface.
    fn of_pixel(&self, pixel: usize) -> Option<[SurfacePoint; AXIS * AXIS]> {
        let hits = std::array::from_fn(|k| &self.hits[self.fine.sub_pixel(AXIS, pixel, k)]);
        hits.iter()
            .all(|hit: &&Hit| hit.is_hit())
            .then(|| hits.map(|hit| SurfacePoint::new(self.scene.mesh(), hit, None)))
    }

    /// Compares `image`, which the view shows, with a view that is nearer to some of it.
    fn compare(
        &self,
        backend: &mut dyn Backend,
        image: &Gray,
        (near, nearer): (&Camera, &Gray),
    ) -> Result<Vec<Comparison>> {
        let candidate = |pixel: usize| {
            let points = self.of_pixel(pixel)?;
            let of_point = |point: &SurfacePoint| {
                near.project(point.position.into())?;
                Some(density(self.camera, point)? / density(near, point)?)
            };
            let ratio = points.iter().map(of_point).sum::<Option<f32>>()? / points.len() as f32;
            (ratio <= 1.0 / NEARER).then_some((pixel, ratio, points))
        };
        let candidates: Vec<_> = (0..image.data.len()).into_par_iter().filter_map(candidate).collect();
        let points: Vec<SurfacePoint> = candidates.iter().flat_map(|(_, _, points)| *points).collect();
        let projected = backend.project(&points, near)?;
        let read = |at: &Projected| match at.distance > 0.0 {
            true => nearer.bilinear(DVec2::from(at.pixel.map(f64::from)), near.wraps()),
            false => f32::NAN,
        };
        let mut predicted = vec![f32::NAN; image.data.len()];
        for ((pixel, ..), at) in candidates.iter().zip(projected.chunks(AXIS * AXIS)) {
            predicted[*pixel] = at.iter().map(read).sum::<f32>() / at.len() as f32;
        }
        // Exposures may differ.
        let factors = candidates.iter().map(|(pixel, ..)| image.data[*pixel] / predicted[*pixel]);
        let mut factors: Vec<f32> = factors.filter(|factor| factor.is_finite()).collect();
        let factor = median(&mut factors).unwrap_or(1.0);
        predicted.iter_mut().for_each(|radiance| *radiance *= factor);
        let compare = |(pixel, ratio): (usize, f32)| -> Option<Comparison> {
            let (x, y) = ((pixel % image.width) as i64, (pixel / image.width) as i64);
            let per_radian = self.camera.pixels_per_radian(y as f32 + 0.5);
            let around = [(-1, 0), (1, 0), (0, -1), (0, 1)].map(|(dx, dy)| self.camera.pixel(x + dx, y + dy));
            let curvature = |values: &[f32]| -> Option<f32> {
                let around: f32 =
                    around.iter().map(|beside| beside.map(|beside| values[beside])).sum::<Option<f32>>()?;
                Some(0.5 * (around - 4.0 * values[pixel]))
            };
            let (of_prediction, of_image) = (curvature(&predicted)?, curvature(&image.data)?);
            let middle = 0.5 * (image.data[pixel] + predicted[pixel]) + BLACK;
            let [difference, curvature, instrument] =
                [image.data[pixel] - predicted[pixel], of_prediction, of_prediction + of_image].map(|v| v / middle);
            let usable = per_radian.y >= NARROW * per_radian.x && (difference + instrument).is_finite();
            usable.then_some(Comparison { difference, curvature, instrument, ratio })
        };
        Ok(candidates.iter().filter_map(|(pixel, ratio, _)| compare((*pixel, *ratio))).collect())
    }
}

/// Pixels of a view per square metre of the surface at a point; `None` where it is seen from behind or at a grazing
/// angle.
fn density(camera: &Camera, point: &SurfacePoint) -> Option<f32> {
    let to_camera = camera.position() - Vec3::from(point.position);
    let cosine = Vec3::from(point.normal).dot(to_camera) / to_camera.length();
    (cosine >= MIN_COSINE).then(|| pixels_per_steradian(camera) * cosine / to_camera.length_squared())
}

/// The slope of the differences over the curvatures, corrected for how the predictions are blurred themselves; `None`
/// where its standard error says that it is not known.
///
/// Products with the curvature of P alone would take noise of P for blur, which is in I − P and in ∇²P; with that of I
/// alone, noise of I for the contrary. With both (an instrumental variable), what remains of noise, which is less in P,
/// makes images sharper than they are, and so does nothing; and what surfaces that are out of place add to one is taken
/// off the other.
fn variance(comparisons: &[Comparison]) -> Option<f32> {
    let (mut slope, mut ratio, mut error) = (0.0f32, 0.0, f32::INFINITY);
    for scale in SCALES {
        let (mut covariance, mut energy, mut ratios, mut scatter) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
        for Comparison { difference, curvature, instrument, ratio } in comparisons {
            let residual = difference - slope * curvature;
            let weighted = instrument / (1.0 + (residual / scale).powi(2));
            covariance += f64::from(weighted * difference);
            energy += f64::from(weighted * curvature);
            ratios += f64::from(weighted * curvature * ratio);
            scatter += f64::from(weighted * residual).powi(2);
        }
        if energy <= 0.0 {
            return None;
        }
        (slope, ratio) = ((covariance / energy) as f32, (ratios / energy) as f32);
        error = (scatter.sqrt() / energy) as f32;
    }
    (error <= UNSURE).then(|| (slope + POINTS + READ * ratio) / (1.0 - ratio))
}
