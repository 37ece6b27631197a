//! Views of a scene with given textures: what `render`, `eval` and `report` look at.
//!
//! primary hits → trilinear footprints → material at every pixel ([`Renderer::surfaces`]) → shade, add emission
//! ([`Renderer::render`]).

use crate::atlas::Atlas;
use crate::backend::{Backend, Material, RoughnessGradient, Sampling, ShadePoint};
use crate::camera::Camera;
use crate::error::Result;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::raster::{Gray, Mask, Raster, Rgb};
use crate::scene::Scene;
use crate::surface::Hit;
use crate::texture::{Footprints, Pyramid};

/// Pixels shaded per call of the backend: bounds its buffers (about 10 MB) whatever the size of the view.
const CHUNK: usize = 1 << 16;

/// Sub-pixel footprints per pixel and axis in rendered views: captured images are box-filtered over the pixel.
const FOOTPRINT_SAMPLES: usize = 2;

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

    /// The materials and light at every pixel centre, by trilinear lookup.
    pub fn surfaces(&mut self, camera: &Camera, textures: &Textures) -> Result<Surfaces> {
        let hits = self.backend.primary(camera)?;
        self.look_up_all(camera, 1, hits, textures)
    }

    /// The view's radiance. Advances `progress` by [`Renderer::rays`]; the caller starts and finishes the task.
    pub fn render(&mut self, camera: &Camera, textures: &Textures, progress: &dyn Progress) -> Result<Rgb> {
        let hits = self.backend.primary(camera)?;
        let pixels: Vec<u32> = (0..camera.pixels() as u32).filter(|&i| hits[i as usize].is_hit()).collect();
        let seen = self.look_up_all(camera, FOOTPRINT_SAMPLES, hits, textures)?;
        let mut radiance = Rgb::filled(camera.width, camera.height, [0.0; 3]);
        for pixels in pixels.chunks(CHUNK) {
            let (points, materials): (Vec<ShadePoint>, Vec<Material>) = pixels
                .iter()
                .map(|&pixel| {
                    let i = pixel as usize;
                    let irradiance = seen.irradiance.data[i];
                    let point = ShadePoint::new(&self.scene.mesh, camera, pixel, &seen.hits[i], irradiance);
                    (point, Material::dielectric(seen.albedo.data[i], seen.roughness.data[i]))
                })
                .unzip();
            let shaded = self.backend.shade(&points, &materials, self.sampling, RoughnessGradient::Exact, progress)?;
            for (&pixel, shaded) in pixels.iter().zip(&shaded) {
                let emitted = seen.emission.data[pixel as usize];
                radiance.data[pixel as usize] = std::array::from_fn(|c| shaded.radiance[c] + emitted[c]);
            }
        }
        progress.advance((camera.pixels() - pixels.len()) as u64 * u64::from(self.sampling.samples));
        Ok(radiance)
    }

    /// All textures through the footprints of `factor`² sub-pixels a pixel; `hits` are those of the pixel centres.
    fn look_up_all(&mut self, camera: &Camera, factor: usize, hits: Vec<Hit>, textures: &Textures) -> Result<Surfaces> {
        let fine = camera.supersampled(factor);
        let fine_hits = if factor == 1 { hits.clone() } else { self.backend.primary(&fine)? };
        let mut seen = Seen { fine, factor, hits: fine_hits, footprints: Vec::new() };
        let mut rgb = |texture: &Rgb| -> Result<Rgb> {
            let values = self.look_up(texture.size(), bytemuck::cast_slice(&texture.data), 3, &mut seen)?;
            Raster::new(camera.width, camera.height, values.as_chunks::<3>().0.to_vec())
        };
        let albedo = rgb(&textures.albedo)?;
        let irradiance = rgb(&textures.irradiance)?;
        let emission = rgb(&textures.emission)?;
        let roughness = self.look_up(textures.roughness.size(), &textures.roughness.data, 1, &mut seen)?;
        let roughness = Raster::new(camera.width, camera.height, roughness)?;
        Ok(Surfaces { hits, albedo, roughness, irradiance, emission })
    }

    /// `channels` numbers per pixel of a texture of the given size.
    fn look_up(&mut self, size: (usize, usize), texture: &[f32], channels: usize, seen: &mut Seen) -> Result<Vec<f32>> {
        let index = self.pyramid(size)?;
        let pyramid = &self.pyramids[index];
        let footprints = seen.footprints(index, pyramid, &self.scene.mesh);
        self.backend.lookup(pyramid, texture, channels, footprints)
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
}

/// What a view's sub-pixels hit, and its footprints by pyramid as they are asked for.
struct Seen {
    fine: Camera,
    factor: usize,
    hits: Vec<Hit>,
    footprints: Vec<(usize, Footprints)>,
}

impl Seen {
    fn footprints(&mut self, index: usize, pyramid: &Pyramid, mesh: &Mesh) -> &Footprints {
        let known = self.footprints.iter().position(|(of, _)| *of == index).unwrap_or_else(|| {
            let pixels: Vec<u32> = (0..(self.fine.pixels() / (self.factor * self.factor)) as u32).collect();
            let made = Footprints::of_pixels(pyramid, mesh, &self.fine, self.factor, &self.hits, &pixels);
            self.footprints.push((index, made));
            self.footprints.len() - 1
        });
        &self.footprints[known].1
    }
}
