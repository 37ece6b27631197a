//! Labels of texels, semantic classes or rooms, by the votes of the views' pixels.
//!
//! Every texel asks each view that sees it for the label of the pixel that shows it. Segmentations are wrong in other
//! places in every view, but in regions rather than pixels: votes are therefore weighed nearly alike over the views, so
//! that the nearest does not decide alone, and blurred over the surface.

use glam::Vec3;
use rayon::prelude::*;

use crate::atlas::Atlas;
use crate::backend::Backend;
use crate::capture::View;
use crate::error::Result;
use crate::fit::adjacency::Adjacency;
use crate::fit::full::segments::surfaces;
use crate::fit::full::segments::votes::{Vote, Votes, sharing};
use crate::progress::{Progress, Task};
use crate::raster::Mask;
use crate::surface::SurfacePoint;
use crate::tbl::shown::{VisibleSurfaces, pixels_per_steradian};

/// Surfaces seen at a smaller cosine have no vote: the pixel's neighbour may be metres away on them.
const MIN_COSINE: f32 = 0.1;
/// Exponent of a view's resolution (pixels per square metre of surface) in its vote: who is near sees edges best, but
/// is mistaken as often as others.
const SHARPNESS: f32 = 0.25;
/// Semantic images of which a smaller share of the votes agrees are of something else: of other photos, or not of
/// classes.
const AGREED: f32 = 0.7;

/// Labels of every texel, as far as they are known.
pub struct Labels {
    /// The flat surface that each texel is part of.
    pub surface: Vec<u32>,
    /// The texels of thin things, each with the one on the other side.
    pub backs: Vec<[u32; 2]>,
    /// Semantic class, as the views voted; `None` where there is no vote around.
    pub class: Vec<Option<u16>>,
    /// Room as the capture names them, likewise.
    pub room: Vec<Option<u16>>,
}

impl Labels {
    /// Lets the views vote.
    pub fn vote(
        backend: &mut dyn Backend,
        (atlas, adjacency): (&Atlas, &Adjacency),
        views: &[View],
        progress: &dyn Progress,
    ) -> Result<Self> {
        let has_labels = |v: &&View| v.semantic.is_some() || v.room.is_some() || v.room_id.is_some();
        let _task = Task::start(progress, "labels", views.iter().filter(has_labels).count() as u64, "views");
        let [mut class, mut room] = [Votes::default(), Votes::default()];
        for view in views.iter().filter(has_labels) {
            progress.check()?;
            let (classes, rooms) = (view.load_semantic()?, view.load_room()?);
            let votes = texel_votes(backend, atlas, view, view.load_mask()?.as_ref())?;
            class.add(&votes, |pixel| classes.as_ref().map_or(0, |ids| ids.data[pixel]));
            let of_view = view.room_id.unwrap_or(0);
            room.add(&votes, |pixel| rooms.as_ref().map_or(of_view, |ids| ids.data[pixel]));
            progress.advance(1);
        }
        let agreed = class.agreement();
        if agreed < AGREED {
            progress.warn(&format!(
                "semantic_path: of the views' votes on each texel's class, {:.0} % agrees with the majority; expected nearly all. Do \
                 the images belong to these photos, and are their ids classes, the same in every view?",
                100.0 * agreed
            ));
        }
        let scene = backend.scene();
        let surface = surfaces::flat_surfaces(atlas, adjacency);
        let backs = surfaces::backs(scene, atlas);
        let (sharing, texel) = (sharing(atlas, adjacency), atlas.typical_texel(scene.mesh()));
        class.blur(&sharing, texel);
        room.blur(&sharing, texel);
        drop(sharing);
        class.share(&backs);
        let [class, room] = [class, room].map(|votes| votes.count(&surface));
        Ok(Self { surface, backs, class, room })
    }

    /// Whether views have semantic classes.
    pub fn has_classes(&self) -> bool {
        self.class.iter().any(Option::is_some)
    }
}

/// The votes for every texel in a view, where the view sees it and `mask` does not exclude the pixel. Rays are only
/// traced from texels whose pixel shows their surface: the others are not seen there anyway.
pub fn texel_votes(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    view: &View,
    mask: Option<&Mask>,
) -> Result<Vec<Option<Vote>>> {
    let camera = &view.camera;
    let shown = VisibleSurfaces::new(backend, camera)?;
    let candidate = |(texel, point): (usize, &SurfacePoint)| {
        let position = Vec3::from(point.position);
        let faces_camera = Vec3::from(point.normal).dot(camera.position() - position) > 0.0;
        let at = faces_camera.then(|| camera.project(position))??;
        let pixel = camera.pixel(at.x as i64, at.y as i64)?;
        let usable = mask.is_none_or(|mask| mask.data[pixel]);
        let shows = usable && shown.shows(pixel, point, position.distance(camera.position()));
        shows.then_some((texel, pixel))
    };
    let candidates: Vec<(usize, usize)> = atlas.points.par_iter().enumerate().filter_map(candidate).collect();
    let points: Vec<SurfacePoint> = candidates.iter().map(|(texel, _)| atlas.points[*texel]).collect();
    let mut votes: Vec<Option<Vote>> = atlas.points.iter().map(|_| None).collect();
    for ((texel, pixel), at) in candidates.into_iter().zip(backend.project(&points, camera)?) {
        if at.distance > 0.0 && at.cosine >= MIN_COSINE {
            let resolution = pixels_per_steradian(camera) * at.cosine / (at.distance * at.distance);
            votes[texel] = Some(Vote { pixel, weight: resolution.powf(SHARPNESS) });
        }
    }
    Ok(votes)
}

