//! Materials of what no view sees: those of what is seen of the same segment, so that it can be shown once the sofa is
//! moved. What is seen so badly that it comes out as no material could be is treated alike.

use glam::Vec3A;

use crate::atlas::Atlas;
use crate::fit::full::partition::Partition;
use crate::inpaint;

/// Reflectance of what nothing is known of: photographers' grey card.
const MIDDLE_GREY: f32 = 0.18;
/// Of a segment, the share of light sources above which they are a thing of their own.
const MUCH: f64 = 0.1;

/// Bounds of what diffuse albedo surfaces have in a channel: soot reflects 3 %, fresh snow 95 %.
const DARKEST: f32 = 0.005;
const BRIGHTEST: f32 = 0.97;
/// Share of a segment's texels up to which those outside are errors.
const FEW: f64 = 0.1;

/// Texels whose albedo no surface has, black as soot or whiter than snow in a channel: what is left there is the error
/// of the one pixel that sees them. Where much of a segment is like that, it is another matter, and they stay.
pub fn outliers(albedo: &[Vec3A], segment: Partition<'_>) -> Vec<bool> {
    let outlier = |a: &Vec3A| a.min_element() < DARKEST || a.max_element() > BRIGHTEST;
    let mut counts = vec![[0u32; 2]; segment.count];
    for (a, &s) in albedo.iter().zip(segment.of) {
        counts[s as usize][0] += 1;
        counts[s as usize][1] += u32::from(outlier(a));
    }
    let few = |s: u32| f64::from(counts[s as usize][1]) < FEW * f64::from(counts[s as usize][0]);
    albedo.iter().zip(segment.of).map(|(a, &s)| outlier(a) && few(s)).collect()
}

/// Gives light sources that make up much of their segment middle grey: what their light hides nobody knows, and what is
/// around them (a window's frame, whatever has the lamp's class elsewhere) is not made of it. Fewer are spots of the
/// surface that they are on.
pub fn grey_sources(segment: Partition<'_>, is_source: impl Fn(usize) -> bool, albedo: &mut [Vec3A]) {
    let mut counts = vec![[0u32; 2]; segment.count];
    for (t, &s) in segment.of.iter().enumerate() {
        counts[s as usize][usize::from(is_source(t))] += 1;
    }
    let much = |[others, sources]: [u32; 2]| f64::from(sources) > MUCH * f64::from(others + sources);
    let grey = |t: usize| is_source(t) && much(counts[segment.of[t] as usize]);
    albedo.iter_mut().enumerate().filter(|(t, _)| grey(*t)).for_each(|(_, a)| *a = Vec3A::splat(MIDDLE_GREY));
}

/// Albedo and roughness of hidden texels: those near in their segment.
pub fn inpaint_materials(
    atlas: &Atlas,
    segment: &[u32],
    seen: impl Fn(usize) -> bool + Sync,
    (albedo, roughness): (&mut [Vec3A], &mut [f32]),
    texel: f32,
) {
    let fill = |value: &dyn Fn(usize) -> [f32; 3]| {
        let known: Vec<_> = (0..segment.len()).map(|t| seen(t).then(|| value(t))).collect();
        inpaint::fill_groups(&atlas.points, segment, &known, |_| true, texel)
    };
    let filled = fill(&|t| albedo[t].to_array());
    albedo.iter_mut().zip(filled).for_each(|(albedo, filled)| *albedo = Vec3A::from(filled));
    let filled = fill(&|t| [roughness[t]; 3]);
    roughness.iter_mut().zip(filled).for_each(|(roughness, [filled, ..])| *roughness = filled);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::full::segments::hidden::tests::{SIDE, TEXEL, floor_and_shelf, seen};

    #[test]
    fn single_texels_of_no_possible_albedo_are_outliers() {
        let segment: Vec<u32> = (0..200).map(|t| t / 100).collect();
        let mut albedo = vec![Vec3A::new(0.5, 0.2, 0.1); 200];
        albedo[3] = Vec3A::new(0.3, 0.0, 0.0);
        albedo[70] = Vec3A::new(1.0, 0.9, 0.9);
        // The second segment is a red that pictures show without any blue.
        albedo[100..].iter_mut().for_each(|a| a.z = 0.0);
        let found: Vec<usize> = outliers(&albedo, Partition { of: &segment, count: 2 })
            .iter()
            .enumerate()
            .filter(|(_, o)| **o)
            .map(|(t, _)| t)
            .collect();
        assert_eq!(found, [3, 70]);
    }

    #[test]
    fn sources_are_grey_where_they_are_a_thing_of_their_own() {
        let segment: Vec<u32> = (0..200).map(|t| t / 100).collect();
        let wall = Vec3A::new(0.6, 0.5, 0.4);
        let mut albedo = vec![wall; 200];
        // Half of a window, and a spot on a ceiling.
        grey_sources(Partition { of: &segment, count: 2 }, |t| t < 50 || (150..155).contains(&t), &mut albedo);
        let expected = |t: usize| if t < 50 { Vec3A::splat(0.18) } else { wall };
        albedo.iter().enumerate().for_each(|(t, a)| assert_eq!(*a, expected(t), "texel {t}"));
    }

    #[test]
    fn hidden_texels_are_painted_as_their_segment_is_around_them() {
        let atlas = floor_and_shelf();
        let segment: Vec<u32> = atlas.points.iter().map(|p| p.triangle).collect();
        let seen_at_all = |t: usize| seen(t).is_some();
        // Brown and half rough to the left, darker and smoother to the right; nonsense where nothing is seen.
        let truth = |t: usize| if t % SIDE < SIDE / 2 { ([0.4, 0.3, 0.2], 0.5) } else { ([0.2, 0.15, 0.1], 0.3) };
        let value = |t: usize| if seen_at_all(t) { truth(t) } else { ([1.0, 0.0, 1.0], 0.9) };
        let mut albedo: Vec<Vec3A> = (0..segment.len()).map(|t| Vec3A::from(value(t).0)).collect();
        let mut roughness: Vec<f32> = (0..segment.len()).map(|t| value(t).1).collect();
        inpaint_materials(&atlas, &segment, seen_at_all, (&mut albedo, &mut roughness), TEXEL);
        for t in (0..SIDE * SIDE).filter(|&t| !seen_at_all(t)) {
            let (a, r) = (albedo[t], roughness[t]);
            assert!((0.19..0.41).contains(&a.x) && (a.y / a.x - 0.75).abs() < 0.01, "texel {t}: {a}");
            assert!((0.29..0.51).contains(&r), "texel {t}: {r}");
        }
        let left = 20 * SIDE + 12;
        assert!((albedo[left].x - 0.4).abs() < 0.01 && (roughness[left] - 0.5).abs() < 0.01);
    }
}
