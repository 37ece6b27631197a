//! Joints: the lines between boards and tiles, whose albedo and finish are not those of what they divide.
//!
//! They are too thin for evidence of their own: few pixels see nothing else. But where they are is seen in albedo, as
//! lines that stand out ([`lines`]): straight ones from wall to wall, or where a segment has none, shorter ones,
//! or any. All dark lines of a segment, and all bright ones, are taken to have one roughness. It is scanned with
//! everything else left as it is, albedo solved anew, and believed as far as the views agree that it explains their
//! pixels better than the segment's.

mod board_ends;
mod comb;
pub mod lines;
mod periodic;

use glam::Vec3A;
use rayon::prelude::*;

use self::lines::{LineCoverage, LogAlbedo, Polarity};
use crate::error::Result;
use crate::fit::full::albedo::{AlbedoProblem, EdgeGuide, Roughness};
use crate::fit::full::observations::packed_tap::PackedTap;
use crate::fit::full::partition::Partition;
use crate::fit::full::roughness::cross_validation::{self, PartCosts};
use crate::fit::full::roughness::evidence::{Tally, cost};
use crate::fit::index::NONE;
use crate::fit::settings::{AcceptanceSettings, JointSettings, RoughnessSettings};
use crate::progress::{Progress, Task};
use crate::specular_table::{NODES, node};
use crate::texture::SparseRows;

/// Albedo of a black line, so that its logarithm stays finite.
const BLACK: f32 = 0.01;
/// Share of a pixel that lines must cover for it to count.
const LEAST: f32 = 0.2;
/// Share from which ends of boards, which are inferred, exclude it.
const END: f32 = 0.05;

/// Nodes that are tried: every other one, from rough to smooth.
fn tried() -> impl Iterator<Item = usize> {
    (0..NODES).rev().step_by(2)
}

/// The roughness of lines, and how far it is trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Their roughness.
    roughness: f32,
    /// Trust in that beside their surface's, in (0, 1].
    trust: f32,
}

impl Joint {
    /// The roughness of a texel that a joint covers so much of, whose surface has this one.
    pub fn on(&self, surface: f32, share: f32) -> f32 {
        mixed(surface, cross_validation::lerp_ln(surface, self.roughness, self.trust), share)
    }
}

/// The roughness of a texel of two: textures are filtered.
fn mixed(surface: f32, joint: f32, share: f32) -> f32 {
    surface + share * (joint - surface)
}

/// Per-pixel inputs of the joint scan.
#[derive(Clone, Copy)]
pub struct JointPixels<'a> {
    /// Segment of each pixel.
    pub segment: &'a [u32],
    /// Weight of each, as in [`Evidence`](crate::fit::full::roughness::evidence::Evidence).
    pub weight: &'a [f32],
    /// Half of the views, 0 or 1, that each belongs to
    /// ([`Evidence::halves`](crate::fit::full::roughness::evidence::Evidence::halves)).
    pub half: &'a [u8],
}

/// Lines that may be joints.
pub struct Lines {
    /// What each texel has of them; `None` beside them.
    covered: Vec<Option<LineCoverage>>,
    /// Whether the lines of each group ([`group`]) are at equal distances, as few patterns but joints are.
    regular: Vec<bool>,
}

/// Number of the darker or of the brighter lines of a segment.
fn group(segment: u32, line: Polarity) -> usize {
    2 * segment as usize + line as usize
}

impl Lines {
    /// Those that `albedo` shows. `texel` is the edge of a typical texel, metres.
    pub fn find(
        problem: &AlbedoProblem<'_>,
        albedo: &[Vec3A],
        texel: f32,
        settings: &JointSettings,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let Partition { of: segment, count: segments } = problem.segment;
        if settings.width == 0.0 {
            return Ok(Self { covered: vec![None; segment.len()], regular: vec![false; 2 * segments] });
        }
        let ln: Vec<f32> = albedo.par_iter().map(|a| (a.element_sum() / 3.0 + BLACK).ln()).collect();
        let (adjacency, is_seen) = (problem.adjacency, &problem.seen.is_seen[..]);
        let albedo_map = LogAlbedo { ln: &ln, is_seen, segment, adjacency, texel };
        let full = |lines: Vec<Option<Polarity>>| lines.into_iter().map(|line| line.map(LineCoverage::full)).collect();
        let straight = settings.straight.iter().map(|course| full(albedo_map.straight(course, settings.width)));
        let regular = albedo_map.regular(settings.width, progress)?;
        let kinds: Vec<Vec<Option<LineCoverage>>> =
            std::iter::once(regular).chain(straight).chain([full(albedo_map.narrow(settings))]).collect();
        let enough: Vec<Vec<bool>> =
            kinds.iter().map(|lines| enough(lines, problem.segment, settings.min_share)).collect();
        let covered = |t: usize| -> Option<LineCoverage> {
            let kind = |line: Polarity| enough.iter().position(|enough| enough[group(segment[t], line)]);
            let by = |line: Polarity| kinds[kind(line)?][t].filter(|covered| covered.line == line);
            [Polarity::Darker, Polarity::Brighter].into_iter().filter_map(by).reduce(LineCoverage::or)
        };
        let covered = (0..segment.len()).into_par_iter().map(covered).collect();
        Ok(Self { covered, regular: enough[0].clone() })
    }

