//! The scene in device memory: the hierarchy, its triangles and the texture-based lighting.

use bytemuck::{Pod, Zeroable};
use texir_core::environment::Environment;
use texir_core::error::{Error, Result};
use texir_core::lights::{LightPart, Lights, Part};
use texir_core::raster::Rgb;
use texir_core::scene::Scene;

use crate::buffer::{View, keep, uniform};
use crate::gpu::Gpu;

/// Columns of a texture that holds an array.
pub(crate) const TEXTURE_COLUMNS: u32 = 8192;

/// Bytes written into a texture at once.
const TEXTURE_PIECE: usize = 32 << 20;

/// As `shared/micromaps.wgsl` has it: of a triangle that rays meet in parts, its tag is where its micromap begins.
pub(crate) const IN_PARTS: u32 = 1 << 31;
/// With the number of parts along its edges: its second and third corner are swapped.
pub(crate) const MIRRORED: u32 = 1 << 31;

/// Where the hierarchy lies on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BvhStorage {
    /// In storage buffers: for GPUs.
    Buffers,
    /// In float storage textures, whose fetches are faster on software drivers.
    Textures,
}

impl BvhStorage {
    /// The faster one for a device.
    pub fn best(gpu: &Gpu) -> Self {
        // Other APIs' software drivers are not measured, and need not keep the bits of small numbers in float textures.
        let vulkan = gpu.info().backend == wgpu::Backend::Vulkan;
        let wide = gpu.device().limits().max_texture_dimension_2d >= TEXTURE_COLUMNS;
        if gpu.is_software() && vulkan && wide { Self::Textures } else { Self::Buffers }
    }
}

/// What rays meet of a scene's triangles: kernels are compiled for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum SceneOpacity {
    /// All of all.
    Opaque,
    /// Of some triangles parts.
    InParts,
    /// Likewise, and some let the same share of light through all over.
    Translucent,
}

impl SceneOpacity {
    #[cfg(test)]
    pub const ALL: [Self; 3] = [Self::Opaque, Self::InParts, Self::Translucent];

    /// Of a scene.
    pub fn of(scene: &Scene) -> Self {
        match scene.micromaps() {
            [] => Self::Opaque,
            _ if scene.is_translucent() => Self::Translucent,
            _ => Self::InParts,
        }
    }
}

/// An array for the shader.
enum DeviceArray {
    Buffer(View),
    Texture(wgpu::TextureView),
}

impl DeviceArray {
    fn new(gpu: &Gpu, name: &str, words: &[[u32; 4]], place: BvhStorage) -> Result<Self> {
        if place == BvhStorage::Buffers {
            return Ok(Self::Buffer(keep(gpu, name, words)?));
        }
        let mut padded;
        let columns = TEXTURE_COLUMNS as usize;
        let rows = words.len().div_ceil(columns).max(1);
        let full = if words.len() == rows * columns {
            words
        } else {
            padded = words.to_vec();
            padded.resize(rows * columns, [0; 4]);
            &padded
        };
        let usage = wgpu::TextureUsages::STORAGE_BINDING;
        let view = texture(gpu, name, usage, [TEXTURE_COLUMNS, rows as u32], |first, count| {
            bytemuck::cast_slice(&full[first * columns..(first + count) * columns]).to_vec()
        })?;
        Ok(Self::Texture(view))
    }

    fn binding(&self) -> wgpu::BindingResource<'_> {
        match self {
            Self::Buffer(view) => view.binding(),
            Self::Texture(view) => wgpu::BindingResource::TextureView(view),
        }
    }
}

/// The mesh and its hierarchy, ready to be traced.
pub(crate) struct Geometry {
    nodes: DeviceArray,
    triangles: DeviceArray,
    /// What surrounds it.
    pub sky: EnvironmentMap,
}

impl Geometry {
    pub fn new(gpu: &Gpu, scene: &Scene, place: BvhStorage) -> Result<Self> {
        let (mesh, order) = (scene.mesh(), scene.primitives());
        let word = |v: glam::Vec3, w: u32| [v.x.to_bits(), v.y.to_bits(), v.z.to_bits(), w];
        let mut triangles = Vec::with_capacity(4 * order.len());
        let (micromaps, begins) = micromap_words(scene, 4 * order.len());
        for &t in order {
            let [a, b, c] = mesh.corners(t);
            let [uv_a, uv_b, uv_c] = mesh.corner_uvs(t);
            let in_parts = scene.micromaps().binary_search_by_key(&t, |(triangle, _)| *triangle);
            let tag = in_parts.map_or(t, |k| IN_PARTS | begins[k]);
            triangles.extend([word(a, tag), word(b - a, uv_c.x.to_bits()), word(c - a, uv_c.y.to_bits())]);
            triangles.push([uv_a.x, uv_a.y, uv_b.x, uv_b.y].map(f32::to_bits));
        }
        triangles.extend(micromaps);
        Ok(Self {
            nodes: DeviceArray::new(gpu, "hierarchy", bytemuck::cast_slice(scene.nodes()), place)?,
            triangles: DeviceArray::new(gpu, "triangles", &triangles, place)?,
            sky: EnvironmentMap::new(gpu, None)?,
        })
    }

