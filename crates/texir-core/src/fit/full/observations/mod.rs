//! Every pixel of every training view as one row of data: what it sees of which texels, from where, and how it would
//! shine at any roughness.

pub mod bands;
pub mod blocks;
mod curve_filter;
mod exclusion;
pub mod packed_tap;
pub mod squares;

use std::sync::Arc;

use glam::Vec3A;
use rayon::prelude::*;

use self::bands::Bands;
use self::blocks::{Blocks, Patch};
use self::curve_filter::ReflectionPatch;
use self::packed_tap::PackedTap;
use self::squares::AXIS;
use crate::atlas::{Atlas, TexelIndex};
use crate::backend::{Backend, ShadePoint};
use crate::brdf::DIELECTRIC_F0;
use crate::camera::Camera;
use crate::capture::View;
use crate::checkpoint::Checkpoints;
use crate::error::{Error, Result};
use crate::fit::index::NONE;
use crate::fit::settings::FullSettings;
use crate::progress::{Progress, Task};
use crate::raster::{Mask, Rgb};
use crate::scene::Scene;
use crate::specular_table::{Curve, PackedCurve, STRATA};
use crate::surface::Hit;
use crate::texture::SparseRows;

/// The smallest n·v that areas are told at.
const GRAZING: f32 = 0.05;

/// The pixels that take part, all views after one another, those of a view by the texels that they see. Pixels that are
/// masked or unknown, or that even in part miss the mesh, see a light source, or see a surface from behind, are left
/// out: irradiance is known of fronts. Lists are per pixel.
#[derive(Default)]
pub struct Observations {
    /// Observed radiance.
    pub radiance: Vec<Vec3A>,
    /// n·v, the mean over what the pixel shows.
    pub cosine: Vec<f32>,
    /// n·v, the least of what the pixel shows.
    pub min_cosine: Vec<f32>,
    /// Whether the pixel lies near an excluded one ([`exclusion`]).
    pub near_excluded: Vec<bool>,
    /// Area of the surface that the pixel shows, square metres; at n·v below 0.05 as at 0.05.
    pub area: Vec<f32>,
    /// Specular radiance of a dielectric by roughness, per block of pixels.
    pub curves: Vec<PackedCurve>,
    /// Specular radiance at F0 = 1 by roughness, per block; where metals are sought.
    pub white_curves: Vec<PackedCurve>,
    /// Block of each pixel.
    pub block: Vec<u32>,
    /// Shares of the texels seen, by index into [`Atlas::texels`]; each row sums to 1.
    pub rows: SparseRows<PackedTap>,
    /// Which pixels see what part of the atlas.
    pub bands: Bands,
    /// Whether a pixel sees it, of each texel.
    pub is_seen: Vec<bool>,
    /// Number of pixels of each view, in order.
    pub views: Vec<usize>,
}

impl Observations {
    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.radiance.len()
    }

    /// True without pixels.
    pub fn is_empty(&self) -> bool {
        self.radiance.is_empty()
    }

    /// Adds those of a view that shows `image`, whose pixels belong to `blocks`, with the blocks' curves and white
    /// curves.
    fn take(&mut self, image: &Rgb, mut pixels: Vec<Pixel>, blocks: &[u32], curves: [Vec<PackedCurve>; 2]) {
        // Pixels that see the same texels come together, and their curves with them: whoever goes through a band of the
        // texels finds all that is known of its pixels together in memory.
        let mut order: Vec<usize> = (0..pixels.len()).collect();
        order.sort_by_key(|&i| pixels[i].shares[0].texel);
        let number_of = renumbered(order.iter().map(|&i| blocks[i]), curves[0].len());
        let first = self.curves.len() as u32;
        for (all, curves) in [&mut self.curves, &mut self.white_curves].into_iter().zip(curves) {
            let start = all.len();
            all.extend_from_slice(&curves);
            curves.iter().zip(&number_of).for_each(|(curve, number)| all[start + *number as usize] = *curve);
        }
        self.views.push(pixels.len());
        for i in order {
            let Pixel { pixel, ref mut shares, cosine, min_cosine, area, near_excluded, .. } = pixels[i];
            self.radiance.push(Vec3A::from(image.data[pixel]));
            self.cosine.push(cosine);
            self.min_cosine.push(min_cosine);
            self.near_excluded.push(near_excluded);
            self.area.push(area);
            self.block.push(first + number_of[blocks[i] as usize]);
            self.rows.push(shares.drain(..));
        }
    }

    /// Finds out from `rows` who sees which of `texels` texels.
    pub fn index(&mut self, texels: usize) {
        self.bands = Bands::new(&self.rows, texels);
        self.is_seen = vec![false; texels];
        self.rows.taps.iter().for_each(|share| self.is_seen[share.texel as usize] = true);
    }

    /// Specular radiance of pixel `p` by roughness, if it shows a dielectric.
    pub fn curve(&self, p: usize) -> &PackedCurve {
        &self.curves[self.block[p] as usize]
    }

    /// Specular radiance of pixel `p` by roughness, if it shows a white metal. Metals must be sought.
    pub fn white_curve(&self, p: usize) -> &PackedCurve {
        &self.white_curves[self.block[p] as usize]
    }
}

