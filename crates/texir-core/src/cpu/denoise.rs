//! Denoising of irradiance, twin of `denoise.wgsl`: the method is described in [`crate::denoise`].

mod around;

use glam::Vec3;
use rayon::prelude::*;

use self::around::Pass;
use super::lanes::Lanes;
use super::sampling::Frame;
use crate::cholesky;
use crate::denoise::{
    CELL, CURVATURE, GUIDE_RADIUS, LOSS_SIGMAS, NOISE_RADIUS, Noisy, RESIDUAL_RADIUS, RESIDUAL_THRESHOLD, RIDGE,
    TOLERANCE,
};
use crate::error::Result;
use crate::neighbours::{FAR, Neighbours};
use crate::progress::Progress;
use crate::real::{Real, V3};

/// The smallest variance and squared value that is divided by.
const TINY: f64 = f32::MIN_POSITIVE as f64;

/// A point smoothed over its closest neighbours.
struct Smoothed<R> {
    /// Smoothed estimate of each half.
    halves: [V3<R>; 2],
    /// Variance of the smoothed value over that of a single point: Σ w² / (Σ w)².
    variance_ratio: R,
    /// Square of the smaller value: the own one beside something brighter, the smoothed one of a firefly.
    squared_value: R,
}

/// The noise at a point.
struct Noise<R> {
    /// Mean square of the difference of both halves, relative to the squared value.
    relative: R,
    /// Variance of the difference between two smoothed estimates of the same half that is due to noise.
    smoothed: R,
}

/// Points between which cancellation is honoured.
const PIECE: usize = 1 << 15;

/// The mean of both halves at every point without most of its noise. Errors when `progress` says to stop.
pub fn denoise<R: Real>(noisy: Noisy<'_>, progress: &dyn Progress) -> Result<Vec<[R; 3]>> {
    let search = Search { noisy, neighbours: Neighbours::new(noisy.points, CELL * noisy.texel) };
    let smoothed = search.each(progress, |i| search.smooth_halves::<R>(i))?;
    let noise = search.each(progress, |i| search.measure_noise(i, &smoothed))?;
    let fits = search.far(progress, &Regress { noisy, smoothed, noise })?;
    let cleaned = search.each(progress, |i| search.clean(i, &fits))?;
    search.far(progress, &Conserve { noisy, cleaned })
}

/// The points, and who lies beside whom.
struct Search<'a> {
    noisy: Noisy<'a>,
    neighbours: Neighbours<FAR>,
}

