//! Labels of what no view sees: floor under a sofa, wall behind a shelf.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use crate::atlas::Atlas;

/// Edges of the cells in which labels are counted, texels: a rim of wrong labels around what is hidden is thinner.
const CELLS: [f32; 6] = [8.0, 16.0, 32.0, 64.0, 128.0, 256.0];
/// Labelled texels that must lie around a hidden one before they are believed.
const ENOUGH: u32 = 100;

/// Labels hidden texels as most of the labelled ones around them on their `surface` are. What has too few of them
/// around stays unlabelled. `texel` is the edge of a typical texel, metres.
pub fn label(atlas: &Atlas, surface: &[u32], known: &[Option<u16>], texel: f32) -> Vec<Option<u16>> {
    let mut labels = known.to_vec();
    let labelled: Vec<u32> = (0..).zip(known).filter_map(|(t, label)| label.map(|_| t)).collect();
    for edge in CELLS.map(|edge| edge * texel) {
        let place = |t: usize| Vec3::from(atlas.points[t].position) / edge;
        let cell = |t: usize| (place(t).floor().as_ivec3(), surface[t]);
        let key = |t: u32| (known[t as usize], cell(t as usize));
        let mut cells: HashMap<(IVec3, u32), Vec<(u16, u32)>> = HashMap::new();
        // Texels beside each other in the atlas mostly lie in one cell.
        let runs = labelled.par_chunk_by(|a, b| key(*a) == key(*b)).map(|run| (key(run[0]), run.len() as u32));
        for ((label, cell), texels) in runs.collect::<Vec<_>>() {
            let Some(label) = label else { continue };
            let counts = cells.entry(cell).or_default();
            match counts.iter_mut().find(|(known, _)| *known == label) {
                Some((_, count)) => *count += texels,
                None => counts.push((label, texels)),
            }
        }
        labels.par_iter_mut().enumerate().filter(|(_, label)| label.is_none()).for_each(|(t, label)| {
            let base = (place(t) - 0.5).floor().as_ivec3();
            let mut counts: Vec<(u16, u32)> = (0..8)
                .filter_map(|corner| {
                    cells.get(&(base + IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2), surface[t]))
                })
                .flatten()
                .copied()
                .collect();
            counts.sort_unstable();
            let all: u32 = counts.iter().map(|(_, count)| count).sum();
            if all >= ENOUGH {
                let sums =
                    counts.chunk_by(|a, b| a.0 == b.0).map(|same| (same.iter().map(|c| c.1).sum::<u32>(), same[0].0));
                *label = sums.max().map(|(_, label)| label);
            }
        });
    }
    labels
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::surface::SurfacePoint;

    pub const SIDE: usize = 40;
    pub const TEXEL: f32 = 0.05;

    /// A floor of `SIDE` × `SIDE` texels, and a shelf as large a little above it.
    pub fn floor_and_shelf() -> Atlas {
        let point = |t: usize| {
            let (x, y, z) = (t % SIDE, t / SIDE % SIDE, t / SIDE / SIDE);
            let position = [x as f32 * TEXEL, y as f32 * TEXEL, 0.1 * z as f32];
            SurfacePoint { position, triangle: z as u32, normal: [0.0, 0.0, 1.0], index: t as u32 }
        };
        let texels = 2 * SIDE * SIDE;
        Atlas {
            width: SIDE,
            height: 2 * SIDE,
            texels: (0..texels as u32).collect(),
            points: (0..texels).map(point).collect(),
            inside: vec![true; texels],
        }
    }

    /// Distance of a texel from the hidden square in the middle of the floor, texels; 0 inside.
    fn from_hidden(t: usize) -> usize {
        let off = |x: usize| 12usize.saturating_sub(x).max(x.saturating_sub(28));
        off(t % SIDE).max(off(t / SIDE))
    }

    /// Floor is 1, the shelf 2; a rim around what is hidden was taken for the sofa, 3.
    pub fn seen(t: usize) -> Option<u16> {
        match (t < SIDE * SIDE, from_hidden(t)) {
            (false, _) => Some(2),
            (true, 0) => None,
            (true, 1) => Some(3),
            (true, _) => Some(1),
        }
    }

    #[test]
    fn hidden_texels_are_what_most_of_their_surface_is() {
        let atlas = floor_and_shelf();
        let surface: Vec<u32> = atlas.points.iter().map(|p| p.triangle).collect();
        let known: Vec<Option<u16>> = (0..atlas.points.len()).map(seen).collect();
        let labels = label(&atlas, &surface, &known, TEXEL);
        for (t, label) in labels[..SIDE * SIDE].iter().enumerate() {
            assert_eq!(*label, Some(seen(t).unwrap_or(1)), "texel {t}");
        }
        // Negative control: on one surface with the shelf, which is seen all over, the hidden floor is taken for it.
        let one = label(&atlas, &vec![0; surface.len()], &known, TEXEL);
        assert_eq!(one[20 * SIDE + 20], Some(2));
        // A surface that is hidden altogether stays unlabelled.
        let nothing: Vec<Option<u16>> = known.iter().zip(&surface).map(|(k, s)| k.filter(|_| *s == 1)).collect();
        assert_eq!(label(&atlas, &surface, &nothing, TEXEL)[0], None);
    }
}
