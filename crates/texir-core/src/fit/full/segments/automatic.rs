//! Classes for captures without semantics: regions of one colour on flat surfaces, those of like colour that face alike
//! being one class.
//!
//! Where semantics tell what things are, geometry and colour tell where one thing ends.

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use crate::atlas::Atlas;
use crate::fit::adjacency::Adjacency;
use crate::fit::full::albedo::palette::Palettes;
use crate::fit::full::partition::Partition;
use crate::fit::full::segments::colours::Colours;
use crate::fit::settings::PaletteSettings;

/// Colours of all regions, by which they are classes.
const IN_THE_SCENE: PaletteSettings =
    PaletteSettings { bandwidth: 0.08, colours: 20, min_share: 0.002, strength: 0.0, reach: 1.0 };
/// Regions that are smaller, square metres, and not the largest of their surface, are part of what surrounds them.
const SMALLEST: f32 = 0.1;
/// A region faces where its mean normal points, if that is at least so long.
const FACES: f32 = 0.7;

/// What a region is like: sums over its texels, in double precision, as single precision would stop growing.
#[derive(Clone, Copy, Default)]
struct Region {
    texels: u32,
    colour: DVec3,
    normal: DVec3,
}

impl Region {
    fn mean_colour(&self) -> Vec3A {
        (self.colour / f64::from(self.texels.max(1))).as_vec3a()
    }

    /// Up, down, sideways, or all around.
    fn facing(&self) -> u16 {
        let normal = (self.normal / f64::from(self.texels.max(1))).as_vec3a();
        match normal.z {
            z if z > FACES => 0,
            z if z < -FACES => 1,
            _ if normal.length() > FACES => 2,
            _ => 3,
        }
    }
}

