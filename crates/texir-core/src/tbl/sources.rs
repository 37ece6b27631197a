//! Light sources at the resolution of the texture.
//!
//! A pixel at the rim of a lamp, or one that is larger than the lamp, shows the lamp and what surrounds it. Blending
//! such pixels dims lamps and lets them glow onto the ceiling beside them, and a dimmed lamp lights the whole scene
//! less. Around light sources the texture is therefore made to explain the pixels of all views: every pixel is the mean
//! of the texels it shows, and Richardson–Lucy iterations (Richardson 1972, Lucy 1974) find non-negative texels with
//! these means. They keep the power that the pixels hold, whatever the pixels' size, so that a lamp below the size of a
//! pixel gets the radiance that its area needs.
//!
//! Which of the texels in a pixel shine, the face of a spot or its rim, only other views can tell, and texel by texel
//! there are too few. Lamps of few pixels therefore begin with one radiance for each of their smooth parts, and depart
//! from that as far as pixels tell.

use std::collections::{HashMap, HashSet};

use glam::Vec3;
use rayon::prelude::*;

use super::Fusion;
use super::connectivity::Connectivity;
use super::photo::Photo;
use super::source_pixels::SourcePixels;
use crate::backend::Backend;
use crate::error::Result;
use crate::inpaint;
use crate::raster::mean_of_channels;
use crate::texture::{SparseRows, Tap, merge};

/// Richardson–Lucy iterations for texels: what is a pixel wide is sharp after about ten, what is a fraction of it after
/// some more, and noise after many.
const ITERATIONS: usize = 30;
/// Iterations for the parts of lamps, which are few and seen by many pixels: dark ones fade slowly.
const PART_ITERATIONS: usize = 2000;
/// A part that fills more pixels than this in some view is told texel by texel from the start.
const PART_PIXELS: f32 = 150.0;
/// Share of a part's texels that must be taken for sources: what glows of a ceiling is no part of a lamp.
const PART_SOURCES: f32 = 0.5;
/// What the pixels say of a texel counts against this many pixels that say that it is right: texels that are hardly
/// seen stay as they are.
const DAMPING: f32 = 0.1;
/// How often texels that come out as light sources although their blend is dark are looked at in all views. A pixel at
/// the rim of a lamp that is brighter than its share of the lamp (noise, a pose that is slightly off) makes the bits of
/// wall that it shows as well shine; in other views, where they are beside no lamp, they are dark. Each round finds a
/// fraction of the last.
const REVIEWS: usize = 4;
/// A pixel mixes a light source in when this share of its radiance is the source's.
const MIXED: f32 = 0.05;
/// Keeps quotients of black finite; far below any radiance that matters.
const BLACK: f32 = 1e-6;
/// No texel.
const NONE: u32 = u32::MAX;

/// What is known of the surroundings of light sources.
pub(super) struct AroundSources {
    /// The texels of light sources and around them that pixels show.
    pub texels: Vec<u32>,
    /// How many pixels' worth of each of them the pixels show.
    pub shown: Vec<f32>,
    /// Their radiance; above `limit` they are sources.
    pub radiance: Vec<[f32; 3]>,
    /// The mean over the channels above which a texel is a light source.
    pub limit: f32,
    /// Per view, the pixels that mix sources in.
    pub mixed: Vec<Vec<usize>>,
}

