//! Specular radiance as a function of roughness, per pixel: with it, the fit moves roughness without tracing a ray.
//!
//! The TBL is fixed while materials are fitted, so the light samples of a pixel can be drawn once and re-weighted for
//! any roughness (method section 5.2). With F0 fixed, what re-weighting yields is one smooth curve per pixel and
//! channel: it is tabulated at [`NODES`] roughnesses and interpolated. In ln r a GGX lobe has the same shape at every
//! width, so that nodes evenly spaced in ln r resolve wide and narrow lobes alike.

use bytemuck::{Pod, Zeroable};
use half::f16;

use crate::brdf::Masking;

/// Roughnesses tabulated.
pub const NODES: usize = 32;
/// The smallest and the largest roughness tabulated.
pub const RANGE: [f32; 2] = [0.03, 1.0];
/// Rays of a pixel leave from this many points of it: images are box-filtered.
pub const STRATA: usize = 4;
/// Roughnesses of the lobes that directions are drawn from.
pub const LOBES: [f32; 5] = [0.04, 0.09, 0.2, 0.4, 0.8];

/// Roughness of node `k`.
pub fn node(k: usize) -> f32 {
    RANGE[0] * (RANGE[1] / RANGE[0]).powf(k as f32 / (NODES - 1) as f32)
}

/// Distance between two nodes in ln r.
pub fn node_step() -> f32 {
    (RANGE[1] / RANGE[0]).ln() / (NODES - 1) as f32
}

/// The node nearest to roughness `r`, in ln r.
pub fn nearest_node(r: f32) -> usize {
    ((r / RANGE[0]).ln() / node_step()).round().clamp(0.0, (NODES - 1) as f32) as usize
}

/// How many directions are drawn at each of a pixel's [`STRATA`] points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TableSampling {
    /// Per lobe of [`LOBES`].
    pub lobe: u32,
    /// Cosine-distributed.
    pub cosine: u32,
    /// To the lights.
    pub light: u32,
    /// The shadowing–masking term of the lobes that are tabulated.
    pub masking: Masking,
    /// Seed of the run; a pixel draws from the sequences scrambled by `hash(seed, index)` of its first point.
    pub seed: u32,
}

impl TableSampling {
    /// About `rays` rays per pixel, at least 24: five eighths to the lobes, a sixteenth cosine-distributed, the rest to
    /// the lights.
    pub fn of_rays(rays: u32, masking: Masking, seed: u32) -> Self {
        let stratum = (rays / STRATA as u32).max(6);
        let lobe = (stratum / 8).max(1);
        let cosine = stratum / 16;
        Self { lobe, cosine, light: stratum - lobe * LOBES.len() as u32 - cosine, masking, seed }
    }

    /// Rays per pixel.
    pub fn rays(&self) -> u32 {
        STRATA as u32 * (LOBES.len() as u32 * self.lobe + self.cosine + self.light)
    }
}

/// Specular radiance at the [`NODES`] under the F0 that was asked for, linear RGB; the mean over the pixel's strata.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Curve {
    /// Node by node.
    pub nodes: [[f16; 3]; NODES],
}

impl Curve {
    /// From radiance per node; what half floats cannot hold is cut to their largest value, and what is no number is 0.
    pub fn new(nodes: [[f32; 3]; NODES]) -> Self {
        Self { nodes: nodes.map(|n| n.map(|c| f16::from_f32(c.max(0.0).min(f16::MAX.to_f32())))) }
    }

    /// Radiance at a node.
    pub fn at_node(&self, k: usize) -> [f32; 3] {
        self.nodes[k].map(f16::to_f32)
    }

    /// Radiance at roughness `r` and its derivative ∂/∂r, by Catmull–Rom interpolation in ln r; constant outside
    /// [`RANGE`].
    pub fn at(&self, r: f32) -> ([f32; 3], [f32; 3]) {
        interpolated(|k| self.at_node(k), r)
    }
}

/// A curve as a fit keeps one for every pixel or few: 9 bits for each channel under an exponent that they share (RGB9E5
/// of Khronos' `EXT_texture_shared_exponent`). A channel is off by two thousandths of the largest at most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PackedCurve([u32; NODES]);

impl PackedCurve {
    /// Bits of a channel.
    const BITS: i32 = 9;
    /// Added to exponents as they are stored.
    const BIAS: i32 = 15;
    /// The largest radiance that can be held.
    const MOST: f32 = 65408.0;

    /// From radiance per node; what is negative is taken for 0, and what cannot be held is cut.
    pub fn new(nodes: [[f32; 3]; NODES]) -> Self {
        Self(nodes.map(Self::pack))
    }

    fn pack(radiance: [f32; 3]) -> u32 {
        let held = radiance.map(|c| c.clamp(0.0, Self::MOST));
        let most = held.into_iter().fold(0.0, f32::max);
        let steps = |exponent: i32| move |c: f32| (c / Self::step(exponent)).round() as u32;
        // What the bits of a float say of it: floor(log2 x).
        let log2 = (most.to_bits() >> 23) as i32 - 127;
        let exponent = log2.max(-Self::BIAS - 1) + 1 + Self::BIAS;
        // The largest may be rounded up to a power of two.
        let exponent = exponent + (steps(exponent)(most) >> Self::BITS) as i32;
        let [r, g, b] = held.map(steps(exponent));
        r | g << 9 | b << 18 | (exponent as u32) << 27
    }

