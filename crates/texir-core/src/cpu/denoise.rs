//! Denoising of irradiance, twin of `denoise.wgsl`: the method is described in [`crate::denoise`].

use glam::Vec3;
use rayon::prelude::*;

use crate::brdf::basis;
use crate::cholesky;
use crate::denoise::{
    CELL, CHANCE, CURVATURE, GUIDE_RADIUS, MISS_RADIUS, NOISE_RADIUS, Noisy, RADIUS, RIDGE, SIGNIFICANT, TOLERANCE,
};
use crate::neighbours::{FAR, Neighbours};
use crate::real::{Real, V3};

/// The smallest variance and squared value that is divided by.
const TINY: f64 = f32::MIN_POSITIVE as f64;

/// What a point's closest neighbours tell about it.
struct Smoothed<R> {
    /// Smoothed estimate of each half.
    halves: [V3<R>; 2],
    /// Variance of what is smoothed as a share of a point's.
    share: R,
    /// Square of the point's value: its own beside what is brighter, the smoothed one where it is bright by chance.
    level: R,
}

/// The noise at a point.
struct Noise<R> {
    /// Mean square of the difference of both halves, relative to the squared value.
    relative: R,
    /// Variance of the difference between two smoothed estimates of the same half that is due to noise.
    smoothed: R,
}

/// The mean of both halves at every point without most of its noise.
pub fn denoise<R: Real>(noisy: Noisy<'_>) -> Vec<[R; 3]> {
    let search = Search { noisy, neighbours: Neighbours::new(noisy.points, CELL * noisy.texel) };
    let smoothed = search.each(|i| search.smoothed::<R>(i));
    let noise = search.each(|i| search.noise(i, &smoothed));
    let fits = search.each(|i| search.fits(i, &smoothed, &noise[i]));
    let cleaned = search.each(|i| search.clean(i, &fits));
    search.each(|i| search.conserve(i, &cleaned).0)
}

/// The points, and who lies beside whom.
struct Search<'a> {
    noisy: Noisy<'a>,
    neighbours: Neighbours<FAR>,
}

