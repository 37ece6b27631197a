//! Views of a scene with given textures: what `render`, `eval` and `report` look at.
//!
//! textures → their mip levels ([`Renderer::mipmapped`]); primary hits → material at every pixel centre
//! ([`Renderer::surfaces`]); primary hits of sub-pixels → trilinear footprints → specular radiance from tables over
//! roughness, diffuse radiance and emission, averaged ([`Renderer::render`]).

mod mipmapped;

use std::borrow::Cow;
use std::f32::consts::FRAC_1_PI;
use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use crate::atlas::{Atlas, bands};
use crate::backend::{Backend, ShadePoint};
use crate::brdf::{self, DIELECTRIC_F0, Masking};
use crate::camera::Camera;
use crate::diffuse::DiffuseModel;
use crate::error::{Error, Result};
use crate::lights::Lights;
use crate::mesh::Mesh;
use crate::progress::{Progress, Uncounted};
use crate::radiance_scale;
use crate::raster::{Gray, Mask, Raster, Rgb, mean_of_channels};
use crate::real::V3;
use crate::scene::Scene;
use crate::specular_table::{Curve, STRATA, TableSampling};
use crate::surface::Hit;
use crate::texture::{Footprint, Pyramid};

pub use mipmapped::Mipmapped;
use mipmapped::Seen;

/// Pixels, or sub-pixels, worked on at a time, but at least a row: bounds hits, points and the backend's buffers (about
/// 100 MB) whatever the size of the view.
const CHUNK: usize = 1 << 18;

/// Sub-pixels per pixel and axis in rendered views. Captured images are box-filtered over the pixel, and at the edges
/// of lamps and windows a small share of it decides.
const SUB_PIXELS: usize = 4;
/// Sub-pixels per pixel.
const ALL: usize = SUB_PIXELS * SUB_PIXELS;
/// The sub-pixels whose highlights are traced, (column, row): one in each row and column.
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
    /// The diffuse model that albedo belongs to.
    pub diffuse: DiffuseModel,
    /// The shadowing–masking term that roughness belongs to.
    pub masking: Masking,
}

/// What a camera sees of the textures, before shading. Zero where the ray met nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct GBuffer {
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

impl GBuffer {
    /// Pixels that show a surface which does not glow: where a material can be seen.
    pub fn reflective(&self) -> Mask {
        Raster {
            width: self.albedo.width,
            height: self.albedo.height,
            data: self.hits.iter().zip(&self.emission.data).map(|(hit, e)| hit.is_hit() && *e == [0.0; 3]).collect(),
        }
    }
}

/// Rays per pixel of a renderer that so many are asked of: as many, rounded, but no fewer than the tables need.
pub fn rays_per_pixel(asked: u32) -> u32 {
    TableSampling::of_rays(asked / STRATA as u32, Masking::default(), 0).rays() * STRATA as u32
}

/// Renders views of one scene.
pub struct Renderer<'a> {
    backend: &'a mut dyn Backend,
    /// The backend's.
    scene: Arc<Scene>,
    /// What the backend's lighting is multiplied with.
    radiance_scale: f32,
    /// Rays per stratum.
    rays: u32,
    seed: u32,
    pyramids: Vec<Arc<Pyramid>>,
}

impl fmt::Debug for Renderer<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { scene, rays, seed, .. } = self;
        let mut renderer = f.debug_struct("Renderer");
        renderer.field("scene", scene).field("rays", rays).field("seed", seed).finish_non_exhaustive()
    }
}

