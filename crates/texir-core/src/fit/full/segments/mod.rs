//! From labels per pixel to segments on the surface: connected regions of one class in one room, and of one paint.

mod automatic;
mod borders;
mod colours;
pub mod hidden;
pub mod labels;
mod paints;
mod surfaces;
mod votes;

use std::collections::{HashMap, VecDeque};

use glam::{Vec3, Vec3A};
use rayon::prelude::*;

use self::colours::Colours;
use self::labels::Labels;
use crate::atlas::Atlas;
use crate::fit::adjacency::Adjacency;
use crate::fit::full::partition::Partition;
use crate::rooms::FloorPlan;

/// Pieces of a segment that are smaller, square metres, are no faces of their own.
const SMALLEST_FACE: f32 = 0.1;

/// Connected regions of one class in one room, divided by their [`paints`], and numbered from 0. The back of something
/// thin is connected with its front.
pub struct Segments {
    /// That of every valid texel.
    pub segment: Vec<u32>,
    /// The flat piece of its segment that every valid texel is in: one wall of those around a room. Small pieces of a
    /// segment count as one.
    pub face: Vec<u32>,
    /// Semantic class of each segment; 0 is "unknown".
    pub class: Vec<u16>,
    /// Class within a room of each segment, numbered from 0; parts of another paint each by themselves.
    pub class_in_room: Vec<u32>,
}

impl Segments {
    /// How many there are.
    pub fn count(&self) -> usize {
        self.class.len()
    }

    /// Which of them every texel is in.
    pub fn partition(&self) -> Partition<'_> {
        Partition { of: &self.segment, count: self.count() }
    }

    /// What every texel has of its segment's.
    pub fn of_texels<T: Copy>(&self, values: &[T]) -> Vec<T> {
        self.segment.iter().map(|s| values[*s as usize]).collect()
    }

    /// What every segment is painted after where it is not known itself: itself, if it is `known` anywhere; else the
    /// best known one of its class, in its room if there is one. `known` has a value per texel.
    pub fn exemplars(&self, known: impl Fn(usize) -> bool) -> Vec<u32> {
        let mut texels = vec![0u32; self.count()];
        (0..self.segment.len()).filter(|t| known(*t)).for_each(|t| texels[self.segment[t] as usize] += 1);
        let best = |key: &dyn Fn(usize) -> u32| {
            let mut best: HashMap<u32, usize> = HashMap::new();
            for s in (0..self.count()).filter(|s| texels[*s] > 0) {
                let kept = best.entry(key(s)).or_insert(s);
                if texels[s] > texels[*kept] {
                    *kept = s;
                }
            }
            best
        };
        let (in_room, anywhere) = (best(&|s| self.class_in_room[s]), best(&|s| u32::from(self.class[s])));
        let model = |s: usize| match texels[s] {
            0 => *in_room.get(&self.class_in_room[s]).or(anywhere.get(&u32::from(self.class[s]))).unwrap_or(&s),
            _ => s,
        };
        (0..self.count()).map(|s| model(s) as u32).collect()
    }
}

/// Segments the texels by the labels that the views voted for, with borders where the colour changes ([`borders`]);
/// where views have no classes, by geometry and colour alone ([`automatic`]). Texels around which there are none take
/// the label of the other side, if they are the back of something thin, or of what is seen of their flat surface, or of
/// the nearest texel along the mesh. Rooms are the capture's, where it names them, and else the floor plan's. Regions of
/// several [`paints`] are divided. `albedo` may be as rough as π · radiance / irradiance; `texel` is the edge of a typical
/// texel, metres.
pub fn segment(
    (atlas, texel): (&Atlas, f32),
    adjacency: &Adjacency,
    labels: &Labels,
    is_seen: &[bool],
    albedo: &[Vec3A],
    plan: &FloorPlan,
) -> Segments {
    let everywhere = |known: &[Option<u16>], otherwise: &dyn Fn(usize) -> u16| {
        spread(hidden::label(atlas, &labels.surface, known, texel), adjacency, otherwise)
    };
    let seen = |t: usize| is_seen[t];
    let colours = Colours::find(adjacency, &labels.surface, albedo, seen, texel);
    let mut known = if labels.has_classes() {
        borders::settle(labels.class.clone(), adjacency, &labels.surface, &colours, texel)
    } else {
        automatic::classes((atlas, texel), adjacency, &labels.surface, &colours, seen)
    };
    drop(colours);
    let of_fronts: Vec<Option<u16>> = labels.backs.iter().map(|[_, front]| known[*front as usize]).collect();
    for ([back, _], class) in labels.backs.iter().zip(of_fronts) {
        known[*back as usize] = known[*back as usize].or(class);
    }
    let class = everywhere(&known, &|_| 0);
    let planned: Vec<u16> =
        atlas.points.par_iter().map(|p| plan.room_of(Vec3::from(p.position), Vec3::from(p.normal))).collect();
    let room =
        if labels.room.iter().all(Option::is_none) { planned } else { everywhere(&labels.room, &|i| planned[i]) };
    let in_room: Vec<(u16, u16)> = class.into_iter().zip(room).collect();
    let (segment, count) = adjacency.regions(&labels.backs, |a, b| in_room[a as usize] == in_room[b as usize]);
    let face = faces(
        Partition { of: &segment, count },
        &labels.surface,
        adjacency,
        (SMALLEST_FACE / (texel * texel)) as usize,
    );
    let undivided = count as u32;
    let (segment, count) = paints::divide(Partition { of: &segment, count }, &face, albedo, seen, texel);
    // Parts of another paint are a class in the room by themselves: no mean of two materials is a prior to either.
    let part = |s: u32| if s < undivided { 0 } else { s };
    let mut of_segment = vec![(0, 0, 0); count];
    segment.iter().zip(in_room).for_each(|(s, (class, room))| of_segment[*s as usize] = (class, room, part(*s)));
    let mut kinds = of_segment.clone();
    kinds.sort_unstable();
    kinds.dedup();
    let number = |kind: &(u16, u16, u32)| kinds.partition_point(|k| k < kind) as u32;
    Segments {
        segment,
        face,
        class: of_segment.iter().map(|(class, ..)| *class).collect(),
        class_in_room: of_segment.iter().map(number).collect(),
    }
}