impl Search<'_> {
    fn each<T: Send>(&self, of: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
        (0..self.noisy.points.len()).into_par_iter().map(of).collect()
    }

    /// Points within `radius` texels that may be mixed with point `i`, offsets in shares of the radius, and 1 less the square of
    /// these: how near they are.
    fn around<R: Real>(&self, i: usize, radius: f32) -> impl Iterator<Item = (usize, V3<R>, R)> + '_ {
        let (apart, radius) = (self.noisy.apart, radius * self.noisy.texel);
        let scale = R::of(1.0) / R::of(f64::from(radius));
        self.neighbours.of(i, radius).filter(move |&(j, _)| apart[j] == apart[i]).map(move |(j, offset): (_, Vec3)| {
            let at = V3::of(offset.to_array()) * scale;
            (j, at, R::of(1.0) - at.dot(at))
        })
    }

    fn halves<R: Real>(&self, i: usize) -> [V3<R>; 2] {
        [0, 1].map(|half| V3::of(self.noisy.halves[half][i]))
    }

    fn smoothed<R: Real>(&self, i: usize) -> Smoothed<R> {
        let (mut sums, mut weight, mut squares) = ([V3::zero(); 2], R::of(0.0), R::of(0.0));
        for (j, _, near) in self.around::<R>(i, GUIDE_RADIUS) {
            let halves = self.halves(j);
            sums = [0, 1].map(|half| sums[half] + halves[half] * near);
            weight = weight + near;
            squares = squares + near * near;
        }
        let halves = sums.map(|sum| sum * (R::of(1.0) / weight));
        let level = square(mean(halves)).min(square(mean(self.halves(i)))).max(R::of(TINY));
        Smoothed { halves, share: squares / (weight * weight), level }
    }

    fn noise<R: Real>(&self, i: usize, smoothed: &[Smoothed<R>]) -> Noise<R> {
        let (mut sum, mut weight) = (R::of(0.0), R::of(0.0));
        for (j, _, near) in self.around::<R>(i, NOISE_RADIUS) {
            // (a − b)² estimates the variance of a − b; relative to the value, it is alike in light and in shadow.
            let [a, b] = self.halves(j);
            sum = sum + near * square(a - b) / smoothed[j].level;
            weight = weight + near;
        }
        let relative = sum / weight;
        Noise { relative, smoothed: (relative * smoothed[i].level * smoothed[i].share).max(R::of(TINY)) }
    }

    /// The fit of each half.
    fn fits<R: Real>(&self, i: usize, smoothed: &[Smoothed<R>], noise: &Noise<R>) -> [V3<R>; 2] {
        let (tangent, bitangent) = basis(V3::of(self.noisy.points[i].normal));
        let mut fits = [Fit::new(); 2];
        for (j, at, near) in self.around::<R>(i, RADIUS) {
            let monomials = Monomials::at(at.dot(tangent), at.dot(bitangent));
            let near = near.max(R::of(0.0));
            let halves = self.halves(j);
            for (half, fit) in fits.iter_mut().enumerate() {
                let difference = square(smoothed[i].halves[1 - half] - smoothed[j].halves[1 - half]);
                let beyond = (difference - noise.smoothed).max(R::of(0.0));
                let alike = R::of(1.0) + beyond / (noise.smoothed * R::of(f64::from(TOLERANCE * TOLERANCE)));
                fit.add(near / (alike * alike), &monomials, halves[half]);
            }
        }
        // A half's variance over that of the coefficients before anything is seen.
        let ridge = noise.relative / R::of(f64::from(2.0 * CURVATURE * CURVATURE));
        let own = self.halves(i);
        [0, 1].map(|half| fits[half].centre(ridge).unwrap_or(own[half]))
    }

    /// The mean of both fits, and of what is beyond them as much as both halves share.
    fn clean<R: Real>(&self, i: usize, fits: &[[V3<R>; 2]]) -> V3<R> {
        // Relative to the fits: what both halves share, and the variance of their mean.
        let (mut shared, mut noise) = (R::of(0.0), R::of(0.0));
        for (j, _, near) in self.around::<R>(i, MISS_RADIUS) {
            let [a, b] = self.halves(j);
            let (a, b) = (a - fits[j][0], b - fits[j][1]);
            let level = square(fits[j][0] + fits[j][1]).max(R::of(TINY));
            shared = shared + near * a.dot(b) / level;
            noise = noise + near * square(a - b) / (R::of(4.0) * level);
        }
        // Wiener's weight, of what is more than chance.
        let signal = (shared - noise * R::of(f64::from(CHANCE))).max(R::of(0.0));
        let kept = if signal > R::of(0.0) { signal / (signal + noise) } else { R::of(0.0) };
        let fit = mean(fits[i]);
        fit + (mean(self.halves(i)) - fit) * kept
    }

    /// What was cleaned, with what it and its neighbours of like brightness lost on average.
    fn conserve<R: Real>(&self, i: usize, cleaned: &[V3<R>]) -> V3<R> {
        let level = |j: usize| square(cleaned[j]).max(R::of(TINY));
        let own = level(i);
        let (mut lost, mut weight, mut squares) = (V3::zero(), R::of(0.0), R::of(0.0));
        for (j, _, near) in self.around::<R>(i, RADIUS) {
            let near = near.max(R::of(0.0));
            let alike = own.min(level(j)) / own.max(level(j));
            let share = near * near * alike;
            let here = mean(self.halves(j)) - cleaned[j];
            lost = lost + here * share;
            weight = weight + share;
            squares = squares + share * share * square(here);
        }
        let lost = lost * (R::of(1.0) / weight);
        let chance = squares / (weight * weight) * R::of(f64::from(SIGNIFICANT * SIGNIFICANT));
        let given = if square(lost) > chance { R::of(1.0) - chance / square(lost) } else { R::of(0.0) };
        (cleaned[i] + lost * given).map(|c| c.max(R::of(0.0)))
    }
}

fn square<R: Real>(v: V3<R>) -> R {
    v.dot(v)
}

