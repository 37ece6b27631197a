//! The fit in full mode: light samples drawn beforehand, albedo by robust least squares, roughness by a scan per
//! segment.
//!
//! labels → observations → segments → scan (→ metals) → hierarchy → colours, finishes → joints → albedo → unseen
//! texels. No ray is traced after the observations. A first, coarse round gives the light that surfaces send, of which
//! irradiance and observations are made again.

mod albedo;
mod joints;
mod observations;
mod partition;
mod roughness;
mod segments;
mod unseen;

use std::f32::consts::PI;
use std::iter::repeat_n;

use glam::Vec3A;
use rayon::prelude::*;

use super::index::NONE;
use super::{FitContext, Materials, outgoing, warnings, without_buried};
use crate::atlas::Atlas;
use crate::backend::Backend;
use crate::bake;
use crate::capture::View;
use crate::diffuse::DiffuseModel;
use crate::error::{Error, Result};
use crate::fit::settings::{FullSettings, PaletteSettings, RoughnessSettings};
use crate::lights::Lights;
use crate::progress::{Named, Progress};
use crate::raster::Rgb;
use albedo::palette::Palettes;
use albedo::{AlbedoProblem, EdgeGuide};
use joints::{JointPixels, Lines};
use observations::{Observations, Observer};
use partition::Partition;
use roughness::blocks::{BlockGrid, BlockTallies};
use roughness::evidence::{Evidence, Tally};
use roughness::{confidence, cross_validation, finishes, hierarchy, metals, scan, similarity_prior};
use segments::Segments;
use segments::labels::Labels;

/// Fits the materials, and tells what radiance surfaces send by them if irradiance was gathered again from that
/// ([`FullSettings::alternations`]). The backend holds the full TBL and its lights; `map` is the irradiance E.
pub fn fit(
    backend: &mut dyn Backend,
    context: &FitContext<'_>,
    map: Rgb,
    training: &[View],
    settings: &FullSettings,
    progress: &dyn Progress,
) -> Result<(Materials, Option<Rgb>)> {
    let FitContext { atlas, adjacency, emitters, seed, .. } = *context;
    let mut irradiance = of_texels(&map, atlas);
    drop(map);
    let labels = Labels::vote(backend, (atlas, adjacency), training, progress)?;
    if !labels.has_classes() {
        let what = match training.iter().any(|view| view.semantic.is_some()) {
            true => "semantic images label no unmasked pixel",
            false => "no view has semantic classes",
        };
        progress.warn(&format!(
            "{what}: segments are made from geometry and colour alone, and surfaces that look alike share their roughness; \
             semantic images tell them apart better"
        ));
    }
    let again = Named { progress, of: "again" };
    let mut rounds = settings.rounds();
    let mut round = 0;
    loop {
        let (settings, progress) = (&rounds[round], if round == 0 { progress } else { &again });
        let checkpoints = &context.checkpoints.within(&format!("round-{round}"));
        let observer = Observer { atlas, emitters, settings, seed, checkpoints };
        let seen = observer.observe(backend, training, progress)?;
        if round == 0 {
            warnings::little_seen(atlas, backend.scene().mesh(), &seen.is_seen)
                .into_iter()
                .for_each(|what| progress.warn(&what));
        }
        // Earlier rounds keep their specks: without them, the next round's roughness came out worse.
        let is_last = round + 1 == rounds.len();
        let guide = if is_last { EdgeGuide::Median } else { EdgeGuide::Albedo };
        let materials = recover(context, &irradiance, (&labels, &seen), settings, guide, progress)?;
        let sent = outgoing::radiance(atlas, context.tbl, &materials, emitters, &seen.is_seen)?;
        drop(seen);
        // One scan for each diffuse model is enough.
        rounds.iter_mut().for_each(|settings| settings.diffuse = materials.diffuse.into());
        round += 1;
        if round == rounds.len() {
            return Ok((materials, (round > 1).then_some(sent)));
        }
        let bake = if round + 1 < rounds.len() { bake::thinned } else { bake::denoised };
        let checkpoints = &context.checkpoints.within(&format!("round-{round}"));
        backend.set_tbl(&sent, &Lights::find(backend.scene(), atlas, &sent)?)?;
        let baked = bake(backend, atlas, context.gather, checkpoints, &again)?;
        irradiance = of_texels(&without_buried(baked, atlas)?, atlas);
    }
}