/// Resolves the light sources that are known from `blended`, one radiance per valid texel.
pub(super) fn resolve(
    fusion: &Fusion<'_>,
    backend: &mut dyn Backend,
    load: &mut dyn FnMut(usize) -> Result<Photo>,
    connectivity: &Connectivity,
    blended: &[Option<[f32; 3]>],
) -> Result<AroundSources> {
    let limit = inpaint::source_limit(blended);
    let mut sources: Vec<bool> = blended.iter().map(|b| b.is_some_and(|b| mean_of_channels(b) > limit)).collect();
    let mut looks = SourcePixels::of(fusion.cameras.len());
    let mut new: Vec<usize> = (0..sources.len()).filter(|&texel| sources[texel]).collect();
    let mut reviews = 0..REVIEWS;
    let explained = loop {
        looks.add(fusion, backend, load, &new)?;
        let explained = explained(fusion, &looks, blended, (&sources, connectivity));
        let shining = explained.texels.iter().zip(&explained.radiance).filter(|(_, l)| mean_of_channels(**l) > limit);
        new = shining.map(|(t, _)| *t as usize).filter(|&t| !sources[t]).collect();
        if new.is_empty() || reviews.next().is_none() {
            break explained;
        }
        new.iter().for_each(|&texel| sources[texel] = true);
    };
    let Explained { texels, radiance, place, rows } = explained;
    let mut shown = vec![0.0; texels.len()];
    rows.taps.iter().for_each(|tap| shown[tap.texel as usize] += tap.weight);

    let sum = |row: usize, least: f32| -> f32 {
        let shown = rows.row(row).iter().map(|tap| (mean_of_channels(radiance[tap.texel as usize]), tap.weight));
        shown.filter(|(value, _)| *value > least).map(|(value, share)| value * share).sum()
    };
    let mut mixed = vec![Vec::new(); fusion.cameras.len()];
    for (row, &(view, pixel)) in place.iter().enumerate() {
        if sum(row, limit) > MIXED * sum(row, 0.0) {
            mixed[view].push(pixel);
        }
    }
    Ok(AroundSources { texels, shown, radiance: radiance.iter().map(Vec3::to_array).collect(), limit, mixed })
}

/// Pixels at light sources, and the texels that explain them.
pub(super) struct Explained {
    /// The texels that the pixels show.
    pub(super) texels: Vec<u32>,
    /// Radiance of these texels.
    pub(super) radiance: Vec<Vec3>,
    /// View of each pixel, and index in its image.
    place: Vec<(usize, usize)>,
    /// Shares of `texels` in each pixel.
    rows: SparseRows,
}

/// The texels that explain what pixels show, where these texels are `sources`.
pub(super) fn explained(
    fusion: &Fusion<'_>,
    looks: &SourcePixels,
    blended: &[Option<[f32; 3]>],
    (sources, connectivity): (&[bool], &Connectivity),
) -> Explained {
    let (mut number, mut texels) = (vec![NONE; blended.len()], Vec::new());
    let (mut place, mut seen, mut taps) = (Vec::new(), Vec::new(), Vec::new());
    for (at, look) in looks.each() {
        place.push(at);
        seen.push(look.radiance);
        let numbered = look.shares.iter().map(|tap| {
            let slot = &mut number[tap.texel as usize];
            if *slot == NONE {
                *slot = texels.len() as u32;
                texels.push(tap.texel);
            }
            Tap { texel: *slot, ..*tap }
        });
        taps.push(numbered.collect::<Vec<Tap>>());
    }
    let start: Vec<Option<Vec3>> = texels.iter().map(|&i| blended[i as usize].map(Vec3::from)).collect();
    let rows = SparseRows::from_lists(taps);
    let parts = parts_of_lamps(fusion, connectivity, sources, &texels, (&place, &rows));
    let start = explain_parts(&rows, &seen, start, &parts, inpaint::source_limit(blended));
    let radiance = richardson_lucy(&rows, &seen, &vec![Vec3::ZERO; rows.len()], &start, ITERATIONS);
    Explained { texels, radiance, place, rows }
}

/// What part of a light source a texel belongs to.
#[derive(Clone, Copy, PartialEq)]
enum Membership {
    /// In this smooth part of a lamp, of few pixels.
    Part(u32),
    /// In a part of a light source that fills many pixels.
    Resolved,
    /// In neither.
    Beside,
}