/// Flat pieces of segments that have at least so many texels; what is left of each segment is one more. Bumps of a scan
/// leave nothing else of it.
fn faces(segment: Partition<'_>, surface: &[u32], adjacency: &Adjacency, least: usize) -> Vec<u32> {
    let of = |t: u32| (segment.of[t as usize], surface[t as usize]);
    let (piece, count) = adjacency.regions(&[], |a, b| of(a) == of(b));
    let mut texels = vec![0; count];
    piece.iter().for_each(|p| texels[*p as usize] += 1);
    let mut numbers = segment.count as u32..;
    let large: Vec<Option<u32>> =
        texels.iter().map(|texels| if *texels >= least { numbers.next() } else { None }).collect();
    let of_texel = |(p, s): (&u32, &u32)| large[*p as usize].unwrap_or(*s);
    piece.iter().zip(segment.of).map(of_texel).collect()
}

/// Fills the gaps breadth first along the surface; `otherwise` labels what is connected to nothing known.
pub(super) fn spread(known: Vec<Option<u16>>, adjacency: &Adjacency, otherwise: impl Fn(usize) -> u16) -> Vec<u16> {
    let mut labels = known;
    let mut queue: VecDeque<u32> = (0..labels.len() as u32).filter(|&i| labels[i as usize].is_some()).collect();
    while let Some(i) = queue.pop_front() {
        let label = labels[i as usize];
        for n in adjacency.around(i) {
            if labels[n as usize].is_none() {
                labels[n as usize] = label;
                queue.push_back(n);
            }
        }
    }
    labels.into_iter().enumerate().map(|(i, label)| label.unwrap_or_else(|| otherwise(i))).collect()
}

#[cfg(test)]
mod tests {
    use self::automatic::tests::{SIDE, floor_and_wall};
    use super::*;
    use crate::fit::index::NONE;

    /// A strip of texels, each beside the next.
    fn strip(count: u32) -> Adjacency {
        let beside = (0..count)
            .map(|i| [if i > 0 { i - 1 } else { NONE }, if i + 1 < count { i + 1 } else { NONE }, NONE, NONE])
            .collect();
        Adjacency::of(beside, Vec::new())
    }

    #[test]
    fn texels_that_no_pixel_sees_take_their_neighbours_label() {
        let known = |texel| [Some(1), None, Some(2)][usize::from(texel > 3) + usize::from(texel > 5)];
        let labels = spread((0..10).map(known).collect(), &strip(10), |_| 0);
        assert_eq!(labels, [1, 1, 1, 1, 1, 2, 2, 2, 2, 2]);
        let (segments, count) = strip(10).regions(&[], |a, b| labels[a as usize] == labels[b as usize]);
        assert_eq!((segments[0], segments[9], count), (0, 1, 2));
    }

    #[test]
    fn unseen_segments_are_painted_after_their_kind_in_their_room_first() {
        // Class and room: a known chair, a hidden one beside it, one in another room, a larger known one there, a lamp.
        let segments = Segments {
            segment: vec![0, 0, 1, 2, 3, 3, 3, 4],
            face: vec![0; 8],
            class: vec![1, 1, 1, 1, 2],
            class_in_room: vec![0, 0, 1, 2, 3],
        };
        let hidden = [2, 3, 7];
        assert_eq!(segments.exemplars(|t| !hidden.contains(&t)), [0, 0, 3, 3, 4]);
        assert_eq!(segments.exemplars(|_| true), [0, 1, 2, 3, 4]);
    }

    #[test]
    fn faces_end_at_creases_and_where_segments_do_and_small_ones_are_one() {
        let (atlas, adjacency) = floor_and_wall();
        let surface = surfaces::flat_surfaces(&atlas, &adjacency);
        let texels = atlas.points.len();
        let (floor, wall) = (0..SIDE * SIDE, SIDE * SIDE..texels);
        let one = vec![0; texels];
        let found = faces(Partition { of: &one, count: 1 }, &surface, &adjacency, 100);
        assert!(found[floor.clone()].iter().all(|f| *f == found[0]));
        assert!(found[wall.clone()].iter().all(|f| *f == found[texels - 1]) && found[0] != found[texels - 1]);
        // Another segment takes half of the floor.
        let two: Vec<u32> = (0..texels).map(|t| u32::from(t < SIDE * SIDE / 2)).collect();
        let found = faces(Partition { of: &two, count: 2 }, &surface, &adjacency, 100);
        assert!(found[0] != found[SIDE * SIDE - 1] && found[SIDE * SIDE - 1] != found[texels - 1]);
        // A floor of bumps is one all the same, and not the wall.
        let bumps: Vec<u32> =
            (0..texels as u32).map(|t| if wall.contains(&(t as usize)) { u32::MAX } else { t }).collect();
        let found = faces(Partition { of: &one, count: 1 }, &bumps, &adjacency, 100);
        assert!(found[floor].iter().all(|f| *f == found[0]) && found[0] != found[texels - 1]);
    }
}
