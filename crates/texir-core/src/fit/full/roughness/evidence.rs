//! What pixels say about roughness: their costs at each node, weighted and summed over groups.

use std::iter::repeat_n;

use glam::Vec3A;
use half::f16;
use rayon::prelude::*;

use super::variation;
use crate::fit::full::partition::Partition;
use crate::fit::index::NONE;
use crate::specular_table::{NODES, nearest_node, node, node_step};

/// Added to the mean cost: smaller differences are within the accuracy of images and models.
const FLOOR: f64 = 2e-3;

/// Most pixels that a likelihood counts as independent.
const INDEPENDENT: f32 = 8.0;
/// Pixels at which it counts half of those.
const HALF_INDEPENDENT: f32 = 100.0;

/// What each pixel says about roughness.
pub struct Evidence {
    /// Segment of the pixel, or [`NONE`] for one that sees several, or at too grazing an angle, or is at a rim.
    pub segment: Vec<u32>,
    /// Per pixel and node: ln(1 + |e|²/(2σ)²), e the residual minus the segment's b (1−nv)⁵ + c.
    pub cost: Vec<[f16; NODES]>,
    /// Weight of each pixel, 1 on average.
    pub weight: Vec<f32>,
    /// Per segment and node: slope b of its grazing term b (1−nv)⁵.
    pub slope: Vec<[f32; NODES]>,
    /// Per segment and node: how much the albedo varies that goes with it
    /// ([`AlbedoProblem::variation`](crate::fit::full::albedo::AlbedoProblem::variation)).
    pub variation: Vec<[f64; NODES]>,
}

impl Evidence {
    /// How much grazing terms had to explain: the mean of |b| over the pixels, at the nodes nearest to their segments'
    /// roughness. Under the diffuse model that the surfaces have, nothing is left for them.
    pub fn grazing(&self, roughness: &[f32]) -> f64 {
        let slope = |s: usize| f64::from(self.slope[s][nearest_node(roughness[s])].abs());
        let of_pixels = self.segment.iter().filter(|s| **s != NONE).map(|s| slope(*s as usize));
        let (sum, count) = of_pixels.fold((0.0, 0u64), |(sum, n), slope| (sum + slope, n + 1));
        sum / count.max(1) as f64
    }

    /// The half of the views, 0 or 1, that each pixel belongs to, for cross-validation: per segment, views are assigned
    /// by descending weight, each to the half with the smaller sum. `views` are the numbers of pixels of the views.
    pub fn halves(&self, views: &[usize]) -> Vec<u8> {
        let view_of_pixel = || (0..).zip(views).flat_map(|(view, pixels)| repeat_n(view, *pixels));
        let mut weights = vec![vec![0.0; views.len()]; self.slope.len()];
        for ((segment, weight), view) in self.segment.iter().zip(&self.weight).zip(view_of_pixel()) {
            if *segment != NONE {
                weights[*segment as usize][view] += *weight;
            }
        }
        let half: Vec<Vec<u8>> = weights.iter().map(|weights| balanced(weights)).collect();
        let of_pixel = |(segment, view): (&u32, usize)| half.get(*segment as usize).map_or(0, |half| half[view]);
        self.segment.iter().zip(view_of_pixel()).map(of_pixel).collect()
    }

    /// The tally of every group's pixels.
    pub fn by_group(&self, group: Partition<'_>) -> Vec<Tally> {
        let mut tallies = vec![Tally::default(); group.count];
        for (pixel, group) in group.of.iter().enumerate().filter(|(_, group)| **group != NONE) {
            tallies[*group as usize].add(self, pixel);
        }
        tallies
    }

    /// The tally of every segment's pixels, with the penalty on its albedo's variation.
    pub fn by_segment(&self) -> Vec<Tally> {
        let mut tallies = self.by_group(Partition { of: &self.segment, count: self.slope.len() });
        for (tally, variation) in tallies.iter_mut().zip(&self.variation) {
            tally.variation_penalty = variation::penalty(variation, tally.pixels);
        }
        tallies
    }

    /// Takes `other`'s evidence for the segments of which `which` is true.
    pub fn replace(&mut self, other: &Self, which: &[bool]) {
        for (p, segment) in self.segment.iter().enumerate() {
            if *segment != NONE && which[*segment as usize] {
                self.cost[p] = other.cost[p];
            }
        }
        for s in (0..self.slope.len()).filter(|s| which[*s]) {
            self.slope[s] = other.slope[s];
            self.variation[s] = other.variation[s];
        }
    }
}

/// Assigns weights by descending size, each to the half, 0 or 1, of the smaller sum.
fn balanced(weights: &[f32]) -> Vec<u8> {
    let mut order: Vec<usize> = (0..weights.len()).collect();
    order.sort_by(|a, b| weights[*b].total_cmp(&weights[*a]));
    let (mut half, mut sums) = (vec![0; weights.len()], [0.0; 2]);
    for i in order {
        let lighter = usize::from(sums[1] < sums[0]);
        sums[lighter] += weights[i];
        half[i] = lighter as u8;
    }
    half
}

