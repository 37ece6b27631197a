//! Denoising of irradiance in the atlas: what is noise is told from what is shadow by two independent estimates.
//!
//! Every texel takes a local linear fit of its neighbours on the surface (first-order regression, which keeps gradients),
//! weighted by distance and by how much their irradiance differs beyond noise. Each half of the samples is fitted with
//! weights that the other half gave, so that a texel's noise does not choose its own neighbours (Rousselle, Knaus and
//! Zwicker, "Adaptive Rendering with Non-Local Means Filtering", SIGGRAPH Asia 2012; regression after Bitterli et al.,
//! "Nonlinearly Weighted First-order Regression for Denoising Monte Carlo Renderings", EGSR 2016). And no texel moves further
//! than a few standard errors from what it gathered, which keeps shadows too thin for the fit to see.

use glam::{Mat3, Vec2, Vec3};
use rayon::prelude::*;

use crate::brdf::basis;
use crate::neighbours::Neighbours;
use crate::real::V3;
use crate::surface::SurfacePoint;

/// Radius of the fit, texels.
const RADIUS: f32 = 5.0;
/// Radius within which noise is measured and the guide smoothed, texels.
const GUIDE_RADIUS: f32 = 1.6;
/// How far away a point may be that has a say in what becomes of another, texels.
pub(crate) const REACH: f32 = RADIUS + GUIDE_RADIUS;
/// A neighbour's weight falls to a quarter where its difference beyond noise is this many times the noise.
const TOLERANCE: f32 = 2.0;
/// How far a texel may move, standard errors.
const LEASH: f32 = 2.5;
/// The regression's ridge, as a share of the weight: keeps a fit along a line of texels solvable.
const RIDGE: f32 = 1e-3;

/// Two independent estimates of a quantity per point, linear RGB; its mean is the estimate, half of the difference its
/// standard error.
pub type Halves = [Vec<[f32; 3]>; 2];

/// What a texel's neighbourhood tells about it.
#[derive(Clone, Copy, Default)]
struct Guide {
    /// Smoothed estimate of each half.
    halves: [Vec3; 2],
    /// Variance of the mean of both halves, over the channels together.
    variance: f32,
    /// Variance of the difference between two guides of the same half that is due to noise.
    noise: f32,
}

/// The mean of both halves without most of its noise. `apart` are points that are not to be mixed with the others (inside
/// other geometry); `texel` is the edge of a typical texel, metres.
pub fn denoise(points: &[SurfacePoint], halves: &Halves, apart: &[bool], texel: f32) -> Vec<[f32; 3]> {
    denoise_some(points, halves, apart, texel, |_| true)
}

/// [`denoise`] of those points, by index, that are `wanted`; what is further than [`REACH`] from all of them does not matter.
pub(crate) fn denoise_some(
    points: &[SurfacePoint],
    halves: &Halves,
    apart: &[bool],
    texel: f32,
    wanted: impl Fn(usize) -> bool + Sync,
) -> Vec<[f32; 3]> {
    let guides = guides(points, halves, apart, GUIDE_RADIUS * texel);
    let radius = RADIUS * texel;
    let neighbours = Neighbours::new(points, radius);
    (0..points.len())
        .into_par_iter()
        .filter(|&i| wanted(i))
        .map(|i| {
            let (tangent, bitangent) = tangents(&points[i]);
            let mut fits = [Fit::EMPTY; 2];
            for (j, offset) in neighbours.of(&points[i]).filter(|&(j, _)| apart[j] == apart[i]) {
                let at = Vec2::new(offset.dot(tangent), offset.dot(bitangent)) / radius;
                let near = (1.0 - at.length_squared()).max(0.0).powi(2);
                for (half, fit) in fits.iter_mut().enumerate() {
                    let difference = guides[i].halves[1 - half].distance_squared(guides[j].halves[1 - half]);
                    let noise = guides[i].noise.max(f32::MIN_POSITIVE);
                    let beyond = (difference - noise).max(0.0) / (TOLERANCE * TOLERANCE * noise);
                    fit.add(near / (1.0 + beyond).powi(2), at, Vec3::from(halves[half][j]));
                }
            }
            let [a, b] = [0, 1].map(|half| fits[half].centre().unwrap_or(Vec3::from(halves[half][i])));
            let gathered = mean(halves, i);
            let moved = (a + b) / 2.0 - gathered;
            (gathered + moved.clamp_length_max(LEASH * guides[i].variance.sqrt())).to_array()
        })
        .collect()
}

