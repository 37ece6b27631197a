//! Joints: the lines between boards and tiles, whose albedo and finish are not those of what they divide.
//!
//! They are too thin for evidence of their own: few pixels see nothing else. But where they are is seen in albedo, as lines that
//! stand out of their surroundings. All dark lines of a segment, and all bright ones, are taken to have one roughness. It is
//! scanned with everything else left as it is, albedo solved anew, and believed where the views agree that it explains their
//! pixels better than the segment's.

use glam::Vec3A;
use rayon::prelude::*;

use super::albedo::{AlbedoProblem, Roughness};
use super::scan::{Evidence, Tally, cost};
use crate::error::Result;
use crate::fit::adjacency::NONE;
use crate::fit::settings::{JointSettings, RoughnessSettings};
use crate::progress::Progress;
use crate::specular_table::{NODES, node};

/// Albedo of a black line, so that its logarithm stays finite.
const BLACK: f32 = 0.01;
/// A pixel speaks for the lines that it sees from this share of it on.
const LEAST: f32 = 0.2;

/// Nodes that are tried: every other one, from rough to smooth.
fn tried() -> impl Iterator<Item = usize> {
    (0..NODES).rev().step_by(2)
}

/// The lines of each segment that are darker than what is around them, or brighter: two groups per segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Line {
    Darker,
    Brighter,
}

/// What the pixels that see a group's lines say, by their share of them.
#[derive(Clone, Copy, Default)]
struct Said {
    /// At the tried nodes.
    other: Tally,
    /// Σ of their costs where lines are as rough as their surface.
    same: f64,
}

/// Roughness of the texels that lie on joints; `None` elsewhere, and on those that are like their surface. `roughness` is that of
/// the texels without joints, `half` the half of the views that each pixel belongs to ([`Evidence::halves`]), `texel` the edge
/// of a typical texel, metres.
pub fn find(
    problem: &AlbedoProblem<'_>,
    evidence: &Evidence,
    half: &[u8],
    (albedo, roughness): (&[Vec3A], &[f32]),
    texel: f32,
    settings: &RoughnessSettings,
    progress: &dyn Progress,
) -> Result<Vec<Option<f32>>> {
    let joints = &settings.joints;
    if joints.width == 0.0 {
        return Ok(vec![None; roughness.len()]);
    }
    let lines = stand_out(problem, albedo, texel, joints);
    let segment = problem.segment.0;
    let (of_segment, parent) = counted(&lines, segment, roughness, problem.segment.1);
    let group = |t: usize| -> Option<usize> {
        let [all, darker, brighter] = of_segment[segment[t] as usize];
        let few = |lines: u32| (lines as f32) < joints.least_share * all as f32;
        match lines[t]? {
            Line::Darker => (!few(darker)).then_some(2 * segment[t] as usize),
            Line::Brighter => (!few(brighter)).then_some(2 * segment[t] as usize + 1),
        }
    };
    let group: Vec<Option<usize>> = (0..segment.len()).into_par_iter().map(group).collect();
    let said = scan(problem, evidence, half, (albedo, roughness), &group, settings, progress)?;
    let chosen: Vec<Option<f32>> = said
        .iter()
        .enumerate()
        .map(|(g, said)| decide(said, parent[g / 2], joints).map(|r| r.min(settings.cap)))
        .collect();
    Ok(group.into_iter().map(|g| chosen[g?]).collect())
}

/// Which seen texels lie on lines at most [`JointSettings::width`] wide and at least [`JointSettings::length`] long, by closing and opening the logarithm of albedo within
/// segments (top-hat transforms; Serra, "Image Analysis and Mathematical Morphology", 1982).
fn stand_out(problem: &AlbedoProblem<'_>, albedo: &[Vec3A], texel: f32, settings: &JointSettings) -> Vec<Option<Line>> {
    let segment = problem.segment.0;
    let rounds = (0.5 * settings.width / texel).round().max(1.0) as usize;
    let ln: Vec<f32> = albedo.par_iter().map(|a| (a.element_sum() / 3.0 + BLACK).ln()).collect();
    let spread = |values: Vec<f32>, pick: fn(f32, f32) -> f32| {
        (0..rounds).fold(values, |values, _| {
            let around = |t: usize| {
                let within = problem.adjacency.around(t as u32).filter(|n| segment[*n as usize] == segment[t]);
                within.fold(values[t], |most, n| pick(most, values[n as usize]))
            };
            (0..values.len()).into_par_iter().map(around).collect()
        })
    };
    let closed = spread(spread(ln.clone(), f32::max), f32::min);
    let opened = spread(spread(ln.clone(), f32::min), f32::max);
    let line = |t: usize| {
        let (darker, brighter) = (closed[t] - ln[t], ln[t] - opened[t]);
        match problem.seen.is_seen[t] && darker.max(brighter) > settings.contrast {
            true if darker >= brighter => Some(Line::Darker),
            true => Some(Line::Brighter),
            false => None,
        }
    };
    let lines: Vec<Option<Line>> = (0..ln.len()).into_par_iter().map(line).collect();
    long(problem, &lines, (settings.length / texel).round() as usize)
}

