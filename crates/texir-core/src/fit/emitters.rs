//! Light sources: texels that send out more than they can reflect.

use std::collections::BTreeSet;

use super::adjacency::Adjacency;
use super::index::NONE;
use crate::atlas::Atlas;
use crate::backend::Backend;
use crate::capture::{Coverage, Tbl, View};
use crate::error::Result;
use crate::inpaint;
use crate::progress::Progress;
use crate::raster::{Mask, Rgb, luminance, mean_of_channels};
use crate::stats::median;
use crate::surface::SurfacePoint;

/// The largest hole in a light source, as a share of it.
const HOLE: f32 = 0.1;

/// Finds the texels that send out more than an albedo of `ratio` would reflect, L > ratio · E/π, and stand out from
/// their room, L > ratio · mean L; in luminance (Rec. 709), with `rooms` by texel, so that a lamp in the dark is found
/// beside a sunny room. Where views see such a texel, the median of what they see must pass too: in the texture, lamps
/// bleed into what is beside and behind them. Sources then grow along the surface over texels with L > ½ ratio · E/π
/// (the darker part of a window, a lamp's shade), and holes in them are filled, as irradiance is noisy there. Unseen
/// texels count only where the texture was filled with a source's light: elsewhere they may well be brighter than the
/// little that arrives in the gap behind a wardrobe.
pub fn find(
    backend: &mut dyn Backend,
    (atlas, adjacency, rooms): (&Atlas, &Adjacency, &[u16]),
    (tbl, irradiance): (&Tbl, &Rgb),
    views: &[View],
    ratio: f32,
    progress: &dyn Progress,
) -> Result<Mask> {
    let radiance = &tbl.radiance;
    let texels = || atlas.texels.iter().map(|&t| t as usize);
    let is_seen = |t: usize| tbl.coverage.data[t] == Coverage::Seen;
    let seen: Vec<_> = texels().map(|t| is_seen(t).then(|| radiance.data[t])).collect();
    let limit = inpaint::source_limit(&seen);
    let known = |t: usize| is_seen(t) || mean_of_channels(radiance.data[t]) > limit;
    let reflected = |t: usize| luminance(&irradiance.data[t]) * std::f32::consts::FRAC_1_PI;
    let means = means(rooms, texels().map(|t| luminance(&radiance.data[t])));
    let least = |i: usize| ratio * reflected(atlas.texels[i] as usize).max(means[rooms[i] as usize]);
    let mut mask = Mask::filled(radiance.width, radiance.height, false);
    for (i, t) in texels().enumerate().filter(|(_, t)| known(*t)) {
        mask.data[t] = luminance(&radiance.data[t]) > least(i);
    }
    let candidates: Vec<usize> = (0..atlas.texels.len()).filter(|&i| mask.data[atlas.texels[i] as usize]).collect();
    for (i, mut seen) in candidates.iter().zip(sightings(backend, atlas, &candidates, views, progress)?) {
        if let Some(median) = median(&mut seen) {
            mask.data[atlas.texels[*i] as usize] = median > least(*i);
        }
    }
    let mut edge: Vec<u32> =
        (0..atlas.texels.len() as u32).filter(|&i| mask.data[atlas.texels[i as usize] as usize]).collect();
    while let Some(i) = edge.pop() {
        for n in adjacency.around(i) {
            let t = atlas.texels[n as usize] as usize;
            if !mask.data[t] && known(t) && luminance(&radiance.data[t]) > 0.5 * ratio * reflected(t) {
                mask.data[t] = true;
                edge.push(n);
            }
        }
    }
    for i in holes(adjacency, |i| mask.data[atlas.texels[i as usize] as usize]) {
        mask.data[atlas.texels[i as usize] as usize] = true;
    }
    Ok(mask)
}

/// The mean over the texels of each room, by its number; 0 for numbers of none.
fn means(rooms: &[u16], values: impl Iterator<Item = f32>) -> Vec<f32> {
    let mut sums = vec![(0.0, 0u32); rooms.iter().max().map_or(0, |last| usize::from(*last) + 1)];
    for (room, value) in rooms.iter().zip(values) {
        let (sum, count) = &mut sums[usize::from(*room)];
        *sum += f64::from(value);
        *count += 1;
    }
    sums.into_iter().map(|(sum, count)| (sum / f64::from(count.max(1))) as f32).collect()
}

