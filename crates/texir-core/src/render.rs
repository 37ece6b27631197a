//! Views of a scene with given textures: what `render`, `eval` and `report` look at.
//!
//! primary hits → material at every pixel centre ([`Renderer::surfaces`]); primary hits of sub-pixels → trilinear footprints →
//! specular radiance from tables over roughness, diffuse radiance and emission, averaged ([`Renderer::render`]).

use std::f32::consts::FRAC_1_PI;
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use crate::atlas::Atlas;
use crate::backend::{Backend, ShadePoint};
use crate::brdf::{self, DIELECTRIC_F0, Masking};
use crate::camera::Camera;
use crate::diffuse::DiffuseModel;
use crate::error::{Error, Result};
use crate::lights::Lights;
use crate::mesh::Mesh;
use crate::progress::{Progress, Silent};
use crate::raster::{Gray, Mask, Raster, Rgb};
use crate::real::V3;
use crate::scene::Scene;
use crate::specular_table::{Curve, STRATA, TableSampling};
use crate::surface::Hit;
use crate::texture::{Pyramid, Rows};

/// Pixels, or sub-pixels, worked on at a time, but at least a row: bounds hits, footprints and the backend's buffers (about
/// 100 MB) whatever the size of the view.
const CHUNK: usize = 1 << 18;

/// Sub-pixels per pixel and axis in rendered views. Captured images are box-filtered over the pixel, and at the edges of
/// lamps and windows a small share of it decides.
const SUB_PIXELS: usize = 4;
/// All sub-pixels, (column, row).
const ALL: [(usize, usize); SUB_PIXELS * SUB_PIXELS] = {
    let mut all = [(0, 0); SUB_PIXELS * SUB_PIXELS];
    let mut i = 0;
    while i < all.len() {
        all[i] = (i % SUB_PIXELS, i / SUB_PIXELS);
        i += 1;
    }
    all
};
/// The sub-pixels whose highlights are traced: one in each row and column.
const STRATUM: [(usize, usize); SUB_PIXELS] = [(1, 0), (3, 1), (0, 2), (2, 3)];

/// Textures in the scene's atlas, and how they scatter light. Their resolutions may differ.
#[derive(Clone, Debug, PartialEq)]
pub struct Textures {
    /// Linear albedo.
    pub albedo: Rgb,
    /// Perceptual roughness.
    pub roughness: Gray,
    /// 1 where the surface is metal; `None` if it is nowhere.
    pub metallic: Option<Gray>,
    /// Irradiance E: cosine included, not divided by π.
    pub irradiance: Rgb,
    /// Emitted radiance; 0 where nothing glows.
    pub emission: Rgb,
    /// The diffuse model that albedo belongs to,
    pub diffuse: DiffuseModel,
    /// and the shadowing–masking term that roughness does.
    pub masking: Masking,
}

/// What a camera sees of the textures, before shading. Zero where the ray met nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Surfaces {
    /// Primary hit of every pixel.
    pub hits: Vec<Hit>,
    /// Linear albedo.
    pub albedo: Rgb,
    /// Perceptual roughness.
    pub roughness: Gray,
    /// Irradiance E.
    pub irradiance: Rgb,
    /// Emitted radiance.
    pub emission: Rgb,
}

impl Surfaces {
    /// Pixels that show a surface which does not glow: where a material can be seen.
    pub fn reflective(&self) -> Mask {
        Raster {
            width: self.albedo.width,
            height: self.albedo.height,
            data: self.hits.iter().zip(&self.emission.data).map(|(hit, e)| hit.is_hit() && *e == [0.0; 3]).collect(),
        }
    }
}

/// Renders views of one scene.
pub struct Renderer<'a> {
    backend: &'a mut dyn Backend,
    /// The backend's.
    scene: Arc<Scene>,
    /// Rays per stratum.
    rays: u32,
    seed: u32,
    pyramids: Vec<Pyramid>,
}

impl<'a> Renderer<'a> {
    /// A renderer whose highlights reflect the texture-based lighting `radiance`, which the backend is given, and which
    /// spends about `rays` rays on those of a pixel, 96 at least.
    pub fn new(backend: &'a mut dyn Backend, radiance: &Rgb, rays: u32, seed: u32) -> Result<Self> {
        let atlas = Atlas::new(backend, radiance.width, radiance.height)?;
        let scene = backend.scene().clone();
        backend.set_tbl(radiance, &Lights::find(&scene, &atlas, radiance))?;
        Ok(Self { backend, scene, rays: rays / STRATUM.len() as u32, seed, pyramids: Vec::new() })
    }