/// What gathering observations takes.
pub struct Observer<'a> {
    /// The texels of the backend's scene.
    pub atlas: &'a Atlas,
    /// Texels that are light sources.
    pub emitters: &'a Mask,
    /// Sample counts.
    pub settings: &'a FullSettings,
    /// Seed of the run.
    pub seed: u32,
    /// Views that were observed before.
    pub checkpoints: &'a Checkpoints,
}

impl Observer<'_> {
    /// Observes the views. The backend holds the full TBL and its lights.
    pub fn observe(&self, backend: &mut dyn Backend, views: &[View], progress: &dyn Progress) -> Result<Observations> {
        let rays: u64 = views.iter().map(|v| v.camera.pixels() as u64).sum::<u64>()
            * self.settings.tables()
            * u64::from(self.settings.sampling(self.seed, 0).rays());
        let task = Task::start(progress, "light samples", rays, "rays");
        let index = TexelIndex::new(self.atlas);
        let mut all = Observations::default();
        for view in views {
            self.observe_one(backend, view, &index, &mut all, progress)?;
            // Rows are told apart by offsets of 32 bits.
            if u32::try_from(all.rows.taps.len()).is_err() {
                return Err(Error::invalid(format!(
                    "the views up to {:?} see texels more than 2³² times together: leave out views, or allow less memory, so that \
                     they are read at a lower resolution",
                    view.name
                )));
            }
        }
        drop(task);
        if all.is_empty() {
            return Err(Error::invalid(
                "no pixel of a training view shows the front of a surface that is not a light source: check masks, which \
                 way faces are turned, and the cameras against the mesh, with `texir inspect`",
            ));
        }
        all.index(self.atlas.texels.len());
        Ok(all)
    }

    fn observe_one(
        &self,
        backend: &mut dyn Backend,
        view: &View,
        index: &TexelIndex,
        all: &mut Observations,
        progress: &dyn Progress,
    ) -> Result<()> {
        let image = view.load_image(progress)?;
        let usable = view.usable(&image)?;
        let classes = view.load_semantic()?;
        let strata = Strata::new(backend, &view.camera)?;
        let class = |pixel: usize| classes.as_ref().map_or(0, |map| map.data[pixel]);
        let pixels = self.pixels(view, &usable, class, &strata, index);
        if !pixels.iter().any(|seen| image.data[seen.pixel].iter().any(|v| *v > 0.0)) {
            progress.warn(&format!(
                "view {:?} shows no lit surface: its image or mask is black, or it sees light sources alone",
                view.name
            ));
        }
        let patches: Vec<Patch> = pixels.iter().map(|seen| seen.patch).collect();
        let indices: Vec<usize> = pixels.iter().map(|seen| seen.pixel).collect();
        let blocks = blocks::group_pixels(&indices, &patches, self.settings.squares(&view.camera));
        let number = all.views.len() as u32;
        let samples = LightSamples::new(self, (view, number), &strata, &blocks);
        let curves = samples.curves(backend, &format!("view-{number}"), DIELECTRIC_F0 as f32, progress)?;
        let white_curves = match self.settings.metallic.enabled {
            true => samples.curves(backend, &format!("view-{number}-white"), 1.0, progress)?,
            false => Vec::new(),
        };
        all.take(&image, pixels, &blocks.of, [curves, white_curves]);
        Ok(())
    }

    /// The pixels of a view that take part.
    fn pixels(
        &self,
        view: &View,
        usable: &Mask,
        class: impl Fn(usize) -> u16 + Sync,
        strata: &Strata,
        index: &TexelIndex,
    ) -> Vec<Pixel> {
        let camera = &view.camera;
        let seen = |pixel: usize| {
            let shares = strata.texels(pixel, index, self.emitters)?;
            let points = strata.points(pixel);
            let cosines = points.each_ref().map(ShadePoint::cosine);
            let cosine = cosines.iter().sum::<f32>() / STRATA as f32;
            let min_cosine = cosines.into_iter().fold(1.0, f32::min);
            let patch = Patch::of(&points, class(pixel));
            let distance = patch.position.distance(camera.position());
            let area = camera.solid_angle(pixel) * distance * distance / cosine.max(GRAZING);
            Some(Pixel { pixel, shares, patch, cosine, min_cosine, area, near_excluded: false })
        };
        let mut pixels: Vec<Pixel> =
            (0..camera.pixels()).into_par_iter().filter(|&pixel| usable.data[pixel]).filter_map(seen).collect();
        let mut left_out = vec![true; camera.pixels()];
        pixels.iter().for_each(|seen| left_out[seen.pixel] = false);
        let near_excluded = exclusion::dilate(camera, &left_out, self.settings.roughness.exclusion_margin);
        pixels.iter_mut().for_each(|seen| seen.near_excluded = near_excluded[seen.pixel]);
        pixels
    }
}