/// What a map holds at every valid texel.
fn of_texels(map: &Rgb, atlas: &Atlas) -> Vec<Vec3A> {
    atlas.texels.iter().map(|&t| map.data[t as usize].into()).collect()
}

/// The materials that explain what is seen: steps 4 to 8 of docs/fit.md.
fn recover(
    context: &FitContext<'_>,
    irradiance: &[Vec3A],
    (labels, seen): (&Labels, &Observations),
    settings: &FullSettings,
    guide: EdgeGuide,
    progress: &dyn Progress,
) -> Result<Materials> {
    let FitContext { atlas, texel, adjacency, plan, .. } = *context;
    // 4. Segments.
    let apparent = apparent_albedo(context, irradiance);
    let segments = segments::segment((atlas, texel), adjacency, labels, &seen.is_seen, &apparent, plan);
    drop(apparent);
    let segment = segments.partition();
    let mut problem =
        AlbedoProblem::new(seen, irradiance, adjacency, segment, DiffuseModel::default(), &settings.albedo);

    // 5 and 6. A scan, and by it one roughness for each segment.
    let Scanned { diffuse, mut albedo, evidence, tallies, by_segment } =
        scan_models(&mut problem, &segments, settings, progress)?;
    problem.solve_at(&mut albedo, segments.of_texels(&by_segment), 1, EdgeGuide::Albedo);

    // 7. Parts of segments: colours and finishes, for which pixels that see joints would make a mixture, then joints.
    let lines = Lines::find(&problem, &albedo, texel, &settings.roughness.joints, progress)?;
    let half = evidence.halves(&seen.views);
    let grid = BlockGrid {
        width: atlas.width,
        texels: &atlas.texels,
        segment: segment.of,
        face: &segments.face,
        block: (settings.roughness.finishes.block / texel).round().max(2.0),
    };
    let dominant = dominant_texel(seen, &evidence.segment);
    let without_joints = dominant_texel(seen, &lines.without(&seen.rows, &evidence.segment));
    let of_pixels = |dominant: &[u32]| grid.blocks(&evidence, dominant, &half);
    let (all, without_joints) = rayon::join(|| of_pixels(&dominant), || of_pixels(&without_joints));
    let blocks = BlockTallies { all, without_joints };
    let palettes = problem.palettes(&albedo, &settings.palette);
    let colour = palettes.numbered(segment, &albedo);
    let of_colours = by_colour((&colour, &palettes), (&dominant, &half), &by_segment, &evidence, &settings.roughness);
    let mut roughness = finishes::refine(&grid, &blocks, &by_segment, &of_colours, &settings.roughness.finishes);
    roughness.iter_mut().for_each(|r| *r = r.min(settings.roughness.cap));
    // From here on nobody needs the costs, a tenth of a large fit's memory.
    drop(evidence.cost);
    problem.solve_at(&mut albedo, &roughness, 1, EdgeGuide::Albedo);
    let pixels = JointPixels { segment: &evidence.segment, weight: &evidence.weight, half: &half };
    let joints = joints::find(&problem, pixels, (&albedo, &roughness), &lines, &settings.roughness, progress)?;
    problem.solve_at(&mut albedo, joints.on(&roughness), settings.albedo.rounds, guide);

    // 8. Few colours, and what no view sees inpainted. That has no joints: lines do not go on by blurring.
    let painted = completed(context, irradiance, (&segments, seen), &settings.palette, (&albedo, &mut roughness));
    let roughness = joints.on(&roughness);
    // What metal shows does not depend on irradiance.
    let depends = |t: usize| seen.is_seen[t] && problem.metal.get(t) != Some(&true);
    let compensated = compensated_irradiance(irradiance, (&albedo, &painted), depends);
    let confidence = confidence::confidence(&grid, &blocks.all, &tallies, &roughness);
    let metallic: Vec<f32> = problem.metal.iter().map(|metal| f32::from(u8::from(*metal))).collect();

    let rgb = |values: &[Vec3A]| {
        let values: Vec<[f32; 3]> = values.iter().map(Vec3A::to_array).collect();
        atlas.padded(&values, bake::PADDING)
    };
    let gray = |values: &[f32]| atlas.padded(values, bake::PADDING);
    Ok(Materials {
        albedo: rgb(&painted)?,
        roughness: gray(&roughness)?,
        metallic: settings.metallic.enabled.then(|| gray(&metallic)).transpose()?,
        irradiance: rgb(&compensated)?,
        diffuse,
        masking: settings.masking,
        confidence: Some(gray(&confidence)?),
    })
}

