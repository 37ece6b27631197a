//! Lens distortion: where a pinhole's pixel is found in the distorted photo, and the pinhole that a photo fills.

use glam::DVec2;

use crate::camera::{Camera, Projection};
use crate::raster::Raster;

/// No pinhole is made wider than this, degrees from its axis: beyond, its pixels cover too little of the photo.
const WIDEST_DEGREES: f64 = 65.0;
/// A pinhole is at most this many times as wide as its photo, pixels: lenses that squeeze more than that do not exist.
const LARGEST_SCALE: f64 = 4.0;
/// Boundary points that are looked at per side when fitting a pinhole into a photo.
const BOUNDARY: usize = 64;
/// Steps along the radius in the search for the place where a model folds back.
const RADIUS_STEPS: usize = 4096;

/// How a lens deviates from a pinhole, in OpenCV's normalised coordinates: x right, y down, at distance 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// Brown–Conrady: x' = x·R(r²) + 2p₁xy + p₂(r² + 2x²), y' likewise, R = (1 + n₁r² + … + n₄r⁸) / (1 + d₁r² + d₂r⁴ +
    /// d₃r⁶). OpenCV's k₁…k₃ are n₁…n₃, its k₄…k₆ are d₁…d₃; nerfstudio's and Matterport's k₄ is n₄.
    Radial {
        /// Coefficients of r², r⁴, r⁶, r⁸ above.
        numerator: [f64; 4],
        /// Coefficients of r², r⁴, r⁶ below.
        denominator: [f64; 3],
        /// p₁, p₂.
        tangential: [f64; 2],
    },
    /// Kannala–Brandt, OpenCV's fisheye: the radius in the photo is θ(1 + k₁θ² + k₂θ⁴ + k₃θ⁶ + k₄θ⁸), θ the angle to
    /// the axis.
    Fisheye {
        /// k₁…k₄.
        k: [f64; 4],
    },
}

/// Coefficients of x, x², … in 1 + c₁x + c₂x² + ….
fn series(coefficients: &[f64], x: f64) -> f64 {
    1.0 + coefficients.iter().rev().fold(0.0, |sum, c| (sum + c) * x)
}

impl Distortion {
    /// `None` when all coefficients are 0 and the model is a pinhole's then.
    pub fn radial(numerator: [f64; 4], denominator: [f64; 3], tangential: [f64; 2]) -> Option<Self> {
        let flat = numerator.iter().chain(&denominator).chain(&tangential).all(|c| *c == 0.0);
        (!flat).then_some(Self::Radial { numerator, denominator, tangential })
    }

    /// The model with its coefficients, for people.
    pub fn describe(&self) -> String {
        match self {
            Self::Radial { numerator, denominator, tangential: [p1, p2] } => {
                let above = (1..).zip(numerator).map(|(i, k)| (format!("k{i}"), *k));
                let below = (4..).zip(denominator).map(|(i, k)| (format!("k{i} of the denominator"), *k));
                let tangential = [("p1".to_owned(), *p1), ("p2".to_owned(), *p2)];
                let named = above.chain(below).chain(tangential).filter(|(_, value)| *value != 0.0);
                named.map(|(name, value)| format!("{name} is {value}")).collect::<Vec<_>>().join(", ")
            }
            Self::Fisheye { k } => format!("camera_model is OPENCV_FISHEYE (coefficients {k:?})"),
        }
    }

    /// All coefficients are finite.
    pub fn is_finite(&self) -> bool {
        match self {
            Self::Radial { numerator, denominator, tangential } => {
                numerator.iter().chain(denominator).chain(tangential).all(|c| c.is_finite())
            }
            Self::Fisheye { k } => k.iter().all(|c| c.is_finite()),
        }
    }

    /// Where the ray through the pinhole's (x, y) meets the photo.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let r2 = x * x + y * y;
        match self {
            Self::Radial { numerator, denominator, tangential: [p1, p2] } => {
                let radial = series(numerator, r2) / series(denominator, r2);
                (
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                )
            }
            Self::Fisheye { k } => {
                let r = r2.sqrt();
                if r < 1e-12 {
                    return (x, y);
                }
                let theta = r.atan();
                let scale = theta * series(k, theta * theta) / r;
                (x * scale, y * scale)
            }
        }
    }

    /// The largest radius of the pinhole up to which the model is one-to-one: a polynomial that was fitted to the
    /// photo's field folds back beyond it. At most the widest pinhole's.
    fn largest_radius(&self) -> f64 {
        let widest = WIDEST_DEGREES.to_radians().tan();
        let photo_radius = |r: f64| match self {
            Self::Radial { numerator, denominator, .. } => r * series(numerator, r * r) / series(denominator, r * r),
            Self::Fisheye { .. } => self.distort(r, 0.0).0,
        };
        let radii = (1..=RADIUS_STEPS).map(|i| widest * i as f64 / RADIUS_STEPS as f64);
        let mut reached = 0.0;
        for r in radii {
            let here = photo_radius(r);
            if !(here > reached) {
                return r * (1.0 - 2.0 / RADIUS_STEPS as f64);
            }
            reached = here;
        }
        widest
    }
}