/// The costs of several pixels together.
#[derive(Clone, Copy, Default)]
pub struct Tally {
    /// Weighted Σ of their costs at each node.
    pub cost: [f64; NODES],
    /// Σ of their weights.
    pub pixels: f64,
    /// Penalty per node for the variation of the segment's albedo. It is not merged: the paint of some segments varies
    /// more than that of others.
    pub variation_penalty: [f32; NODES],
}

impl Tally {
    /// Adds a pixel.
    pub fn add(&mut self, evidence: &Evidence, pixel: usize) {
        let weight = f64::from(evidence.weight[pixel]);
        self.cost.iter_mut().zip(&evidence.cost[pixel]).for_each(|(sum, cost)| *sum += weight * cost.to_f64());
        self.pixels += weight;
    }

    /// A share of every pixel.
    pub fn times(&self, share: f64) -> Self {
        Self { cost: self.cost.map(|cost| share * cost), pixels: share * self.pixels, ..Self::default() }
    }

    /// Adds other pixels.
    pub fn merge(&mut self, other: &Self) {
        self.cost.iter_mut().zip(other.cost).for_each(|(sum, cost)| *sum += cost);
        self.pixels += other.pixels;
    }

    /// All of them together.
    pub fn sum<'a>(tallies: impl Iterator<Item = &'a Self>) -> Self {
        tallies.fold(Self::default(), |mut sum, tally| {
            sum.merge(tally);
            sum
        })
    }

    /// The node that explains them best.
    pub fn best_node(&self) -> usize {
        (0..NODES).min_by(|a, b| self.cost[*a].total_cmp(&self.cost[*b])).unwrap_or(0)
    }

    /// The logarithm of the mean of a sum of costs.
    pub fn ln_mean(&self, cost: f64) -> f32 {
        (cost / self.pixels + FLOOR).ln() as f32
    }

    /// The logarithm of the mean cost at each node: the negative profile log-likelihood, per pixel, of residuals whose
    /// size is not known beforehand.
    pub fn misfit(&self) -> [f32; NODES] {
        self.cost.map(|cost| self.ln_mean(cost))
    }

    /// What a segment's roughness minimises, apart from priors: the misfit and the penalty on albedo's variation.
    pub fn objective(&self) -> [f32; NODES] {
        let misfit = self.misfit();
        std::array::from_fn(|k| misfit[k] + self.variation_penalty[k])
    }

    /// The logarithm of the likelihood of each node's roughness by its pixels: (mean cost)^-n, as of residuals whose
    /// size is not known. The number n of what counts as independent is bounded however many pixels there are, since
    /// what goes wrong here is systematic ([`super::hierarchy`]).
    pub fn ln_likelihood(&self) -> [f32; NODES] {
        let pixels = self.pixels as f32;
        if pixels == 0.0 {
            return [0.0; NODES];
        }
        let independent = INDEPENDENT * pixels / (pixels + HALF_INDEPENDENT);
        self.misfit().map(|misfit| -independent * misfit)
    }
}

/// Weights of pixels by the areas that they show: proportional to the root of the area, 1 on average. A near view has
/// many pixels on a surface, all with the same systematic errors: what it sees reflected, and an albedo that no other
/// view contradicts.
pub fn pixel_weights(area: &[f32]) -> Vec<f32> {
    let root: Vec<f32> = area.par_iter().map(|area| area.sqrt()).collect();
    let mean = root.iter().copied().map(f64::from).sum::<f64>() / root.len().max(1) as f64;
    root.into_par_iter().map(|root| (f64::from(root) / mean) as f32).collect()
}

/// Mean of the channels.
pub fn grey(e: Vec3A) -> f32 {
    e.element_sum() / 3.0
}

/// The cost of a residual e, ln(1 + |e|²/(2σ)²), |e|² being the squared mean of its channels plus `colour_weight` times
/// their mean squared deviation from it: most errors of irradiance are alike in all channels, on surfaces that are
/// nearly grey, while highlights have the colours of what they reflect.
pub fn cost(e: Vec3A, sigma: f32, colour_weight: f32) -> f32 {
    let grey = grey(e);
    let squared = grey * grey + colour_weight / 3.0 * (e - grey).length_squared();
    (squared / (2.0 * sigma).powi(2)).ln_1p()
}