/// Albedo drawn to the few colours of its segment; of unseen texels, and of outliers, inpainted, as is their
/// `roughness`; of light sources that make up much of a segment, grey.
fn completed(
    context: &FitContext<'_>,
    irradiance: &[Vec3A],
    (segments, seen): (&Segments, &Observations),
    settings: &PaletteSettings,
    (albedo, roughness): (&[Vec3A], &mut [f32]),
) -> Vec<Vec3A> {
    let FitContext { atlas, texel, .. } = *context;
    let segment = segments.partition();
    let palettes = Palettes::find(albedo, segment, |t| seen.is_seen[t], settings);
    let mut painted: Vec<Vec3A> =
        (albedo, segment.of).into_par_iter().map(|(a, s)| palettes.drawn(*s, *a, settings)).collect();
    let outlier = unseen::outliers(albedo, segment);
    let known = |t: usize| seen.is_seen[t] && !outlier[t];
    let exemplar = segments.of_texels(&segments.exemplars(known));
    unseen::inpaint_materials(atlas, &exemplar, known, (&mut painted, roughness), texel);
    // Emitter masks include a rim that may be paint: only what exceeds any albedo is a source.
    let apparent = apparent_albedo(context, irradiance);
    let emits = |t: usize| context.emitters.data[atlas.texels[t] as usize] && apparent[t].max_element() >= 1.0;
    unseen::grey_sources(segment, emits, &mut painted);
    painted
}

/// The albedo of every texel if all that it sends were reflected diffusely.
fn apparent_albedo(context: &FitContext<'_>, irradiance: &[Vec3A]) -> Vec<Vec3A> {
    /// Irradiance that is taken for none.
    const DARK: f32 = 1e-6;
    let of_texel = |(l, e): (Vec3A, &Vec3A)| (PI * l / e.max(Vec3A::splat(DARK))).min(Vec3A::ONE);
    of_texels(&context.tbl.radiance, context.atlas).into_iter().zip(irradiance).map(of_texel).collect()
}

/// Irradiance that keeps a E, and with it the images' diffuse part, as albedo is replaced by the `painted` one, at
/// texels where the images `depends` on it; by a factor of ten at most.
fn compensated_irradiance(
    irradiance: &[Vec3A],
    (albedo, painted): (&[Vec3A], &[Vec3A]),
    depends: impl Fn(usize) -> bool + Sync,
) -> Vec<Vec3A> {
    const MOST: Vec3A = Vec3A::splat(10.0);
    let of_texel = |t: usize| {
        let given_up = (albedo[t] / painted[t].max(Vec3A::splat(1e-3))).clamp(MOST.recip(), MOST);
        irradiance[t] * if depends(t) { given_up } else { Vec3A::ONE }
    };
    (0..irradiance.len()).into_par_iter().map(of_texel).collect()
}

/// What the scan found under one diffuse model.
struct Scanned {
    diffuse: DiffuseModel,
    albedo: Vec<Vec3A>,
    evidence: Evidence,
    /// The tally of every segment.
    tallies: Vec<Tally>,
    /// Roughness of every segment.
    by_segment: Vec<f32>,
}

/// Scans under every model that comes into question, and keeps the one that leaves least for grazing terms to explain.
/// (Misfit does not tell: it is what is left after them.)
fn scan_models(
    problem: &mut AlbedoProblem<'_>,
    segments: &Segments,
    settings: &FullSettings,
    progress: &dyn Progress,
) -> Result<Scanned> {
    let mut best: Option<(f64, Scanned)> = None;
    for diffuse in settings.diffuse.candidates() {
        problem.diffuse = diffuse;
        let mut albedo = problem.start();
        let evidence = scan::scan(problem, &diffuse.to_string(), &settings.roughness, &mut albedo, progress)?;
        let tallies = evidence.by_segment();
        let by_segment = roughness_of_segments(problem, segments, (&tallies, &albedo), &settings.roughness);
        let grazing = evidence.grazing(&by_segment);
        if best.as_ref().is_none_or(|(least, _)| grazing < *least) {
            best = Some((grazing, Scanned { diffuse, albedo, evidence, tallies, by_segment }));
        }
    }
    let (_, mut scanned) = best.ok_or_else(|| Error::invalid("no diffuse model to choose from"))?;
    problem.diffuse = scanned.diffuse;
    if settings.metallic.enabled {
        find_metals(problem, segments, settings, &mut scanned, progress)?;
    }
    Ok(scanned)
}