    /// What tracing passes bind.
    pub fn bindings(&self) -> [(&'static str, wgpu::BindingResource<'_>); 2] {
        [("bvh_nodes", self.nodes.binding()), ("bvh_triangles", self.triangles.binding())]
    }

    /// What gathering passes bind.
    pub fn lit_by<'a>(&'a self, lighting: &'a Lighting) -> [(&'static str, wgpu::BindingResource<'a>); 4] {
        let [nodes, triangles] = self.bindings();
        let tbl = ("tbl", wgpu::BindingResource::TextureView(&lighting.tbl));
        let environment = ("environment", wgpu::BindingResource::TextureView(&self.sky.radiance));
        [nodes, triangles, tbl, environment]
    }
}

/// The micromaps of a scene, behind `first` words, as `shared/micromaps.wgsl` reads them; and where each begins.
fn micromap_words(scene: &Scene, first: usize) -> (Vec<[u32; 4]>, Vec<u32>) {
    let (mut words, mut begins) = (Vec::new(), Vec::new());
    for (triangle, micromap) in scene.micromaps() {
        begins.push((first + words.len()) as u32);
        let even = micromap.even_opacity().unwrap_or(0.0).to_bits();
        let mirrored = if micromap.is_mirrored() { MIRRORED } else { 0 };
        words.push([*triangle, micromap.side() | mirrored, even, micromap.seed()]);
        words.extend(micromap.words().chunks(4).map(|bits| {
            let mut word = [0; 4];
            word[..bits.len()].copy_from_slice(bits);
            word
        }));
    }
    (words, begins)
}

/// What rays see that miss the mesh, and the density with which it is sampled.
pub(crate) struct EnvironmentMap {
    radiance: wgpu::TextureView,
    bright_rows: View,
    bright_pixels: View,
    /// Rows with bright pixels; 0 where nothing stands out.
    pub rows: u32,
}

impl EnvironmentMap {
    /// An environment, or blackness.
    pub fn new(gpu: &Gpu, environment: Option<&Environment>) -> Result<Self> {
        let black = Environment::constant([0.0; 3])?;
        let environment = environment.unwrap_or(&black);
        let bright = environment.bright();
        Ok(Self {
            radiance: environment_texture(gpu, environment)?,
            bright_rows: keep(gpu, "bright rows", &bright.rows)?,
            bright_pixels: keep(gpu, "bright pixels", &bright.pixels)?,
            rows: bright.rows.len() as u32,
        })
    }

    /// What passes bind that sample it.
    pub fn bindings(&self) -> [(&'static str, wgpu::BindingResource<'_>); 2] {
        [("bright_rows", self.bright_rows.binding()), ("bright_pixels", self.bright_pixels.binding())]
    }
}

/// As `shared/light_sampling.wgsl` has it: by primitive of the hierarchy, not by triangle of the mesh.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct LightPrimitive {
    pub primitive: u32,
    pub part: Part,
    pub cluster: u32,
    pub pdf_area: f32,
}

/// As `shared/light_sampling.wgsl` has it.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct LightGrid {
    pub origin: [f32; 3],
    pub per_metre: f32,
    pub size: [u32; 3],
    pub clusters: u32,
    pub first_cell: u32,
    pub first_cluster: u32,
    pub first_member: u32,
    pub first_cdf: u32,
    pub one_sided: u32,
    pub pad: [u32; 3],
}

/// The texture-based lighting and the lights in it.
pub(crate) struct Lighting {
    /// Outgoing radiance.
    tbl: wgpu::TextureView,
    light_primitives: View,
    light_index: View,
    light_tables: View,
    light_grid: View,
    /// Clusters of lights; 0 without lights.
    pub clusters: usize,
}