/// The lines of at least `least` texels that touch: what stands out by itself is noise (an area opening; Vincent, "Morphological
/// area openings and closings for grey-scale images", 1994).
fn long(problem: &AlbedoProblem<'_>, lines: &[Option<Line>], least: usize) -> Vec<Option<Line>> {
    let segment = problem.segment.0;
    let mut long = vec![None; lines.len()];
    let mut reached: Vec<bool> = lines.iter().map(Option::is_none).collect();
    for start in 0..lines.len() {
        if std::mem::replace(&mut reached[start], true) {
            continue;
        }
        let mut line = vec![start as u32];
        let mut at = 0;
        while let Some(&t) = line.get(at) {
            at += 1;
            let goes_on = |n: usize| segment[n] == segment[start] && lines[n] == lines[start];
            let touching = problem.adjacency.touching(t).filter(|n| goes_on(*n as usize));
            line.extend(touching.filter(|n| !std::mem::replace(&mut reached[*n as usize], true)));
        }
        if line.len() >= least {
            line.into_iter().for_each(|t| long[t as usize] = lines[start]);
        }
    }
    long
}

/// Of each segment: how many texels it has, how many lie on darker and on brighter lines; and its mean roughness.
fn counted(lines: &[Option<Line>], segment: &[u32], roughness: &[f32], segments: usize) -> (Vec<[u32; 3]>, Vec<f32>) {
    let mut counts = vec![[0; 3]; segments];
    let mut sums = vec![0.0; segments];
    for ((line, segment), roughness) in lines.iter().zip(segment).zip(roughness) {
        let [all, darker, brighter] = &mut counts[*segment as usize];
        *all += 1;
        *darker += u32::from(*line == Some(Line::Darker));
        *brighter += u32::from(*line == Some(Line::Brighter));
        sums[*segment as usize] += f64::from(*roughness);
    }
    let means = sums.into_iter().zip(&counts).map(|(sum, [all, ..])| (sum / f64::from((*all).max(1))) as f32).collect();
    (counts, means)
}

/// What the pixels of each half of the views say about every group.
fn scan(
    problem: &AlbedoProblem<'_>,
    evidence: &Evidence,
    half: &[u8],
    (albedo, roughness): (&[Vec3A], &[f32]),
    group: &[Option<usize>],
    settings: &RoughnessSettings,
    progress: &dyn Progress,
) -> Result<Vec<[Said; 2]>> {
    let mut said = vec![[Said::default(); 2]; 2 * problem.segment.1];
    if group.iter().all(Option::is_none) {
        return Ok(said);
    }
    let sigma = problem.noise(settings.image_noise);
    // The group that a pixel sees most of, and its share.
    let sees = |p: usize| -> Option<(usize, f32)> {
        let mut shares = [0.0; 2];
        for tap in problem.seen.rows.row(p) {
            group[tap.texel as usize].into_iter().for_each(|g| shares[g % 2] += tap.weight);
        }
        let (side, share) = if shares[0] >= shares[1] { (0, shares[0]) } else { (1, shares[1]) };
        let s = evidence.segment[p];
        (s != NONE && share >= LEAST).then_some((2 * s as usize + side, share))
    };
    let sees: Vec<Option<(usize, f32)>> = (0..problem.seen.len()).into_par_iter().map(sees).collect();
    progress.start("joints", 1 + tried().count() as u64, "roughnesses");
    for k in std::iter::once(None).chain(tried().map(Some)) {
        progress.check()?;
        let mut with = roughness.to_vec();
        if let Some(k) = k {
            with.iter_mut().zip(group).filter(|(_, g)| g.is_some()).for_each(|(r, _)| *r = node(k));
        }
        let target = problem.target(&Roughness::Texels(&with));
        let mut albedo = albedo.to_vec();
        problem.solve(&mut albedo, &target, &sigma, 1, settings.iterations);
        for (p, sees) in sees.iter().enumerate() {
            let Some((g, share)) = *sees else { continue };
            let say = f64::from(share * evidence.say[p]);
            let residual = problem.residual(&albedo, &target, p);
            let cost = say * f64::from(cost(residual, sigma[p], settings.colour_weight));
            let said = &mut said[g][usize::from(half[p])];
            match k {
                Some(k) => said.other.cost[k] += cost,
                None => {
                    said.same += cost;
                    said.other.pixels += say;
                }
            }
        }
        progress.advance(1);
    }
    progress.finish();
    Ok(said)
}

/// The roughness of a group's lines, if it is not that of their surface, `parent`.
fn decide(said: &[Said; 2], parent: f32, settings: &JointSettings) -> Option<f32> {
    let both = Tally::sum(said.iter().map(|half| &half.other));
    if both.pixels < f64::from(settings.pixels) {
        return None;
    }
    let best = |said: &Tally| {
        let by = |k: &usize| said.ln_mean(said.cost[*k]) + settings.pull * (2.0 * (node(*k) - parent)).powi(2);
        tried().min_by(|a, b| by(a).total_cmp(&by(b)))
    };
    // Each half judges what the other one asks for.
    let judged = |by: &Said, other: &Said| match best(&other.other) {
        Some(k) if other.other.pixels > 0.0 => by.other.cost[k],
        _ => by.same,
    };
    let [first, second] = said;
    let gain = both.ln_mean(first.same + second.same) - both.ln_mean(judged(first, second) + judged(second, first));
    best(&both).filter(|_| gain > settings.agreement).map(node)
}