/// Roughness of the minimum of a cost curve over the nodes, refined in ln r by a cubic through the best node and its
/// neighbours: costs rise unevenly, as highlights fade faster than they sharpen.
pub fn minimum(cost: &[f32; NODES]) -> f32 {
    let k = (0..NODES).min_by(|a, b| cost[*a].total_cmp(&cost[*b])).unwrap_or(0);
    if k == 0 || k == NODES - 1 {
        return node(k);
    }
    let rise = |side: i32| cost.get((k as i32 + side) as usize).map(|c| c - cost[k]);
    let (left, right) = (cost[k - 1] - cost[k], cost[k + 1] - cost[k]);
    // cost(k + t) − cost(k) = a t + b t² + c t³; c is what the nodes beyond ask for, on average.
    let (slope, b) = (0.5 * (right - left), 0.5 * (left + right));
    let asked: Vec<f32> =
        [-2, 2].into_iter().filter_map(|side| Some(((rise(side)? - 4.0 * b) / side as f32 - slope) / 3.0)).collect();
    let c = asked.iter().sum::<f32>() / asked.len().max(1) as f32;
    let value = |t: f32| ((c * t + b) * t + slope - c) * t;
    const STEPS: i32 = 64;
    let best = (-STEPS..=STEPS).map(|i| i as f32 / STEPS as f32).min_by(|s, t| value(*s).total_cmp(&value(*t)));
    node(k) * (best.unwrap_or(0.0) * node_step()).exp()
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::prior::shrink;
    use super::*;

    /// What pixels of one segment say, each as much as any other.
    pub fn of_one_segment(cost: Vec<[f16; NODES]>) -> Evidence {
        let pixels = cost.len();
        Evidence { segment: vec![0; pixels], cost, weight: vec![1.0; pixels], slope: vec![], variation: vec![] }
    }

    #[test]
    fn colours_in_which_residuals_differ_count_by_their_weight() {
        let (grey, tint) = (Vec3A::splat(0.1), Vec3A::new(0.1, -0.1, 0.0));
        let squared = |e: Vec3A, weight: f32| cost(e, 0.5, weight).exp_m1();
        assert!((squared(grey, 0.0) - 0.01).abs() < 1e-6 && (squared(grey, 2.0) - 0.01).abs() < 1e-6);
        assert!(squared(tint, 0.0) < 1e-9 && (squared(tint, 3.0) - 0.02).abs() < 1e-6);
        let mean_square = (grey + tint).length_squared() / 3.0;
        assert!((squared(grey + tint, 1.0) - mean_square).abs() < 1e-6);
    }

    #[test]
    fn halves_of_the_views_say_alike_much_of_each_segment() {
        // Two pixels of each view; the first segment is seen by views 0 and 2 alone.
        let views = [2, 2, 2, 2];
        let segment = vec![0, 1, 1, 1, 0, 1, 1, NONE];
        let cost = vec![[f16::ZERO; NODES]; 8];
        let say = vec![1.0, 5.0, 1.0, 1.0, 1.0, 3.0, 1.0, 1.0];
        let evidence = Evidence { segment, cost, weight: say, slope: vec![[0.0; NODES]; 2], variation: vec![] };
        let half = evidence.halves(&views);
        assert_ne!(half[0], half[4]);
        // Of the second, views 0 to 3 say 5, 2, 3 and 1: 5 against 3 and 2, and 1 anywhere.
        assert!(half[1] != half[5] && half[5] == half[2] && half[2] == half[3], "{half:?}");
    }

    #[test]
    fn the_minimum_of_a_parabola_is_found_between_nodes() {
        let centre = (node(9) * (0.3 * node_step()).exp()).ln();
        let cost: [f32; NODES] = std::array::from_fn(|k| (node(k).ln() - centre).powi(2));
        assert!((minimum(&cost).ln() - centre).abs() < 1e-3);
        assert_eq!(minimum(&std::array::from_fn(|k| k as f32)), node(0));
    }

    #[test]
    fn a_near_views_many_pixels_do_not_outvote_a_far_one() {
        // 300 pixels of 1 cm² from beside, three of 100 cm² from afar: as much surface, a tenth of the weight.
        let area: Vec<f32> = (0..303).map(|p| if p < 300 { 1e-4 } else { 1e-2 }).collect();
        let weight = pixel_weights(&area);
        assert!(
            (weight.iter().sum::<f32>() / 303.0 - 1.0).abs() < 1e-5 && (weight[302] / weight[0] - 10.0).abs() < 1e-3
        );
        // Near ones are told hardly anything by highlights, far ones clearly; in unequal numbers.
        let cost = |p: usize| -> [f16; NODES] {
            let (truth, depth): (f32, f32) = if p < 300 { (0.8, 0.01) } else { (0.1, 0.3) };
            std::array::from_fn(|k| f16::from_f32(0.01 + depth * (2.0 * (node(k) / truth).ln()).powi(2).min(1.0)))
        };
        let settled = |weight: Vec<f32>| {
            let evidence = Evidence { weight, ..of_one_segment((0..303).map(cost).collect()) };
            nearest_node(shrink(&evidence.by_group(Partition { of: &evidence.segment, count: 1 }), &[[]])[0])
        };
        assert!(settled(weight.clone()) < nearest_node(0.2));
        // Negative control: every pixel alike.
        assert!(settled(vec![1.0; 303]) > nearest_node(0.6));
    }
}
