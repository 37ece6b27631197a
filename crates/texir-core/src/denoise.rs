//! Denoising of irradiance in the atlas: what is noise is told from what is shadow by two independent estimates.
//!
//! Every texel takes a local quadratic fit of its neighbours on the surface (regression keeps gradients, and curvature as far as
//! noise lets it be seen), weighted by distance and by how much their irradiance differs beyond noise. Each half of the
//! samples is fitted with weights that the other half gave, so that a texel's noise does not choose its own neighbours
//! (Rousselle, Knaus and Zwicker, "Adaptive Rendering with Non-Local Means Filtering", SIGGRAPH Asia 2012; regression after
//! Bitterli et al., "Nonlinearly Weighted First-order Regression for Denoising Monte Carlo Renderings", EGSR 2016). And what
//! both halves have beyond their fits is no noise: it stays, which keeps shadows too thin for the fit to see.

#[cfg(feature = "oidn")]
pub mod oidn;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::brdf::basis;
use crate::cholesky;
use crate::neighbours::Neighbours;
use crate::real::V3;
use crate::surface::SurfacePoint;

/// Radius of the fit, texels.
const RADIUS: f32 = 8.0;
/// Radius within which the guide is smoothed, texels.
const GUIDE_RADIUS: f32 = 1.6;
/// Radius within which noise is measured, texels: so wide that a texel's own noise hardly sets how much it is smoothed, which
/// would keep dark texels dark and not bright ones bright.
const NOISE_RADIUS: f32 = 3.2;
/// Radius within which texels tell together what the fits miss, texels.
const MISS_RADIUS: f32 = 2.5;
/// How far away a point may be that has a say in what becomes of another, texels.
pub(crate) const REACH: f32 = MISS_RADIUS + RADIUS + GUIDE_RADIUS;
/// A neighbour's weight falls to a quarter where its difference beyond noise is this many times the noise.
const TOLERANCE: f32 = 2.0;
/// How much curvature is expected: standard deviation of the quadratic coefficients over the fit's radius, as a share of the
/// value. Noise makes the fit as linear as this lets it.
const CURVATURE: f32 = 0.5;
/// The regression's ridge, as a share of the weight: keeps a fit along a line of texels solvable.
const RIDGE: f64 = 1e-3;

/// Two independent estimates of a quantity per point, linear RGB; its mean is the estimate, half of the difference its
/// standard error.
pub type Halves = [Vec<[f32; 3]>; 2];

/// What a texel's neighbourhood tells about it.
struct Guide {
    /// Smoothed estimate of each half.
    halves: [Vec3; 2],
    /// Mean square of the difference of both halves, relative to the squared value.
    relative: f32,
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
    let fits = fits(points, halves, apart, texel);
    let neighbours = Neighbours::new(points, MISS_RADIUS * texel);
    (0..points.len())
        .into_par_iter()
        .filter(|&i| wanted(i))
        .map(|i| {
            // Of what is beyond the fits, relative to them: what both halves share, and the variance of their mean.
            let (mut shared, mut noise) = (0.0, 0.0);
            for (j, offset) in neighbours.of(&points[i]).filter(|&(j, _)| apart[j] == apart[i]) {
                let near = 1.0 - offset.length_squared() / (MISS_RADIUS * texel).powi(2);
                let [a, b] = [0, 1].map(|half| Vec3::from(halves[half][j]) - fits[j][half]);
                let level = (fits[j][0] + fits[j][1]).length_squared().max(f32::MIN_POSITIVE);
                shared += near * a.dot(b) / level;
                noise += near * a.distance_squared(b) / 4.0 / level;
            }
            // Wiener's weight; halves that agree by chance share about as much as their noise.
            let signal = (shared - noise).max(0.0);
            let kept = if signal > 0.0 { signal / (signal + noise) } else { 0.0 };
            let fit = (fits[i][0] + fits[i][1]) / 2.0;
            (fit + (mean(halves, i) - fit) * kept).to_array()
        })
        .collect()
}

