//! The fit in full mode: light samples drawn beforehand, albedo by robust least squares, roughness by a scan per
//! segment.
//!
//! labels → observations → segments → scan (→ metals) → hierarchy → lines → colours, finishes → joints → albedo → what
//! is hidden. No ray is traced after the observations. A first, coarse round tells what light surfaces send, of which
//! irradiance and observations are made again.

mod albedo;
mod automatic;
mod bands;
mod blocks;
mod board_ends;
mod borders;
mod colours;
mod confidence;
mod hidden;
mod hierarchy;
mod joints;
mod kin;
mod labels;
mod lines;
mod local;
mod metals;
mod nodes;
mod observations;
mod own;
mod palette;
mod parent;
mod partition;
mod periodic_lines;
mod reflections;
mod regular;
mod rims;
mod scan;
mod segments;
mod share;
mod squares;
mod variation;

use std::f32::consts::PI;
use std::iter::repeat_n;

use glam::Vec3A;
use rayon::prelude::*;

use super::adjacency::NONE;
use super::{Ground, Materials, diffused, outside, warnings};
use crate::atlas::Atlas;
use crate::backend::Backend;
use crate::bake;
use crate::capture::View;
use crate::diffuse::DiffuseModel;
use crate::error::{Error, Result};
use crate::fit::settings::{FullSettings, RoughnessSettings};
use crate::lights::Lights;
use crate::progress::{Named, Progress};
use crate::raster::Rgb;
use albedo::{AlbedoProblem, Edges};
use joints::{Judges, Lines};
use labels::Labels;
use local::Surface;
use observations::{Observations, Observer};
use palette::Palettes;
use partition::Partition;
use scan::Tally;
use segments::Segments;