/// A pixel that takes part; see [`Observations`].
struct Pixel {
    /// Index into the image.
    pixel: usize,
    shares: Vec<PackedTap>,
    patch: Patch,
    cosine: f32,
    min_cosine: f32,
    area: f32,
    near_excluded: bool,
}

/// What draws the light samples of a view.
struct LightSamples<'a> {
    observer: &'a Observer<'a>,
    view: &'a View,
    /// Which view of all it is.
    number: u32,
    strata: &'a Strata,
    blocks: &'a Blocks,
    /// What each block reflects.
    reflections: Vec<ReflectionPatch>,
}

impl<'a> LightSamples<'a> {
    fn new(
        observer: &'a Observer<'a>,
        (view, number): (&'a View, u32),
        strata: &'a Strata,
        blocks: &'a Blocks,
    ) -> Self {
        let reflection = |(patch, corners): (&Patch, &[usize; STRATA])| {
            ReflectionPatch::new(&strata.scene, *patch, &strata.points(corners[0])[0])
        };
        let reflections = blocks.patches.par_iter().zip(&blocks.corners).map(reflection).collect();
        Self { observer, view, number, strata, blocks, reflections }
    }

    /// Specular radiance at `f0` of every block, each with what its neighbours know; kept as `step`.
    fn curves(
        &self,
        backend: &mut dyn Backend,
        step: &str,
        f0: f32,
        progress: &dyn Progress,
    ) -> Result<Vec<PackedCurve>> {
        let &Self { observer: &Observer { settings, seed, checkpoints, .. }, view, strata, blocks, .. } = self;
        let corners = &blocks.corners;
        let sampling = settings.sampling(seed, self.number);
        let mut skipped = view.camera.pixels();
        let curves: Vec<Curve> = checkpoints.array(step, corners.len(), || {
            skipped -= corners.len();
            let points: Vec<[ShadePoint; STRATA]> =
                corners.par_iter().map(|pixels| std::array::from_fn(|k| strata.points(pixels[k])[k])).collect();
            backend.specular_tables(&points, f0, sampling, progress)
        })?;
        progress.advance(skipped as u64 * u64::from(sampling.rays()));
        let angle = settings.squares(&view.camera).edge as f32 * view.camera.pixel_angle();
        Ok(curve_filter::filter(&curves, blocks, &self.reflections, angle, settings.curve_filter_width))
    }
}

/// New numbers of `count` things: in the order in which they come first.
fn renumbered(order: impl Iterator<Item = u32>, count: usize) -> Vec<u32> {
    let (mut numbers, mut next) = (vec![NONE; count], 0);
    for thing in order {
        let number = &mut numbers[thing as usize];
        if *number == NONE {
            *number = next;
            next += 1;
        }
    }
    numbers
}

/// What the strata of a view's pixels hit.
struct Strata {
    scene: Arc<Scene>,
    /// The view's camera, with a pixel for each stratum.
    fine: Camera,
    /// By pixel of that.
    hits: Vec<Hit>,
}

impl Strata {
    fn new(backend: &mut dyn Backend, camera: &Camera) -> Result<Self> {
        let fine = camera.supersampled(AXIS);
        let hits = backend.primary(&fine, fine.rows())?;
        Ok(Self { scene: backend.scene().clone(), fine, hits })
    }