    /// The mesh that views are rendered of.
    pub fn mesh(&self) -> &Mesh {
        &self.scene.mesh
    }

    /// Rays per pixel: those that were asked for, rounded, but no fewer than the tables need.
    pub fn rays_per_pixel(&self) -> u32 {
        self.sampling(Masking::default()).rays() * STRATA as u32
    }

    fn sampling(&self, masking: Masking) -> TableSampling {
        TableSampling::of_rays(self.rays, masking, self.seed)
    }

    /// Rays of a view, as progress counts them.
    pub fn rays(&self, camera: &Camera) -> u64 {
        camera.pixels() as u64 * u64::from(self.rays_per_pixel())
    }

    /// The materials and light at every pixel centre, looked up at that point alone, as renderers write them.
    pub fn surfaces(&mut self, camera: &Camera, textures: &Textures) -> Result<Surfaces> {
        indexable(camera)?;
        let mut hits = Vec::with_capacity(camera.pixels());
        let mut all = Values::default();
        for rows in bands(camera.height, camera.width) {
            let band = Band { hits: self.backend.primary(camera, rows.clone())?, first: rows.start * camera.width };
            let pixels: Vec<u32> = (rows.start * camera.width..rows.end * camera.width).map(|i| i as u32).collect();
            let seen = SeenPixels { camera, band: &band, pixels: &pixels, filter: Filter::Point };
            all.append(self.look_up_all(&seen, textures)?);
            hits.extend(band.hits);
        }
        let (width, height) = (camera.width, camera.height);
        Ok(Surfaces {
            hits,
            albedo: Raster::new(width, height, all.albedo)?,
            roughness: Raster::new(width, height, all.roughness)?,
            irradiance: Raster::new(width, height, all.irradiance)?,
            emission: Raster::new(width, height, all.emission)?,
        })
    }

    /// The view's radiance. Advances `progress` by [`Renderer::rays`]; the caller starts and finishes the task.
    pub fn render(&mut self, camera: &Camera, textures: &Textures, progress: &dyn Progress) -> Result<Rgb> {
        let [radiance] = self.render_each(camera, [textures], progress)?;
        Ok(radiance)
    }