impl<'a> Renderer<'a> {
    /// A renderer whose highlights reflect the texture-based lighting `radiance`, which the backend is given in a unit
    /// in which it is about 1, and which spends about `rays` rays on those of a pixel, 96 at least. Errors on lighting
    /// that [`Backend::set_tbl`] refuses in that unit.
    pub fn new(backend: &'a mut dyn Backend, radiance: &Rgb, rays: u32, seed: u32) -> Result<Self> {
        radiance.check("the texture-based lighting")?;
        let atlas = Atlas::new(backend, radiance.size())?;
        let scene = backend.scene().clone();
        let of_texel = |texel: &u32| f64::from(mean_of_channels(radiance.data[*texel as usize]));
        let mean = atlas.texels.iter().map(of_texel).sum::<f64>() / atlas.texels.len().max(1) as f64;
        let factor = radiance_scale::radiance_scale(mean);
        let mut radiance = Cow::Borrowed(radiance);
        if factor != 1.0 {
            radiance_scale::scale(radiance.to_mut(), factor);
        }
        backend.set_tbl(&radiance, &Lights::find(&scene, &atlas, &radiance)?)?;
        Ok(Self {
            backend,
            scene,
            radiance_scale: factor,
            rays: rays / STRATUM.len() as u32,
            seed,
            pyramids: Vec::new(),
        })
    }

    /// What brings the light of the scene to about 1.
    pub(crate) fn radiance_scale(&self) -> f32 {
        self.radiance_scale
    }

    /// The mesh that views are rendered of.
    pub fn mesh(&self) -> &Mesh {
        self.scene.mesh()
    }

    /// See [`rays_per_pixel`].
    pub fn rays_per_pixel(&self) -> u32 {
        rays_per_pixel(self.rays * STRATA as u32)
    }

    fn sampling(&self, masking: Masking) -> TableSampling {
        TableSampling::of_rays(self.rays, masking, self.seed)
    }

    /// Rays of a view, as progress counts them.
    pub fn rays(&self, camera: &Camera) -> u64 {
        camera.pixels() as u64 * u64::from(self.rays_per_pixel())
    }

