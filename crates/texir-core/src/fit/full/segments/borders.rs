//! Where semantic classes end on a flat surface.
//!
//! Segmentations end some pixels beside the edge that they mean, in most views on the same side of it: the wall along a
//! window is voted to be window, which nothing else on the wall is. Labels are therefore believed some way inside of
//! their borders only. From there they grow over what has the same colour.

use std::collections::VecDeque;

use crate::fit::adjacency::Adjacency;
use crate::fit::full::segments::colours::Colours;

/// How far from a border labels may be wrong, metres: two pixels of a panorama of 256 columns are a twentieth of the
/// distance, and rooms are some metres wide.
const UNSURE: f32 = 0.3;

/// The labels with borders moved to where the colour changes on the same flat `surface`. What is nowhere reached keeps
/// its label: a picture on a wall, a thing of its own surface. `texel` is the edge of a typical texel, metres.
pub fn settle(
    label: Vec<Option<u16>>,
    adjacency: &Adjacency,
    surface: &[u32],
    colours: &Colours,
    texel: f32,
) -> Vec<Option<u16>> {
    let on_surface = |t: u32| adjacency.around(t).filter(move |&n| surface[n as usize] == surface[t as usize]);
    let differ = |a: u32, b: u32| {
        let (a, b) = (label[a as usize], label[b as usize]);
        a.is_some() && b.is_some() && a != b
    };
    let mut sure = vec![true; label.len()];
    let mut ring: Vec<u32> = (0..label.len() as u32).filter(|&t| on_surface(t).any(|n| differ(t, n))).collect();
    for _ in 0..(UNSURE / texel).ceil() as usize {
        if ring.is_empty() {
            break;
        }
        ring.iter().for_each(|&t| sure[t as usize] = false);
        ring = ring.iter().flat_map(|&t| on_surface(t)).filter(|&n| sure[n as usize]).collect();
        ring.sort_unstable();
        ring.dedup();
    }
    let mut settled = label;
    let mut queue: VecDeque<u32> =
        (0..settled.len() as u32).filter(|&t| sure[t as usize] && settled[t as usize].is_some()).collect();
    while let Some(t) = queue.pop_front() {
        for n in on_surface(t) {
            let (t, n) = (t as usize, n as usize);
            if !sure[n] && settled[n].is_some() && colours.colour[n] == colours.colour[t] {
                sure[n] = true;
                settled[n] = settled[t];
                queue.push_back(n as u32);
            }
        }
    }
    settled
}

#[cfg(test)]
mod tests {
    use glam::Vec3A;

    use super::*;
    use crate::fit::full::segments::automatic::tests::{SIDE, TEXEL, floor_and_wall};
    use crate::fit::full::segments::surfaces::flat_surfaces;

    const FLOOR: u16 = 1;
    const RUG: u16 = 2;
    const SOFA: u16 = 3;
    const WALL: u16 = 4;
    const PICTURE: u16 = 5;

    /// A red rug of 2 × 1.5 m on a floor of 3 × 3 m, and a wall.
    fn truth(t: usize) -> u16 {
        match (t % SIDE, t / SIDE) {
            (_, SIDE..) => WALL,
            (10..50, 10..40) => RUG,
            _ => FLOOR,
        }
    }

    /// The share of texels whose label is the true one, of labels settled in a room with `colour` by truth.
    fn right(voted: impl Fn(usize) -> u16, colour: impl Fn(u16) -> Vec3A) -> f32 {
        let (atlas, adjacency) = floor_and_wall();
        let texels = 0..atlas.points.len();
        let albedo: Vec<Vec3A> = texels.clone().map(|t| colour(truth(t))).collect();
        let surface = flat_surfaces(&atlas, &adjacency);
        let colours = Colours::find(&adjacency, &surface, &albedo, |_| true, TEXEL);
        let voted = texels.clone().map(|t| Some(voted(t))).collect();
        let settled = settle(voted, &adjacency, &surface, &colours, TEXEL);
        texels.clone().filter(|&t| settled[t] == Some(truth(t))).count() as f32 / texels.len() as f32
    }

    fn red_rug(class: u16) -> Vec3A {
        if class == RUG { Vec3A::new(0.5, 0.1, 0.1) } else { Vec3A::splat(0.5) }
    }

    /// The rug reaches 15 cm too far, and 20 cm of the floor along the other sides are sofa, as is a spot of the wall.
    fn off(t: usize) -> u16 {
        match (t % SIDE, t / SIDE) {
            (7..53, 7..43) => RUG,
            (56.., 0..SIDE) => SOFA,
            (30..34, 80..84) => SOFA,
            _ => truth(t),
        }
    }

    #[test]
    fn borders_go_where_the_colour_changes() {
        let voted = (0..2 * SIDE * SIDE).filter(|&t| off(t) == truth(t)).count() as f32 / (2 * SIDE * SIDE) as f32;
        assert!(voted < 0.91, "{voted}");
        let settled = right(off, red_rug);
        assert!(settled > 0.99, "{settled}");
        // Negative control: a rug in the floor's colour is told by its votes alone, of which some are left.
        let grey = right(off, |_| Vec3A::splat(0.5));
        assert!((0.9..0.98).contains(&grey), "{grey}");
    }

    #[test]
    fn what_is_right_stays() {
        assert_eq!(right(truth, red_rug), 1.0);
        // A border without a change of colour stays where the votes have it.
        assert!(right(truth, |_| Vec3A::splat(0.5)) > 0.99);
    }

    #[test]
    fn a_small_thing_of_another_colour_keeps_its_label() {
        let (atlas, adjacency) = floor_and_wall();
        let surface = flat_surfaces(&atlas, &adjacency);
        let is_picture = |t: usize| matches!((t % SIDE, t / SIDE), (20..32, 80..90));
        let texels = || 0..atlas.points.len();
        let left = |paint: Vec3A| {
            let albedo: Vec<Vec3A> = texels().map(|t| if is_picture(t) { paint } else { Vec3A::splat(0.5) }).collect();
            let colours = Colours::find(&adjacency, &surface, &albedo, |_| true, TEXEL);
            let label = texels().map(|t| Some(if is_picture(t) { PICTURE } else { truth(t) })).collect();
            let settled = settle(label, &adjacency, &surface, &colours, TEXEL);
            texels().filter(|&t| is_picture(t) && settled[t] == Some(PICTURE)).count()
        };
        assert!(left(Vec3A::new(0.1, 0.1, 0.5)) > 100, "{}", left(Vec3A::new(0.1, 0.1, 0.5)));
        // Negative control: nothing tells this one from borders that are wrong.
        assert_eq!(left(Vec3A::splat(0.5)), 0);
    }
}