    /// The view's radiance under several sets of textures, for the rays of one: light does not depend on them.
    pub fn render_each<const N: usize>(
        &mut self,
        camera: &Camera,
        textures: [&Textures; N],
        progress: &dyn Progress,
    ) -> Result<[Rgb; N]> {
        let fine = camera.supersampled(SUB_PIXELS);
        indexable(&fine)?;
        let is_metal = |of: &&Textures| of.metallic.as_ref().is_some_and(|map| map.data.iter().any(|m| *m > 0.0));
        let metals = textures.iter().any(is_metal);
        let mut radiance = [(); N].map(|()| Rgb::filled(camera.width, camera.height, [0.0; 3]));
        for rows in bands(camera.height, ALL.len() * camera.width) {
            progress.check()?;
            let first = rows.start * SUB_PIXELS * fine.width;
            let hits = self.backend.primary(&fine, rows.start * SUB_PIXELS..rows.end * SUB_PIXELS)?;
            let band = Band { hits, first };
            let pixels = rows.start * camera.width..rows.end * camera.width;
            let of = |which| sub_pixels(&fine, pixels.clone(), which).filter(|&i| band.hit(i as usize).is_hit());
            let strata: Vec<u32> = of(&STRATUM).collect();
            let points: Vec<[ShadePoint; STRATA]> = strata
                .par_iter()
                .map(|&i| [ShadePoint::new(&self.scene.mesh, &fine, i, &band.hit(i as usize), [0.0; 3]); STRATA])
                .collect();
            // Unasked-for rays are not counted: they depend on the textures.
            let white_points = if metals { &points[..] } else { &[] };
            let missed = pixels.len() * STRATUM.len() - strata.len();
            progress.advance(missed as u64 * u64::from(self.sampling(Masking::default()).rays()));
            let mut tables: Vec<(Masking, [Vec<Curve>; 2])> = Vec::new();
            let seen: Vec<u32> = of(&ALL).collect();
            for (radiance, textures) in radiance.iter_mut().zip(textures) {
                let mut add = |i: u32, share: usize, value: [f32; 3]| {
                    let (x, y) = (i as usize % fine.width / SUB_PIXELS, i as usize / fine.width / SUB_PIXELS);
                    let sum = &mut radiance.data[y * camera.width + x];
                    *sum = std::array::from_fn(|c| sum[c] + value[c] / share as f32);
                };
                let view = |pixels| SeenPixels { camera: &fine, band: &band, pixels, filter: Filter::Area };
                let values = self.look_up_all(&view(&strata), textures)?;
                let masking = textures.masking;
                let known = tables.iter().position(|(of, _)| *of == masking);
                let at = known.unwrap_or(tables.len());
                if known.is_none() {
                    let counted = if tables.is_empty() { progress } else { &Silent };
                    let sampling = self.sampling(masking);
                    let dielectric = self.backend.specular_tables(&points, DIELECTRIC_F0 as f32, sampling, counted)?;
                    let white = self.backend.specular_tables(white_points, 1.0, sampling, &Silent)?;
                    tables.push((masking, [dielectric, white]));
                }
                let [curves, white] = &tables[at].1;
                for (k, (&i, curve)) in strata.iter().zip(curves).enumerate() {
                    let dielectric = curve.at(values.roughness[k]).0;
                    let f0 = brdf::f0(V3(values.albedo[k]), values.metallic[k]);
                    // Linear in F0, and known at two.
                    let white = white.get(k).map_or(dielectric, |white| white.at(values.roughness[k]).0);
                    let share = |c: usize| (f0.0[c] - DIELECTRIC_F0 as f32) / (1.0 - DIELECTRIC_F0 as f32);
                    add(
                        i,
                        STRATUM.len(),
                        std::array::from_fn(|c| dielectric[c] + share(c) * (white[c] - dielectric[c])),
                    );
                }
                let values = self.look_up_all(&view(&seen), textures)?;
                for (k, &i) in seen.iter().enumerate() {
                    let point =
                        ShadePoint::new(&self.scene.mesh, &fine, i, &band.hit(i as usize), values.irradiance[k]);
                    let factor = textures.diffuse.factor(point.cosine(), values.roughness[k]) * FRAC_1_PI;
                    let diffuse =
                        |c: usize| values.albedo[k][c] * (1.0 - values.metallic[k]) * values.irradiance[k][c] * factor;
                    add(i, ALL.len(), std::array::from_fn(|c| diffuse(c) + values.emission[k][c]));
                }
            }
        }
        Ok(radiance)
    }

    /// All textures at some pixels. Emission is looked up on the atlas itself: on the coarse levels of its pyramid, lamps
    /// would shine into the charts beside theirs.
    fn look_up_all(&mut self, seen: &SeenPixels<'_>, textures: &Textures) -> Result<Values> {
        let mut known = Vec::new();
        let albedo = self.look_up_rgb(&textures.albedo, seen, &mut known)?;
        let irradiance = self.look_up_rgb(&textures.irradiance, seen, &mut known)?;
        let Raster { width, height, data } = &textures.roughness;
        let roughness = self.look_up((*width, *height), data, 1, seen, &mut known)?;
        let metallic = match &textures.metallic {
            Some(Raster { width, height, data }) => self.look_up((*width, *height), data, 1, seen, &mut known)?,
            None => vec![0.0; roughness.len()],
        };
        let emission = &textures.emission;
        let index = self.pyramid(emission.size())?;
        let footprints = seen.bilinear(&self.pyramids[index], &self.scene.mesh);
        let texels = bytemuck::cast_slice(&emission.data);
        let emission = self.backend.lookup(&self.pyramids[index], texels, 3, &footprints)?.as_chunks::<3>().0.to_vec();
        Ok(Values { albedo, roughness, metallic, irradiance, emission })
    }

    fn look_up_rgb(
        &mut self,
        texture: &Rgb,
        seen: &SeenPixels<'_>,
        known: &mut SharedFootprints,
    ) -> Result<Vec<[f32; 3]>> {
        let values = self.look_up(texture.size(), bytemuck::cast_slice(&texture.data), 3, seen, known)?;
        Ok(values.as_chunks::<3>().0.to_vec())
    }

