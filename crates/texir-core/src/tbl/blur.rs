//! How blurred the images of a capture are, from surfaces that several views see.
//!
//! A pixel is taken for the mean of what it covers. Lenses, stitching and resampling spread it further. A view that is much
//! nearer to a surface shows what the pixel of a farther one should hold: P, the mean of what it sees within that pixel. A
//! narrow point spread of variance v (square pixels, along each axis) makes it I = P + v/2 ∇²P, so that v is the slope of
//! I − P over ∇²P/2. What views see differently for other reasons (reflections) has nothing to do with ∇²P, and is weighed down.

use glam::{DVec2, Vec3};
use rayon::prelude::*;

use super::photo;
use super::photo::Photo;
use super::shown::{Shown, pixels_per_radian, pixels_per_steradian};
use crate::backend::Backend;
use crate::camera::{Camera, Projection};
use crate::capture::View;
use crate::error::Result;
use crate::inpaint;
use crate::progress::Progress;
use crate::raster::Gray;
use crate::scene::Scene;
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
/// Fewer pixels say nothing.
const ENOUGH: usize = 500;
/// More pixels say no more.
const PLENTY: usize = 50_000;
/// Pixels of the views that are compared, altogether: 256 MB.
const PIXELS: usize = 1 << 26;
/// Keeps quotients of black finite.
const BLACK: f32 = 1e-4;

/// The variance of the point spread beyond that of a pixel, square pixels along each axis, which is never negative; `None` where
/// too few surfaces are seen from near and from far. Large captures are judged by their first views.
pub fn measure(
    backend: &mut dyn Backend,
    scene: &Scene,
    views: &[View],
    progress: &dyn Progress,
) -> Result<Option<f32>> {
    let mut pixels = 0;
    let within = |view: &&View| {
        pixels += view.camera.pixels();
        pixels <= PIXELS
    };
    let cameras: Vec<Camera> = views.iter().take_while(within).map(|v| v.camera).collect();
    measure_photos(backend, scene, &cameras, |i| photo(&views[i], progress), progress)
}

/// [`measure`] for photos that `load` gives by index.
pub(super) fn measure_photos(
    backend: &mut dyn Backend,
    scene: &Scene,
    cameras: &[Camera],
    mut load: impl FnMut(usize) -> Result<Photo>,
    progress: &dyn Progress,
) -> Result<Option<f32>> {
    let images = (0..cameras.len()).map(|i| Ok(load(i)?.image.map(|radiance| inpaint::mean(*radiance))));
    let images: Vec<Gray> = images.collect::<Result<_>>()?;
    progress.start("sharpness", cameras.len() as u64, "views");
    let mut comparisons = Vec::new();
    for (far, (camera, image)) in cameras.iter().zip(&images).enumerate() {
        progress.check()?;
        let points = Points::new(backend, scene, camera)?;
        for (_, near) in cameras.iter().zip(&images).enumerate().filter(|(near, _)| *near != far) {
            comparisons.extend(points.compare(backend, image, near)?);
        }
        progress.advance(1);
        if comparisons.len() >= PLENTY {
            break;
        }
    }
    progress.finish();
    Ok((comparisons.len() >= ENOUGH).then(|| variance(&comparisons).max(0.0)))
}

/// What a pixel shows beside what a nearer view predicts.
struct Comparison {
    /// I − P, relative to the mean of the two.
    difference: f32,
    /// ∇²P/2, likewise.
    curvature: f32,
    /// Area of a pixel of the nearer view, in pixels of this one.
    ratio: f32,
}

/// What a view sees through [`AXIS`]² points of each of its pixels.
struct Points<'a> {
    shown: Shown<'a>,
    camera: &'a Camera,
    /// Pixel by pixel; `None` where there is no surface, or it is seen at a grazing angle.
    points: Vec<Option<SurfacePoint>>,
}

impl<'a> Points<'a> {
    fn new(backend: &mut dyn Backend, scene: &'a Scene, camera: &'a Camera) -> Result<Self> {
        let fine = camera.supersampled(AXIS);
        let hits = backend.primary(&fine)?;
        let of_pixel = |pixel: usize| {
            let (x, y) = (pixel % camera.width * AXIS, pixel / camera.width * AXIS);
            (0..AXIS * AXIS).map(move |k| (y + k / AXIS) * fine.width + x + k % AXIS)
        };
        let point = |hit: &Hit| hit.is_hit().then(|| SurfacePoint::new(&scene.mesh, hit, None));
        let points = (0..camera.pixels()).flat_map(of_pixel).map(|i| point(&hits[i])).collect();
        Ok(Self { shown: Shown::new(backend, &scene.mesh, camera)?, camera, points })
    }