/// Texels that what `shines` encloses on its surface, up to [`HOLE`] of it: one pane does not shine but for a speck.
fn holes(adjacency: &Adjacency, shines: impl Fn(u32) -> bool) -> Vec<u32> {
    let texels = adjacency.beside.len() as u32;
    let (source, count) = adjacency.regions(&[], |a, b| shines(a) && shines(b));
    let mut sizes = vec![0u32; count];
    (0..texels).filter(|&i| shines(i)).for_each(|i| sizes[source[i as usize] as usize] += 1);
    let most = |sizes: &[u32]| (sizes.iter().map(|size| u64::from(*size)).sum::<u64>() as f32 * HOLE) as usize;
    let most_of_all = most(&sizes);
    let mut place = vec![NONE; texels as usize];
    let mut all = Vec::new();
    let beside_one = |i: &u32| adjacency.around(*i).any(&shines);
    for first in (0..texels).filter(|i| !shines(*i)).filter(beside_one) {
        if place[first as usize] != NONE {
            continue;
        }
        place[first as usize] = first;
        let (mut hole, mut k, mut enclosed) = (vec![first], 0, true);
        let mut around = BTreeSet::new();
        while enclosed && k < hole.len() {
            enclosed = hole.len() <= most_of_all && !adjacency.beside[hole[k] as usize].contains(&NONE);
            for n in adjacency.around(hole[k]) {
                if shines(n) {
                    around.insert(source[n as usize]);
                    continue;
                }
                // One that was looked at before was no hole.
                enclosed &= [NONE, first].contains(&place[n as usize]);
                if place[n as usize] == NONE {
                    place[n as usize] = first;
                    hole.push(n);
                }
            }
            k += 1;
        }
        let around: Vec<u32> = around.into_iter().map(|source| sizes[source as usize]).collect();
        if enclosed && hole.len() <= most(&around) {
            all.append(&mut hole);
        }
    }
    all
}