#[cfg(test)]
mod tests {
    use std::hash::{DefaultHasher, Hash, Hasher};
    use std::path::PathBuf;
    use std::sync::Arc;

    use super::*;
    use crate::camera::Camera;
    use crate::capture::Split;
    use crate::cpu::CpuBackend;
    use crate::fit::full::segments::spread;
    use crate::raster::Labels;
    use crate::scene::Scene;
    use crate::surface::Hit;
    use crate::tbl::tests::{panorama, room};

    /// Walls with a door, a floor with a rug, a ceiling. By triangle: a texel on a crease lies in two surfaces.
    fn class(triangle: u32, p: Vec3) -> u16 {
        let rug = (p.x - 2.2).abs() < 0.8 && (p.y - 1.4).abs() < 0.6;
        let door = (p.x - 1.2).abs() < 0.45 && p.z < 2.0;
        match triangle / 2 {
            0 if rug => 5,
            0 => 2,
            1 => 3,
            2 if door => 4,
            _ => 1,
        }
    }

    /// A number in [0, 1) that belongs to `of`.
    fn chance(of: impl Hash) -> f32 {
        let mut hasher = DefaultHasher::new();
        of.hash(&mut hasher);
        (hasher.finish() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// One pixel in ten of some other class.
    fn speckled(labels: &Labels, view: usize) -> Labels {
        let wrong = |(i, id): (usize, &u16)| match chance((view, i)) < 0.1 {
            true => 1 + (id + (4.0 * chance((view, i, "class"))) as u16) % 5,
            false => *id,
        };
        Labels { data: labels.data.iter().enumerate().map(wrong).collect(), ..*labels }
    }

    /// Discs of wrong classes, on a tenth of the pixels.
    fn blotched(labels: &Labels, view: usize) -> Labels {
        let mut blotched = labels.clone();
        let (width, height) = (labels.width as f32, labels.height as f32);
        for disc in 0.. {
            let [x, y, radius, id] = std::array::from_fn(|k| chance((view, disc, k)));
            for (i, pixel) in blotched.data.iter_mut().enumerate() {
                let dx = (i % labels.width) as f32 - x * width;
                let dy = (i / labels.width) as f32 - y * height;
                if dx.hypot(dy) < 4.0 + 10.0 * radius {
                    *pixel = 1 + (5.0 * id) as u16;
                }
            }
            let wrong = blotched.data.iter().zip(&labels.data).filter(|(a, b)| a != b).count();
            if 10 * wrong >= labels.data.len() {
                break;
            }
        }
        blotched
    }

    #[test]
    fn views_that_are_wrong_on_a_tenth_of_their_pixels_outvote_each_other() {
        let scene = Arc::new(Scene::new(room()).unwrap());
        let mut backend = CpuBackend::new(scene.clone());
        let atlas = Atlas::new(&mut backend, [192, 128]).unwrap();
        let adjacency = Adjacency::new(scene.mesh(), &atlas);
        let truth: Vec<u16> = atlas.points.iter().map(|p| class(p.triangle, p.position.into())).collect();
        let places = [[0.7, 0.6], [3.3, 0.7], [0.8, 2.4], [3.2, 2.3], [2.0, 1.5], [1.3, 1.6]];
        let views = places.map(|[x, y]| {
            let camera = Camera { width: 256, height: 128, ..panorama(Vec3::new(x, y, 1.3), x) };
            View::new(x.to_string(), camera, Split::Train, PathBuf::new())
        });
        let mut right = |wrong: fn(&Labels, usize) -> Labels, views: &[View]| {
            let mut votes = Votes::default();
            let mut seen = vec![false; truth.len()];
            for (i, view) in views.iter().enumerate() {
                let Camera { width, height, .. } = view.camera;
                let hits = backend.primary(&view.camera, view.camera.rows()).unwrap();
                let shows = |(pixel, hit): (usize, &Hit)| {
                    let direction = view.camera.direction_of(pixel);
                    class(hit.triangle, view.camera.position() + direction * hit.t)
                };
                let labels = Labels::new(width, height, hits.iter().enumerate().map(shows).collect()).unwrap();
                let labels = wrong(&labels, i);
                let of_view = texel_votes(&mut backend, &atlas, view, None).unwrap();
                seen.iter_mut().zip(&of_view).for_each(|(seen, vote)| *seen |= vote.is_some());
                votes.add(&of_view, |pixel| labels.data[pixel]);
            }
            votes.blur(&sharing(&atlas, &adjacency), atlas.typical_texel(scene.mesh()));
            let fused = spread(votes.count(&surfaces::flat_surfaces(&atlas, &adjacency)), &adjacency, |_| 0);
            let all = seen.iter().filter(|seen| **seen).count();
            let right = (0..truth.len()).filter(|&t| seen[t] && fused[t] == truth[t]).count();
            right as f64 / all as f64
        };
        let clean = right(|labels, _| labels.clone(), &views);
        let (speckles, blotches, alone) =
            (right(speckled, &views), right(blotched, &views), right(blotched, &views[..1]));
        assert!(clean > 0.985, "{clean} of the texels are right when all pixels are");
        assert!(speckles > 0.97, "{speckles} of the texels are right");
        assert!(blotches > 0.97, "{blotches} of the texels are right");
        // Negative control: nobody to outvote the one view.
        assert!(alone < 0.95, "{alone} of the texels are right in one view alone");
    }
}