/// What each of the texels belongs to.
fn parts_of_lamps(
    fusion: &Fusion<'_>,
    connectivity: &Connectivity,
    sources: &[bool],
    texels: &[u32],
    (place, rows): (&[(usize, usize)], &SparseRows),
) -> Vec<Membership> {
    let part = |texel: usize| connectivity.part(fusion.atlas.points[texel].triangle);
    let mut counts: HashMap<u32, [u32; 2]> = HashMap::new();
    for (texel, source) in sources.iter().enumerate() {
        let [all, shining] = counts.entry(part(texel)).or_default();
        *all += 1;
        *shining += u32::from(*source);
    }
    let is_lamp = |part: &u32| {
        let [all, shining] = counts[part];
        shining as f32 >= PART_SOURCES * all as f32
    };
    let of = |&texel: &u32| Some(texel as usize).filter(|&t| sources[t]).map(part).filter(is_lamp);
    let parts: Vec<Option<u32>> = texels.iter().map(of).collect();
    let mut filled: HashMap<(u32, usize), f32> = HashMap::new();
    for (row, (view, _)) in place.iter().enumerate() {
        for tap in rows.row(row) {
            if let Some(part) = parts[tap.texel as usize] {
                *filled.entry((part, *view)).or_default() += tap.weight;
            }
        }
    }
    let large: HashSet<u32> =
        filled.iter().filter(|(_, pixels)| **pixels > PART_PIXELS).map(|((p, _), _)| *p).collect();
    let place = |part: Option<u32>| match part {
        Some(part) if large.contains(&part) => Membership::Resolved,
        Some(part) => Membership::Part(part),
        None => Membership::Beside,
    };
    parts.into_iter().map(place).collect()
}

/// Where texels start from: those of a part from the one radiance that explains the pixels best, the others from
/// `start`. What is beside parts is taken as it is in `start`, but below `limit` where it is no lamp: what glows there,
/// the lamp lends it.
fn explain_parts(
    rows: &SparseRows,
    seen: &[Vec3],
    mut start: Vec<Option<Vec3>>,
    parts: &[Membership],
    limit: f32,
) -> Vec<Option<Vec3>> {
    let mut number = HashMap::new();
    for part in parts {
        if let Membership::Part(part) = part {
            let new = number.len() as u32;
            number.entry(*part).or_insert(new);
        }
    }
    let dim = |t: u32| match (parts[t as usize], start[t as usize]) {
        (Membership::Resolved, Some(start)) => start,
        (_, Some(start)) => start * (limit / mean_of_channels(start).max(limit).max(BLACK)),
        (_, None) => Vec3::ZERO,
    };
    let of_parts = |row: usize| {
        let (mut taps, mut beside) = (Vec::new(), Vec3::ZERO);
        for tap in rows.row(row) {
            match parts[tap.texel as usize] {
                Membership::Part(part) => taps.push(Tap { texel: number[&part], ..*tap }),
                _ => beside += dim(tap.texel) * tap.weight,
            }
        }
        let shown: f32 = taps.iter().map(|tap| tap.weight).sum();
        merge(&mut taps);
        taps.iter_mut().for_each(|tap| tap.weight *= shown);
        (!taps.is_empty()).then_some((taps, (seen[row], beside)))
    };
    let (taps, pixels): (Vec<_>, Vec<_>) = (0..rows.len()).filter_map(of_parts).unzip();
    let (seen, beside): (Vec<Vec3>, Vec<Vec3>) = pixels.into_iter().unzip();
    let explained =
        richardson_lucy(&SparseRows::from_lists(taps), &seen, &beside, &vec![None; number.len()], PART_ITERATIONS);
    for (start, part) in start.iter_mut().zip(parts) {
        if let Membership::Part(part) = part {
            *start = Some(explained[number[part] as usize]);
        }
    }
    start
}