/// The fit of each half at every point.
fn fits(points: &[SurfacePoint], halves: &Halves, apart: &[bool], texel: f32) -> Vec<[Vec3; 2]> {
    let guides = guides(points, halves, apart, texel);
    let radius = RADIUS * texel;
    let neighbours = Neighbours::new(points, radius);
    (points.par_iter().enumerate())
        .map(|(i, point)| {
            let (tangent, bitangent) = basis(V3(point.normal));
            let (tangent, bitangent) = (Vec3::from(tangent.0), Vec3::from(bitangent.0));
            let noise = guides[i].noise.max(f32::MIN_POSITIVE);
            let mut fits = [Fit::default(); 2];
            for (j, offset) in neighbours.of(point).filter(|&(j, _)| apart[j] == apart[i]) {
                let at = Vec2::new(offset.dot(tangent), offset.dot(bitangent)) / radius;
                let near = (1.0 - at.length_squared()).max(0.0).powi(2);
                let monomials = Monomials::at(at);
                for (half, fit) in fits.iter_mut().enumerate() {
                    let difference = guides[i].halves[1 - half].distance_squared(guides[j].halves[1 - half]);
                    let beyond = (difference - noise).max(0.0) / (TOLERANCE * TOLERANCE * noise);
                    fit.add(near / (1.0 + beyond).powi(2), &monomials, halves[half][j]);
                }
            }
            // A half's variance over that of the coefficients before anything is seen.
            let ridge = guides[i].relative / 2.0 / (CURVATURE * CURVATURE);
            [0, 1].map(|half| fits[half].centre(ridge).unwrap_or(Vec3::from(halves[half][i])))
        })
        .collect()
}

fn guides(points: &[SurfacePoint], halves: &Halves, apart: &[bool], texel: f32) -> Vec<Guide> {
    let radius = GUIDE_RADIUS * texel;
    let neighbours = Neighbours::new(points, radius);
    // The smoothed halves, and the variance of what is smoothed as a share of a texel's.
    let smoothed: Vec<([Vec3; 2], f32)> = (0..points.len())
        .into_par_iter()
        .map(|i| {
            let (mut sums, mut weight, mut squares) = ([Vec3::ZERO; 2], 0.0, 0.0);
            for (j, offset) in neighbours.of(&points[i]).filter(|&(j, _)| apart[j] == apart[i]) {
                let near = 1.0 - offset.length_squared() / (radius * radius);
                sums = [0, 1].map(|half| sums[half] + near * Vec3::from(halves[half][j]));
                weight += near;
                squares += near * near;
            }
            (sums.map(|sum| sum / weight), squares / (weight * weight))
        })
        .collect();
    // The square of a texel's value: its own beside what is brighter, the smoothed one where it is bright by chance.
    let level = |i: usize| {
        let [a, b] = smoothed[i].0;
        ((a + b) / 2.0).length_squared().min(mean(halves, i).length_squared()).max(f32::MIN_POSITIVE)
    };
    let radius = NOISE_RADIUS * texel;
    let neighbours = Neighbours::new(points, radius);
    (0..points.len())
        .into_par_iter()
        .map(|i| {
            let (mut sum, mut weight) = (0.0, 0.0);
            for (j, offset) in neighbours.of(&points[i]).filter(|&(j, _)| apart[j] == apart[i]) {
                let near = 1.0 - offset.length_squared() / (radius * radius);
                // (a − b)² estimates the variance of a − b; relative to the value, it is alike in light and in shadow.
                let [a, b] = [0, 1].map(|half| Vec3::from(halves[half][j]));
                sum += near * a.distance_squared(b) / level(j);
                weight += near;
            }
            let (halves, share) = smoothed[i];
            let relative = sum / weight;
            Guide { halves, relative, noise: relative * level(i) * share }
        })
        .collect()
}

fn mean(halves: &Halves, i: usize) -> Vec3 {
    (Vec3::from(halves[0][i]) + Vec3::from(halves[1][i])) / 2.0
}

/// How many coefficients a quadratic has in two variables,
const TERMS: usize = 6;
/// and how many different products of two of its terms there are.
const PRODUCTS: usize = 15;
/// Exponents of x and y of the products; those of the terms come first.
const EXPONENTS: [[usize; 2]; PRODUCTS] = [
    [0, 0],
    [1, 0],
    [0, 1],
    [2, 0],
    [1, 1],
    [0, 2],
    [3, 0],
    [2, 1],
    [1, 2],
    [0, 3],
    [4, 0],
    [3, 1],
    [2, 2],
    [1, 3],
    [0, 4],
];

/// The products of a quadratic's terms at a place.
struct Monomials([f32; PRODUCTS]);

