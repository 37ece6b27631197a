//! The roughness scan: how well every pixel is explained at each tabulated roughness, with all albedos solved anew.
//!
//! Descending from a start is not enough: from a smooth start, lobes that miss every lamp have no gradient, and from a
//! rough one they broaden until they fade. A scan has no start.

use glam::Vec3A;
use half::f16;
use rayon::prelude::*;

use super::evidence::{Evidence, cost, grey, pixel_weights};
use super::nodes::{self, Between};
use super::variation;
use crate::error::Result;
use crate::fit::full::albedo::{AlbedoProblem, EdgeGuide, Roughness};
use crate::fit::full::partition::Partition;
use crate::fit::index::NONE;
use crate::fit::settings::RoughnessSettings;
use crate::progress::{Progress, Task};
use crate::specular_table::NODES;

/// Runs of the solver at the first node: after six, more change nothing.
const FIRST_ROUNDS: u32 = 6;

/// Scans all nodes from rough to smooth, the albedo of one node being the start of the next. `albedo` is left at the
/// smoothest node's. `model` names what is assumed, for progress.
pub fn scan(
    problem: &AlbedoProblem<'_>,
    model: &str,
    settings: &RoughnessSettings,
    albedo: &mut [Vec3A],
    progress: &dyn Progress,
) -> Result<Evidence> {
    let nodes = nodes::solved(settings.node_stride as usize);
    let _task = Task::start(progress, &format!("roughness scan, {model}"), nodes.len() as u64, "roughnesses");
    let sigma = problem.noise(settings.image_noise);
    let segment = pure_segments(problem, settings.min_cosine);
    let mut costs = vec![[f16::ZERO; NODES]; problem.seen.len()];
    let mut slope = vec![[0.0; NODES]; problem.segment.count];
    let mut variation = vec![[0.0; NODES]; problem.segment.count];
    let constrained = variation::constrained(problem, &segment);
    let mut predicted = problem.predicted(albedo);
    let rougher = [None].into_iter().chain(nodes.iter().copied().map(Some));
    for (k, rougher) in nodes.iter().copied().zip(rougher) {
        progress.check()?;
        let known = |slope: &[f32; NODES]| rougher.map_or(0.0, |k| slope[k]);
        // Grazing terms of the rougher node go into the target, lest albedo fit them.
        let mut target = problem.target(&Roughness::Node(k));
        (&mut target.albedo, &segment, &problem.seen.cosine).into_par_iter().for_each(|(target, segment, cosine)| {
            if *segment != NONE {
                *target += known(&slope[*segment as usize]) * grazing(*cosine);
            }
        });
        // Later nodes start near their solution; the first must not cost more for its start.
        let rounds = if rougher.is_none() { FIRST_ROUNDS } else { 1 };
        problem.solve((albedo, &mut predicted), (&target, &sigma), rounds, settings.iterations, EdgeGuide::Albedo);
        let residual = |p: usize| problem.residual(&predicted, &target, p);
        variation
            .iter_mut()
            .zip(problem.variation(albedo, &constrained))
            .for_each(|(variation, mean)| variation[k] = mean);
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
    Ok(Evidence { segment, cost: costs, weight: pixel_weights(&problem.seen.area), slope, variation })
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
            let pure = !problem.seen.near_excluded[p] && problem.seen.min_cosine[p] > min_cosine;
            if pure && seen.all(|s| s == first) { first } else { NONE }
        })
        .collect()
}

/// (1 − n·v)⁵: how Fresnel terms grow towards grazing angles.
fn grazing(cosine: f32) -> f32 {
    (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
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