/// Richardson–Lucy: the texels whose means over `rows` are the pixels `seen` less what is known to be `beside` them,
/// from `start` (from what the pixels show, where there is none).
fn richardson_lucy(
    rows: &SparseRows,
    seen: &[Vec3],
    beside: &[Vec3],
    start: &[Option<Vec3>],
    iterations: usize,
) -> Vec<Vec3> {
    let columns = rows.transposed(start.len());
    let gather = |matrix: &SparseRows, values: &[Vec3]| -> Vec<Vec3> {
        let row = |i| matrix.row(i).iter().map(|tap| values[tap.texel as usize] * tap.weight).sum();
        (0..matrix.len()).into_par_iter().map(row).collect()
    };
    let total = gather(&columns, &vec![Vec3::ONE; rows.len()]);
    let mut texels = gather(&columns, seen);
    for ((texel, total), start) in texels.iter_mut().zip(&total).zip(start) {
        *texel = start.unwrap_or(*texel / *total);
    }
    for _ in 0..iterations {
        let shown = gather(rows, &texels);
        let quotient: Vec<Vec3> = seen
            .iter()
            .zip(beside)
            .zip(shown)
            .map(|((seen, beside), shown)| (seen + BLACK) / (beside + shown + BLACK))
            .collect();
        for (texel, (correction, total)) in texels.iter_mut().zip(gather(&columns, &quotient).iter().zip(&total)) {
            *texel *= (*correction + DAMPING) / (*total + DAMPING);
        }
    }
    texels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::hash2;

    #[test]
    fn the_rim_of_a_spot_that_pixels_show_together_with_its_face_stays_dark() {
        // Eight texels of a face that shines with 100, as many of its dark rim, and of the ceiling beside it. Pixels
        // are larger than all of the spot, off by up to 10 %, and the blend has given the spot's light to everything.
        const TEXELS: u32 = 8;
        let random = |pixel: u32, k: u32| hash2(pixel, k) as f32 / u32::MAX as f32;
        let (mut rows, mut seen) = (Vec::new(), Vec::new());
        for pixel in 0..60 {
            let shares = [0.1 + 0.4 * random(pixel, 0), 0.02 + 0.2 * random(pixel, 1)];
            let shares = [shares[0], shares[1], 1.0 - shares[0] - shares[1]];
            let mut taps = Vec::new();
            for (group, share) in (0..).zip(shares) {
                let first = hash2(pixel, 10 + group) % TEXELS;
                let texel = |k: u32| group * TEXELS + (first + k) % TEXELS;
                taps.extend((0..3).map(|k| Tap { texel: texel(k), weight: share / 3.0 }));
            }
            rows.push(taps);
            let noise = 1.0 + 0.2 * (random(pixel, 2) - 0.5);
            seen.push(Vec3::splat(noise * (100.0 * shares[0] + 0.5 * (shares[1] + shares[2]))));
        }
        let rows = SparseRows::from_lists(rows);
        let of_group =
            |values: [f32; 3]| (0..3 * TEXELS).map(|t| Some(Vec3::splat(values[(t / TEXELS) as usize]))).collect();
        let blended: Vec<Option<Vec3>> = of_group([40.0, 30.0, 5.0]);
        let places: Vec<Membership> = (0..3 * TEXELS)
            .map(|t| if t < 2 * TEXELS { Membership::Part(t / TEXELS) } else { Membership::Beside })
            .collect();
        let resolved = |start: &[Option<Vec3>]| {
            let radiance = richardson_lucy(&rows, &seen, &vec![Vec3::ZERO; seen.len()], start, ITERATIONS);
            let mean = |group: usize| {
                let texels = group * TEXELS as usize..(group + 1) * TEXELS as usize;
                radiance[texels].iter().map(|v| v.x).sum::<f32>() / TEXELS as f32
            };
            [mean(0), mean(1)]
        };
        let [face, rim] = resolved(&explain_parts(&rows, &seen, blended.clone(), &places, 2.0));
        assert!((face / 100.0 - 1.0).abs() < 0.05 && rim < 5.0, "face {face}, rim {rim}");
        // Negative control: texel by texel from the blend.
        let [face, rim] = resolved(&blended);
        assert!(rim > 10.0, "face {face}, rim {rim}");
    }

    #[test]
    fn black_stays_black() {
        let tap = |texel| Tap { texel, weight: 0.5 };
        let rows = SparseRows::from_lists([vec![tap(0), tap(1)]]);
        let black = vec![Some(Vec3::ZERO); 2];
        let start = explain_parts(&rows, &[Vec3::ZERO], black, &[Membership::Part(7), Membership::Beside], 0.0);
        assert!(
            start.iter().flatten().all(|radiance| radiance.max_element() < 1e-3 && radiance.is_finite()),
            "{start:?}"
        );
    }
}
