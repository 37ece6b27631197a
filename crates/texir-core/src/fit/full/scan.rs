//! The roughness scan: how well every pixel is explained at each tabulated roughness, with all albedos solved anew.
//!
//! Descending from a start is not enough: from a smooth start, lobes that miss every lamp have no gradient, and from a
//! rough one they broaden until they fade. A scan has no start.

use std::iter::repeat_n;

use glam::Vec3A;
use half::f16;
use rayon::prelude::*;

use super::albedo::{AlbedoProblem, Edges, Roughness};
use super::nodes::{self, Between};
use super::partition::Partition;
use super::variation;
use crate::error::Result;
use crate::fit::adjacency::NONE;
use crate::fit::settings::RoughnessSettings;
use crate::progress::{Progress, Task};
use crate::specular_table::{NODES, nearest_node, node, node_step};

/// What each pixel says about roughness.
pub struct Evidence {
    /// Segment of the pixel, or [`NONE`] for one that sees several, or at too grazing an angle, or is at a rim.
    pub segment: Vec<u32>,
    /// Per pixel and node: ln(1 + |e|²/(2σ)²), e without what the segment's grazing term explains.
    pub cost: Vec<[f16; NODES]>,
    /// How much of a say each pixel has, 1 on average.
    pub say: Vec<f32>,
    /// Per segment and node: slope b of its grazing term b (1−nv)⁵.
    pub slope: Vec<[f32; NODES]>,
    /// Per segment and node: how much the albedo varies that goes with it ([`AlbedoProblem::variation`]).
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

    /// The half of the views, 0 or 1, that each pixel belongs to, so that what one half says of a segment can be judged
    /// by the other: its views are dealt out from the one that says most of it, each to the half that has said less.
    /// `views` are the numbers of pixels of the views.
    pub fn halves(&self, views: &[usize]) -> Vec<u8> {
        let view_of_pixel = || (0..).zip(views).flat_map(|(view, pixels)| repeat_n(view, *pixels));
        let mut said = vec![vec![0.0; views.len()]; self.slope.len()];
        for ((segment, say), view) in self.segment.iter().zip(&self.say).zip(view_of_pixel()) {
            if *segment != NONE {
                said[*segment as usize][view] += say;
            }
        }
        let half: Vec<Vec<u8>> = said.iter().map(|said| dealt(said)).collect();
        let of_pixel = |(segment, view): (&u32, usize)| half.get(*segment as usize).map_or(0, |half| half[view]);
        self.segment.iter().zip(view_of_pixel()).map(of_pixel).collect()
    }

    /// What the pixels of every group say.
    pub fn by_group(&self, group: Partition<'_>) -> Vec<Tally> {
        let mut tallies = vec![Tally::default(); group.count];
        for (pixel, group) in group.of.iter().enumerate().filter(|(_, group)| **group != NONE) {
            tallies[*group as usize].add(self, pixel);
        }
        tallies
    }

    /// What the pixels of every segment say, and its albedo.
    pub fn by_segment(&self) -> Vec<Tally> {
        let mut tallies = self.by_group(Partition { of: &self.segment, count: self.slope.len() });
        for (tally, variation) in tallies.iter_mut().zip(&self.variation) {
            tally.albedo = variation::against(variation, tally.pixels);
        }
        tallies
    }