impl Search<'_> {
    fn each<T: Send>(&self, progress: &dyn Progress, of: impl Fn(usize) -> T + Sync + Send) -> Result<Vec<T>> {
        let count = self.noisy.points.len();
        let mut found = Vec::with_capacity(count);
        for first in (0..count).step_by(PIECE) {
            progress.check()?;
            found.par_extend((first..(first + PIECE).min(count)).into_par_iter().map(&of));
        }
        Ok(found)
    }

    fn far<R: Real, const FEATURES: usize, P: Pass<R, FEATURES>>(
        &self,
        progress: &dyn Progress,
        pass: &P,
    ) -> Result<Vec<P::Found>> {
        around::each(pass, &self.neighbours, self.noisy, progress)
    }

    /// Gives `found` the points within `radius` texels that may be mixed with point `i`, offsets in shares of the
    /// radius, and the kernel there, 1 − |x|² (Epanechnikov).
    #[inline(always)]
    fn around<R: Real>(&self, i: usize, radius: f32, mut found: impl FnMut(usize, V3<R>, R)) {
        let (apart, radius) = (self.noisy.apart, radius * self.noisy.texel);
        let scale = R::of(1.0) / R::of(f64::from(radius));
        self.neighbours.each(i, radius, |j, offset: Vec3| {
            if apart[j] == apart[i] {
                let at = V3::of(offset.to_array()) * scale;
                found(j, at, R::of(1.0) - at.dot(at));
            }
        });
    }

    fn smooth_halves<R: Real>(&self, i: usize) -> Smoothed<R> {
        let (mut sums, mut weight, mut squares) = ([V3::zero(); 2], R::of(0.0), R::of(0.0));
        self.around(i, GUIDE_RADIUS, |j, _, kernel: R| {
            let halves = self.noisy.at(j);
            sums = [0, 1].map(|half| sums[half] + halves[half] * kernel);
            weight = weight + kernel;
            squares = squares + kernel * kernel;
        });
        let halves = sums.map(|sum| sum * (R::of(1.0) / weight));
        let squared_value = square(mean(halves)).min(square(mean(self.noisy.at(i)))).max(R::of(TINY));
        Smoothed { halves, variance_ratio: squares / (weight * weight), squared_value }
    }

    fn measure_noise<R: Real>(&self, i: usize, smoothed: &[Smoothed<R>]) -> Noise<R> {
        let (mut sum, mut weight) = (R::of(0.0), R::of(0.0));
        self.around(i, NOISE_RADIUS, |j, _, kernel: R| {
            // (a − b)² estimates the variance of a − b; relative to the value, it is alike in light and in shadow.
            let [a, b] = self.noisy.at(j);
            sum = sum + kernel * square(a - b) / smoothed[j].squared_value;
            weight = weight + kernel;
        });
        let relative = sum / weight;
        Noise {
            relative,
            smoothed: (relative * smoothed[i].squared_value * smoothed[i].variance_ratio).max(R::of(TINY)),
        }
    }

    /// The mean of both fits, and of what is beyond them as much as both halves share.
    fn clean<R: Real>(&self, i: usize, fits: &[[V3<R>; 2]]) -> V3<R> {
        // Relative to the fits: what both halves share, and the variance of their mean.
        let (mut shared, mut noise) = (R::of(0.0), R::of(0.0));
        self.around(i, RESIDUAL_RADIUS, |j, _, kernel: R| {
            let [a, b] = self.noisy.at(j);
            let (a, b) = (a - fits[j][0], b - fits[j][1]);
            let level = square(fits[j][0] + fits[j][1]).max(R::of(TINY));
            shared = shared + kernel * a.dot(b) / level;
            noise = noise + kernel * square(a - b) / (R::of(4.0) * level);
        });
        // Wiener's weight, of what is more than chance.
        let signal = (shared - noise * R::of(f64::from(RESIDUAL_THRESHOLD))).max(R::of(0.0));
        let kept = if signal > R::of(0.0) { signal / (signal + noise) } else { R::of(0.0) };
        let fit = mean(fits[i]);
        fit + (mean(self.noisy.at(i)) - fit) * kept
    }
}

/// The fit of each half.
struct Regress<'a, R> {
    noisy: Noisy<'a>,
    smoothed: Vec<Smoothed<R>>,
    noise: Vec<Noise<R>>,
}

/// Of a point.
struct FitSums<R> {
    tangent: [Lanes<R>; 3],
    bitangent: [Lanes<R>; 3],
    smoothed: [[Lanes<R>; 3]; 2],
    /// Squared difference between smoothed halves that noise explains.
    expected: Lanes<R>,
    /// (TOLERANCE · noise)², the scale on which the difference beyond that lowers weights.
    tolerated: Lanes<R>,
    fits: [Fit<R>; 2],
}

impl<R: Real> Pass<R, 12> for Regress<'_, R> {
    type Sums = FitSums<R>;
    type Found = [V3<R>; 2];

    /// Both halves, and both smoothed.
    fn features(&self, j: usize) -> [R; 12] {
        let ([V3([a, b, c]), V3([d, e, f])], [V3([g, h, i]), V3([k, l, m])]) =
            (self.noisy.at(j), self.smoothed[j].halves);
        [a, b, c, d, e, f, g, h, i, k, l, m]
    }

    #[inline(always)]
    fn start(&self, i: usize) -> FitSums<R> {
        let Frame { tangent, bitangent, .. } = Frame::of(V3::of(self.noisy.points[i].normal));
        let ([a, b], noise) = (self.smoothed[i].halves, self.noise[i].smoothed);
        FitSums {
            tangent: splat(tangent),
            bitangent: splat(bitangent),
            smoothed: [splat(a), splat(b)],
            expected: Lanes::splat(noise),
            tolerated: Lanes::splat(noise * R::of(f64::from(TOLERANCE * TOLERANCE))),
            fits: [Fit::new(), Fit::new()],
        }
    }

    #[inline(always)]
    fn add(sums: &mut FitSums<R>, at: [Lanes<R>; 3], kernel: Lanes<R>, features: &[Lanes<R>; 12]) {
        let &[a, b, c, d, e, f, g, h, i, k, l, m] = features;
        let (halves, smoothed) = ([[a, b, c], [d, e, f]], [[g, h, i], [k, l, m]]);
        let monomials = Monomials::at(Lanes::dot(at, sums.tangent), Lanes::dot(at, sums.bitangent));
        for half in 0..2 {
            let (own, other) = (sums.smoothed[1 - half], smoothed[1 - half]);
            let apart = [own[0] - other[0], own[1] - other[1], own[2] - other[2]];
            let beyond = (Lanes::dot(apart, apart) - sums.expected).max(Lanes::splat(R::of(0.0)));
            let alike = Lanes::splat(R::of(1.0)) + beyond / sums.tolerated;
            sums.fits[half].add(kernel / (alike * alike), &monomials, halves[half]);
        }
    }

    #[inline(always)]
    fn found(&self, i: usize, sums: FitSums<R>) -> [V3<R>; 2] {
        // A half's variance over that of the coefficients before anything is seen.
        let curved = self.noise[i].relative / R::of(f64::from(2.0 * CURVATURE * CURVATURE));
        let own = self.noisy.at(i);
        [0, 1].map(|half| sums.fits[half].centre(curved).unwrap_or(own[half]))
    }
}