impl Monomials {
    fn at(at: Vec2) -> Self {
        let powers = |v: f32| [1.0, v, v * v, v * v * v, v * v * v * v];
        let (x, y) = (powers(at.x), powers(at.y));
        Self(EXPONENTS.map(|[i, j]| x[i] * y[j]))
    }
}

/// Weighted least squares of value = c + g·at + atᵀH at, per channel.
#[derive(Clone, Copy, Default)]
struct Fit {
    /// Σ w monomial.
    moments: [f32; PRODUCTS],
    /// Σ w term value, by channel.
    values: [[f32; TERMS]; 3],
}

impl Fit {
    fn add(&mut self, weight: f32, Monomials(monomials): &Monomials, value: [f32; 3]) {
        let weighted = monomials.map(|m| weight * m);
        (0..PRODUCTS).for_each(|k| self.moments[k] += weighted[k]);
        for (sums, value) in self.values.iter_mut().zip(value) {
            (0..TERMS).for_each(|k| sums[k] += weighted[k] * value);
        }
    }

    /// The fitted value at the centre, `ridge` the weight of there being no curvature; the weighted mean where
    /// extrapolation makes it negative. `None` without weight.
    fn centre(&self, ridge: f32) -> Option<Vec3> {
        let weight = f64::from(self.moments[0]);
        let mut matrix = [0.0; TERMS * TERMS];
        for (r, [xr, yr]) in EXPONENTS[..TERMS].iter().enumerate() {
            for (c, [xc, yc]) in EXPONENTS[..TERMS].iter().enumerate() {
                let product = EXPONENTS.iter().position(|e| *e == [xr + xc, yr + yc])?;
                matrix[r * TERMS + c] = f64::from(self.moments[product]);
            }
            let curved = if xr + yr == 2 { f64::from(ridge) } else { 0.0 };
            matrix[r * TERMS + r] += if r > 0 { RIDGE * weight + curved } else { 0.0 };
        }
        let mut terms: [[f64; 3]; TERMS] = std::array::from_fn(|k| self.values.map(|v| f64::from(v[k])));
        cholesky::solve(&mut matrix, &mut terms)?;
        let fitted = Vec3::from(terms[0].map(|v| v as f32));
        let mean = Vec3::from(self.values.map(|v| v[0])) / self.moments[0];
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
        assert!(rim < before / 2.4, "{rim} of {before}");
    }

    #[test]
    fn rare_bright_samples_keep_their_light() {
        // A twentieth of a half's texels found a small source: 2.9 instead of 0.9 of the truth. Smoothing that follows a
        // texel's own noise keeps the others where they are, and takes 2.5 % of the light.
        for seed in [5u32, 9, 31, 77] {
            let halves = [1u32, 2].map(|half| {
                let rare = |i: usize| hash2(hash2(i as u32, seed), half) < u32::MAX / 20;
                (0..SIDE * SIDE).map(|i| [if rare(i) { 2.9 } else { 0.9 }; 3]).collect()
            });
            let got = denoise(&floor(), &halves, &[false; SIDE * SIDE], TEXEL);
            let gathered: f32 = (0..got.len()).map(|i| mean(&halves, i).x).sum();
            let ratio = got.iter().map(|e| e[0]).sum::<f32>() / gathered;
            assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
            let spread = error(&got.iter().map(|e| e[0]).collect::<Vec<_>>(), &vec![1.0; got.len()], |_| true);
            assert!(spread < 0.12, "{spread} left of 0.31");
        }
    }

    #[test]
    fn a_peak_keeps_its_height() {
        // What a lamp close above leaves on a floor: a linear fit takes the mean of its kernel for the peak.
        let truth: Vec<f32> = (0..SIDE * SIDE)
            .map(|i| {
                let (x, y) = ((i % SIDE) as f32 - 19.5, (i / SIDE) as f32 - 19.5);
                (1.0 + (x * x + y * y) / 300.0).powi(-2)
            })
            .collect();
        let got = run(&floor(), &truth);
        let peak: Vec<usize> = (0..SIDE * SIDE).filter(|i| truth[*i] > 0.9).collect();
        let sum = |of: &[f32]| peak.iter().map(|i| of[*i]).sum::<f32>();
        let ratio = sum(&got) / sum(&truth);
        assert!((ratio - 1.0).abs() < 0.01, "{ratio} of {} texels", peak.len());
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