    /// The group that a pixel of `segment` sees most of, and its share.
    fn seen(&self, rows: &SparseRows<PackedTap>, segment: u32, pixel: usize) -> Option<(usize, f32)> {
        let mut shares = [0.0; 2];
        for share in rows.row(pixel) {
            if let Some(covered) = self.covered[share.texel as usize] {
                shares[covered.line as usize] += covered.share() * share.weight();
            }
        }
        let (line, share) =
            if shares[0] >= shares[1] { (Polarity::Darker, shares[0]) } else { (Polarity::Brighter, shares[1]) };
        (segment != NONE && share > 0.0).then(|| (group(segment, line), share))
    }

    /// The group that a pixel of `segment` has to judge, and its share.
    fn judged(&self, rows: &SparseRows<PackedTap>, segment: u32, pixel: usize) -> Option<(usize, f32)> {
        self.seen(rows, segment, pixel).filter(|(_, share)| *share >= LEAST && self.ends(rows, pixel) < END)
    }

    /// The share of a pixel that ends of boards have.
    fn ends(&self, rows: &SparseRows<PackedTap>, pixel: usize) -> f32 {
        let of = |share: &PackedTap| {
            self.covered[share.texel as usize]
                .filter(|covered| covered.is_end)
                .map_or(0.0, |covered| covered.share() * share.weight())
        };
        rows.row(pixel).iter().map(of).sum()
    }

    /// Segments of the pixels, [`NONE`] for those that regular lines cover by [`LEAST`] or more: they show another
    /// finish. Segments that would keep too few pixels keep all.
    pub fn without(&self, rows: &SparseRows<PackedTap>, segment: &[u32]) -> Vec<u32> {
        /// The share of a segment's pixels that are enough.
        const ENOUGH: f32 = 0.25;
        let sees =
            |p: usize| self.seen(rows, segment[p], p).is_some_and(|(g, share)| self.regular[g] && share >= LEAST);
        let sees: Vec<bool> = (0..segment.len()).into_par_iter().map(sees).collect();
        let mut pixels = vec![[0.0; 2]; self.regular.len() / 2];
        for (s, sees) in segment.iter().zip(&sees).filter(|(s, _)| **s != NONE) {
            let [all, plain] = &mut pixels[*s as usize];
            *all += 1.0;
            *plain += f32::from(u8::from(!sees));
        }
        let left_out = |s: u32| pixels.get(s as usize).is_some_and(|[all, plain]| *plain >= ENOUGH * all);
        segment.iter().zip(sees).map(|(s, sees)| if sees && left_out(*s) { NONE } else { *s }).collect()
    }
}

/// Lines of which it is known what they are.
pub struct Joints<'a> {
    lines: &'a Lines,
    segment: &'a [u32],
    /// `None` where they are like their surface.
    of_group: Vec<Option<Joint>>,
}

impl Joints<'_> {
    /// The joint that a texel lies on, and the share that it covers.
    pub fn at(&self, texel: usize) -> Option<(Joint, f32)> {
        let covered = self.lines.covered[texel]?;
        Some((self.of_group[group(self.segment[texel], covered.line)]?, covered.share()))
    }

    /// Roughness of all texels, of which this is that without joints.
    pub fn on(&self, roughness: &[f32]) -> Vec<f32> {
        let of_texel = |(t, r): (usize, &f32)| self.at(t).map_or(*r, |(joint, share)| joint.on(*r, share));
        roughness.par_iter().enumerate().map(of_texel).collect()
    }
}

