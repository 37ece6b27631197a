//! Renders the flat: global illumination with the material model that texir fits.
//!
//! Outgoing radiance is emission + a/π·E + the GGX lobe of [`crate::brdf`] (metallic 0). E comes from
//! [`super::irradiance`]: direct light and all diffuse bounces, solved once in the atlas. The lobe is integrated per
//! pixel by tracing: one lobe sample per sub-pixel sample and per bounce, and emitter samples, several at the first
//! bounce, joined by multiple importance sampling.
//!
//! Included: every path of diffuse bounces; up to [`RenderOptions::specular_bounces`] specular reflections in a row
//! before the camera; between diffuse surfaces up to one (caustics of lamps and of lit surfaces). Left out: longer
//! chains of specular reflections, each of which reflects a few per cent. Irradiance is a texture, filtered along the
//! surface: over one texel (about 2 cm, standard deviation) for direct light, over 6 cm for indirect.

use glam::Vec3;
use rayon::prelude::*;

use super::Flat;
use super::cameras::Panorama;
use super::irradiance;
use super::options::RenderOptions;
use super::random::{Sample, stream};
use super::trace::{Vertex, World, bilinear, lobe, sample_lobe};
use crate::error::{Error, Result};
use crate::progress::{Progress, Task};
use crate::raster::{Gray, Labels, Mask, Raster, Rgb};

/// Emitter samples at the first bounce, where a small lamp in a lobe of middling width would sparkle.
const FIRST_LIGHTS: usize = 6;

/// One rendered view with its ground truth.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// The camera.
    pub shot: Panorama,
    /// Linear radiance, box-filtered over the pixel.
    pub image: Rgb,
    /// Linear albedo at the pixel centre.
    pub albedo: Rgb,
    /// Perceptual roughness at the pixel centre.
    pub roughness: Gray,
    /// Semantic class at the pixel centre; 0 where nothing was hit.
    pub semantic: Labels,
    /// Room id of the surface at the pixel centre; 0 where nothing was hit.
    pub room: Labels,
    /// False on emitters and where nothing was hit.
    pub mask: Mask,
}

/// Solves the light and renders all shots. Deterministic for the options, whatever the number of threads.
pub fn render(
    flat: &Flat,
    shots: &[Panorama],
    options: &RenderOptions,
    progress: &dyn Progress,
) -> Result<Vec<Rendered>> {
    for (field, value) in [
        ("pixel_samples", options.pixel_samples),
        ("light_samples", options.light_samples),
        ("gather_rays", options.gather_rays),
    ] {
        if value == 0 || value > 1 << 20 {
            return Err(Error::invalid(format!("{field} must be from 1 to 2^20, got {value}")));
        }
    }
    let world = World::new(flat)?;
    let light = Light { irradiance: irradiance::solve(&world, options, progress)?, world, options: *options };
    let rows = shots.iter().map(|shot| shot.camera.height as u64).sum();
    let _task = Task::start(progress, "demo: views", rows, "rows");
    shots.iter().enumerate().map(|(i, shot)| light.view(i, shot, progress)).collect()
}

/// What one pixel holds.
struct Pixel {
    image: Vec3,
    albedo: Vec3,
    roughness: f32,
    semantic: u16,
    room: u16,
    mask: bool,
}

/// The flat with its light solved.
struct Light<'a> {
    world: World<'a>,
    irradiance: Rgb,
    options: RenderOptions,
}