impl Lighting {
    pub fn new(gpu: &Gpu, scene: &Scene, radiance: &Rgb, lights: &Lights) -> Result<Self> {
        let order = scene.primitives();
        let triangles = scene.mesh().triangles.len();
        let mut primitive_of = vec![0; triangles];
        for (primitive, &triangle) in order.iter().enumerate() {
            primitive_of[triangle as usize] = primitive as u32;
        }
        let primitives: Vec<LightPrimitive> = (lights.parts.iter())
            .map(|&LightPart { triangle, part, cluster, pdf_area }| {
                let primitive = primitive_of.get(triangle as usize).copied().unwrap_or(0);
                LightPrimitive { primitive, part, cluster, pdf_area }
            })
            .collect();
        let mut index: Vec<u32> = order.iter().map(|&t| bytemuck::cast(lights.cuts[t as usize])).collect();
        let first_cell = index.len() as u32;
        index.extend(&lights.grid.tables);
        let first_cluster = index.len() as u32;
        index.extend(&lights.clusters);
        let first_member = index.len() as u32;
        index.extend(&lights.members);
        let clusters = lights.clusters.len() - 1;
        let grid = LightGrid {
            origin: lights.grid.origin.to_array(),
            per_metre: lights.grid.per_metre,
            size: lights.grid.size,
            clusters: clusters as u32,
            first_cell,
            first_cluster,
            first_member,
            first_cdf: lights.tables.len() as u32,
            one_sided: u32::from(lights.one_sided),
            pad: [0; 3],
        };
        Ok(Self {
            tbl: radiance_texture(gpu, "texture-based lighting", radiance)?,
            light_primitives: keep(gpu, "light primitives", &primitives)?,
            light_index: keep(gpu, "light index", &index)?,
            light_tables: keep(gpu, "light tables", &[&lights.tables[..], &lights.cdf].concat())?,
            light_grid: uniform(gpu, &grid),
            clusters,
        })
    }

    /// What passes bind that sample the lights.
    pub fn lights(&self) -> [(&'static str, wgpu::BindingResource<'_>); 4] {
        [
            ("light_primitives", self.light_primitives.binding()),
            ("light_index", self.light_index.binding()),
            ("light_tables", self.light_tables.binding()),
            ("light_grid", self.light_grid.binding()),
        ]
    }
}

/// An image of radiance as a texture.
fn radiance_texture(gpu: &Gpu, name: &str, radiance: &Rgb) -> Result<wgpu::TextureView> {
    if radiance.data.is_empty() {
        return Err(Error::invalid(format!("the {name} has no texels")));
    }
    let size = [radiance.width as u32, radiance.height as u32];
    texture(gpu, name, wgpu::TextureUsages::TEXTURE_BINDING, size, |first, count| {
        let texels = &radiance.data[first * radiance.width..(first + count) * radiance.width];
        let rgba: Vec<[f32; 4]> = texels.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect();
        bytemuck::cast_slice(&rgba).to_vec()
    })
}

/// The panorama, with the density of its pixels.
fn environment_texture(gpu: &Gpu, environment: &Environment) -> Result<wgpu::TextureView> {
    let (radiance, density) = (environment.radiance(), &environment.bright().density);
    let size = [radiance.width as u32, radiance.height as u32];
    texture(gpu, "environment", wgpu::TextureUsages::TEXTURE_BINDING, size, |first, count| {
        let pixels = first * radiance.width..(first + count) * radiance.width;
        let rgba: Vec<[f32; 4]> = pixels
            .map(|i| {
                let [r, g, b] = radiance.data[i];
                [r, g, b, density[i]]
            })
            .collect();
        bytemuck::cast_slice(&rgba).to_vec()
    })
}

/// An rgba32float texture, written in pieces of rows: `rows(first, count)` gives their bytes.
fn texture(
    gpu: &Gpu,
    name: &str,
    usage: wgpu::TextureUsages,
    [width, height]: [u32; 2],
    rows: impl Fn(usize, usize) -> Vec<u8>,
) -> Result<wgpu::TextureView> {
    let limit = gpu.device().limits().max_texture_dimension_2d;
    if width > limit || height > limit {
        return Err(Error::device(format!(
            "{}: the {name} needs a {width} × {height} texture, and this device takes at most {limit} × {limit}",
            gpu.info().name,
        )));
    }
    let texture = gpu.device().create_texture(&wgpu::TextureDescriptor {
        label: Some(name),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage: usage | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    let row_bytes = 16 * width;
    let piece = (TEXTURE_PIECE / row_bytes as usize).max(1) as u32;
    for first in (0..height).step_by(piece as usize) {
        let count = piece.min(height - first);
        gpu.queue().write_texture(
            wgpu::TexelCopyTextureInfo { origin: wgpu::Origin3d { x: 0, y: first, z: 0 }, ..texture.as_image_copy() },
            &rows(first as usize, count as usize),
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row_bytes), rows_per_image: None },
            wgpu::Extent3d { width, height: count, depth_or_array_layers: 1 },
        );
        // Otherwise the pieces' staging memory is held until the next submission, all of it at once.
        gpu.queue().submit([]);
    }
    Ok(texture.create_view(&Default::default()))
}