/// Scans once more as if everything were metal, and takes that for the segments which it explains clearly better.
fn find_metals(
    problem: &mut AlbedoProblem<'_>,
    segments: &Segments,
    settings: &FullSettings,
    scanned: &mut Scanned,
    progress: &dyn Progress,
) -> Result<()> {
    problem.metal = vec![true; segments.segment.len()];
    let mut albedo = problem.start();
    let evidence = scan::scan(problem, "metal", &settings.roughness, &mut albedo, progress)?;
    let metal = metals::find([&scanned.tallies, &evidence.by_segment()], &settings.metallic);
    problem.metal = segments.segment.iter().map(|s| metal[*s as usize]).collect();
    scanned.evidence.replace(&evidence, &metal);
    (&mut scanned.albedo, albedo, &problem.metal)
        .into_par_iter()
        .filter(|(_, _, metal)| **metal)
        .for_each(|(albedo, of_metal, _)| *albedo = of_metal);
    scanned.tallies = scanned.evidence.by_segment();
    let found = (&scanned.tallies[..], &scanned.albedo[..]);
    scanned.by_segment = roughness_of_segments(problem, segments, found, &settings.roughness);
    Ok(())
}

/// Roughness of every segment by what a scan says of it, and by the albedo that it left.
fn roughness_of_segments(
    problem: &AlbedoProblem<'_>,
    segments: &Segments,
    (tallies, albedo): (&[Tally], &[Vec3A]),
    settings: &RoughnessSettings,
) -> Vec<f32> {
    let colours = similarity_prior::colours(problem.segment, albedo, &problem.seen.is_seen);
    hierarchy::of_segments(segments, tallies, &colours, settings)
}

/// The texel of largest weight in each pixel; [`NONE`] for pixels of no segment, which do not count.
fn dominant_texel(seen: &Observations, segment: &[u32]) -> Vec<u32> {
    let of_pixel = |(p, segment): (usize, &u32)| {
        let largest = seen.rows.row(p).iter().max_by(|a, b| a.weight().total_cmp(&b.weight()));
        largest.filter(|_| *segment != NONE).map_or(NONE, |share| share.texel)
    };
    segment.par_iter().enumerate().map(of_pixel).collect()
}

/// Roughness of every texel: its segment's, or its colour's as far as the halves of the views agree on that.
/// `colour` is each texel's number in [`Palettes::starts`], `dominant` the texel and `half` the half of each pixel.
fn by_colour(
    (colour, palettes): (&[u32], &Palettes),
    (dominant, half): (&[u32], &[u8]),
    by_segment: &[f32],
    evidence: &Evidence,
    settings: &RoughnessSettings,
) -> Vec<f32> {
    let starts = palettes.starts();
    let of_pixel = |(&t, &half): (&u32, &u8)| if t == NONE { NONE } else { 2 * colour[t as usize] + u32::from(half) };
    let group: Vec<u32> = dominant.par_iter().zip(half).map(of_pixel).collect();
    let halves = evidence.by_group(Partition { of: &group, count: 2 * *starts.last().unwrap_or(&0) as usize });
    let colours = starts.windows(2).map(|ends| (ends[1] - ends[0]) as usize);
    let parents = by_segment.iter().zip(colours).flat_map(|(r, colours)| repeat_n(*r, colours));
    let of_colour: Vec<f32> = (halves.as_chunks().0.iter().zip(parents))
        .map(|(halves, r)| cross_validation::of_part(halves, r, &settings.colours))
        .collect();
    colour.iter().map(|&number| of_colour[number as usize]).collect()
}

#[cfg(test)]
mod tests;