    /// `channels` numbers per pixel of a texture of the given size.
    fn look_up(
        &mut self,
        size: (usize, usize),
        texture: &[f32],
        channels: usize,
        seen: &SeenPixels<'_>,
        known: &mut SharedFootprints,
    ) -> Result<Vec<f32>> {
        let index = self.pyramid(size)?;
        let pyramid = &self.pyramids[index];
        let at = known.iter().position(|(of, _)| *of == index).unwrap_or_else(|| {
            known.push((index, seen.footprints(pyramid, &self.scene.mesh)));
            known.len() - 1
        });
        self.backend.lookup(pyramid, texture, channels, &known[at].1)
    }

    /// Index of the atlas's pyramid at a size, made at its first use.
    fn pyramid(&mut self, (width, height): (usize, usize)) -> Result<usize> {
        let known = self.pyramids.iter().position(|p| (p.levels[0].width, p.levels[0].height) == (width, height));
        if let Some(index) = known {
            return Ok(index);
        }
        self.pyramids.push(Atlas::new(self.backend, width, height)?.pyramid());
        Ok(self.pyramids.len() - 1)
    }
}

/// The rows of a view in bands of about [`CHUNK`] items, of which a row has so many.
fn bands(rows: usize, items: usize) -> impl Iterator<Item = Range<usize>> {
    let band = (CHUNK / items.max(1)).max(1);
    (0..rows).step_by(band).map(move |first| first..rows.min(first + band))
}

/// Pixels are numbered in 32 bits.
fn indexable(camera: &Camera) -> Result<()> {
    let Camera { width, height, .. } = camera;
    u32::try_from(camera.pixels()).map(|_| ()).map_err(|_| {
        Error::invalid(format!("a view of {width} × {height} samples has more than 2³² of them; render a smaller one"))
    })
}

/// Indices in the finer image of some sub-pixels of some pixels, pixel by pixel.
fn sub_pixels<'a>(
    fine: &Camera,
    pixels: Range<usize>,
    which: &'a [(usize, usize)],
) -> impl Iterator<Item = u32> + use<'a> {
    let fine = *fine;
    pixels.flat_map(move |pixel| {
        which.iter().map(move |(dx, dy)| fine.sub_pixel(SUB_PIXELS, pixel, dy * SUB_PIXELS + dx) as u32)
    })
}

/// Footprints by pyramid, so that textures of one size share theirs.
type SharedFootprints = Vec<(usize, Rows)>;

/// What of a texture a pixel shows.
#[derive(Clone, Copy)]
enum Filter {
    /// What lies at its centre: bilinear.
    Point,
    /// What it covers: trilinear.
    Area,
}

/// What some rows of a view hit.
struct Band {
    hits: Vec<Hit>,
    /// Index in the view of the first of them.
    first: usize,
}

impl Band {
    /// What a pixel of the view hits.
    fn hit(&self, pixel: usize) -> Hit {
        self.hits[pixel - self.first]
    }
}

/// Pixels of a view, and what the view hits.
struct SeenPixels<'a> {
    camera: &'a Camera,
    band: &'a Band,
    pixels: &'a [u32],
    filter: Filter,
}

impl SeenPixels<'_> {
    fn footprints(&self, pyramid: &Pyramid, mesh: &Mesh) -> Rows {
        match self.filter {
            Filter::Point => self.bilinear(pyramid, mesh),
            Filter::Area => Rows::of_pixels(pyramid, mesh, self.camera, 1, |pixel| self.band.hit(pixel), self.pixels),
        }
    }

    fn bilinear(&self, pyramid: &Pyramid, mesh: &Mesh) -> Rows {
        let taps = |&pixel: &u32| match self.band.hit(pixel as usize) {
            hit if hit.is_hit() => pyramid.bilinear(0, hit.uv(mesh)),
            _ => Vec::new(),
        };
        Rows::from_lists(self.pixels.par_iter().map(taps).collect::<Vec<_>>())
    }
}

/// Textures at some pixels.
#[derive(Default)]
struct Values {
    albedo: Vec<[f32; 3]>,
    roughness: Vec<f32>,
    metallic: Vec<f32>,
    irradiance: Vec<[f32; 3]>,
    emission: Vec<[f32; 3]>,
}

impl Values {
    fn append(&mut self, mut other: Self) {
        self.albedo.append(&mut other.albedo);
        self.roughness.append(&mut other.roughness);
        self.metallic.append(&mut other.metallic);
        self.irradiance.append(&mut other.irradiance);
        self.emission.append(&mut other.emission);
    }
}

#[cfg(test)]
mod tests;