/// What was cleaned, with what it and its neighbours of like brightness lost on average.
struct Conserve<'a, R> {
    noisy: Noisy<'a>,
    cleaned: Vec<V3<R>>,
}

impl<R: Real> Conserve<'_, R> {
    fn level(&self, i: usize) -> R {
        square(self.cleaned[i]).max(R::of(TINY))
    }
}

/// Of a point: how bright it is, and over those of like brightness Σ w lost, Σ w and Σ w² |lost|².
struct ConserveSums<R> {
    level: Lanes<R>,
    lost: [Lanes<R>; 3],
    weight: Lanes<R>,
    squares: Lanes<R>,
}

impl<R: Real> Pass<R, 4> for Conserve<'_, R> {
    type Sums = ConserveSums<R>;
    type Found = [R; 3];

    /// What was lost, and how bright what is left is.
    fn features(&self, j: usize) -> [R; 4] {
        let V3([r, g, b]) = mean(self.noisy.at(j)) - self.cleaned[j];
        [r, g, b, self.level(j)]
    }

    #[inline(always)]
    fn start(&self, i: usize) -> ConserveSums<R> {
        let none = Lanes::splat(R::of(0.0));
        ConserveSums { level: Lanes::splat(self.level(i)), lost: [none; 3], weight: none, squares: none }
    }

    #[inline(always)]
    fn add(sums: &mut ConserveSums<R>, _: [Lanes<R>; 3], kernel: Lanes<R>, &[r, g, b, level]: &[Lanes<R>; 4]) {
        let share = kernel * kernel * (sums.level.min(level) / sums.level.max(level));
        sums.lost = [sums.lost[0] + r * share, sums.lost[1] + g * share, sums.lost[2] + b * share];
        sums.weight = sums.weight + share;
        sums.squares = sums.squares + share * share * Lanes::dot([r, g, b], [r, g, b]);
    }

    #[inline(always)]
    fn found(&self, i: usize, ConserveSums { lost, weight, squares, .. }: ConserveSums<R>) -> [R; 3] {
        let (lost, weight, squares) = (V3(lost.map(Lanes::sum)), weight.sum(), squares.sum());
        let lost = lost * (R::of(1.0) / weight);
        let chance = squares / (weight * weight) * R::of(f64::from(LOSS_SIGMAS * LOSS_SIGMAS));
        let given = if square(lost) > chance { R::of(1.0) - chance / square(lost) } else { R::of(0.0) };
        (self.cleaned[i] + lost * given).0.map(|c| c.max(R::of(0.0)))
    }
}

impl Noisy<'_> {
    /// Both halves at a point.
    fn at<R: Real>(&self, i: usize) -> [V3<R>; 2] {
        self.halves.map(|half| V3::of(half[i]))
    }
}

#[inline(always)]
fn splat<R: Real>(V3([x, y, z]): V3<R>) -> [Lanes<R>; 3] {
    [Lanes::splat(x), Lanes::splat(y), Lanes::splat(z)]
}

fn square<R: Real>(v: V3<R>) -> R {
    v.dot(v)
}

fn mean<R: Real>([a, b]: [V3<R>; 2]) -> V3<R> {
    (a + b) * R::of(0.5)
}

/// Coefficients of a quadratic in two variables.
const TERMS: usize = 6;
/// Different products of two of its terms.
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
struct Monomials<R>([Lanes<R>; PRODUCTS]);