    /// Textures ready to be seen in views of this renderer's scene: with their mip levels, a third of their memory
    /// more.
    pub fn mipmapped<'t>(&mut self, textures: &'t Textures) -> Result<Mipmapped<'t>> {
        Mipmapped::new(self.scene.clone(), textures, |size| self.pyramid(size))
    }

    /// The materials and light at every pixel centre, looked up at that point alone, as renderers write them.
    pub fn surfaces(&mut self, camera: &Camera, textures: &Mipmapped<'_>) -> Result<GBuffer> {
        camera.check()?;
        let scene = self.scene.clone();
        textures.check(&scene)?;
        let seen = |hit: &Hit| match hit.is_hit() {
            true => textures.at(&Footprint::centre(scene.mesh(), hit)),
            false => Seen::default(),
        };
        let (width, height) = (camera.width, camera.height);
        let rgb = || Vec::with_capacity(camera.pixels());
        let (mut albedo, mut irradiance, mut emission) = (rgb(), rgb(), rgb());
        let mut hits = Vec::with_capacity(camera.pixels());
        let mut roughness = Vec::with_capacity(camera.pixels());
        for rows in bands(width, height, CHUNK) {
            let band = self.backend.primary(camera, rows)?;
            for seen in band.par_iter().map(seen).collect::<Vec<Seen>>() {
                albedo.push(seen.albedo);
                roughness.push(seen.roughness);
                irradiance.push(seen.irradiance);
                emission.push(seen.emission);
            }
            hits.extend(band);
        }
        Ok(GBuffer {
            hits,
            albedo: Raster::new(width, height, albedo)?,
            roughness: Raster::new(width, height, roughness)?,
            irradiance: Raster::new(width, height, irradiance)?,
            emission: Raster::new(width, height, emission)?,
        })
    }

    /// The view's radiance. Advances `progress` by [`Renderer::rays`]; the caller starts and finishes the task.
    pub fn render(&mut self, camera: &Camera, textures: &Mipmapped<'_>, progress: &dyn Progress) -> Result<Rgb> {
        let [radiance] = self.render_each(camera, [textures], progress)?;
        Ok(radiance)
    }

    /// The view's radiance under several sets of textures, for the rays of one: light does not depend on them.
    pub fn render_each<const N: usize>(
        &mut self,
        camera: &Camera,
        textures: [&Mipmapped<'_>; N],
        progress: &dyn Progress,
    ) -> Result<[Rgb; N]> {
        camera.check()?;
        let fine = camera.supersampled(SUB_PIXELS);
        indexable(&fine)?;
        let scene = self.scene.clone();
        textures.iter().try_for_each(|textures| textures.check(&scene))?;
        let metals = textures.iter().any(|textures| textures.is_metal());
        let mut radiance = [(); N].map(|()| Rgb::filled(camera.width, camera.height, [0.0; 3]));
        for rows in bands(ALL * camera.width, camera.height, CHUNK) {
            progress.check()?;
            let first = rows.start * SUB_PIXELS * fine.width;
            let hits = self.backend.primary(&fine, rows.start * SUB_PIXELS..rows.end * SUB_PIXELS)?;
            let band = Band { mesh: scene.mesh(), camera: &fine, hits, first };
            let pixels = rows.start * camera.width..rows.end * camera.width;
            // Sub-pixels that hit something, and which of these are strata.
            let hitting: Vec<u32> = sub_pixels(&fine, pixels.clone()).filter(|&i| band.hit(i).is_hit()).collect();
            let strata: Vec<usize> = (0..hitting.len()).filter(|k| is_stratum(&fine, hitting[*k])).collect();
            let missed = pixels.len() * STRATUM.len() - strata.len();
            progress.advance(missed as u64 * u64::from(self.sampling(Masking::default()).rays()));
            let at_strata: Vec<_> = strata.par_iter().map(|&k| [band.point(hitting[k], [0.0; 3]); STRATA]).collect();
            let highlights = self.highlights(&at_strata, &textures, metals, progress)?;
            for (radiance, textures) in radiance.iter_mut().zip(textures) {
                let mut add = |i: u32, share: usize, value: [f32; 3]| {
                    let (x, y) = (i as usize % fine.width / SUB_PIXELS, i as usize / fine.width / SUB_PIXELS);
                    let sum = &mut radiance.data[y * camera.width + x];
                    *sum = std::array::from_fn(|c| sum[c] + value[c] / share as f32);
                };
                let seen: Vec<Seen> = hitting.par_iter().map(|&i| band.seen(i, textures)).collect();
                let specular = highlights.iter().find(|of| of.masking == textures.masking);
                let specular = specular.map_or(Vec::new(), |of| of.radiance(&strata, &seen));
                let specular = specular.into_iter().map(|value| value.map(|v| v / self.radiance_scale));
                strata.iter().zip(specular).for_each(|(&k, value)| add(hitting[k], STRATUM.len(), value));
                let rest = |(&i, seen): (&u32, &Seen)| band.diffuse_and_emitted(i, seen, textures.diffuse);
                let rest: Vec<_> = hitting.par_iter().zip(&seen).map(rest).collect();
                hitting.iter().zip(rest).for_each(|(&i, value)| add(i, ALL, value));
            }
        }
        Ok(radiance)
    }

    /// What light strata reflect specularly, under every masking that one of the textures has.
    fn highlights(
        &mut self,
        points: &[[ShadePoint; STRATA]],
        textures: &[&Mipmapped<'_>],
        metals: bool,
        progress: &dyn Progress,
    ) -> Result<Vec<Highlights>> {
        let white_points = if metals { points } else { &[] };
        let mut all: Vec<Highlights> = Vec::new();
        for masking in textures.iter().map(|textures| textures.masking) {
            if all.iter().all(|known| known.masking != masking) {
                // Unasked-for rays are not counted: they depend on the textures.
                let uncounted = &Uncounted(progress);
                let counted = if all.is_empty() { progress } else { uncounted };
                let sampling = self.sampling(masking);
                let dielectric = self.backend.specular_tables(points, DIELECTRIC_F0 as f32, sampling, counted)?;
                let white = self.backend.specular_tables(white_points, 1.0, sampling, uncounted)?;
                all.push(Highlights { masking, dielectric, white });
            }
        }
        Ok(all)
    }

    /// The atlas's pyramid at a size, made at its first use.
    fn pyramid(&mut self, [width, height]: [usize; 2]) -> Result<Arc<Pyramid>> {
        let known = self.pyramids.iter().find(|p| (p.levels[0].width, p.levels[0].height) == (width, height));
        if let Some(known) = known {
            return Ok(known.clone());
        }
        let pyramid = Arc::new(Atlas::new(self.backend, [width, height])?.pyramid());
        self.pyramids.push(pyramid.clone());
        Ok(pyramid)
    }
}

/// Sub-pixels are numbered in 32 bits.
fn indexable(camera: &Camera) -> Result<()> {
    let Camera { width, height, .. } = camera;
    u32::try_from(camera.pixels()).map(|_| ()).map_err(|_| {
        Error::invalid(format!("a view of {width} × {height} samples has more than 2³² of them; render a smaller one"))
    })
}

/// Indices in the finer image of all sub-pixels of some pixels, pixel by pixel.
fn sub_pixels(fine: &Camera, pixels: Range<usize>) -> impl Iterator<Item = u32> + use<> {
    let fine = *fine;
    pixels.flat_map(move |pixel| (0..ALL).map(move |k| fine.sub_pixel(SUB_PIXELS, pixel, k) as u32))
}

/// Whether a sub-pixel's highlights are traced.
fn is_stratum(fine: &Camera, sub_pixel: u32) -> bool {
    let (x, y) = (sub_pixel as usize % fine.width, sub_pixel as usize / fine.width);
    STRATUM.contains(&(x % SUB_PIXELS, y % SUB_PIXELS))
}

/// What some rows of a supersampled view hit.
struct Band<'a> {
    mesh: &'a Mesh,
    camera: &'a Camera,
    hits: Vec<Hit>,
    /// Index in the view of the first of them.
    first: usize,
}