fn guides(points: &[SurfacePoint], halves: &Halves, apart: &[bool], radius: f32) -> Vec<Guide> {
    let neighbours = Neighbours::new(points, radius);
    (0..points.len())
        .into_par_iter()
        .map(|i| {
            let (mut sums, mut noise, mut weight, mut squares) = ([Vec3::ZERO; 2], 0.0, 0.0, 0.0);
            for (j, offset) in neighbours.of(&points[i]).filter(|&(j, _)| apart[j] == apart[i]) {
                let near = 1.0 - offset.length_squared() / (radius * radius);
                let values = [0, 1].map(|half| Vec3::from(halves[half][j]));
                sums = [sums[0] + near * values[0], sums[1] + near * values[1]];
                // (a − b)² estimates the variance of a − b; relative to the value, it is alike in light and in shadow.
                let level = mean(halves, j).length_squared().max(f32::MIN_POSITIVE);
                noise += near * values[0].distance_squared(values[1]) / level;
                weight += near;
                squares += near * near;
            }
            let difference = noise / weight * mean(halves, i).length_squared();
            Guide {
                halves: sums.map(|s| s / weight),
                variance: difference / 4.0,
                noise: difference * squares / (weight * weight),
            }
        })
        .collect()
}

fn mean(halves: &Halves, i: usize) -> Vec3 {
    (Vec3::from(halves[0][i]) + Vec3::from(halves[1][i])) / 2.0
}

fn tangents(point: &SurfacePoint) -> (Vec3, Vec3) {
    let (tangent, bitangent) = basis(V3(point.normal));
    (Vec3::from(tangent.0), Vec3::from(bitangent.0))
}

/// Weighted least squares of value = c + g·at, per channel.
#[derive(Clone, Copy)]
struct Fit {
    /// Σ w (1, x, y)ᵀ(1, x, y).
    moments: Mat3,
    /// Σ w (1, x, y)ᵀ value: a column per channel.
    values: Mat3,
}

impl Fit {
    const EMPTY: Self = Self { moments: Mat3::ZERO, values: Mat3::ZERO };

    fn add(&mut self, weight: f32, at: Vec2, value: Vec3) {
        let row = Vec3::new(1.0, at.x, at.y);
        let weighted = weight * row;
        self.moments += Mat3::from_cols(weighted, weighted * at.x, weighted * at.y);
        self.values += Mat3::from_cols(weighted * value.x, weighted * value.y, weighted * value.z);
    }