impl<R: Real> Monomials<R> {
    #[inline(always)]
    fn at(x: Lanes<R>, y: Lanes<R>) -> Self {
        let one = Lanes::splat(R::of(1.0));
        let (x, y) = ([one, x, x * x, x * x * x, x * x * x * x], [one, y, y * y, y * y * y, y * y * y * y]);
        let mut products = [one; PRODUCTS];
        for (product, [i, j]) in products.iter_mut().zip(EXPONENTS) {
            *product = x[i] * y[j];
        }
        Self(products)
    }
}

/// Weighted least squares of value = c + g·at + atᵀH at, per channel.
#[derive(Clone, Copy)]
struct Fit<R> {
    /// Σ w monomial.
    moments: [Lanes<R>; PRODUCTS],
    /// Σ w term value, by channel.
    values: [[Lanes<R>; TERMS]; 3],
}

impl<R: Real> Fit<R> {
    fn new() -> Self {
        let none = Lanes::splat(R::of(0.0));
        Self { moments: [none; PRODUCTS], values: [[none; TERMS]; 3] }
    }

    #[inline(always)]
    fn add(&mut self, weight: Lanes<R>, Monomials(monomials): &Monomials<R>, value: [Lanes<R>; 3]) {
        for (k, monomial) in monomials.iter().enumerate() {
            let weighted = weight * *monomial;
            self.moments[k] = self.moments[k] + weighted;
            if k < TERMS {
                for (sums, value) in self.values.iter_mut().zip(value) {
                    sums[k] = sums[k] + weighted * value;
                }
            }
        }
    }