impl Band<'_> {
    /// What a pixel of the view hits.
    fn hit(&self, pixel: u32) -> Hit {
        self.hits[pixel as usize - self.first]
    }

    fn point(&self, pixel: u32, irradiance: [f32; 3]) -> ShadePoint {
        ShadePoint::new(self.mesh, self.camera, pixel, &self.hit(pixel), irradiance)
    }

    /// What a pixel, which must hit something, shows.
    fn seen(&self, pixel: u32, textures: &Mipmapped<'_>) -> Seen {
        let (x, y) = (pixel as usize % self.camera.width, pixel as usize / self.camera.width);
        textures.at(&Footprint::area(self.mesh, self.camera, &self.hit(pixel), x, y))
    }

    /// Radiance that leaves a pixel without its highlights: f_d · E / π + emission.
    fn diffuse_and_emitted(&self, pixel: u32, seen: &Seen, diffuse: DiffuseModel) -> [f32; 3] {
        let cosine = self.point(pixel, seen.irradiance).cosine();
        let factor = diffuse.factor(cosine, seen.roughness) * FRAC_1_PI * (1.0 - seen.metallic);
        std::array::from_fn(|c| seen.albedo[c] * seen.irradiance[c] * factor + seen.emission[c])
    }
}

/// Specular radiance, in the unit of the backend's lighting, of a band's strata by roughness, under one masking; linear
/// in F0, and known at two.
struct Highlights {
    masking: Masking,
    /// At the F0 of dielectrics.
    dielectric: Vec<Curve>,
    /// At 1; empty where nothing is metal.
    white: Vec<Curve>,
}

impl Highlights {
    /// What the strata reflect, which are these of what is seen.
    fn radiance(&self, strata: &[usize], seen: &[Seen]) -> Vec<[f32; 3]> {
        let of_stratum = |(k, &at): (usize, &usize)| {
            let seen = &seen[at];
            let dielectric = self.dielectric[k].at(seen.roughness).0;
            let Some(white) = self.white.get(k) else { return dielectric };
            let white = white.at(seen.roughness).0;
            let f0 = brdf::f0(V3(seen.albedo), seen.metallic).0;
            let share = |c: usize| (f0[c] - DIELECTRIC_F0 as f32) / (1.0 - DIELECTRIC_F0 as f32);
            std::array::from_fn(|c| dielectric[c] + share(c) * (white[c] - dielectric[c]))
        };
        strata.par_iter().enumerate().map(of_stratum).collect()
    }
}

#[cfg(test)]
mod tests;