fn mean<R: Real>([a, b]: [V3<R>; 2]) -> V3<R> {
    (a + b) * R::of(0.5)
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
struct Monomials<R>([R; PRODUCTS]);

impl<R: Real> Monomials<R> {
    fn at(x: R, y: R) -> Self {
        let powers = |v: R| [R::of(1.0), v, v * v, v * v * v, v * v * v * v];
        let (x, y) = (powers(x), powers(y));
        Self(EXPONENTS.map(|[i, j]| x[i] * y[j]))
    }
}

/// Weighted least squares of value = c + g·at + atᵀH at, per channel.
#[derive(Clone, Copy)]
struct Fit<R> {
    /// Σ w monomial.
    moments: [R; PRODUCTS],
    /// Σ w term value, by channel.
    values: [[R; TERMS]; 3],
}

impl<R: Real> Fit<R> {
    fn new() -> Self {
        Self { moments: [R::of(0.0); PRODUCTS], values: [[R::of(0.0); TERMS]; 3] }
    }

    fn add(&mut self, weight: R, Monomials(monomials): &Monomials<R>, value: V3<R>) {
        let weighted = monomials.map(|m| weight * m);
        (0..PRODUCTS).for_each(|k| self.moments[k] = self.moments[k] + weighted[k]);
        for (sums, value) in self.values.iter_mut().zip(value.0) {
            (0..TERMS).for_each(|k| sums[k] = sums[k] + weighted[k] * value);
        }
    }

    /// The fitted value at the centre, `ridge` the weight of there being no curvature; the weighted mean where
    /// extrapolation makes it negative. `None` where neither is a number.
    fn centre(&self, ridge: R) -> Option<V3<R>> {
        let weight = self.moments[0].value();
        let mut matrix = [0.0; TERMS * TERMS];
        for (r, [xr, yr]) in EXPONENTS[..TERMS].iter().enumerate() {
            for (c, [xc, yc]) in EXPONENTS[..TERMS].iter().enumerate() {
                let product = EXPONENTS.iter().position(|e| *e == [xr + xc, yr + yc])?;
                matrix[r * TERMS + c] = self.moments[product].value();
            }
            let curved = if xr + yr == 2 { ridge.value() } else { 0.0 };
            matrix[r * TERMS + r] += if r > 0 { f64::from(RIDGE) * weight + curved } else { 0.0 };
        }
        let mut terms: [[f64; 3]; TERMS] = std::array::from_fn(|k| self.values.map(|v| v[k].value()));
        cholesky::solve(&mut matrix, &mut terms)?;
        let fitted = V3(terms[0].map(R::of));
        let mean = V3(self.values.map(|v| v[0])) * (R::of(1.0) / self.moments[0]);
        let plausible = |v: &V3<R>| v.0.iter().all(|c| c.value().is_finite() && c.value() >= 0.0);
        [fitted, mean].into_iter().find(plausible)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::denoise::Halves;
    use crate::rng::{hash, hash2};
    use crate::surface::SurfacePoint;

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

    fn clean(points: &[SurfacePoint], halves: &Halves, apart: &[bool]) -> Vec<[f32; 3]> {
        denoise(Noisy { points, halves, apart, texel: TEXEL })
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
        // A twentieth of a half's texels found a small source: 2.9 instead of 0.9 of the truth. Smoothing that follows a
        // texel's own noise keeps the others where they are, and takes 2.5 % of the light.
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
    fn light_that_few_samples_bring_is_not_lost() {
        // Cosine samples under a small lamp: a hundredth of a half's texels found it, and bring nine tenths of the light.
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
    fn lonely_and_empty_inputs_pass() {
        assert!(clean(&[], &[vec![], vec![]], &[]).is_empty());
        let one = clean(&floor()[..1], &[vec![[1.0; 3]], vec![[3.0; 3]]], &[false]);
        assert_eq!(one, [[2.0; 3]]);
        let dark = clean(&floor(), &noisy(&[0.0; SIDE * SIDE]), &[false; SIDE * SIDE]);
        assert!(dark.iter().all(|e| *e == [0.0; 3]));
    }
}