    /// The fitted value at the centre, `curved` the weight of there being no curvature; the weighted mean where nothing
    /// can be fitted, or extrapolation makes it negative. `None` where neither is a number.
    fn centre(&self, curved: R) -> Option<V3<R>> {
        let (moments, values) = (self.moments.map(Lanes::sum), self.values.map(|terms| terms.map(Lanes::sum)));
        let weight = moments[0].value();
        let mut matrix = [0.0; TERMS * TERMS];
        for (r, [xr, yr]) in EXPONENTS[..TERMS].iter().enumerate() {
            for (c, [xc, yc]) in EXPONENTS[..TERMS].iter().enumerate() {
                let product = EXPONENTS.iter().position(|e| *e == [xr + xc, yr + yc])?;
                matrix[r * TERMS + c] = moments[product].value();
            }
            let curved = if xr + yr == 2 { curved.value() } else { 0.0 };
            matrix[r * TERMS + r] += if r > 0 { f64::from(RIDGE) * weight + curved } else { 0.0 };
        }
        let mut terms: [[f64; 3]; TERMS] = std::array::from_fn(|k| values.map(|v| v[k].value()));
        let fitted = cholesky::solve(&mut matrix, &mut terms).map(|()| V3(terms[0].map(R::of)));
        let mean = V3(values.map(|v| v[0])) * (R::of(1.0) / moments[0]);
        let plausible = |v: &V3<R>| v.0.iter().all(|c| c.value().is_finite() && c.value() >= 0.0);
        fitted.into_iter().chain([mean]).find(plausible)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use crate::rng::{hash, hash2};
    use crate::surface::SurfacePoint;

    const SIDE: usize = 40;
    const TEXEL: f32 = 0.05;
    /// Standard deviation of a half, as a share of the value.
    const NOISE: f32 = 0.1;

    fn point(position: Vec3, normal: Vec3) -> SurfacePoint {
        SurfacePoint { position: position.to_array(), triangle: 0, normal: normal.to_array(), index: 0 }
    }

    /// Texel (x, y) of a floor.
    fn floor() -> Vec<SurfacePoint> {
        let at = |i: usize| Vec3::new((i % SIDE) as f32, (i / SIDE) as f32, 0.0) * TEXEL;
        (0..SIDE * SIDE).map(|i| point(at(i), Vec3::Z)).collect()
    }

    /// Two halves of `truth` with independent, nearly normal noise.
    fn noisy(truth: &[f32]) -> [Vec<[f32; 3]>; 2] {
        [1u32, 2].map(|half| {
            let unit = |k: u32| hash(k) as f32 / u32::MAX as f32 - 0.5;
            let normal = |i: u32| (0..6).map(|k| unit(hash2(hash2(i, k), half))).sum::<f32>() * 2f32.sqrt();
            truth.iter().enumerate().map(|(i, t)| [t * (1.0 + NOISE * normal(i as u32)); 3]).collect()
        })
    }

    fn clean(points: &[SurfacePoint], [a, b]: &[Vec<[f32; 3]>; 2], apart: &[bool]) -> Vec<[f32; 3]> {
        denoise(Noisy { points, halves: [a, b], apart, texel: TEXEL }, &Silent).unwrap()
    }

    fn run(points: &[SurfacePoint], truth: &[f32]) -> Vec<f32> {
        clean(points, &noisy(truth), &vec![false; points.len()]).iter().map(|e| e[0]).collect()
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
        // A twentieth of a half's texels found a small source: 2.9 instead of 0.9 of the truth. Smoothing that follows
        // a texel's own noise keeps the others where they are, and takes 2.5 % of the light.
        for seed in [5u32, 9, 31, 77] {
            let halves = [1u32, 2].map(|half| {
                let rare = |i: usize| hash2(hash2(i as u32, seed), half) < u32::MAX / 20;
                (0..SIDE * SIDE).map(|i| [if rare(i) { 2.9 } else { 0.9 }; 3]).collect()
            });
            let got = clean(&floor(), &halves, &[false; SIDE * SIDE]);
            let gathered: f32 = (0..got.len()).map(|i| (halves[0][i][0] + halves[1][i][0]) / 2.0).sum();
            let ratio = got.iter().map(|e| e[0]).sum::<f32>() / gathered;
            assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
            let spread = error(&got.iter().map(|e| e[0]).collect::<Vec<_>>(), &vec![1.0; got.len()], |_| true);
            assert!(spread < 0.12, "{spread} left of 0.31");
        }
    }

    #[test]
    fn most_of_the_light_that_few_samples_bring_is_kept() {
        // Cosine samples under a small lamp: a hundredth of a half's texels found it, and bring nine tenths of the
        // light.
        for seed in [5u32, 9, 31, 77] {
            let halves = [1u32, 2].map(|half| {
                let rare = |i: usize| hash2(hash2(i as u32, seed), half) < u32::MAX / 100;
                (0..SIDE * SIDE).map(|i| [if rare(i) { 90.0 } else { 0.1 }; 3]).collect()
            });
            let got = clean(&floor(), &halves, &[false; SIDE * SIDE]);
            let gathered: f32 = (0..got.len()).map(|i| (halves[0][i][0] + halves[1][i][0]) / 2.0).sum();
            let ratio = got.iter().map(|e| e[0]).sum::<f32>() / gathered;
            assert!((0.7..1.05).contains(&ratio), "{ratio}");
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
        let blurred = clean(&floor(), &halves, &[false; SIDE * SIDE]);
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
        let got = clean(&points, &[exact.clone(), exact.clone()], &buried);
        for (got, exact) in got.iter().zip(&exact) {
            assert!((got[0] - exact[0]).abs() < 1e-4, "{got:?} for {exact:?}");
        }
    }

    #[test]
    fn the_order_of_texels_does_not_matter() {
        let truth: Vec<f32> = (0..SIDE * SIDE).map(|i| 2.0 + (i / SIDE) as f32 * 0.05).collect();
        let (points, halves) = (floor(), noisy(&truth));
        let apart = vec![false; points.len()];
        let straight = clean(&points, &halves, &apart);
        // Another atlas: the same texels in other charts.
        let order: Vec<usize> = (0..points.len()).map(|i| i * 7 % points.len()).collect();
        let moved: Vec<SurfacePoint> = order.iter().map(|&i| points[i]).collect();
        let halves = halves.map(|half| order.iter().map(|&i| half[i]).collect());
        let other = clean(&moved, &halves, &apart);
        for (k, &i) in order.iter().enumerate() {
            assert!((other[k][0] - straight[i][0]).abs() < 1e-4);
        }
    }

    #[test]
    fn where_nothing_can_be_fitted_the_mean_is_taken() {
        let mut fit = Fit::<f64>::new();
        fit.moments[0] = Lanes::splat(0.5);
        fit.values.iter_mut().for_each(|terms| terms[0] = Lanes::splat(1.0));
        // Of squares, as only rounding leaves it.
        fit.moments[3] = Lanes::splat(-1.0);
        assert_eq!(fit.centre(0.0).map(|V3(mean)| mean), Some([2.0; 3]));
    }

    #[test]
    fn lonely_and_empty_inputs_pass() {
        assert!(clean(&[], &[vec![], vec![]], &[]).is_empty());
        let one = clean(&floor()[..1], &[vec![[1.0; 3]], vec![[3.0; 3]]], &[false]);
        assert_eq!(one, [[2.0; 3]]);
        let dark = clean(&floor(), &noisy(&[0.0; SIDE * SIDE]), &[false; SIDE * SIDE]);
        assert!(dark.iter().all(|e| *e == [0.0; 3]));
    }
}
