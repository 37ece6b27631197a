//! What no view sees: floor under a sofa, wall behind a shelf, the back of a door. Labels come from what is seen of the
//! same flat surface, or of the other side of what is thin, and materials from what is seen of the same segment, so
//! that it can be shown once the sofa is moved. What is seen so badly that it comes out as no material could be is
//! treated alike.

use std::collections::HashMap;

use glam::{IVec3, Vec3, Vec3A};
use rayon::prelude::*;

use crate::atlas::{Atlas, TexelIndex};
use crate::fit::adjacency::Adjacency;
use crate::fit::full::partition::Partition;
use crate::inpaint;
use crate::ray_origin::offset_origin;
use crate::real::V3;
use crate::scene::Scene;
use crate::scene::trace::Trace;
use crate::surface::{Hit, SurfacePoint};

/// Neighbours on one flat surface differ in their normals by less than the angle of this cosine.
const FLAT: f32 = 0.95;
/// Edges of the cells in which labels are counted, texels: a rim of wrong labels around what is hidden is thinner.
const CELLS: [f32; 6] = [8.0, 16.0, 32.0, 64.0, 128.0, 256.0];
/// Labelled texels that must lie around a hidden one before they are believed.
const ENOUGH: u32 = 100;

/// Things up to this thick are thin, metres: two rooms are further apart.
const THIN: f32 = 0.06;
/// Cosine of the angle up to which the two sides of something thin are parallel.
const PARALLEL: f32 = 0.7;

/// Reflectance of what nothing is known of: photographers' grey card.
const MIDDLE_GREY: f32 = 0.18;
/// Of a segment, the share of light sources above which they are a thing of their own.
const MUCH: f64 = 0.1;

/// Bounds of what diffuse albedo surfaces have in a channel: soot reflects 3 %, fresh snow 95 %.
const DARKEST: f32 = 0.005;
const BRIGHTEST: f32 = 0.97;
/// Share of a segment's texels up to which those outside are errors.
const FEW: f64 = 0.1;

/// The flat surface that each texel is part of.
pub fn flat_surfaces(atlas: &Atlas, adjacency: &Adjacency) -> Vec<u32> {
    let normal = |t: u32| Vec3::from(atlas.points[t as usize].normal);
    adjacency.regions(&[], |a, b| normal(a).dot(normal(b)) > FLAT).0
}

/// The texels of thin things, the leaves of doors and the boards of shelves, each with the one on the other side,
/// ascending.
pub fn backs(scene: &Scene, atlas: &Atlas) -> Vec<[u32; 2]> {
    let index = TexelIndex::new(atlas);
    let front = |t: usize| {
        let SurfacePoint { position, triangle, normal, .. } = atlas.points[t];
        let face = scene.mesh().face_normal(triangle);
        let inwards = if face.dot(normal.into()) > 0.0 { -face } else { face };
        // The point lies a step outside.
        let origin = offset_origin(position.into(), 2.0 * inwards);
        let hit = Trace::<f32>::closest(scene, V3::of(origin.to_array()), V3::of(inwards.to_array()))?;
        let leaves = scene.mesh().face_normal(hit.triangle).dot(inwards) > PARALLEL;
        let hit = Hit { triangle: hit.triangle, u: hit.u, v: hit.v, t: hit.t };
        index.nearest(hit.uv(scene.mesh())).filter(|_| leaves && hit.t < THIN)
    };
    let of = |t: usize| Some([t as u32, front(t)?]);
    (0..atlas.points.len()).into_par_iter().filter_map(of).collect()
}

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
        for run in labelled.chunk_by(|a, b| key(*a) == key(*b)) {
            let (Some(label), cell) = key(run[0]) else { continue };
            let counts = cells.entry(cell).or_default();
            match counts.iter_mut().find(|(known, _)| *known == label) {
                Some((_, count)) => *count += run.len() as u32,
                None => counts.push((label, run.len() as u32)),
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
    use glam::Vec2;

    use super::*;
    use crate::backend::Backend;
    use crate::cpu::CpuBackend;
    use crate::mesh::Mesh;

    const SIDE: usize = 40;
    const TEXEL: f32 = 0.05;

    /// A floor of `SIDE` × `SIDE` texels, and a shelf as large a little above it.
    fn floor_and_shelf() -> Atlas {
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
    fn seen(t: usize) -> Option<u16> {
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

    /// A block from z = 0 down, of this thickness, of which there are top and bottom; `flipped` turns the bottom
    /// inside.
    fn slab(thickness: f32, flipped: bool) -> Scene {
        let quad = |z: f32, up: bool, left: f32| {
            let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
            let corners = if up { corners } else { [corners[0], corners[3], corners[2], corners[1]] };
            let normal = if up { Vec3::Z } else { -Vec3::Z };
            corners.map(|(x, y)| (Vec3::new(x, y, z), normal, Vec2::new(left + 0.4 * x, 0.8 * y)))
        };
        let corners = [quad(0.0, true, 0.05), quad(-thickness, flipped, 0.55)].concat();
        Scene::new(Mesh {
            positions: corners.iter().map(|c| c.0).collect(),
            normals: corners.iter().map(|c| c.1).collect(),
            uvs: corners.iter().map(|c| c.2).collect(),
            triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
        })
        .unwrap()
    }

    #[test]
    fn thin_things_have_backs_and_thick_ones_have_none() {
        let backs_of = |scene: Scene| {
            let mut backend = CpuBackend::new(scene);
            let atlas = Atlas::new(&mut backend, [40, 20]).unwrap();
            (backs(backend.scene(), &atlas), atlas)
        };
        let (found, atlas) = backs_of(slab(0.04, false));
        assert!(found.len() as f32 > 0.9 * atlas.points.len() as f32, "{} of {}", found.len(), atlas.points.len());
        for [back, front] in found {
            let [back, front] = [back, front].map(|t| atlas.points[t as usize]);
            assert!(back.normal[2] == -front.normal[2]);
            let aside = (Vec3::from(back.position) - Vec3::from(front.position)).truncate().length();
            assert!(aside < 1.5 / 16.0, "{aside} m aside");
        }
        assert_eq!(backs_of(slab(0.2, false)).0, [[0; 2]; 0], "what is thick");
        assert_eq!(backs_of(slab(0.04, true)).0, [[0; 2]; 0], "two sheets that face alike");
    }

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
