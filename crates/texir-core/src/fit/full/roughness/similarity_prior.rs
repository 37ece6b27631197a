//! Similarity prior: the roughness to expect of a segment whose own pixels say little.
//!
//! Materials go with appearance more than with class. The rod of a curtain is wood or metal, like the legs of tables
//! and unlike the cloth that hangs from it; the frame of a bed is not its mattress. A segment's roughness is predicted
//! from all others', weighted by their trust and by similarity in colour, class and room: kernel regression (Nadaraya,
//! "On Estimating Regression", 1964; Watson, "Smooth Regression Analysis", 1964) of ln r.

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use super::prior::Prior;
use crate::fit::full::albedo::palette::log;
use crate::fit::full::partition::Partition;
use crate::fit::settings::{RoughnessSettings, SimilaritySettings};

/// Seen texels from which on the colour of a segment is known.
const COLOUR_TEXELS: u32 = 20;
/// Similarity of any two segments, at least.
const BASE_SIMILARITY: f32 = 1e-3;
/// Sum of weights at which the prior has half of its pseudo-count.
const ENOUGH: f32 = 0.1;
/// Segments that predict others, at most: those of most trust. Scans may have a hundred thousand.
const MAX_SAMPLES: usize = 4096;

/// What is known of a segment.
#[derive(Clone, Copy, Debug)]
pub struct SegmentSummary {
    /// Its semantic class.
    pub class: u16,
    /// Number of that class in its room.
    pub class_in_room: u32,
    /// The logarithm of its mean albedo, where enough of it is seen.
    pub colour: Option<Vec3A>,
    /// Its roughness by its own pixels.
    pub roughness: f32,
    /// How far that is trusted, 0 to 1.
    pub trust: f32,
}

/// The similarity prior of every segment: the kernel-weighted mean of the others' roughness, in ln r, with the weight
/// of up to `segment_pixels` pixels, fewer where none is similar; [`RoughnessSettings::prior_mean`] without any
/// evidence.
pub fn priors(segments: &[SegmentSummary], settings: &RoughnessSettings) -> Vec<Prior> {
    let mut samples: Vec<(usize, &SegmentSummary)> =
        segments.iter().enumerate().filter(|(_, known)| known.trust > 0.0).collect();
    if samples.len() > MAX_SAMPLES {
        samples.sort_by(|(_, a), (_, b)| b.trust.total_cmp(&a.trust));
        samples.truncate(MAX_SAMPLES);
    }
    let expected = |(i, own): (usize, &SegmentSummary)| {
        let others = samples.iter().filter(|(j, _)| *j != i);
        let (sum, weight) = others.fold((0.0, 0.0), |(sum, weight), (_, other)| {
            let w = other.trust * (similarity(own, other, &settings.similarity) + BASE_SIMILARITY);
            (sum + w * other.roughness.ln(), weight + w)
        });
        let roughness = if weight > 0.0 { (sum / weight).exp() } else { settings.prior_mean };
        Prior::pseudo_pixels(roughness, settings.segment_pixels * weight / (weight + ENOUGH))
    };
    segments.par_iter().enumerate().map(expected).collect()
}

/// Weight of one segment in another's prediction, apart from trust; 1 for two of one class, room and colour.
fn similarity(a: &SegmentSummary, b: &SegmentSummary, settings: &SimilaritySettings) -> f32 {
    let by_label = match (a.class == b.class, a.class_in_room == b.class_in_room) {
        (_, true) => 1.0,
        (true, false) => settings.other_room,
        (false, false) => settings.other_class,
    };
    let by_colour = match (a.colour, b.colour) {
        (Some(a), Some(b)) => (-0.5 * a.distance_squared(b) / settings.colour_sigma.powi(2)).exp(),
        _ => 1.0,
    };
    by_label * by_colour
}