    /// The fitted value at the centre; the weighted mean where extrapolation makes it negative. `None` without weight.
    fn centre(&self) -> Option<Vec3> {
        let weight = self.moments.x_axis.x;
        let ridge = Mat3::from_diagonal(Vec3::new(0.0, RIDGE * weight, RIDGE * weight));
        let fitted = ((self.moments + ridge).inverse() * self.values).transpose().x_axis;
        let mean = self.values.transpose().x_axis / weight;
        [fitted, mean].into_iter().find(|v| v.is_finite() && v.min_element() >= 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{hash, hash2};

    const SIDE: usize = 40;
    const TEXEL: f32 = 0.05;
    /// Standard deviation of a half, as a share of the value.
    const NOISE: f32 = 0.1;

    fn point(position: Vec3, normal: Vec3) -> SurfacePoint {
        SurfacePoint { position: position.to_array(), triangle: 0, normal: normal.to_array(), sequence: 0 }
    }

    /// Texel (x, y) of a floor.
    fn floor() -> Vec<SurfacePoint> {
        let at = |i: usize| Vec3::new((i % SIDE) as f32, (i / SIDE) as f32, 0.0) * TEXEL;
        (0..SIDE * SIDE).map(|i| point(at(i), Vec3::Z)).collect()
    }

    /// Two halves of `truth` with independent, nearly normal noise.
    fn noisy(truth: &[f32]) -> Halves {
        [1u32, 2].map(|half| {
            let unit = |k: u32| hash(k) as f32 / u32::MAX as f32 - 0.5;
            let normal = |i: u32| (0..6).map(|k| unit(hash2(hash2(i, k), half))).sum::<f32>() * 2f32.sqrt();
            truth.iter().enumerate().map(|(i, t)| [t * (1.0 + NOISE * normal(i as u32)); 3]).collect()
        })
    }

    fn run(points: &[SurfacePoint], truth: &[f32]) -> Vec<f32> {
        denoise(points, &noisy(truth), &vec![false; points.len()], TEXEL).iter().map(|e| e[0]).collect()
    }

    /// Root mean square of the relative errors of some texels.
    fn error(got: &[f32], truth: &[f32], of: impl Fn(usize) -> bool) -> f32 {
        let squares: Vec<f32> = (0..got.len()).filter(|&i| of(i)).map(|i| (got[i] / truth[i] - 1.0).powi(2)).collect();
        assert!(!squares.is_empty());
        (squares.iter().sum::<f32>() / squares.len() as f32).sqrt()
    }

    #[test]
    fn noise_goes_and_gradients_stay() {
        let truth: Vec<f32> = (0..SIDE * SIDE).map(|i| 1.0 + (i % SIDE) as f32 * 0.1).collect();
        let got = run(&floor(), &truth);
        let before = NOISE / 2f32.sqrt();
        let after = error(&got, &truth, |_| true);
        assert!(after < before / 3.5, "{after} of {before}");
        // Along the rim, where a mean would be biased by the missing side.
        let rim = error(&got, &truth, |i| i % SIDE == 0);
        assert!(rim < before / 2.5, "{rim} of {before}");
    }

    #[test]
    fn a_contact_shadow_stays_sharp() {
        let truth: Vec<f32> = (0..SIDE * SIDE).map(|i| if i % SIDE < 20 { 1.0 } else { 3.0 }).collect();
        let got = run(&floor(), &truth);
        let edge = error(&got, &truth, |i| (19..21).contains(&(i % SIDE)));
        assert!(edge < NOISE / 2f32.sqrt(), "{edge} beside the edge");
        let inside = error(&got, &truth, |i| (8..12).contains(&(i % SIDE)));
        assert!(inside < 0.25 * NOISE, "{inside} in the shadow");
        // Negative control: halves that differ so much that the shadow could be noise do not keep it.
        let halves = [1.0, -1.0].map(|sign| truth.iter().map(|t| [t * (1.0 + sign * 0.9); 3]).collect());
        let blurred = denoise(&floor(), &halves, &[false; SIDE * SIDE], TEXEL);
        assert!(blurred[20 * SIDE + 19][0] > 1.2, "{:?}", blurred[20 * SIDE + 19]);
    }

    #[test]
    fn walls_and_buried_texels_stay_apart() {
        // A wall rises from the floor's rim, ten times as bright; a part of the floor is buried and black.
        let mut points = floor();
        let wall = |i: usize| point(Vec3::new(0.0, (i % SIDE) as f32, (i / SIDE) as f32 + 0.5) * TEXEL, Vec3::X);
        points.extend((0..10 * SIDE).map(wall));
        let buried: Vec<bool> = (0..points.len()).map(|i| i < SIDE * SIDE && i % SIDE > 30).collect();
        let value = |i: usize| if i >= SIDE * SIDE { 10.0 } else { f32::from(u8::from(!buried[i])) };
        let exact: Vec<[f32; 3]> = (0..points.len()).map(|i| [value(i); 3]).collect();
        let got = denoise(&points, &[exact.clone(), exact.clone()], &buried, TEXEL);
        for (got, exact) in got.iter().zip(&exact) {
            assert!((got[0] - exact[0]).abs() < 1e-4, "{got:?} for {exact:?}");
        }
    }

    #[test]
    fn the_order_of_texels_does_not_matter() {
        let truth: Vec<f32> = (0..SIDE * SIDE).map(|i| 2.0 + (i / SIDE) as f32 * 0.05).collect();
        let (points, halves) = (floor(), noisy(&truth));
        let apart = vec![false; points.len()];
        let straight = denoise(&points, &halves, &apart, TEXEL);
        // Another atlas: the same texels in other charts.
        let order: Vec<usize> = (0..points.len()).map(|i| i * 7 % points.len()).collect();
        let moved: Vec<SurfacePoint> = order.iter().map(|&i| points[i]).collect();
        let halves = halves.map(|half| order.iter().map(|&i| half[i]).collect());
        let other = denoise(&moved, &halves, &apart, TEXEL);
        for (k, &i) in order.iter().enumerate() {
            assert!((other[k][0] - straight[i][0]).abs() < 1e-4);
        }
    }

    #[test]
    fn lonely_and_empty_inputs_pass() {
        assert!(denoise(&[], &[vec![], vec![]], &[], TEXEL).is_empty());
        let one = denoise(&floor()[..1], &[vec![[1.0; 3]], vec![[3.0; 3]]], &[false], TEXEL);
        assert_eq!(one, [[2.0; 3]]);
        let dark = denoise(&floor(), &noisy(&[0.0; SIDE * SIDE]), &[false; SIDE * SIDE], TEXEL);
        assert!(dark.iter().all(|e| *e == [0.0; 3]));
    }
}