/// Which of the `lines` are joints. `roughness` is that of the texels without joints.
pub fn find<'a>(
    problem: &AlbedoProblem<'a>,
    pixels: JointPixels<'_>,
    (albedo, roughness): (&[Vec3A], &[f32]),
    lines: &'a Lines,
    settings: &RoughnessSettings,
    progress: &dyn Progress,
) -> Result<Joints<'a>> {
    let parent = means(roughness, problem.segment);
    let costs = scan(problem, pixels, (albedo, roughness), lines, settings, progress)?;
    let capped = |joint: Joint| Joint { roughness: joint.roughness.min(settings.cap), ..joint };
    let of_group = costs
        .iter()
        .enumerate()
        .map(|(g, halves)| decide(halves, parent[g / 2], &settings.joints.acceptance).map(capped))
        .collect();
    Ok(Joints { lines, segment: problem.segment.of, of_group })
}

/// Whether the darker and the brighter lines of each segment are at least a share of its texels.
fn enough(lines: &[Option<LineCoverage>], segment: Partition<'_>, min_share: f32) -> Vec<bool> {
    let mut texels = vec![0u32; segment.count];
    let mut on_lines = vec![0.0; 2 * segment.count];
    for (covered, segment) in lines.iter().zip(segment.of) {
        texels[*segment as usize] += 1;
        covered.iter().for_each(|covered| on_lines[group(*segment, covered.line)] += f64::from(covered.share()));
    }
    let enough =
        |(g, on_lines): (usize, &f64)| *on_lines > 0.0 && *on_lines >= f64::from(min_share) * f64::from(texels[g / 2]);
    on_lines.iter().enumerate().map(enough).collect()
}

/// The mean roughness of each segment.
fn means(roughness: &[f32], segment: Partition<'_>) -> Vec<f32> {
    let mut sums = vec![(0.0, 0u32); segment.count];
    for (segment, roughness) in segment.of.iter().zip(roughness) {
        let (sum, count) = &mut sums[*segment as usize];
        *sum += f64::from(*roughness);
        *count += 1;
    }
    sums.into_iter().map(|(sum, count)| (sum / f64::from(count.max(1))) as f32).collect()
}

/// The costs of every group's pixels by half of the views, weighted by their share of its lines.
fn scan(
    problem: &AlbedoProblem<'_>,
    pixels: JointPixels<'_>,
    (albedo, roughness): (&[Vec3A], &[f32]),
    lines: &Lines,
    settings: &RoughnessSettings,
    progress: &dyn Progress,
) -> Result<Vec<[PartCosts; 2]>> {
    let mut costs = vec![[PartCosts::default(); 2]; 2 * problem.segment.count];
    if lines.covered.iter().all(Option::is_none) {
        return Ok(costs);
    }
    let sigma = problem.noise(settings.image_noise);
    let rows = &problem.seen.rows;
    let judged = |p: usize| {
        let (group, share) = lines.judged(rows, pixels.segment[p], p)?;
        Some((p, group, share))
    };
    let judged: Vec<(usize, usize, f32)> = (0..problem.seen.len()).into_par_iter().filter_map(judged).collect();
    let sees_lines = |p: usize| rows.row(p).iter().any(|share| lines.covered[share.texel as usize].is_some());
    let before = problem.predicted(albedo);
    let mut target = problem.target(&Roughness::Texels(roughness));
    let _task = Task::start(progress, "joints", 1 + tried().count() as u64, "roughnesses");
    for k in std::iter::once(None).chain(tried().map(Some)) {
        progress.check()?;
        if let Some(k) = k {
            let mut with = roughness.to_vec();
            for (r, covered) in with.iter_mut().zip(&lines.covered) {
                covered.iter().for_each(|covered| *r = mixed(*r, node(k), covered.share()));
            }
            problem.retarget(&mut target, &Roughness::Texels(&with), sees_lines);
        }
        let (mut albedo, mut predicted) = (albedo.to_vec(), before.clone());
        problem.solve((&mut albedo, &mut predicted), (&target, &sigma), 1, settings.iterations, EdgeGuide::Albedo);
        for &(p, group, share) in &judged {
            let weight = f64::from(share * pixels.weight[p]);
            let residual = problem.residual(&predicted, &target, p);
            let cost = weight * f64::from(cost(residual, sigma[p], settings.colour_weight));
            let costs = &mut costs[group][usize::from(pixels.half[p])];
            match k {
                Some(k) => costs.at_nodes.cost[k] += cost,
                None => {
                    costs.at_parent += cost;
                    costs.at_nodes.pixels += weight;
                }
            }
        }
        progress.advance(1);
    }
    Ok(costs)
}