/// The logarithm of each segment's mean albedo, over the texels that are seen.
pub fn colours(segment: Partition<'_>, albedo: &[Vec3A], is_seen: &[bool]) -> Vec<Option<Vec3A>> {
    let mut sums = vec![(DVec3::ZERO, 0_u32); segment.count];
    for ((s, a), _) in segment.of.iter().zip(albedo).zip(is_seen).filter(|(_, seen)| **seen) {
        let (sum, count) = &mut sums[*s as usize];
        *sum += a.as_dvec3();
        *count += 1;
    }
    let mean = |(sum, count): (DVec3, u32)| (count >= COLOUR_TEXELS).then(|| log((sum / f64::from(count)).as_vec3a()));
    sums.into_iter().map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLOTH: Vec3A = Vec3A::new(0.6, 0.6, 0.55);
    const WOOD: Vec3A = Vec3A::new(0.3, 0.18, 0.1);
    const CURTAIN: u16 = 1;
    const TABLE: u16 = 2;

    fn known(class: u16, room: u32, albedo: Vec3A, roughness: f32) -> SegmentSummary {
        SegmentSummary {
            class,
            class_in_room: 10 * room + u32::from(class),
            colour: Some(log(albedo)),
            roughness,
            trust: 1.0,
        }
    }

    fn unknown(class: u16, room: u32, colour: Option<Vec3A>) -> SegmentSummary {
        SegmentSummary { colour: colour.map(log), trust: 0.0, ..known(class, room, CLOTH, 0.03) }
    }

    /// What is expected of one more segment.
    fn expected(others: &[SegmentSummary], asked: SegmentSummary, settings: &RoughnessSettings) -> Prior {
        let all: Vec<SegmentSummary> = others.iter().copied().chain([asked]).collect();
        *priors(&all, settings).last().unwrap()
    }

    #[test]
    fn a_rod_is_like_wood_and_not_like_the_curtain_that_it_is_called() {
        let others = [known(CURTAIN, 0, CLOTH, 0.85), known(TABLE, 0, WOOD, 0.3), known(TABLE, 1, CLOTH, 0.5)];
        let of = |class, room, colour| {
            expected(&others, unknown(class, room, colour), &RoughnessSettings::default()).roughness
        };
        let rod = of(CURTAIN, 0, Some(WOOD * 1.1));
        let cloth = of(CURTAIN, 0, Some(CLOTH * 0.9));
        let hidden = of(CURTAIN, 0, None);
        let upstairs = of(TABLE, 1, Some(CLOTH));
        assert!((rod - 0.3).abs() < 0.03 && cloth > 0.75, "{rod} {cloth}");
        // Of what is not seen nothing is known but what it is called.
        assert!((0.6..cloth).contains(&hidden) && (0.5..0.6).contains(&upstairs), "{hidden} {upstairs}");
        // Negative control: where colours say nothing, the rod is a curtain.
        let blind = SimilaritySettings { colour_sigma: 1e3, ..SimilaritySettings::default() };
        let blind = RoughnessSettings { similarity: blind, ..RoughnessSettings::default() };
        let rod = expected(&others, unknown(CURTAIN, 0, Some(WOOD)), &blind).roughness;
        assert!((rod - hidden).abs() < 1e-3, "{rod} {hidden}");
    }

    #[test]
    fn nobody_speaks_for_himself_and_strangers_hardly_for_others() {
        let settings = RoughnessSettings::default();
        let nothing = expected(&[unknown(CURTAIN, 0, None)], unknown(TABLE, 0, Some(WOOD)), &settings);
        assert_eq!((nothing.roughness, nothing.pseudo_count), (settings.prior_mean, 0.0));
        let [first, second] = [known(TABLE, 0, WOOD, 0.2), known(TABLE, 0, WOOD, 0.8)];
        let twin = expected(&[first], second, &settings);
        assert!((twin.roughness - 0.2).abs() < 1e-6 && twin.pseudo_count > 0.9 * settings.segment_pixels, "{twin:?}");
        let stranger = expected(&[known(CURTAIN, 0, CLOTH, 0.85)], second, &settings);
        assert!(stranger.roughness > 0.8 && stranger.pseudo_count < 0.02 * settings.segment_pixels, "{stranger:?}");
        // Less trust, less weight.
        let faint = SegmentSummary { trust: 0.01, ..second };
        let third = expected(&[first, faint], unknown(TABLE, 0, Some(WOOD)), &settings).roughness;
        assert!((third - 0.2).abs() < 0.01, "{third}");
    }

    #[test]
    fn of_very_many_those_speak_that_are_believed_most() {
        let settings = RoughnessSettings::default();
        let sure = SegmentSummary { trust: 0.9, ..known(TABLE, 0, WOOD, 0.2) };
        let unsure = SegmentSummary { trust: 0.5, ..known(TABLE, 0, WOOD, 0.8) };
        let mut all = vec![unsure; MAX_SAMPLES];
        all.extend(vec![sure; MAX_SAMPLES]);
        all.push(unknown(TABLE, 0, Some(WOOD)));
        assert!((priors(&all, &settings).last().unwrap().roughness - 0.2).abs() < 1e-3);
        // Negative control: of a few less, all do.
        let few: Vec<SegmentSummary> = all[MAX_SAMPLES / 2..].iter().step_by(2).copied().collect();
        assert!(priors(&few, &settings).last().unwrap().roughness > 0.25);
    }

    #[test]
    fn colours_are_those_of_what_is_seen() {
        let segment: Vec<u32> = (0..100).map(|t| t / 50).collect();
        let is_seen: Vec<bool> = (0..100).map(|t| t < 25 || (50..55).contains(&t)).collect();
        let albedo: Vec<Vec3A> = is_seen.iter().map(|seen| if *seen { WOOD } else { CLOTH }).collect();
        let found = colours(Partition { of: &segment, count: 2 }, &albedo, &is_seen);
        assert!((found[0].unwrap() - log(WOOD)).abs().max_element() < 1e-5);
        assert_eq!(found[1], None);
    }

    /// Four million texels of one colour, which sums in f32 miss by per cents.
    #[test]
    fn colours_of_large_segments_are_exact() {
        const TEXELS: usize = 1 << 22;
        let found =
            colours(Partition { of: &vec![0; TEXELS], count: 1 }, &vec![WOOD; TEXELS], &vec![true; TEXELS])[0].unwrap();
        assert!((found - log(WOOD)).abs().max_element() < 1e-6, "{found}");
        let running = (0..TEXELS).fold(Vec3A::ZERO, |sum, _| sum + WOOD) / TEXELS as f32;
        assert!((log(running) - log(WOOD)).abs().max_element() > 0.01, "{running}");
    }
}
