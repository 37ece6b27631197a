//! What the pixels of all views show at light sources and beside them.
//!
//! A lamp may be a fraction of a pixel: many rays go through each, so that no texel is missed. Sources that are found
//! later add the pixels around them; what was looked at is not looked at again.

use std::collections::{BTreeMap, HashMap};

use glam::Vec3;
use rayon::prelude::*;

use super::Fusion;
use super::photo::Photo;
use super::shown::pixels_per_steradian;
use crate::atlas::TexelIndex;
use crate::backend::Backend;
use crate::camera::Camera;
use crate::error::Result;
use crate::progress::Task;
use crate::real::V3;
use crate::scene::trace::Trace;
use crate::surface::Hit;
use crate::texture::{Tap, merge};

/// Rays through a pixel along each axis, at least and at most.
const RAYS: (f32, f32) = (4.0, 16.0);
/// Rays through a pixel per texel that it shows, along each axis: none shall be missed.
const RAYS_PER_TEXEL: f32 = 1.5;

/// What the pixels at and beside light sources show, as far as they were looked at: by view, and by index in its image.
pub(super) struct SourcePixels(Vec<BTreeMap<usize, SourcePixel>>);

/// What one pixel shows.
pub(super) struct SourcePixel {
    /// Along each axis, as it was looked at.
    rays: u8,
    pub radiance: Vec3,
    /// The texels, which sum to the part of the pixel that shows the mesh. Nothing where it shows the back of a
    /// surface, whose radiance the texture does not hold.
    pub shares: Vec<Tap>,
}

impl SourcePixels {
    /// None, of some views.
    pub(super) fn of(views: usize) -> Self {
        Self((0..views).map(|_| BTreeMap::new()).collect())
    }

    /// Looks at the pixels of all views at and beside more light sources, these texels.
    pub(super) fn add(
        &mut self,
        fusion: &Fusion<'_>,
        backend: &mut dyn Backend,
        load: &mut dyn FnMut(usize) -> Result<Photo>,
        sources: &[usize],
    ) -> Result<()> {
        let Fusion { scene, atlas, cameras, progress, .. } = *fusion;
        let points: Vec<_> = sources.iter().map(|&texel| atlas.points[texel]).collect();
        let index = TexelIndex::new(atlas);
        let _task = Task::start(progress, "light sources", cameras.len() as u64, "views");
        for (view, (camera, looks)) in cameras.iter().zip(&mut self.0).enumerate() {
            progress.check()?;
            let mut asked: HashMap<usize, u8> = HashMap::new();
            for (at, point) in backend.project(&points, camera)?.iter().zip(&points).filter(|(at, _)| at.distance > 0.0)
            {
                let area = atlas.texel_area(scene.mesh(), point.triangle);
                let texels = at.distance / (area * at.cosine * pixels_per_steradian(camera)).sqrt();
                let needed = (RAYS_PER_TEXEL * texels).ceil().clamp(RAYS.0, RAYS.1) as u8;
                for pixel in around(camera, at.pixel) {
                    let rays = asked.entry(pixel).or_default();
                    *rays = needed.max(*rays);
                }
            }
            asked.retain(|pixel, rays| looks.get(pixel).is_none_or(|look| look.rays < *rays));
            if !asked.is_empty() {
                let image = load(view)?.image;
                let look = |(pixel, rays): (usize, u8)| {
                    let radiance = Vec3::from(image.data[pixel]);
                    (pixel, SourcePixel { rays, radiance, shares: shares(fusion, view, &index, pixel, rays) })
                };
                looks.par_extend(asked.into_par_iter().map(look));
            }
            progress.advance(1);
        }
        Ok(())
    }

    /// The pixels that show something, view by view, each in the order of its pixels: view and index in its image, and
    /// what.
    pub(super) fn each(&self) -> impl Iterator<Item = ((usize, usize), &SourcePixel)> {
        let of_view = |(view, looks)| BTreeMap::iter(looks).map(move |(pixel, look)| ((view, *pixel), look));
        let shows_something = |look: &SourcePixel| !look.shares.is_empty() && look.radiance.is_finite();
        self.0.iter().enumerate().flat_map(of_view).filter(move |(_, look)| shows_something(look))
    }
}

/// The pixel at continuous coordinates and its eight neighbours.
fn around(camera: &Camera, [x, y]: [f32; 2]) -> impl Iterator<Item = usize> {
    (0..9).filter_map(move |k| camera.pixel(x as i64 + k % 3 - 1, y as i64 + k / 3 - 1))
}

/// See [`SourcePixel::shares`].
fn shares(fusion: &Fusion<'_>, view: usize, index: &TexelIndex, pixel: usize, rays: u8) -> Vec<Tap> {
    let (scene, camera) = (fusion.scene, &fusion.cameras[view]);
    let origin = V3(camera.position().to_array());
    let (x, y) = ((pixel % camera.width) as f32, (pixel / camera.width) as f32);
    let n = u32::from(rays);
    let weight = 1.0 / (n * n) as f32;
    let mut taps = Vec::with_capacity((n * n) as usize);
    for k in 0..n * n {
        let (dx, dy) = ((k % n) as f32 + 0.5, (k / n) as f32 + 0.5);
        let direction = camera.direction(x + dx / n as f32, y + dy / n as f32);
        let Some(hit) = scene.closest(origin, V3(direction.to_array())) else { continue };
        if hit.back {
            return Vec::new();
        }
        taps.extend(index.nearest(Hit::from(hit).uv(scene.mesh())).map(|texel| Tap { texel, weight }));
    }
    let shown = taps.len() as f32 * weight;
    merge(&mut taps);
    taps.iter_mut().for_each(|tap| tap.weight *= shown);
    taps
}