    /// What one step of a channel is worth under a stored exponent, 2^(exponent − bias − bits).
    fn step(exponent: i32) -> f32 {
        f32::from_bits(((exponent - Self::BIAS - Self::BITS + 127) as u32) << 23)
    }

    /// Radiance at a node.
    pub fn at_node(&self, k: usize) -> [f32; 3] {
        let node = self.0[k];
        let step = Self::step((node >> 27) as i32);
        [0, 9, 18].map(|shift| (node >> shift & 511) as f32 * step)
    }

    /// As [`Curve::at`].
    pub fn at(&self, r: f32) -> ([f32; 3], [f32; 3]) {
        interpolated(|k| self.at_node(k), r)
    }
}

impl From<&Curve> for PackedCurve {
    fn from(curve: &Curve) -> Self {
        Self::new(std::array::from_fn(|k| curve.at_node(k)))
    }
}

/// The curve through the nodes at roughness `r`, and its derivative.
fn interpolated(at_node: impl Fn(usize) -> [f32; 3], r: f32) -> ([f32; 3], [f32; 3]) {
    let inside = r.clamp(RANGE[0], RANGE[1]);
    let x = (inside / RANGE[0]).ln() / node_step();
    let k = (x as usize).min(NODES - 2);
    let t = x - k as f32;
    let (left, right) = (at_node(k), at_node(k + 1));
    // Beyond the ends the curve goes on straight.
    let beyond = |a: [f32; 3], b: [f32; 3]| std::array::from_fn(|c| 2.0 * a[c] - b[c]);
    let before = if k > 0 { at_node(k - 1) } else { beyond(left, right) };
    let after = if k + 2 < NODES { at_node(k + 2) } else { beyond(right, left) };
    let p = [before, left, right, after];
    let slope = if r == inside { 1.0 / (node_step() * r) } else { 0.0 };
    let cubic = |c: usize| {
        let [p0, p1, p2, p3] = p.map(|p| p[c]);
        let (m1, m2) = (0.5 * (p2 - p0), 0.5 * (p3 - p1));
        let (a, b) = (2.0 * (p1 - p2) + m1 + m2, 3.0 * (p2 - p1) - 2.0 * m1 - m2);
        (((a * t + b) * t + m1) * t + p1, ((3.0 * a * t + 2.0 * b) * t + m1) * slope)
    };
    let [x, y, z] = [0, 1, 2].map(cubic);
    ([x.0, y.0, z.0], [x.1, y.1, z.1])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a pixel sees of a lobe that passes a lamp: the GGX distribution at a fixed half-vector.
    fn lobe(nh: f32) -> impl Fn(f32) -> f32 {
        move |r| crate::brdf::ndf(nh, r)
    }

    #[test]
    fn interpolation_follows_a_lobe_within_a_percent_of_its_peak() {
        for nh in [0.9999f32, 0.995, 0.96, 0.8] {
            let truth = lobe(nh);
            let curve = Curve::new(std::array::from_fn(|k| [truth(node(k)); 3]));
            let peak = (0..NODES).map(|k| truth(node(k))).fold(0.0, f32::max);
            for i in 0..500 {
                let r = 0.03 + 0.97 * i as f32 / 499.0;
                let (value, _) = curve.at(r);
                assert!((value[0] - truth(r)).abs() < 0.01 * peak, "nh {nh}, r {r}: {} against {}", value[0], truth(r));
            }
        }
    }

    #[test]
    fn packing_is_off_by_half_a_step_of_the_largest_channel_at_most() {
        for most in [1e-4f32, 0.0123, 0.5, 0.999_999, 1.0, 3.3, 1023.9, 65407.0] {
            let radiance = [most, 0.37 * most, 1e-3 * most];
            let held = PackedCurve::new([radiance; NODES]).at_node(5);
            let off = |i: usize| (held[i] - radiance[i]).abs();
            assert!((0..3).all(|i| off(i) < most / 511.0), "{radiance:?} {held:?}");
        }
        let held = |c: f32| PackedCurve::new([[c; 3]; NODES]).at_node(0)[0];
        let most = PackedCurve::MOST;
        assert_eq!([0.0, -1.0, f32::NAN, f32::INFINITY, 1e30].map(held), [0.0, 0.0, 0.0, most, most]);
        // What the least exponent resolves.
        assert_eq!([1e-9, 6e-8].map(held), [0.0, f32::exp2(-24.0)]);
    }

    #[test]
    fn the_derivative_is_that_of_the_interpolant() {
        let truth = lobe(0.98);
        let curve = Curve::new(std::array::from_fn(|k| [truth(node(k)), 1.0, 2.0 * truth(node(k))]));
        for r in [0.031f32, 0.05, 0.123, 0.3, 0.77, 0.99] {
            let h = 1e-3 * r;
            let difference = (curve.at(r + h).0[0] - curve.at(r - h).0[0]) / (2.0 * h);
            let (_, slope) = curve.at(r);
            assert!((slope[0] - difference).abs() < 0.01 * difference.abs().max(0.1), "{r}: {slope:?}, {difference}");
            assert!(slope[1].abs() < 1e-3 && (slope[2] - 2.0 * slope[0]).abs() < 1e-2 * slope[0].abs().max(0.1));
        }
        assert_eq!(curve.at(0.01).0, curve.at(0.03).0);
        assert_eq!(curve.at(0.01).1, [0.0; 3]);
    }
}