impl Light<'_> {
    fn view(&self, index: usize, shot: &Panorama, progress: &dyn Progress) -> Result<Rendered> {
        let (width, height) = (shot.camera.width, shot.camera.height);
        let mut pixels = Vec::with_capacity(width * height);
        let rows_at_once = (4096 / width).max(1);
        for first in (0..height).step_by(rows_at_once) {
            progress.check()?;
            let rows = rows_at_once.min(height - first);
            let chunk = first * width..(first + rows) * width;
            pixels.par_extend(chunk.into_par_iter().map(|i| {
                let seed = stream(self.options.seed, 100 + index as u32, i);
                self.pixel(shot, i % width, i / width, seed)
            }));
            progress.advance(rows as u64);
        }
        let rgb = |value: fn(&Pixel) -> Vec3| {
            Raster::new(width, height, pixels.iter().map(|p| value(p).to_array()).collect())
        };
        let label = |value: fn(&Pixel) -> u16| Raster::new(width, height, pixels.iter().map(value).collect());
        Ok(Rendered {
            shot: shot.clone(),
            image: rgb(|p| p.image)?,
            albedo: rgb(|p| p.albedo)?,
            roughness: Raster::new(width, height, pixels.iter().map(|p| p.roughness).collect())?,
            semantic: label(|p| p.semantic)?,
            room: label(|p| p.room)?,
            mask: Raster::new(width, height, pixels.iter().map(|p| p.mask).collect())?,
        })
    }

    fn pixel(&self, shot: &Panorama, x: usize, y: usize, seed: u32) -> Pixel {
        let camera = &shot.camera;
        let origin = camera.position();
        let mut image = Vec3::ZERO;
        for i in 0..self.options.pixel_samples {
            let mut sample = Sample::new(seed, i as u32);
            let [dx, dy] = sample.pair();
            let direction = camera.direction(x as f32 + dx, y as f32 + dy);
            if let Some(vertex) = self.world.closest(origin, direction) {
                let specular = self.specular(&vertex, -direction, self.options.specular_bounces, &mut sample);
                image += self.world.emission(&vertex) + self.diffuse(&vertex) + specular;
            }
        }
        let image = image / self.options.pixel_samples as f32;
        match self.world.closest(origin, camera.direction(x as f32 + 0.5, y as f32 + 0.5)) {
            Some(vertex) => {
                let (semantic, room) = self.world.flat.labels(vertex.triangle);
                Pixel {
                    image,
                    albedo: self.world.albedo(vertex.uv),
                    roughness: self.world.roughness(vertex.uv),
                    semantic,
                    room,
                    mask: !self.world.emitters.contains(vertex.triangle),
                }
            }
            None => Pixel { image, albedo: Vec3::ZERO, roughness: 0.0, semantic: 0, room: 0, mask: false },
        }
    }

    /// Diffuse outgoing radiance a/π·E; none from the inside of an object.
    fn diffuse(&self, vertex: &Vertex) -> Vec3 {
        if !vertex.front {
            return Vec3::ZERO;
        }
        self.world.albedo(vertex.uv) * bilinear(&self.irradiance, vertex.uv) / std::f32::consts::PI
    }

    /// Radiance reflected by the specular lobe towards `view`, following up to `bounces` reflections.
    fn specular(&self, vertex: &Vertex, view: Vec3, bounces: usize, sample: &mut Sample) -> Vec3 {
        if bounces == 0 || !vertex.front {
            return Vec3::ZERO;
        }
        let world = &self.world;
        let (choice, roughness) = (world.choice(vertex), world.roughness(vertex.uv));
        let lights = if bounces == self.options.specular_bounces { FIRST_LIGHTS } else { 1 };
        let mut sum = Vec3::ZERO;
        for _ in 0..lights {
            if let Some((direction, radiance, p_light)) = world.light(vertex.position, vertex.normal, &choice, sample) {
                let (value, p_lobe) = lobe(vertex.normal, view, direction, roughness);
                sum += radiance * value / (lights as f32 * p_light + p_lobe);
            }
        }
        if let Some(drawn) = sample_lobe(vertex.normal, view, roughness, sample.pair())
            && let Some(next) = world.closest(vertex.position, drawn.direction)
        {
            let share = drawn.pdf / (drawn.pdf + lights as f32 * world.light_pdf(&next, &choice));
            let further = self.specular(&next, -drawn.direction, bounces - 1, sample);
            sum += (world.emission(&next) * share + self.diffuse(&next) + further) * drawn.weight;
        }
        sum
    }
}
