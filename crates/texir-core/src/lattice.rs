//! Rank-1 lattices in the unit square: for a number of samples that is known beforehand, their error where an integrand
//! jumps (the outline of a lamp) is lower than that of a scrambled net.

/// The lattice {(i/n, frac(i·z/n))}, i = 0 … n−1, as steps of 32-bit fractions. Shifted as a whole by a random offset
/// (Cranley and Patterson 1976), every point of it is uniform, so that an estimate is unbiased; and it costs two
/// multiplications.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lattice {
    /// 2³²·(1/n, z/n), rounded.
    pub step: [u32; 2],
}

/// How many generators are tried: beyond so many the best one changes little.
const CANDIDATES: u32 = 2048;

impl Lattice {
    /// The lattice of `n` points whose shortest vector is longest (the spectral test, with wrap-around).
    pub fn new(n: u32) -> Self {
        let n = n.max(1);
        // z and n − z are mirror images. Generators that share a factor with n repeat coordinates.
        let half = (n / 2).max(1);
        let stride = half.div_ceil(CANDIDATES);
        let best = (1..=half)
            .step_by(stride as usize)
            .filter(|&z| greatest_common_divisor(z, n) == 1)
            .max_by_key(|&z| shortest_squared(z, n));
        let fraction = |z: u32| (((u64::from(z) << 32) + u64::from(n) / 2) / u64::from(n)) as u32;
        Self { step: [fraction(1), fraction(best.unwrap_or(1))] }
    }

    /// Point `i`, shifted by `offset` (32-bit fractions). Values have 24 bits: the same numbers in `f32` and `f64`.
    pub fn point(self, i: u32, offset: [u32; 2]) -> [f32; 2] {
        std::array::from_fn(|d| crate::rng::to_unit(i.wrapping_mul(self.step[d]).wrapping_add(offset[d])))
    }
}

fn greatest_common_divisor(mut a: u32, mut b: u32) -> u32 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// Squared length of the shortest vector of the lattice spanned by (1, z) and (0, n): Gauss's reduction.
fn shortest_squared(z: u32, n: u32) -> i64 {
    let dot = |a: [i64; 2], b: [i64; 2]| a[0] * b[0] + a[1] * b[1];
    let (mut a, mut b) = ([1, i64::from(z)], [0, i64::from(n)]);
    loop {
        if dot(a, a) > dot(b, b) {
            (a, b) = (b, a);
        }
        let length = dot(a, a);
        let k = (2 * dot(a, b) + length).div_euclid(2 * length);
        if k == 0 {
            return length;
        }
        b = [b[0] - k * a[0], b[1] - k * a[1]];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{hash, hash2, sobol2};

    #[test]
    fn points_are_spread_as_no_net_is() {
        // The hexagonal lattice has the longest shortest vector: 2/(√3 n) squared. A poor one has a fraction of it.
        for n in [7u32, 64, 100, 128, 1000, 4096, 100_000] {
            let [x, y] = Lattice::new(n).step.map(|s| f64::from(s) / 2f64.powi(32));
            let wrap = |v: f64| v - v.round();
            let shortest = (1..n)
                .map(|i| wrap(f64::from(i) * x).powi(2) + wrap(f64::from(i) * y).powi(2))
                .fold(f64::MAX, f64::min);
            let quality = shortest * f64::from(n) * 3f64.sqrt() / 2.0;
            assert!(quality > 0.7 && quality < 1.001, "{n} points: {quality}");
        }
    }

    /// Standard deviation, over shifts, of the estimated area of a disc.
    fn deviation(n: u32, points: impl Fn(u32, u32) -> [f32; 2]) -> f64 {
        let inside = |[u, v]: [f32; 2]| f64::from(u8::from((u - 0.4).powi(2) + (v - 0.6).powi(2) < 0.09));
        let area = 0.09 * std::f64::consts::PI;
        let square = |s: u32| ((0..n).map(|i| inside(points(i, s))).sum::<f64>() / f64::from(n) - area).powi(2);
        ((0..400).map(square).sum::<f64>() / 400.0).sqrt()
    }

    #[test]
    fn a_shifted_lattice_is_unbiased_and_beats_a_scrambled_net() {
        for n in [128, 500, 1024] {
            let lattice = Lattice::new(n);
            let shifted = deviation(n, |i, s| lattice.point(i, [hash(s), hash2(s, 1)]));
            let net = deviation(n, |i, s| sobol2(i, s));
            assert!(shifted < 0.9 * net, "{n} points: {shifted} against {net}");
            // Negative control: a bad generator is worse than the net.
            let bad = Lattice { step: [lattice.step[0], lattice.step[0]] };
            assert!(deviation(n, |i, s| bad.point(i, [hash(s), hash2(s, 1)])) > net);
        }
    }

    #[test]
    fn few_points_are_a_lattice_too() {
        assert_eq!(Lattice::new(0), Lattice::new(1));
        assert_eq!(Lattice::new(1).point(0, [1 << 31, 1 << 30]), [0.5, 0.25]);
        assert_eq!(Lattice::new(2).point(1, [0, 0])[0], 0.5);
    }
}