    /// Compares `image`, which the view shows, with a view that is nearer to some of it.
    fn compare(
        &self,
        backend: &mut dyn Backend,
        image: &Gray,
        (near, nearer): (&Camera, &Gray),
    ) -> Result<Vec<Comparison>> {
        let ratio = |points: &[Option<SurfacePoint>]| -> Option<f32> {
            let of_point = |point: &Option<SurfacePoint>| {
                let point = point.as_ref()?;
                near.project(point.position.into())?;
                Some(density(self.camera, point)? / density(near, point)?)
            };
            points.iter().map(of_point).sum::<Option<f32>>().map(|sum| sum / points.len() as f32)
        };
        let candidates: Vec<(usize, f32)> = self
            .points
            .par_chunks(AXIS * AXIS)
            .enumerate()
            .filter_map(|(pixel, points)| Some((pixel, ratio(points).filter(|ratio| *ratio <= 1.0 / NEARER)?)))
            .collect();
        let points_of = |pixel: usize| self.points[pixel * AXIS * AXIS..][..AXIS * AXIS].iter().flatten().copied();
        let points: Vec<SurfacePoint> = candidates.iter().flat_map(|(pixel, _)| points_of(*pixel)).collect();
        let projected = backend.project(&points, near)?;
        let wraps = near.projection == Projection::Equirectangular;
        let mut predicted = vec![f32::NAN; image.data.len()];
        for ((pixel, _), projected) in candidates.iter().zip(projected.chunks(AXIS * AXIS)) {
            let read = |at: DVec2| -> f32 { nearer.around(at, wraps).iter().map(|&(i, w)| w * nearer.data[i]).sum() };
            let shown = projected.iter().map(|at| match at.distance > 0.0 {
                true => read(DVec2::from(at.pixel.map(f64::from))),
                false => f32::NAN,
            });
            predicted[*pixel] = shown.sum::<f32>() / projected.len() as f32;
        }
        // Exposures may differ.
        let factors = candidates.iter().map(|&(pixel, _)| image.data[pixel] / predicted[pixel]);
        let mut factors: Vec<f32> = factors.filter(|factor| factor.is_finite()).collect();
        factors.sort_by(f32::total_cmp);
        let factor = factors.get(factors.len() / 2).copied().unwrap_or(1.0);
        predicted.iter_mut().for_each(|radiance| *radiance *= factor);
        let compare = |&(pixel, ratio): &(usize, f32)| -> Option<Comparison> {
            let (x, y) = ((pixel % image.width) as i64, (pixel / image.width) as i64);
            let per_radian = pixels_per_radian(self.camera, y as f32 + 0.5);
            let around = [(-1, 0), (1, 0), (0, -1), (0, 1)].map(|(dx, dy)| self.shown.pixel(x + dx, y + dy));
            let around: f32 = around.into_iter().map(|p| p.map(|p| predicted[p])).sum::<Option<f32>>()?;
            let middle = 0.5 * (image.data[pixel] + predicted[pixel]) + BLACK;
            let difference = (image.data[pixel] - predicted[pixel]) / middle;
            let curvature = 0.5 * (around - 4.0 * predicted[pixel]) / middle;
            let usable = per_radian.y >= NARROW * per_radian.x && (difference + curvature).is_finite();
            usable.then_some(Comparison { difference, curvature, ratio })
        };
        Ok(candidates.iter().filter_map(compare).collect())
    }
}

/// Pixels of a view per square metre of the surface at a point; `None` where it is seen from behind or at a grazing angle.
fn density(camera: &Camera, point: &SurfacePoint) -> Option<f32> {
    let to_camera = camera.position() - Vec3::from(point.position);
    let cosine = Vec3::from(point.normal).dot(to_camera) / to_camera.length();
    (cosine >= MIN_COSINE).then(|| pixels_per_steradian(camera) * cosine / to_camera.length_squared())
}

/// The slope of the differences over the curvatures, corrected for how the predictions are blurred themselves.
fn variance(comparisons: &[Comparison]) -> f32 {
    let mut measured = 0.0;
    let mut ratio = 0.0;
    for scale in SCALES {
        let mut sums = [0.0f64; 3];
        for Comparison { difference, curvature, ratio } in comparisons {
            let error = (difference - measured * curvature) / scale;
            let weight = curvature / (1.0 + error * error);
            let terms = [weight * difference, weight * curvature, weight * curvature * ratio];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += f64::from(term));
        }
        measured = (sums[0] / sums[1].max(f64::MIN_POSITIVE)) as f32;
        ratio = (sums[2] / sums[1].max(f64::MIN_POSITIVE)) as f32;
    }
    (measured + POINTS + READ * ratio) / (1.0 - ratio)
}