/// Luminances of the pixels that show each of the given texels, as far as they are known.
fn sightings(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    texels: &[usize],
    views: &[View],
    progress: &dyn Progress,
) -> Result<Vec<Vec<f32>>> {
    let points: Vec<SurfacePoint> = texels.iter().map(|&i| atlas.points[i]).collect();
    let mut seen = vec![Vec::new(); texels.len()];
    for view in views {
        progress.check()?;
        let projected = backend.project(&points, &view.camera)?;
        if projected.iter().all(|at| at.distance <= 0.0) {
            continue;
        }
        let image = view.load_image(progress)?;
        for (seen, at) in seen.iter_mut().zip(projected) {
            if at.distance > 0.0 {
                let [x, y] = at.pixel.map(|c| c.max(0.0) as usize);
                let shown = luminance(image.at(x.min(image.width - 1), y.min(image.height - 1)));
                seen.extend(shown.is_finite().then_some(shown));
            }
        }
    }
    Ok(seen)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::lit_square::{LitSquare, SIDE};
    use crate::progress::Silent;
    use crate::raster::Raster;

    const LAMP: usize = 2 * SIDE + 2;
    const SHADE: usize = LAMP + 1;
    const BESIDE: usize = 5 * SIDE + 5;

    #[test]
    fn a_light_source_is_what_glows_and_all_that_is_joined_to_it_but_not_what_only_the_texture_takes_for_one() {
        let square = LitSquare::new();
        let mut truth = Rgb::filled(SIDE, SIDE, [0.2; 3]);
        truth.data[LAMP] = [10.0; 3];
        truth.data[SHADE] = [0.4; 3];
        let mut radiance = truth.clone();
        radiance.data[BESIDE] = [10.0; 3];
        let views = square.views(&truth, [256, 128]);
        // At E/π = 0.2, the shade reflects at twice an albedo of 1: not a seed of its own.
        let irradiance = Rgb::filled(SIDE, SIDE, [0.2 * std::f32::consts::PI; 3]);
        let mut coverage = Raster::filled(SIDE, SIDE, Coverage::Seen);
        let found = |radiance: &Rgb, coverage: &Raster<Coverage>, views: &[View]| {
            let mut backend = square.backend();
            let surface = (&square.atlas, &square.adjacency, &[1; SIDE * SIDE][..]);
            let tbl = Tbl { radiance: radiance.clone(), coverage: coverage.clone() };
            let mask = find(&mut backend, surface, (&tbl, &irradiance), views, 3.0, &Silent).unwrap();
            (0..SIDE * SIDE).filter(|&t| mask.data[t]).collect::<Vec<_>>()
        };
        assert_eq!(found(&radiance, &coverage, &views), [LAMP, SHADE]);
        assert_eq!(found(&radiance, &coverage, &[]), [LAMP, SHADE, BESIDE], "without views the texture decides");
        let blind = square.views(&truth.map(|_| [f32::NAN; 3]), [256, 128]);
        assert_eq!(found(&radiance, &coverage, &blind), [LAMP, SHADE, BESIDE], "unknown pixels say nothing");
        let views = square.views(&truth, [256, 128]);
        // What no view sees: filled from around, then with the light of the lamp that it is part of.
        coverage.data[SHADE] = Coverage::Inpainted;
        assert_eq!(found(&radiance, &coverage, &views), [LAMP]);
        radiance.data[SHADE] = [10.0; 3];
        assert_eq!(found(&radiance, &coverage, &[]), [LAMP, SHADE, BESIDE]);
        radiance.data[SHADE] = [0.4; 3];
        coverage.data[SHADE] = Coverage::Seen;
        radiance.data[LAMP] = [0.4; 3];
        let dim = found(&radiance, &coverage, &views);
        assert_eq!(dim, [0; 0], "a dim surface beside nothing that glows is no light source");
    }

    #[test]
    fn a_lamp_in_the_dark_shines_beside_a_room_in_the_sun() {
        let square = LitSquare::new();
        // Half of it is in the sun, with a window; the other half has a lamp that is no brighter than what the sun
        // lights.
        let sunny = |t: usize| t % SIDE < SIDE / 2;
        const WINDOW: usize = 2 * SIDE + 1;
        let mut radiance = Rgb::filled(SIDE, SIDE, [0.0; 3]);
        (0..SIDE * SIDE).for_each(|t| radiance.data[t] = [if sunny(t) { 10.0 } else { 0.1 }; 3]);
        let irradiance = radiance.map(|l| l.map(|l| 2.0 * std::f32::consts::PI * l));
        radiance.data[WINDOW] = [1000.0; 3];
        radiance.data[BESIDE] = [10.0; 3];
        let coverage = Raster::filled(SIDE, SIDE, Coverage::Seen);
        let tbl = Tbl { radiance, coverage };
        let found = |room: &dyn Fn(usize) -> u16| {
            let rooms: Vec<u16> = square.atlas.texels.iter().map(|t| room(*t as usize)).collect();
            let surface = (&square.atlas, &square.adjacency, &rooms[..]);
            let mask = find(&mut square.backend(), surface, (&tbl, &irradiance), &[], 3.0, &Silent).unwrap();
            (0..SIDE * SIDE).filter(|&t| mask.data[t]).collect::<Vec<_>>()
        };
        assert_eq!(found(&|t| if sunny(t) { 1 } else { 4 }), [WINDOW, BESIDE]);
        // Negative control: in one room, it does not stand out.
        assert_eq!(found(&|_| 1), [WINDOW]);
    }

    #[test]
    fn what_light_sources_enclose_is_one_of_them() {
        let adjacency = LitSquare::new().adjacency;
        let place = |t: u32| [t as usize % SIDE, t as usize / SIDE];
        let pane = |t: u32| place(t).iter().all(|at| (1..SIDE - 1).contains(at));
        let filled = |dark: &[[usize; 2]]| {
            let mut holes = holes(&adjacency, |t| pane(t) && !dark.contains(&place(t)));
            holes.sort_unstable();
            holes.into_iter().map(place).collect::<Vec<_>>()
        };
        assert_eq!(filled(&[[3, 3], [4, 3], [5, 5]]), [[3, 3], [4, 3], [5, 5]]);
        // Open to the rest at one place; and as large as a thing of its own.
        assert_eq!(filled(&[[1, 3], [2, 3]]), [[0; 2]; 0]);
        assert_eq!(filled(&[[3, 3], [4, 3], [3, 4], [4, 4]]), [[0; 2]; 0]);
        // Two panes: the hole is as large as a tenth of both, and more than a tenth of the one that it is in.
        let column = 4;
        let bar: Vec<[usize; 2]> = (1..SIDE - 1).map(|row| [column, row]).collect();
        assert_eq!(filled(&[&bar[..], &[[2, 3], [2, 4]]].concat()), [[0; 2]; 0]);
    }
}
