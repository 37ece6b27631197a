//! From evidence per pixel to roughness per texel: shrinkage along a hierarchy of ever smaller groups.
//!
//! Each group takes the roughness that explains its n pixels best, shrunk to its priors: the minimum over r of ln(mean
//! cost(r)) + Σ (weight + n_prior/n) · (2 (r − r_prior))², for a segment plus the penalty on its albedo's variation
//! ([`super::variation`]). The logarithm makes the first term a profile likelihood, the residuals' scale being unknown:
//! pixels that no roughness explains well count little. It does not grow with n; more pixels only shrink n_prior/n,
//! while constant weights stay, since errors here (irradiance, the BRDF model) are systematic and do not average out.
//! Distances are in r, in which steps look alike: in ln r, a mirror would be further from what lies between it and
//! chalk than chalk is.

use glam::Vec3A;

use super::evidence::Tally;
use super::prior::{Prior, shrink};
use super::similarity_prior::{self, SegmentSummary};
use crate::fit::full::segments::Segments;
use crate::fit::settings::RoughnessSettings;

/// Roughness of every segment: everything → class → class in a room → segment, which has the similarity prior besides.
/// `tallies` are the segments', `colours` their [`similarity_prior::colours`].
pub fn of_segments(
    segments: &Segments,
    tallies: &[Tally],
    colours: &[Option<Vec3A>],
    settings: &RoughnessSettings,
) -> Vec<f32> {
    let s = settings;
    let class_of = |i: usize| usize::from(segments.class[i]);
    let room_of = |i: usize| segments.class_in_room[i] as usize;
    let all = shrink(&[Tally::sum(tallies.iter())], &[[Prior::weighted(s.prior_mean, s.class_prior)]])[0];
    let classes = summed(tallies, class_of);
    let class = shrink(&classes, &vec![[Prior::weighted(all, s.class_prior)]; classes.len()]);
    let rooms = summed(tallies, room_of);
    let mut parent = vec![[Prior::weighted(all, s.room_prior)]; rooms.len()];
    (0..tallies.len()).for_each(|i| parent[room_of(i)] = [Prior::weighted(class[class_of(i)], s.room_prior)]);
    let room = shrink(&rooms, &parent);

    let of_room: Vec<Prior> = (0..tallies.len()).map(|i| Prior::weighted(room[room_of(i)], s.segment_prior)).collect();
    let alone = shrink(tallies, &of_room.iter().map(|room| [*room]).collect::<Vec<_>>());
    let known = |i: usize| SegmentSummary {
        class: segments.class[i],
        class_in_room: segments.class_in_room[i],
        colour: colours[i],
        roughness: alone[i].min(s.cap),
        trust: tallies[i].pixels as f32 / (tallies[i].pixels as f32 + s.segment_pixels),
    };
    let known: Vec<SegmentSummary> = (0..tallies.len()).map(known).collect();
    let priors: Vec<[Prior; 2]> =
        of_room.into_iter().zip(similarity_prior::priors(&known, s)).map(|(room, similar)| [room, similar]).collect();
    shrink(tallies, &priors).into_iter().map(|r| r.min(s.cap)).collect()
}

/// Tallies of larger groups: `of` is the group that each belongs to.
fn summed(tallies: &[Tally], of: impl Fn(usize) -> usize) -> Vec<Tally> {
    let groups = (0..tallies.len()).map(&of).max().map_or(0, |last| last + 1);
    let mut sums = vec![Tally::default(); groups];
    tallies.iter().enumerate().for_each(|(i, tally)| sums[of(i)].merge(tally));
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::specular_table::node;

    #[test]
    fn segments_without_evidence_take_what_is_nearest_to_them_in_the_hierarchy() {
        // A segment that nothing is known of, one of its class in its room, one of its class elsewhere, and one of another
        // class.
        let segments =
            Segments { segment: vec![], face: vec![], class: vec![1, 1, 1, 2], class_in_room: vec![0, 0, 1, 2] };
        let asking = |roughness: f32| {
            let cost = std::array::from_fn(|k| 1e4 * f64::from(1e-4 + (node(k) - roughness).powi(2)));
            Tally { cost, pixels: 1e4, ..Tally::default() }
        };
        let settings = RoughnessSettings::default();
        let found = |of: [f32; 3]| {
            let tallies = [Tally::default(), asking(of[0]), asking(of[1]), asking(of[2])];
            of_segments(&segments, &tallies, &[None; 4], &settings)
        };
        let [unknown, room, elsewhere, other] = found([0.3, 0.6, 0.7])[..] else { panic!() };
        assert!((room - 0.3).abs() < 0.02 && (elsewhere - 0.6).abs() < 0.02 && (other - 0.7).abs() < 0.02);
        assert!((0.29..0.42).contains(&unknown), "{unknown} in a room where its class has 0.3, and 0.6 in another");
        // Nothing is as rough as chalk by what pixels alone say.
        assert_eq!(found([1.0, 0.6, 0.7])[1], settings.cap);
    }
}