/// Fits the materials, and tells what radiance surfaces send by them if irradiance was gathered again from that
/// ([`FullSettings::alternations`]). The backend holds the full TBL and its lights; `map` is the irradiance E.
pub fn fit(
    backend: &mut dyn Backend,
    ground: &Ground<'_>,
    map: Rgb,
    training: &[View],
    settings: &FullSettings,
    progress: &dyn Progress,
) -> Result<(Materials, Option<Rgb>)> {
    let Ground { atlas, adjacency, emitters, seed, .. } = *ground;
    let mut irradiance = of_texels(&map, atlas);
    drop(map);
    let labels = Labels::vote(backend, (atlas, adjacency), training, progress)?;
    if !labels.has_classes() {
        let what = match training.iter().any(|view| view.semantic.is_some()) {
            true => "semantic images name no class where masks let pixels count",
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
        let checkpoints = &ground.checkpoints.within(&format!("round-{round}"));
        let observer = Observer { atlas, emitters, settings, seed, checkpoints };
        let seen = observer.observe(backend, training, progress)?;
        if round == 0 {
            warnings::little_seen(atlas, backend.scene().mesh(), &seen.is_seen)
                .into_iter()
                .for_each(|what| progress.warn(&what));
        }
        // What the next round's light is made of keeps its specks: its roughness came out worse without.
        let is_last = round + 1 == rounds.len();
        let edges = if is_last { Edges::WithoutSpecks } else { Edges::OfTexels };
        let materials = recover(ground, &irradiance, (&labels, &seen), settings, edges, progress)?;
        let sent = diffused::radiance(atlas, ground.tbl, &materials, emitters, &seen.is_seen);
        drop(seen);
        // One scan for each diffuse model is enough.
        rounds.iter_mut().for_each(|settings| settings.diffuse = materials.diffuse.into());
        round += 1;
        if round == rounds.len() {
            return Ok((materials, (round > 1).then_some(sent)));
        }
        let bake = if round + 1 < rounds.len() { bake::thinned } else { bake::denoised };
        let checkpoints = &ground.checkpoints.within(&format!("round-{round}"));
        backend.set_tbl(&sent, &Lights::find(backend.scene(), atlas, &sent)?)?;
        let baked = bake(backend, atlas, ground.gather, checkpoints, &again)?;
        irradiance = of_texels(&outside(baked, atlas)?, atlas);
    }
}

/// What a map holds at every valid texel.
fn of_texels(map: &Rgb, atlas: &Atlas) -> Vec<Vec3A> {
    atlas.texels.iter().map(|&t| map.data[t as usize].into()).collect()
}

/// The materials that explain what is seen: steps 4 to 8 of docs/fit.md.
fn recover(
    ground: &Ground<'_>,
    irradiance: &[Vec3A],
    (labels, seen): (&Labels, &Observations),
    settings: &FullSettings,
    edges: Edges,
    progress: &dyn Progress,
) -> Result<Materials> {
    let Ground { atlas, texel, adjacency, plan, .. } = *ground;
    // 4. Segments.
    let apparent = apparent_albedo(ground, irradiance);
    let segments = segments::segment((atlas, texel), adjacency, labels, &seen.is_seen, &apparent, plan);
    drop(apparent);
    let segment = segments.partition();
    let mut problem =
        AlbedoProblem::new(seen, irradiance, adjacency, segment, DiffuseModel::default(), &settings.albedo);

    // 5 and 6. A scan, and by it one roughness for each segment.
    let Scanned { diffuse, mut albedo, evidence, tallies, by_segment } =
        scan_models(&mut problem, &segments, settings, progress)?;
    problem.solve_at(&mut albedo, segments.of_texels(&by_segment), 1, Edges::OfTexels);

    // 7. Roughness of its colours, and where it has two finishes: pixels that see joints would make a mixture of those.
    let lines = Lines::find(&problem, &albedo, texel, &settings.roughness.joints, progress)?;
    let half = evidence.halves(&seen.views);
    let surface = Surface {
        width: atlas.width,
        texels: &atlas.texels,
        segment: segment.of,
        face: &segments.face,
        heaviest: &heaviest(seen, &evidence.segment),
        half: &half,
        block: (settings.roughness.local.block / texel).round().max(2.0),
    };
    let without_joints = heaviest(seen, &lines.without(&seen.rows, &evidence.segment));
    let blocks = local::Said {
        by_all: surface.blocks(&evidence),
        by_plain: Surface { heaviest: &without_joints, ..surface }.blocks(&evidence),
    };
    let palettes = problem.palettes(&albedo, &settings.palette);
    let of_colours = by_colour(&surface, (&palettes, &albedo), &by_segment, &evidence, &settings.roughness);
    let mut roughness = local::refine(&surface, &blocks, &by_segment, &of_colours, &settings.roughness.local);
    roughness.iter_mut().for_each(|r| *r = r.min(settings.roughness.cap));
    // Nothing from here on asks what pixels cost, a tenth of a large fit's memory.
    drop(evidence.cost);
    problem.solve_at(&mut albedo, &roughness, 1, Edges::OfTexels);

    // 7, still. Roughness of its joints.
    let judges = Judges { segment: &evidence.segment, say: &evidence.say, half: &half };
    let joints = joints::find(&problem, judges, (&albedo, &roughness), &lines, &settings.roughness, progress)?;
    problem.solve_at(&mut albedo, joints.on(&roughness), settings.albedo.rounds, edges);

    // 8. Few colours, and what no view sees painted after what it is like. That has no joints: lines do not go on by
    // blurring.
    let palettes = problem.palettes(&albedo, &settings.palette);
    let mut painted: Vec<Vec3A> =
        (&albedo, &segments.segment).into_par_iter().map(|(a, s)| palettes.drawn(*s, *a, &settings.palette)).collect();
    let outlier = hidden::outliers(&albedo, segment);
    let known = |t: usize| seen.is_seen[t] && !outlier[t];
    let model = segments.of_texels(&segments.models(known));
    hidden::paint(atlas, &model, known, (&mut painted, &mut roughness), texel);
    // Sources are told with a rim, which may be paint; what sends more than paint could is none.
    let apparent = apparent_albedo(ground, irradiance);
    let shines = |t: usize| ground.emitters.data[atlas.texels[t] as usize] && apparent[t].max_element() >= 1.0;
    hidden::grey_sources(segment, shines, &mut painted);
    let roughness = joints.on(&roughness);

    // What metal shows does not depend on irradiance.
    let depends = |t: usize| seen.is_seen[t] && problem.metal.get(t) != Some(&true);
    let corrected = with_what_albedo_gives_up(irradiance, (&albedo, &painted), depends);
    let confidence = confidence::confidence(&surface, &blocks.by_all, &tallies, &roughness);
    let metallic: Vec<f32> = problem.metal.iter().map(|metal| f32::from(u8::from(*metal))).collect();
    let all = vec![true; painted.len()];
    let rgb = |values: &[Vec3A]| {
        let values: Vec<[f32; 3]> = values.iter().map(Vec3A::to_array).collect();
        atlas.scatter_padded(&values, &all, [0.0; 3], bake::PADDING)
    };
    let gray = |values: &[f32]| atlas.scatter_padded(values, &all, 0.0, bake::PADDING);
    Ok(Materials {
        albedo: rgb(&painted),
        roughness: gray(&roughness),
        metallic: settings.metallic.enabled.then(|| gray(&metallic)),
        irradiance: rgb(&corrected),
        diffuse,
        masking: settings.masking,
        confidence: Some(gray(&confidence)),
    })
}

/// The albedo of every texel if all that it sends were reflected diffusely.
fn apparent_albedo(ground: &Ground<'_>, irradiance: &[Vec3A]) -> Vec<Vec3A> {
    /// Irradiance that is taken for none.
    const DARK: f32 = 1e-6;
    let of_texel = |(l, e): (Vec3A, &Vec3A)| (PI * l / e.max(Vec3A::splat(DARK))).min(Vec3A::ONE);
    of_texels(&ground.tbl.radiance, ground.atlas).into_iter().zip(irradiance).map(of_texel).collect()
}

/// Irradiance by which what the images show stays what they show when the albedo that they ask for is `painted`
/// otherwise, at the texels of which that `depends` on it: it takes what albedo gives up, even all of a black
/// outlier's.
fn with_what_albedo_gives_up(
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
    evidence: scan::Evidence,
    /// What it says of every segment,
    tallies: Vec<Tally>,
    /// and the roughness that they take by that.
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
    let pixels = settings.roughness.segment_pixels;
    let metal = metals::find([&scanned.tallies, &evidence.by_segment()], pixels, &settings.metallic);
    problem.metal = segments.segment.iter().map(|s| metal[*s as usize]).collect();
    scanned.evidence.take(&evidence, &metal);
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
    let colours = kin::colours(problem.segment, albedo, &problem.seen.is_seen);
    hierarchy::of_segments(segments, tallies, &colours, settings)
}

/// The texel that each pixel sees most of; [`NONE`] for pixels of no segment, which do not count.
fn heaviest(seen: &Observations, segment: &[u32]) -> Vec<u32> {
    let of_pixel = |(p, segment): (usize, &u32)| {
        let heaviest = seen.rows.row(p).iter().max_by(|a, b| a.weight().total_cmp(&b.weight()));
        heaviest.filter(|_| *segment != NONE).map_or(NONE, |share| share.texel)
    };
    segment.par_iter().enumerate().map(of_pixel).collect()
}

/// Roughness of every texel: its segment's, and where the views agree that its colour has one of its own, that.
fn by_colour(
    surface: &Surface<'_>,
    (palettes, albedo): (&Palettes, &[Vec3A]),
    by_segment: &[f32],
    evidence: &scan::Evidence,
    settings: &RoughnessSettings,
) -> Vec<f32> {
    let starts = palettes.starts();
    let of_texel = |(s, a): (&u32, &Vec3A)| starts[*s as usize] + palettes.nearest(*s, *a) as u32;
    let colour: Vec<u32> = (surface.segment, albedo).into_par_iter().map(of_texel).collect();
    let of_pixel = |(&t, &half): (&u32, &u8)| if t == NONE { NONE } else { 2 * colour[t as usize] + u32::from(half) };
    let group: Vec<u32> = surface.heaviest.par_iter().zip(surface.half).map(of_pixel).collect();
    let halves = evidence.by_group(Partition { of: &group, count: 2 * *starts.last().unwrap_or(&0) as usize });
    let colours = starts.windows(2).map(|ends| (ends[1] - ends[0]) as usize);
    let parents = by_segment.iter().zip(colours).flat_map(|(r, colours)| repeat_n(*r, colours));
    let own: Vec<f32> =
        halves.as_chunks().0.iter().zip(parents).map(|(said, r)| own::of_part(said, r, &settings.colours)).collect();
    colour.iter().map(|&g| own[g as usize]).collect()
}

#[cfg(test)]
mod tests;
