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

/// Texels count as no wider than this many pixels, where images are far finer than the texture.
const WIDEST: f32 = 16.0;

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
                for pixel in around(camera, at.pixel, area.sqrt() / at.distance) {
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

/// The pixels that show a texel, `angle` radians wide, at continuous coordinates, and those beside them: at least nine,
/// and more columns near the poles of a panorama, where they are crowded.
fn around(camera: &Camera, [x, y]: [f32; 2], angle: f32) -> impl Iterator<Item = usize> {
    let (x, y, angle) = (x as i64, y as i64, angle.min(WIDEST * camera.pixel_angle()));
    // Rounded: a texel narrower than a pixel takes none but the nine.
    let reach = move |pixels_per_radian: f32| 1 + (0.5 * angle * pixels_per_radian).round() as i64;
    let rows = reach(1.0 / camera.pixel_angle());
    (y - rows..=y + rows).flat_map(move |row| {
        let columns = reach(camera.pixels_per_radian(row as f32 + 0.5).x).min(camera.width as i64 / 2);
        (x - columns..=x + columns).filter_map(move |column| camera.pixel(column, row))
    })
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use glam::Mat4;

    use super::*;
    use crate::camera::Projection;

    #[test]
    fn the_pixels_of_a_texel_and_those_beside_them_are_looked_at() {
        let (width, height) = (512, 256);
        let projection = Projection::Equirectangular;
        let camera = Camera { projection, width, height, world_from_camera: Mat4::IDENTITY };
        let extent = |[x, y]: [f32; 2], pixels: f32| {
            let looked: BTreeSet<usize> = around(&camera, [x, y], pixels * camera.pixel_angle()).collect();
            let columns: BTreeSet<usize> = looked.iter().map(|p| p % width).collect();
            let rows: BTreeSet<usize> = looked.iter().map(|p| p / width).collect();
            assert_eq!(looked.len(), columns.len() * rows.len());
            [columns.len(), rows.len()]
        };
        let horizon = [100.5, 128.5];
        assert_eq!(extent(horizon, 0.3), [3, 3]);
        // A texel of 4.2 pixels covers 2.1 to either side of its centre, and one pixel more is beside it.
        assert_eq!(extent(horizon, 4.2), [7, 7]);
        assert_eq!(extent(horizon, 1000.0), [19, 19]);
        assert_eq!(extent([0.5, 128.5], 0.3), [3, 3], "over the seam");
    }

    #[test]
    fn a_texel_near_the_pole_of_a_panorama_takes_the_columns_that_it_spans() {
        let (width, height) = (512, 256);
        let projection = Projection::Equirectangular;
        let camera = Camera { projection, width, height, world_from_camera: Mat4::IDENTITY };
        let angle = 0.3 * camera.pixel_angle();
        let [x, y] = [100.5, 1.5];
        let spans = 0.5 * angle * camera.pixels_per_radian(y).x;
        assert!(spans > 4.0, "{spans}");
        let in_row: BTreeSet<usize> =
            around(&camera, [x, y], angle).filter(|pixel| pixel / width == y as usize).collect();
        let missed = (0..width).filter(|column| (*column as f32 + 0.5 - x).abs() <= spans + 0.5);
        let missed: Vec<usize> = missed.filter(|column| !in_row.contains(&(y as usize * width + column))).collect();
        assert!(missed.is_empty(), "{missed:?}");
    }
}