    /// Takes what `other` says of the segments of which `which` is true.
    pub fn take(&mut self, other: &Self, which: &[bool]) {
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

/// Deals weights out from the largest, each to the half, 0 or 1, that has less.
fn dealt(weights: &[f32]) -> Vec<u8> {
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

/// Cost below which nothing counts as explained better: images and models are not that exact.
const FLOOR: f64 = 2e-3;

/// Runs of the solver at the first node: after six, more change nothing.
const FIRST_ROUNDS: u32 = 6;

/// The most that a likelihood of roughness is raised to,
const INDEPENDENT: f32 = 8.0;
/// and the pixels at which it is half of that.
const HALF_BELIEVED: f32 = 100.0;

/// What several pixels say together.
#[derive(Clone, Copy, Default)]
pub struct Tally {
    /// Σ of their costs at each node, by their say.
    pub cost: [f64; NODES],
    /// Σ of their say: how many pixels they are worth.
    pub pixels: f64,
    /// What the albedo of a whole segment says against each node besides. That of several is not added up: some are
    /// painted more wildly than others.
    pub albedo: [f32; NODES],
}

impl Tally {
    /// Adds a pixel.
    pub fn add(&mut self, evidence: &Evidence, pixel: usize) {
        let say = f64::from(evidence.say[pixel]);
        self.cost.iter_mut().zip(&evidence.cost[pixel]).for_each(|(sum, cost)| *sum += say * cost.to_f64());
        self.pixels += say;
    }

    /// What a share of the pixels says.
    pub fn times(&self, share: f64) -> Self {
        Self { cost: self.cost.map(|cost| share * cost), pixels: share * self.pixels, ..Self::default() }
    }

    /// Adds what others say.
    pub fn merge(&mut self, other: &Self) {
        self.cost.iter_mut().zip(other.cost).for_each(|(sum, cost)| *sum += cost);
        self.pixels += other.pixels;
    }

    /// What all of them say.
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

    /// All that speaks against each node's roughness: the misfit, and what albedo would have to imitate.
    pub fn against(&self) -> [f32; NODES] {
        let misfit = self.misfit();
        std::array::from_fn(|k| misfit[k] + self.albedo[k])
    }

    /// The logarithm of the likelihood of each node's roughness by its pixels: (mean cost)^-n, as of residuals whose
    /// size is not known. The number n of what counts as independent is bounded however many pixels there are, since
    /// what goes wrong here is systematic ([`super::hierarchy`]).
    pub fn ln_likelihood(&self) -> [f32; NODES] {
        let pixels = self.pixels as f32;
        if pixels == 0.0 {
            return [0.0; NODES];
        }
        let independent = INDEPENDENT * pixels / (pixels + HALF_BELIEVED);
        self.misfit().map(|misfit| -independent * misfit)
    }
}

/// Scans all nodes from rough to smooth, the albedo of one node being the start of the next. `albedo` is left at the
/// smoothest node's. `model` names what is assumed, for progress.
pub fn scan(
    problem: &AlbedoProblem<'_>,
    model: &str,
    settings: &RoughnessSettings,
    albedo: &mut [Vec3A],
    progress: &dyn Progress,
) -> Result<Evidence> {
    let nodes = nodes::solved(settings.every as usize);
    let _task = Task::start(progress, &format!("roughness scan, {model}"), nodes.len() as u64, "roughnesses");
    let sigma = problem.noise(settings.image_noise);
    let segment = pure_segments(problem, settings.min_cosine);
    let mut costs = vec![[f16::ZERO; NODES]; problem.seen.len()];
    let mut slope = vec![[0.0; NODES]; problem.segment.count];
    let mut variation = vec![[0.0; NODES]; problem.segment.count];
    let told = variation::told(problem, &segment);
    let mut shown = problem.shown(albedo);
    let rougher = [None].into_iter().chain(nodes.iter().copied().map(Some));
    for (k, rougher) in nodes.iter().copied().zip(rougher) {
        progress.check()?;
        let known = |slope: &[f32; NODES]| rougher.map_or(0.0, |k| slope[k]);
        // What is known of the grazing terms from rougher nodes is no business of albedo.
        let mut target = problem.target(&Roughness::Node(k));
        (&mut target.albedo, &segment, &problem.seen.cosine).into_par_iter().for_each(|(target, segment, cosine)| {
            if *segment != NONE {
                *target += known(&slope[*segment as usize]) * grazing(*cosine);
            }
        });
        // From then on, every node begins beside its solution. The first must not look worse for its start.
        let rounds = if rougher.is_none() { FIRST_ROUNDS } else { 1 };
        problem.solve((albedo, &mut shown), (&target, &sigma), rounds, settings.iterations, Edges::OfTexels);
        let residual = |p: usize| problem.residual(&shown, &target, p);
        variation.iter_mut().zip(problem.variation(albedo, &told)).for_each(|(variation, mean)| variation[k] = mean);
        let nuisance = grazing_terms(problem, &segment, residual, &sigma);
        slope
            .iter_mut()
            .zip(&nuisance)
            .for_each(|(slope, [more, _])| slope[k] = (known(slope) + more).clamp(-1.0, 1.0));
        (&mut costs, &sigma, &segment, &problem.seen.cosine).into_par_iter().enumerate().for_each(
            |(p, (of_pixel, s, segment, cosine))| {
                if *segment != NONE {
                    let [slope, offset] = nuisance[*segment as usize];
                    let e = residual(p) - slope * grazing(*cosine) - offset;
                    of_pixel[k] = f16::from_f32(cost(e, *s, settings.colour_weight));
                }
            },
        );
        progress.advance(1);
    }
    let between: Vec<Between> = nodes::between(&nodes).collect();
    costs.par_iter_mut().for_each(|of| {
        between.iter().for_each(|b| of[b.node] = f16::from_f32(b.at(|k| of[k].to_f32()).max(0.0)));
    });
    slope.iter_mut().for_each(|of| between.iter().for_each(|b| of[b.node] = b.at(|k| of[k])));
    variation
        .iter_mut()
        .for_each(|of| between.iter().for_each(|b| of[b.node] = b.at(|k| of[k] as f32).max(0.0).into()));
    Ok(Evidence { segment, cost: costs, say: say(&problem.seen.area), slope, variation })
}

/// The one segment that a pixel sees, all of it at a cosine above `min_cosine`; [`NONE`] otherwise: the grazing side of
/// an edge reflects more than all the rest of the pixel. Pixels at rims may hold light that is none of their segment's.
fn pure_segments(problem: &AlbedoProblem<'_>, min_cosine: f32) -> Vec<u32> {
    let segments = problem.segment.of;
    (0..problem.seen.len())
        .into_par_iter()
        .map(|p| {
            let mut seen = problem.seen.rows.row(p).iter().map(|share| segments[share.texel as usize]);
            let first = seen.next().unwrap_or(NONE);
            let pure = !problem.seen.at_rim[p] && problem.seen.least_cosine[p] > min_cosine;
            if pure && seen.all(|s| s == first) { first } else { NONE }
        })
        .collect()
}

/// How much of a say pixels have that show these areas: it grows with the root of the area, and is 1 on average.
/// Whoever is near has many pixels on a surface, all with the same systematic errors: what this view sees reflected,
/// and an albedo that no other view contradicts.
pub(super) fn say(area: &[f32]) -> Vec<f32> {
    let root: Vec<f32> = area.par_iter().map(|area| area.sqrt()).collect();
    let mean = root.iter().copied().map(f64::from).sum::<f64>() / root.len().max(1) as f64;
    root.into_par_iter().map(|root| (f64::from(root) / mean) as f32).collect()
}

/// (1 − n·v)⁵: how Fresnel terms grow towards grazing angles.
fn grazing(cosine: f32) -> f32 {
    (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
}

/// Mean of the channels.
fn grey(e: Vec3A) -> f32 {
    e.element_sum() / 3.0
}

/// What a residual e costs, ln(1 + |e|²/(2σ)²). |e|² is what its channels have in common, squared, and `colour_weight`
/// times the mean square of what they do not: most errors of irradiance are alike in all channels, on surfaces that are
/// nearly grey, while highlights have the colours of what they reflect.
pub(super) fn cost(e: Vec3A, sigma: f32, colour_weight: f32) -> f32 {
    let grey = grey(e);
    let squared = grey * grey + colour_weight / 3.0 * (e - grey).length_squared();
    (squared / (2.0 * sigma).powi(2)).ln_1p()
}

/// Per segment, the slope b and the offset c of the residual's least-squares fit b (1−nv)⁵ + c, |b| ≤ 1 beyond what
/// rougher nodes have found: real materials differ from the BRDF in their grazing reflectance (and in
/// retro-reflection), which a scan would take for gloss.
fn grazing_terms(
    problem: &AlbedoProblem<'_>,
    segment: &[u32],
    residual: impl Fn(usize) -> Vec3A + Sync,
    sigma: &[f32],
) -> Vec<[f32; 2]> {
    // ω (1, g, g², e, g e), ω the Cauchy weight.
    let of_pixel = |p: usize| {
        let (g, e, s) = (f64::from(grazing(problem.seen.cosine[p])), grey(residual(p)), sigma[p]);
        let weight = f64::from(1.0 / (1.0 + (e / (2.0 * s)).powi(2)) / (s * s));
        let e = f64::from(e);
        Some([1.0, g, g * g, e, g * e].map(|term| weight * term))
    };
    let sums = Partition { of: segment, count: problem.segment.count }.sums(of_pixel);
    sums.into_iter()
        .map(|[w, g, gg, e, ge]| {
            if w == 0.0 {
                return [0.0; 2];
            }
            let spread = gg - g * g / w;
            let slope = if spread > 1e-9 * gg { ((ge - g * e / w) / spread).clamp(-1.0, 1.0) } else { 0.0 };
            [slope as f32, ((e - slope * g) / w) as f32]
        })
        .collect()
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
