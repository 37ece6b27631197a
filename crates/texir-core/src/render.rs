//! Views of a scene with given textures: what `render`, `eval` and `report` look at.
//!
//! primary hits → trilinear footprints → material at every pixel ([`Renderer::surfaces`]) → shade, add emission
//! ([`Renderer::render`]).

use glam::Vec3;

use crate::atlas::Atlas;
use crate::backend::{Backend, Material, RoughnessGradient, Sampling, ShadePoint};
use crate::camera::Camera;
use crate::error::Result;
use crate::progress::Progress;
use crate::raster::{Gray, Mask, Raster, Rgb};
use crate::scene::Scene;
use crate::surface::{Hit, SurfacePoint};
use crate::texture::{Footprints, Pyramid};

/// Pixels shaded per call of the backend: bounds its buffers (about 10 MB) whatever the size of the view.
const CHUNK: usize = 1 << 16;

/// Textures in the scene's atlas. Their resolutions may differ.
#[derive(Clone, Debug, PartialEq)]
pub struct Textures {
    /// Linear albedo.
    pub albedo: Rgb,
    /// Perceptual roughness.
    pub roughness: Gray,
    /// Irradiance E: cosine included, not divided by π.
    pub irradiance: Rgb,
    /// Emitted radiance; 0 where nothing glows.
    pub emission: Rgb,
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

/// A rendered view with the buffers it was shaded from.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderedView {
    /// Outgoing radiance, emission included; black where the ray met nothing.
    pub radiance: Rgb,
    /// The materials and light it was shaded from.
    pub surfaces: Surfaces,
}

/// Renders views of one scene. The backend's TBL is what highlights reflect: set it first.
pub struct Renderer<'a> {
    backend: &'a mut dyn Backend,
    scene: &'a Scene,
    sampling: Sampling,
    pyramids: Vec<Pyramid>,
}

impl<'a> Renderer<'a> {
    /// A renderer with `sampling.samples` specular samples per pixel.
    pub fn new(backend: &'a mut dyn Backend, scene: &'a Scene, sampling: Sampling) -> Self {
        Self { backend, scene, sampling, pyramids: Vec::new() }
    }

    /// Specular samples per pixel.
    pub fn samples(&self) -> u32 {
        self.sampling.samples
    }

    /// Rays of a view, as progress counts them: samples × pixels.
    pub fn rays(&self, camera: &Camera) -> u64 {
        camera.pixels() as u64 * u64::from(self.sampling.samples)
    }

    /// The materials and light at every pixel, by trilinear lookup.
    pub fn surfaces(&mut self, camera: &Camera, textures: &Textures) -> Result<Surfaces> {
        let hits = self.backend.primary(camera)?;
        let mut footprints = Vec::new();
        let mut rgb = |texture: &Rgb| -> Result<Rgb> {
            let texels = bytemuck::cast_slice(&texture.data);
            let values = self.look_up(camera, &hits, texture.size(), texels, 3, &mut footprints)?;
            Raster::new(camera.width, camera.height, values.as_chunks::<3>().0.to_vec())
        };
        let albedo = rgb(&textures.albedo)?;
        let irradiance = rgb(&textures.irradiance)?;
        let emission = rgb(&textures.emission)?;
        let size = textures.roughness.size();
        let roughness = self.look_up(camera, &hits, size, &textures.roughness.data, 1, &mut footprints)?;
        let roughness = Raster::new(camera.width, camera.height, roughness)?;
        Ok(Surfaces { hits, albedo, roughness, irradiance, emission })
    }

    /// The view's radiance. Advances `progress` by [`Renderer::rays`]; the caller starts and finishes the task.
    pub fn render(&mut self, camera: &Camera, textures: &Textures, progress: &dyn Progress) -> Result<RenderedView> {
        let surfaces = self.surfaces(camera, textures)?;
        let mut radiance = Rgb::filled(camera.width, camera.height, [0.0; 3]);
        let seen: Vec<usize> = (0..camera.pixels()).filter(|&i| surfaces.hits[i].is_hit()).collect();
        for pixels in seen.chunks(CHUNK) {
            let points: Vec<ShadePoint> = pixels.iter().map(|&i| self.shade_point(camera, &surfaces, i)).collect();
            let materials: Vec<Material> = pixels
                .iter()
                .map(|&i| Material::dielectric(surfaces.albedo.data[i], surfaces.roughness.data[i]))
                .collect();
            let shaded = self.backend.shade(&points, &materials, self.sampling, RoughnessGradient::Exact, progress)?;
            for (&i, shaded) in pixels.iter().zip(&shaded) {
                let emitted = surfaces.emission.data[i];
                radiance.data[i] = std::array::from_fn(|c| shaded.radiance[c] + emitted[c]);
            }
        }
        progress.advance((camera.pixels() - seen.len()) as u64 * u64::from(self.sampling.samples));
        Ok(RenderedView { radiance, surfaces })
    }

    fn shade_point(&self, camera: &Camera, surfaces: &Surfaces, pixel: usize) -> ShadePoint {
        let (x, y) = ((pixel % camera.width) as f32 + 0.5, (pixel / camera.width) as f32 + 0.5);
        let view: Vec3 = -camera.direction(x, y);
        let point = SurfacePoint::new(&self.scene.mesh, &surfaces.hits[pixel], Some(view));
        ShadePoint {
            position: point.position,
            sequence: pixel as u32,
            normal: point.normal,
            pad0: 0.0,
            view: view.to_array(),
            pad1: 0.0,
            irradiance: surfaces.irradiance.data[pixel],
            pad2: 0.0,
        }
    }

    /// Index of the atlas's pyramid at a size, made at its first use.
    fn pyramid(&mut self, (width, height): (usize, usize)) -> Result<usize> {
        let known = self.pyramids.iter().position(|p| (p.levels[0].width, p.levels[0].height) == (width, height));
        if let Some(index) = known {
            return Ok(index);
        }
        self.pyramids.push(Atlas::new(self.backend, self.scene, width, height)?.pyramid());
        Ok(self.pyramids.len() - 1)
    }

    /// `channels` numbers per pixel of a texture of the given size. `footprints` keeps the view's footprints by pyramid.
    fn look_up(
        &mut self,
        camera: &Camera,
        hits: &[Hit],
        size: (usize, usize),
        texture: &[f32],
        channels: usize,
        footprints: &mut Vec<(usize, Footprints)>,
    ) -> Result<Vec<f32>> {
        let index = self.pyramid(size)?;
        let pyramid = &self.pyramids[index];
        let known = footprints.iter().position(|(of, _)| *of == index).unwrap_or_else(|| {
            footprints.push((index, Footprints::of_view(pyramid, &self.scene.mesh, camera, hits)));
            footprints.len() - 1
        });
        self.backend.lookup(pyramid, texture, channels, &footprints[known].1)
    }
}