/// A photo's pixels as a pinhole sees them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Undistortion {
    photo: Camera,
    distortion: Distortion,
    /// The pinhole: the photo's pose and focal lengths, and the largest image that the photo fills.
    pub(super) pinhole: Camera,
}

impl Undistortion {
    /// `None` for a panorama, and when no pixel of the photo is usable: the model folds back at its centre.
    pub(super) fn new(photo: &Camera, distortion: Distortion) -> Option<Self> {
        let Projection::Pinhole { fx, fy, cx, cy } = photo.projection else { return None };
        let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(f64::from);
        let limit = distortion.largest_radius();
        // The extents left, right, up and down that are usable together: all shrink at once until the rim is inside.
        let rim = |scale: f64| {
            let [left, right] = [cx / fx, (photo.width as f64 - cx) / fx].map(|e| scale * e);
            let [up, down] = [cy / fy, (photo.height as f64 - cy) / fy].map(|e| scale * e);
            (left, right, up, down)
        };
        let fits = |scale: f64| {
            let (left, right, up, down) = rim(scale);
            (0..=BOUNDARY).all(|i| {
                let t = i as f64 / BOUNDARY as f64;
                let (x, y) = (-left + t * (left + right), -up + t * (up + down));
                [(x, -up), (x, down), (-left, y), (right, y)].iter().all(|&(x, y)| {
                    let (px, py) = distortion.distort(x, y);
                    let (px, py) = (px * fx + cx, py * fy + cy);
                    let inside = |p: f64, size: usize| p >= 0.0 && p <= size as f64;
                    x.hypot(y) <= limit && inside(px, photo.width) && inside(py, photo.height)
                })
            })
        };
        let (mut low, mut high) = (0.0, LARGEST_SCALE);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if fits(middle) { low = middle } else { high = middle }
        }
        let (left, right, up, down) = rim(low);
        let (width, height) = (((left + right) * fx).floor(), ((up + down) * fy).floor());
        if !(width >= 1.0 && height >= 1.0) {
            return None;
        }
        // What rounding down leaves over is shared by both sides.
        let (cx, cy) = (left * fx - ((left + right) * fx - width) / 2.0, up * fy - ((up + down) * fy - height) / 2.0);
        let projection = Projection::Pinhole { fx: fx as f32, fy: fy as f32, cx: cx as f32, cy: cy as f32 };
        let pinhole = Camera { projection, width: width as usize, height: height as usize, ..*photo };
        Some(Self { photo: *photo, distortion, pinhole })
    }

    /// The place in the photo, in its pixels, that the pinhole's pixel (column, row) shows at its centre.
    fn photo_position(&self, column: usize, row: usize) -> (f64, f64) {
        let (Projection::Pinhole { fx, fy, cx, cy }, Projection::Pinhole { cx: px, cy: py, .. }) =
            (self.photo.projection, self.pinhole.projection)
        else {
            return (column as f64 + 0.5, row as f64 + 0.5);
        };
        let [fx, fy, cx, cy, px, py] = [fx, fy, cx, cy, px, py].map(f64::from);
        let (x, y) = ((column as f64 + 0.5 - px) / fx, (row as f64 + 0.5 - py) / fy);
        let (x, y) = self.distortion.distort(x, y);
        (x * fx + cx, y * fy + cy)
    }

    /// Values between the photo's pixels, bilinear: for colours.
    pub(super) fn smooth<const N: usize>(&self, photo: &Raster<[f32; N]>) -> Raster<[f32; N]> {
        self.resample(|x, y| {
            let around = photo.around(DVec2::new(x, y), false);
            std::array::from_fn(|i| around.iter().map(|&(at, weight)| weight * photo.data[at][i]).sum())
        })
    }

    /// The photo's nearest values: for ids and masks.
    pub(super) fn nearest<T: Copy>(&self, photo: &Raster<T>) -> Raster<T> {
        let index = |v: f64, size: usize| (v.max(0.0) as usize).min(size - 1);
        self.resample(|x, y| *photo.at(index(x, photo.width), index(y, photo.height)))
    }

    fn resample<T>(&self, value: impl Fn(f64, f64) -> T) -> Raster<T> {
        let Camera { width, height, .. } = self.pinhole;
        let pixel = |i: usize| {
            let (x, y) = self.photo_position(i % width, i / width);
            value(x, y)
        };
        Raster { width, height, data: (0..width * height).map(pixel).collect() }
    }
}
