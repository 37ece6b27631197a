//! What a stage needs of each training view, prepared once: shading points, footprints, targets and pixel groups.

use std::collections::BTreeMap;

use glam::{Vec2, Vec3};

use crate::backend::{Backend, Groups, Material, RoughnessGradient, Sampling, ShadePoint};
use crate::capture::View;
use crate::error::Result;
use crate::fit::FitContext;
use crate::progress::{Progress, Task, Uncounted};
use crate::raster::Rgb;
use crate::rng::hash2;
use crate::texture::{Footprints, Pyramid, SparseRows};

/// Roughness and samples of the virtual-highlight render (method section 3).
const HIGHLIGHT_ROUGHNESS: f32 = 0.01;
const HIGHLIGHT_SAMPLES: u32 = 16;

/// The pixels of one training view that take part: those that hit the mesh, may be used and see no light source.
/// All lists are per such pixel.
pub struct FitView {
    /// What shading needs.
    pub points: Vec<ShadePoint>,
    /// Observed radiance.
    pub target: Vec<[f32; 3]>,
    /// Texels seen.
    pub footprints: Footprints,
    /// Pixels by semantic class.
    pub by_class: Groups,
    /// Pixels by class, those that could show a highlight first.
    pub by_class_highlights: Groups,
    /// Pixels by class within a room.
    pub by_class_and_room: Groups,
    /// Indices of the pixels that could show a highlight.
    pub highlights: Vec<u32>,
}

/// What all views share while they are prepared.
pub struct Surroundings<'a> {
    /// The scene and its light.
    pub context: &'a FitContext<'a>,
    /// E per texel.
    pub irradiance: &'a Rgb,
    /// Mips of the atlas.
    pub pyramid: &'a Pyramid,
    /// Sub-pixel footprints per axis.
    pub footprint_samples: usize,
}

impl Surroundings<'_> {
    /// Prepares the training views. The backend must hold the TBL of the light sources alone: the virtual highlights
    /// are found with it.
    pub fn prepare(&self, backend: &mut dyn Backend, views: &[View], progress: &dyn Progress) -> Result<Vec<FitView>> {
        let _task = Task::start(progress, "views", views.len() as u64, "views");
        views
            .iter()
            .map(|view| {
                progress.check()?;
                let prepared = self.prepare_one(backend, view, progress)?;
                progress.advance(1);
                Ok(prepared)
            })
            .collect()
    }

    fn prepare_one(&self, backend: &mut dyn Backend, view: &View, progress: &dyn Progress) -> Result<FitView> {
        let image = view.load_image(progress)?;
        let usable = view.usable(&image)?;
        let classes = view.load_semantic()?;
        let rooms = view.load_room()?;
        let scene = backend.scene().clone();
        let hits = backend.primary(&view.camera, view.camera.rows())?;
        let used: Vec<u32> = (0..hits.len() as u32)
            .filter(|&i| {
                let hit = &hits[i as usize];
                let is_front = || hit.is_front(scene.mesh(), -view.camera.direction_of(i as usize));
                usable.data[i as usize] && hit.is_hit() && is_front() && !self.is_emitter(hit.uv(scene.mesh()))
            })
            .collect();
        let fine = view.camera.supersampled(self.footprint_samples);
        let fine_hits = backend.primary(&fine, fine.rows())?;
        let rows =
            SparseRows::of_pixels(self.pyramid, scene.mesh(), &fine, self.footprint_samples, |i| fine_hits[i], &used);
        let irradiance = backend.lookup(self.pyramid, self.irradiance.data.as_flattened(), 3, &rows)?;
        let points: Vec<ShadePoint> = used
            .iter()
            .zip(irradiance.as_chunks::<3>().0)
            .map(|(&pixel, &irradiance)| {
                ShadePoint::new(scene.mesh(), &view.camera, pixel, &hits[pixel as usize], irradiance)
            })
            .collect();
        let highlights = self.highlights(backend, &points, &view.name, progress)?;
        let class_of = |i: usize| classes.as_ref().map_or(0, |c| c.data[used[i] as usize]);
        let room_of = |i: usize| match (&rooms, view.room_id) {
            (Some(map), _) => map.data[used[i] as usize],
            (None, Some(id)) => id,
            (None, None) => self.context.plan.room_of(Vec3::from(points[i].position), Vec3::from(points[i].normal)),
        };
        let mut is_highlight = vec![false; points.len()];
        highlights.iter().for_each(|&h| is_highlight[h as usize] = true);
        let none = vec![false; points.len()];
        Ok(FitView {
            target: used.iter().map(|&i| image.data[i as usize]).collect(),
            by_class: group(class_of, &none),
            by_class_highlights: group(class_of, &is_highlight),
            by_class_and_room: group(|i| (class_of(i), room_of(i)), &none),
            points,
            footprints: Footprints::new(rows),
            highlights,
        })
    }

    fn is_emitter(&self, uv: Vec2) -> bool {
        self.context.emitters.nearest(uv) == Some(&true)
    }

    /// Virtual highlights: pixels that reflect a light source when the surface is a black near-mirror.
    fn highlights(
        &self,
        backend: &mut dyn Backend,
        points: &[ShadePoint],
        name: &str,
        progress: &dyn Progress,
    ) -> Result<Vec<u32>> {
        let mirror = vec![Material::dielectric([0.0; 3], HIGHLIGHT_ROUGHNESS); points.len()];
        let seed = name.bytes().fold(self.context.seed, |s, b| hash2(s, u32::from(b)));
        let sampling = Sampling { samples: HIGHLIGHT_SAMPLES, seed };
        let shaded = backend.shade(points, &mirror, sampling, RoughnessGradient::Exact, &Uncounted(progress))?;
        Ok((0..points.len() as u32).filter(|&i| shaded[i as usize].radiance.iter().any(|&c| c > 0.0)).collect())
    }
}

/// Groups items by key, in key order; members flagged `first` lead their group.
fn group<K: Ord>(key: impl Fn(usize) -> K, first: &[bool]) -> Groups {
    let mut lists: BTreeMap<K, [Vec<u32>; 2]> = BTreeMap::new();
    for (i, first) in first.iter().enumerate() {
        lists.entry(key(i)).or_default()[usize::from(!first)].push(i as u32);
    }
    let mut groups = Groups { offsets: vec![0], members: Vec::with_capacity(first.len()), references: Vec::new() };
    for [references, others] in lists.into_values() {
        groups.references.push(references.len() as u32);
        groups.members.extend(references);
        groups.members.extend(others);
        groups.offsets.push(groups.members.len() as u32);
    }
    groups
}