/// Roughness of the least of what was tried, by the parabola in ln r through it and its neighbours.
fn between(least: usize, at: impl Fn(usize) -> f32) -> f32 {
    let neighbours = tried().filter(|k| k.abs_diff(least) == 2).collect::<Vec<_>>();
    let [rougher, smoother] = neighbours[..] else { return node(least) };
    let [up, down] = [rougher, smoother].map(|k| at(k) - at(least));
    let step = if up + down > 0.0 { 0.5 * (down - up) / (up + down) } else { 0.0 };
    node(least) * (node(rougher) / node(least)).powf(step)
}

/// The joint that a group's lines make, if they are not like their surface, whose roughness is `parent`.
fn decide(halves: &[PartCosts; 2], parent: f32, settings: &AcceptanceSettings) -> Option<Joint> {
    let trust = cross_validation::trust(halves, tried, parent, settings);
    let both = Tally::sum(halves.iter().map(|half| &half.at_nodes));
    let least = cross_validation::asked(&both, tried(), parent, settings).filter(|_| trust > 0.0)?;
    Some(Joint { roughness: between(least, |k| cross_validation::objective(&both, k, parent, settings)), trust })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::Tap;

    #[test]
    fn a_joint_that_covers_part_of_a_texel_has_part_of_it() {
        let joint = Joint { roughness: 0.4, trust: 1.0 };
        assert_eq!([0.0, 0.25, 1.0].map(|share| joint.on(0.2, share)), [0.2, 0.25, 0.4]);
        // Half trusted, it is half as far by the logarithm.
        assert!((Joint { trust: 0.5, ..joint }.on(0.1, 1.0) - 0.2).abs() < 1e-6);
    }

    #[test]
    fn the_least_is_found_between_what_is_tried() {
        let tried: Vec<usize> = tried().collect();
        let k = tried[tried.len() / 2];
        let step = (node(tried[0]) / node(tried[1])).ln();
        for off in [-0.4, 0.0, 0.3] {
            let true_ln = node(k).ln() + off * step;
            let found = between(k, |k| (node(k).ln() - true_ln).powi(2));
            assert!((found.ln() - true_ln).abs() < 1e-3, "{off}: {found}");
        }
        // At either end of what is tried there is nothing between, and where all cost the same nothing is nearer.
        assert_eq!(between(tried[0], |k| k as f32), node(tried[0]));
        assert_eq!(between(k, |_| 1.0), node(k));
    }

    /// A pixel that sees a surface, and of the texel after it a share.
    fn pixel(surface: u32, joint: f32) -> Vec<PackedTap> {
        let taps = vec![Tap { texel: surface, weight: 1.0 - joint }, Tap { texel: surface + 1, weight: joint }];
        PackedTap::of([taps.clone(), taps.clone(), taps.clone(), taps])
    }

    #[test]
    fn joints_are_judged_by_who_sees_much_of_them_and_no_end() {
        let dark = LineCoverage::full(Polarity::Darker);
        let half = LineCoverage::of(Polarity::Darker, 0.5, 0.5);
        let lines = Lines { covered: vec![None, Some(dark), Some(dark.at_end()), None, half], regular: vec![true; 2] };
        let rows = SparseRows::from_lists([pixel(0, 0.3), pixel(0, 0.1), pixel(1, 0.1), pixel(1, 0.02), pixel(3, 0.6)]);
        let judged = [0, 1, 2, 3, 4].map(|p| lines.judged(&rows, 0, p).map(|(_, share)| (100.0 * share).round()));
        assert_eq!(judged, [Some(30.0), None, None, Some(100.0), Some(30.0)]);
        assert_eq!(lines.judged(&rows, NONE, 0), None);
    }

    #[test]
    fn what_pixels_see_of_regular_joints_is_not_their_surfaces() {
        // Segment 0 has texel 0 beside its joint, texel 1; segment 1 likewise 2 and 3. The lines of segment 2, texel 5,
        // may be paint.
        let lines = Lines {
            covered: [false, true, false, true, false, true]
                .map(|on| on.then_some(LineCoverage::full(Polarity::Darker)))
                .to_vec(),
            regular: vec![true, false, true, false, false, false],
        };
        let pixels = [(0, 0.5), (0, 0.1), (0, 0.0), (2, 0.3), (2, 0.4), (4, 0.9), (0, 0.3)];
        let rows = SparseRows::from_lists(pixels.map(|(surface, joint)| pixel(surface, joint)));
        // The last shows an edge, and counts for nothing anyway. No pixel of segment 1 is without its joint, so that
        // all stay.
        let segment = [0, 0, 0, 1, 1, 2, NONE];
        assert_eq!(lines.without(&rows, &segment), [NONE, 0, 0, 1, 1, 2, NONE]);
    }
}