    /// The pixels of `fine` that a pixel of the view consists of.
    fn of(&self, pixel: usize) -> [usize; STRATA] {
        std::array::from_fn(|k| self.fine.sub_pixel(AXIS, pixel, k))
    }

    /// Shares of the texels that a pixel shows; `None` where it shows none, or something else than fronts that reflect,
    /// even in part.
    fn texels(&self, pixel: usize, index: &TexelIndex, emitters: &Mask) -> Option<Vec<PackedTap>> {
        let mesh = self.scene.mesh();
        let reflects = |s: usize| {
            let hit = &self.hits[s];
            hit.is_hit()
                && hit.is_front(mesh, -self.fine.direction_of(s))
                && emitters.nearest(hit.uv(mesh)) == Some(&false)
        };
        let strata = self.of(pixel);
        if !strata.into_iter().all(reflects) {
            return None;
        }
        let shares = PackedTap::of(strata.map(|s| index.bilinear(self.hits[s].uv(mesh)).collect()));
        (!shares.is_empty()).then_some(shares)
    }

    /// The points that a pixel shows, all of which is on the mesh.
    fn points(&self, pixel: usize) -> [ShadePoint; STRATA] {
        let point = |s: usize| ShadePoint::new(self.scene.mesh(), &self.fine, s as u32, &self.hits[s], [0.0; 3]);
        self.of(pixel).map(point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::lit_square::{LitSquare, SIDE};
    use crate::image_io::{read_rgb, write_png_mask, write_rgb};
    use crate::lights::Lights;
    use crate::progress::Silent;

    #[test]
    fn unknown_pixels_are_no_observations() {
        let square = LitSquare::new();
        let emitters = Mask::filled(SIDE, SIDE, false);
        let observer = Observer {
            atlas: &square.atlas,
            emitters: &emitters,
            settings: &FullSettings::default(),
            seed: 1,
            checkpoints: &Checkpoints::none(),
        };
        let texture = Rgb::filled(SIDE, SIDE, [0.3; 3]);
        let mut backend = square.backend();
        backend.set_tbl(&texture, &Lights::none(square.scene.mesh())).unwrap();
        let view = &square.views(&texture, [64, 32])[0];
        let mut observed = |view: &View| observer.observe(&mut backend, std::slice::from_ref(view), &Silent).unwrap();
        let all = observed(view);
        let mut image = read_rgb(&view.image).unwrap();
        let unknown = |i: usize| i % 64 < 32;
        let folder = tempfile::tempdir().unwrap();
        let kept = Mask { width: 64, height: 32, data: (0..64 * 32).map(|i| !unknown(i)).collect() };
        let masked = View { mask: Some(folder.path().join("mask.png")), ..view.clone() };
        write_png_mask(masked.mask.as_ref().unwrap(), &kept).unwrap();
        let masked = observed(&masked);
        (0..64 * 32).filter(|&i| unknown(i)).for_each(|i| image.data[i][1] = f32::INFINITY);
        write_rgb(&view.image, &image).unwrap();
        let seen = observed(view);
        assert!(seen.len() < all.len() - 50 && seen.len() > 50, "{} of {}", seen.len(), all.len());
        assert_eq!(seen.radiance, masked.radiance);
        // Beside them, what an image shows is not to be told to the pixel. (Without a mask, the sky beside the square
        // is left out.)
        let near_excluded = |of: &Observations| of.near_excluded.iter().filter(|rim| **rim).count();
        assert!(near_excluded(&masked) > near_excluded(&all) / 2 && near_excluded(&masked) < masked.len() / 2);
        assert_eq!(seen.near_excluded, masked.near_excluded);
        // A pixel of 6° sees the square from angles that differ.
        let cosines = || all.min_cosine.iter().zip(&all.cosine);
        assert!(cosines().all(|(least, mean)| least < mean && least > &(mean - 0.15)));
    }

    fn observed(square: &LitSquare, emitters: &Mask, views: &[View]) -> Observations {
        observe(square, emitters, views).unwrap()
    }

    fn observe(square: &LitSquare, emitters: &Mask, views: &[View]) -> Result<Observations> {
        let observer = Observer {
            atlas: &square.atlas,
            emitters,
            settings: &FullSettings::default(),
            seed: 1,
            checkpoints: &Checkpoints::none(),
        };
        let mut backend = square.backend();
        backend.set_tbl(&Rgb::filled(SIDE, SIDE, [0.3; 3]), &Lights::none(square.scene.mesh())).unwrap();
        observer.observe(&mut backend, views, &Silent)
    }

    #[test]
    fn pixels_that_show_a_light_source_even_in_part_are_no_observations_of_it() {
        let square = LitSquare::new();
        let texture = Rgb::filled(SIDE, SIDE, [0.3; 3]);
        let view = &square.views(&texture, [64, 32])[..1];
        let mut lamp = Mask::filled(SIDE, SIDE, false);
        let [x, y] = [3, 5];
        lamp.data[y * SIDE + x] = true;
        let [plain, lit] = [&Mask::filled(SIDE, SIDE, false), &lamp].map(|emitters| observed(&square, emitters, view));
        // Rays of a finer camera that hit that texel.
        let camera = view[0].camera;
        let fine = camera.supersampled(AXIS);
        let hits = square.backend().primary(&fine, fine.rows()).unwrap();
        let shows = |pixel: usize| {
            let within = |k: usize| {
                let hit = &hits[fine.sub_pixel(AXIS, pixel, k)];
                let at = || hit.uv(square.scene.mesh()) * SIDE as f32;
                hit.is_hit() && [at().x as usize, at().y as usize] == [x, y]
            };
            (0..STRATA).map(within).filter(|lamp| *lamp).count()
        };
        let pixels = |least: usize| (0..camera.pixels()).filter(|p| shows(*p) >= least).count();
        assert_eq!(plain.len() - lit.len(), pixels(1));
        // Negative control: fewer show it throughout.
        assert!(pixels(STRATA) < pixels(1));
    }

    #[test]
    fn the_areas_that_pixels_show_are_all_of_a_surface() {
        let square = LitSquare::new();
        let view = &square.views(&Rgb::filled(SIDE, SIDE, [0.3; 3]), [512, 256])[..1];
        let seen = observed(&square, &Mask::filled(SIDE, SIDE, false), view);
        let area: f32 = seen.area.iter().sum();
        // Pixels that show its rim show something else as well, and are left out.
        assert!((3.85..4.0).contains(&area), "{area} of 4 m²");
    }

    #[test]
    fn pixels_that_show_a_surface_from_behind_are_no_observations_of_it() {
        let square = LitSquare::new();
        let emitters = Mask::filled(SIDE, SIDE, false);
        let mut view = square.views(&Rgb::filled(SIDE, SIDE, [0.3; 3]), [64, 32]).swap_remove(0);
        let count = |view: &View| {
            let hits = square.backend().primary(&view.camera, view.camera.rows()).unwrap();
            hits.iter().filter(|hit| hit.is_hit()).count()
        };
        let front = observed(&square, &emitters, std::slice::from_ref(&view));
        assert!(front.len() > count(&view) / 2 && front.len() <= count(&view));
        // The same image from below: the square is seen as large.
        view.camera.world_from_camera.w_axis.z = -1.0;
        assert!(count(&view) > front.len());
        let error = observe(&square, &emitters, &[view]).err().unwrap().to_string();
        assert!(error.contains("front"), "{error}");
    }
}