/// The class of every texel that is `seen`, apart from those of small regions. `surface` tells flat surfaces apart,
/// `colours` what they are painted in; `texel` is the edge of a typical texel, metres.
pub fn classes(
    (atlas, texel): (&Atlas, f32),
    adjacency: &Adjacency,
    surface: &[u32],
    Colours { albedo, colour }: &Colours,
    seen: impl Fn(usize) -> bool + Sync,
) -> Vec<Option<u16>> {
    let together = |a: u32, b: u32| {
        let (a, b) = (a as usize, b as usize);
        surface[a] == surface[b] && seen(a) && seen(b) && colour[a] == colour[b]
    };
    let (of, count) = adjacency.regions(&[], together);

    let mut regions = vec![Region::default(); count];
    let surfaces = surface.iter().max().map_or(0, |last| *last as usize + 1);
    let mut largest = vec![(0_u32, 0_u32); surfaces];
    for (t, &r) in of.iter().enumerate().filter(|(t, _)| seen(*t)) {
        let region = &mut regions[r as usize];
        region.texels += 1;
        region.colour += albedo[t].as_dvec3();
        region.normal += Vec3A::from(atlas.points[t].normal).as_dvec3();
        let largest = &mut largest[surface[t] as usize];
        if region.texels > largest.0 {
            *largest = (region.texels, r);
        }
    }
    let stands = |t: usize| {
        let large = regions[of[t] as usize].texels as f32 * texel * texel >= SMALLEST;
        seen(t) && (large || largest[surface[t] as usize].1 == of[t])
    };
    let painted: Vec<Vec3A> = of.par_iter().map(|&r| regions[r as usize].mean_colour()).collect();
    let palette = Palettes::find(&painted, Partition { of: &vec![0; painted.len()], count: 1 }, stands, &IN_THE_SCENE);
    let class: Vec<u16> =
        regions.par_iter().map(|r| 1 + 4 * palette.nearest(0, r.mean_colour()) as u16 + r.facing()).collect();
    (0..of.len()).map(|t| stands(t).then(|| class[of[t] as usize])).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::fit::full::segments::surfaces::flat_surfaces;
    use crate::surface::SurfacePoint;

    pub const SIDE: usize = 60;
    pub const TEXEL: f32 = 0.05;

    /// A floor, and a wall of the same paint beside it, `SIDE` × `SIDE` texels each.
    pub fn floor_and_wall() -> (Atlas, Adjacency) {
        let point = |t: usize| {
            let (x, y) = ((t % SIDE) as f32 * TEXEL, (t / SIDE % SIDE) as f32 * TEXEL);
            let (position, normal) =
                if t < SIDE * SIDE { ([x, y, 0.0], [0.0, 0.0, 1.0]) } else { ([x, 3.0, y], [0.0, -1.0, 0.0]) };
            SurfacePoint { position, triangle: 0, normal, index: t as u32 }
        };
        let texels = 2 * SIDE * SIDE;
        let beside = |t: usize| {
            let (x, y) = (t % SIDE, t / SIDE);
            let to = |there: bool, n: usize| if there { n as u32 } else { crate::fit::index::NONE };
            // The wall is above the floor in the atlas: their creased edges are neighbours.
            [
                to(x > 0, t.wrapping_sub(1)),
                to(x + 1 < SIDE, t + 1),
                to(y > 0, t.wrapping_sub(SIDE)),
                to(y + 1 < 2 * SIDE, t + SIDE),
            ]
        };
        let atlas = Atlas {
            width: SIDE,
            height: 2 * SIDE,
            texels: (0..texels as u32).collect(),
            points: (0..texels).map(point).collect(),
            inside: vec![true; texels],
        };
        (atlas, Adjacency::of((0..texels).map(beside).collect(), Vec::new()))
    }

    #[test]
    fn a_rug_is_another_class_and_a_spot_is_not() {
        let (atlas, adjacency) = floor_and_wall();
        let place = |t: usize| (t % SIDE, t / SIDE);
        let is_rug = |t: usize| matches!(place(t), (10..40, 10..30));
        let is_spot = |t: usize| matches!(place(t), (50..54, 50..54));
        let hidden = |t: usize| matches!(place(t), (0..5, 0..5));
        let paint = |t: usize| {
            // A shade of 10 %, in no order.
            let shade = 0.95 + 0.1 * ((t * 7919) % 101) as f32 / 101.0;
            let colour = match t {
                t if is_rug(t) => Vec3A::new(0.5, 0.1, 0.1),
                t if is_spot(t) => Vec3A::new(0.1, 0.1, 0.5),
                _ => Vec3A::new(0.6, 0.55, 0.5),
            };
            colour * shade
        };
        let albedo: Vec<Vec3A> = (0..atlas.points.len()).map(paint).collect();
        let surface = flat_surfaces(&atlas, &adjacency);
        let colours = Colours::find(&adjacency, &surface, &albedo, |t| !hidden(t), TEXEL);
        let found = classes((&atlas, TEXEL), &adjacency, &surface, &colours, |t| !hidden(t));
        let (floor, rug, wall) = (found[45 * SIDE + 5], found[20 * SIDE + 20], found[90 * SIDE + 30]);
        assert!(floor.is_some() && rug.is_some() && wall.is_some());
        assert!(floor != rug && floor != wall && rug != wall, "{floor:?} {rug:?} {wall:?}");
        let expected = |t: usize| match t {
            t if t >= SIDE * SIDE => wall,
            t if is_rug(t) => rug,
            _ => floor,
        };
        let all = 0..found.len();
        let wrong = all.clone().filter(|&t| found[t].is_some() && found[t] != expected(t)).count();
        assert!(wrong < 150, "{wrong} texels, more than the blurred edges of the rug");
        assert!(all.clone().filter(|&t| hidden(t)).all(|t| found[t].is_none()), "what is not seen has no class");
        let spot = found[52 * SIDE + 52];
        assert!(spot.is_none() || spot == floor, "the spot is too small for a class: {spot:?}");
    }
}
