//! The result as one GLB: what Blender, three.js, Bevy and Godot show without further files.
//!
//! Base colour is sRGB-encoded; roughness is in G and metallic in B of one linear image; lamps are an emissive image
//! scaled by `KHR_materials_emissive_strength`. TEXCOORD_1 repeats the atlas, for a lightmap. Values that eight bits
//! cannot hold (float albedo and roughness, HDR radiance, irradiance) are written as EXR beside it, by others. Beyond
//! the charts, where all maps are 0, images go on as what is near, so that mips of them keep their colours.

mod beyond;
mod one_sided;

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use bytesize::ByteSize;
use glam::{Vec2, Vec3};
use gltf::binary::{Glb, Header};
use gltf_json::accessor::{ComponentType, GenericComponentType, Type};
use gltf_json::buffer::{Target, View};
use gltf_json::extensions::material::{EmissiveStrength, EmissiveStrengthFactor, Material as MaterialExtensions};
use gltf_json::image::MimeType;
use gltf_json::material::{EmissiveFactor, PbrBaseColorFactor, PbrMetallicRoughness, StrengthFactor};
use gltf_json::mesh::{Mode, Primitive, Semantic};
use gltf_json::scene::UnitQuaternion;
use gltf_json::texture::{Info, MagFilter, MinFilter, Sampler, WrappingMode};
use gltf_json::validation::Checked::Valid;
use gltf_json::validation::USize64;
use gltf_json::{Accessor, Buffer, Image, Index, Material, Mesh as GltfMesh, Node, Root, Scene, Texture, Value};

pub(crate) use self::one_sided::is_one_sided;
use crate::atomic_file::write_atomic;
use crate::error::{Error, Result};
use crate::image_io::{encode_png, encode_srgb};
use crate::mesh::Mesh;
use crate::raster::{Gray, Raster, Rgb, times};

/// How `asset.generator` of what is written here begins.
const GENERATOR: &str = "texir ";

/// Whether a file is a GLB that texir wrote, by its `asset.generator`; not where it cannot be read.
pub fn is_by_texir(path: impl AsRef<Path>) -> bool {
    let generator = || {
        let glb = Glb::from_reader(File::open(path).ok()?).ok()?;
        Root::from_slice(&glb.json).ok()?.asset.generator
    };
    generator().is_some_and(|generator| generator.starts_with(GENERATOR))
}

/// Textures in the mesh's atlas.
#[derive(Clone, Copy, Debug)]
pub struct Materials<'a> {
    /// Base colour, linear, [0, 1].
    pub albedo: &'a Rgb,
    /// Perceptual roughness, [0, 1].
    pub roughness: &'a Gray,
    /// Metallic, [0, 1], of the roughness' size; absent means 0 everywhere.
    pub metallic: Option<&'a Gray>,
    /// Emitted radiance, linear. Black or absent: the material does not emit.
    pub emission: Option<&'a Rgb>,
}

/// The capture's up axis. glTF is Y-up: a Z-up scene stays in its own frame, under a root node that turns it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Up {
    /// +Z, as texir's captures have it.
    #[default]
    Z,
    /// +Y: no rotation.
    Y,
}

/// Writes a mesh with its materials as one GLB with everything inside.
pub fn write_glb(path: impl AsRef<Path>, mesh: &Mesh, materials: &Materials, up: Up) -> Result<()> {
    let path = path.as_ref();
    let mut builder = Builder::default();
    let primitive = builder.primitive(mesh, &mesh.uvs, &[]);
    let material = builder.material(path, materials)?;
    builder.finish_scene(Primitive { material: Some(material), ..primitive }, up);
    builder.write(path)
}

/// The JSON and the binary chunk as they grow. The one buffer has index 0.
#[derive(Default)]
pub(crate) struct Builder {
    pub root: Root,
    bytes: Vec<u8>,
}

impl Builder {
    /// A mesh whose own coordinates are TEXCOORD_1, the lightmap's, and `base` TEXCOORD_0; `further` sets come after
    /// them.
    pub fn primitive(&mut self, mesh: &Mesh, base: &[Vec2], further: &[Vec<Vec2>]) -> Primitive {
        let (low, high) = mesh.bounds();
        let positions = self.accessor("position", ComponentType::F32, Type::Vec3, &mesh.positions);
        let bounded = &mut self.root.accessors[positions.value()];
        bounded.min = Some(Value::from(low.to_array().to_vec()));
        bounded.max = Some(Value::from(high.to_array().to_vec()));
        // Unit again after any rounding: the specification asks for it. Zero has no direction to keep.
        let unit: Vec<Vec3> =
            mesh.normals.iter().map(|n| n.as_dvec3().normalize_or(glam::DVec3::Z).as_vec3()).collect();
        let normals = self.accessor("normal", ComponentType::F32, Type::Vec3, &unit);
        let lightmap = self.accessor::<Vec2>("atlas", ComponentType::F32, Type::Vec2, &mesh.uvs);
        let same = std::ptr::eq(base, mesh.uvs.as_slice());
        let base = if same { lightmap } else { self.accessor::<Vec2>("base", ComponentType::F32, Type::Vec2, base) };
        let further = further.iter().map(|uvs| self.accessor::<Vec2>("uv", ComponentType::F32, Type::Vec2, uvs));
        let sets = (0..).map(|set| Valid(Semantic::TexCoords(set))).zip([base, lightmap].into_iter().chain(further));
        let mut attributes: BTreeMap<_, _> = sets.collect();
        attributes.extend([(Valid(Semantic::Positions), positions), (Valid(Semantic::Normals), normals)]);
        let indices: &[u32] = bytemuck::cast_slice(&mesh.triangles);
        let indices = self.accessor("triangles", ComponentType::U32, Type::Scalar, indices);
        Primitive {
            attributes,
            indices: Some(indices),
            material: None,
            mode: Valid(Mode::Triangles),
            targets: None,
            extensions: None,
            extras: None,
        }
    }

    fn material(&mut self, path: &Path, of: &Materials) -> Result<Index<Material>> {
        let sampler = self.root.push(Sampler {
            mag_filter: Some(Valid(MagFilter::Linear)),
            min_filter: Some(Valid(MinFilter::LinearMipmapLinear)),
            wrap_s: Valid(WrappingMode::ClampToEdge),
            wrap_t: Valid(WrappingMode::ClampToEdge),
            name: Some("atlas".to_owned()),
            ..Sampler::default()
        });
        let albedo = beyond::filled(of.albedo, &of.charts(of.albedo.size()));
        let base_colour = self.texture(path, "albedo", &encode_srgb(&albedo), sampler)?;
        let metallic_roughness = pack_metallic_roughness(of)?;
        let metallic_roughness = self.texture(path, "metallic_roughness", &metallic_roughness, sampler)?;
        let mut material = Material {
            name: Some("texir".to_owned()),
            // texir shades the side that a ray meets: from behind, a wall is there as well. Light it sends from its front.
            double_sided: true,
            extras: one_sided::extras(),
            pbr_metallic_roughness: PbrMetallicRoughness {
                base_color_factor: PbrBaseColorFactor([1.0; 4]),
                base_color_texture: Some(base_colour),
                // Absent factors count as 1, so that a missing metallic map must say 0 here.
                metallic_factor: StrengthFactor(if of.metallic.is_some() { 1.0 } else { 0.0 }),
                roughness_factor: StrengthFactor(1.0),
                metallic_roughness_texture: Some(metallic_roughness),
                ..PbrMetallicRoughness::default()
            },
            ..Material::default()
        };
        let finite = |rgb: &Rgb| rgb.data.iter().flatten().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
        if let Some((emission, strength)) = of.emission.map(|e| (e, finite(e))).filter(|(_, max)| *max > 0.0) {
            let emission = beyond::filled(emission, &of.charts(emission.size()));
            let normalised = emission.map(|rgb| rgb.map(|v| v / strength));
            material.emissive_texture = Some(self.texture(path, "emission", &encode_srgb(&normalised), sampler)?);
            material.emissive_factor = EmissiveFactor([1.0; 3]);
            let emissive_strength = Some(EmissiveStrength { emissive_strength: EmissiveStrengthFactor(strength) });
            material.extensions = Some(MaterialExtensions { emissive_strength, ..Default::default() });
            self.root.extensions_used.push("KHR_materials_emissive_strength".to_owned());
        }
        Ok(self.root.push(material))
    }

    fn finish_scene(&mut self, primitive: Primitive, up: Up) {
        let name = |name: &str| Some(name.to_owned());
        let mesh = self.root.push(GltfMesh {
            name: name("scene"),
            primitives: vec![primitive],
            weights: None,
            extensions: None,
            extras: None,
        });
        let node = self.root.push(Node { mesh: Some(mesh), name: name("scene"), ..Node::default() });
        let rotation = match up {
            Up::Y => None,
            // −90° about X carries +Z to +Y.
            Up::Z => {
                Some(UnitQuaternion([-std::f32::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f32::consts::FRAC_1_SQRT_2]))
            }
        };
        let root = Node { children: Some(vec![node]), name: name("y_up_from_world"), rotation, ..Node::default() };
        let root = self.root.push(root);
        let scene = Scene { nodes: vec![root], name: name("texir"), extensions: None, extras: None };
        self.root.scene = Some(self.root.push(scene));
    }

    /// Writes everything collected.
    pub fn write(mut self, path: &Path) -> Result<()> {
        self.pad();
        self.root.asset.generator = Some(format!("{GENERATOR}{}", env!("CARGO_PKG_VERSION")));
        self.root.buffers.push(Buffer {
            byte_length: USize64::from(self.bytes.len()),
            name: None,
            uri: None,
            extensions: None,
            extras: None,
        });
        let json = self.root.to_vec().map_err(|e| Error::cannot_write(path, e))?;
        check_length((json.len() + self.bytes.len()) as u64).map_err(|what| Error::file(path, what))?;
        // The writer computes the length itself.
        let header = Header { magic: *b"glTF", version: 2, length: 0 };
        let glb = Glb { header, json: json.into(), bin: Some(self.bytes.into()) };
        write_atomic(path, |sink| glb.to_writer(sink))
    }

    /// Aligns what comes next to four bytes.
    fn pad(&mut self) {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
    }

    /// An image with its file's bytes inside.
    pub fn image(&mut self, name: Option<String>, mime_type: &str, file: &[u8]) -> Image {
        Image {
            buffer_view: Some(self.view("image", None, file)),
            mime_type: Some(MimeType(mime_type.to_owned())),
            name,
            uri: None,
            extensions: None,
            extras: None,
        }
    }

    /// A buffer view over bytes that are added to the binary chunk.
    fn view(&mut self, name: &str, target: Option<Target>, bytes: &[u8]) -> Index<View> {
        self.pad();
        let offset = self.bytes.len();
        self.bytes.extend_from_slice(bytes);
        self.root.push(View {
            buffer: Index::new(0),
            byte_length: USize64::from(bytes.len()),
            byte_offset: Some(USize64::from(offset)),
            byte_stride: None,
            name: Some(name.to_owned()),
            target: target.map(Valid),
            extensions: None,
            extras: None,
        })
    }

    fn accessor<T: bytemuck::Pod>(
        &mut self,
        name: &str,
        component: ComponentType,
        shape: Type,
        values: &[T],
    ) -> Index<Accessor> {
        let target = if matches!(shape, Type::Scalar) { Target::ElementArrayBuffer } else { Target::ArrayBuffer };
        let view = self.view(name, Some(target), bytemuck::cast_slice(values));
        self.root.push(Accessor {
            buffer_view: Some(view),
            byte_offset: None,
            count: USize64::from(values.len()),
            component_type: Valid(GenericComponentType(component)),
            type_: Valid(shape),
            min: None,
            max: None,
            name: Some(name.to_owned()),
            normalized: false,
            sparse: None,
            extensions: None,
            extras: None,
        })
    }

    fn texture(&mut self, path: &Path, name: &str, pixels: &Raster<[u8; 3]>, sampler: Index<Sampler>) -> Result<Info> {
        let mut png = Vec::new();
        encode_png(pixels, &mut png)
            .map_err(|e| Error::file(path, format!("the {name} image cannot be encoded: {e}")))?;
        let image = self.image(Some(name.to_owned()), "image/png", &png);
        let source = self.root.push(image);
        let texture =
            Texture { name: Some(name.to_owned()), sampler: Some(sampler), source, extensions: None, extras: None };
        let index = self.root.push(texture);
        Ok(Info { index, tex_coord: 0, extensions: None, extras: None })
    }
}

impl Materials<'_> {
    /// The texels where any map of this size is not zero: those of charts, and around them.
    fn charts(&self, size: [usize; 2]) -> Vec<bool> {
        let of_rgb = |map: &&Rgb| map.data.iter().map(|v| *v != [0.0; 3]).collect::<Vec<_>>();
        let of_gray = |map: &&Gray| map.data.iter().map(|v| *v != 0.0).collect::<Vec<_>>();
        let rgb = [Some(self.albedo), self.emission].into_iter().flatten().filter(|map| map.size() == size);
        let gray = [Some(self.roughness), self.metallic].into_iter().flatten().filter(|map| map.size() == size);
        let mut any = vec![false; size[0] * size[1]];
        for holds in rgb.map(|map| of_rgb(&map)).chain(gray.map(|map| of_gray(&map))) {
            any.iter_mut().zip(holds).for_each(|(any, holds)| *any |= holds);
        }
        any
    }
}

/// What is wrong with a GLB of so many bytes of geometry, images and JSON, if it is too long.
pub(crate) fn check_length(bytes: u64) -> std::result::Result<(), String> {
    // Lengths have 32 bits; the headers and the padding are far below a kilobyte.
    match u32::try_from(bytes + 1024) {
        Ok(_) => Ok(()),
        Err(_) => Err(format!(
            "the GLB would have {}, but ends at 4 GiB: its geometry and images are too much for one; simplify the mesh, divide \
             it, or give it smaller images",
            ByteSize(bytes)
        )),
    }
}

/// Linear: R unused, G roughness, B metallic.
fn pack_metallic_roughness(of: &Materials) -> Result<Raster<[u8; 3]>> {
    let level = |v: f32| (v * 255.0).round() as u8;
    let (roughness, charts) = (of.roughness, of.charts(of.roughness.size()));
    let Some(metallic) = of.metallic else {
        return Ok(beyond::filled(&roughness.map(|r| [*r]), &charts).map(|[r]| [0, level(*r), 0]));
    };
    if metallic.size() != roughness.size() {
        return Err(Error::invalid(format!(
            "the metallic map is {} texels and the roughness map {}; expected one size: they share an image",
            times(metallic.size()),
            times(roughness.size())
        )));
    }
    let both = roughness.data.iter().zip(&metallic.data).map(|(r, m)| [*r, *m]).collect();
    let both = Raster::new(roughness.width, roughness.height, both)?;
    Ok(beyond::filled(&both, &charts).map(|[r, m]| [0, level(*r), level(*m)]))
}

#[cfg(test)]
mod tests {
    use gltf::image::Source;

    use super::*;
    use crate::mesh_io::read_mesh;

    #[test]
    fn a_glb_ends_at_four_gibibytes() {
        assert_eq!(check_length(4 * (1 << 30) - 4096), Ok(()));
        let what = check_length(5 * (1 << 30)).unwrap_err();
        assert!(what.contains("5.0 GiB") && what.contains("4 GiB"), "{what}");
    }

    fn mesh() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Z, Vec3::ONE],
            // Neither unit nor finite: the file's must be.
            normals: vec![Vec3::Y * 2.0, Vec3::Y, Vec3::ZERO, Vec3::Y],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE],
            triangles: vec![[0, 2, 1], [1, 2, 3]],
        }
    }

    /// The document, and its images decoded, by name.
    fn written(materials: &Materials, up: Up) -> (gltf::Document, BTreeMap<String, image::RgbImage>, Mesh) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.glb");
        write_glb(&path, &mesh(), materials, up).unwrap();
        let read = read_mesh(&path).unwrap().mesh;
        let gltf = gltf::Gltf::open(&path).unwrap();
        let bytes = gltf.blob.unwrap();
        let images = gltf.document.images().map(|image| {
            let Source::View { view, mime_type: "image/png" } = image.source() else { panic!("an embedded PNG") };
            let png = &bytes[view.offset()..][..view.length()];
            let decoded = image::load_from_memory_with_format(png, image::ImageFormat::Png).unwrap();
            (image.name().unwrap().to_owned(), decoded.into_rgb8())
        });
        let images = images.collect();
        (gltf.document, images, read)
    }

    #[test]
    fn textures_are_encoded_as_the_specification_says() {
        let albedo = Rgb::new(2, 1, vec![[0.214_041_14, 0.0, 1.0], [2.0, f32::NAN, -1.0]]).unwrap();
        let roughness = Gray::new(2, 1, vec![0.2, 1.0]).unwrap();
        let metallic = Gray::new(2, 1, vec![1.0, 0.4]).unwrap();
        let emission = Rgb::new(2, 1, vec![[0.0; 3], [40.0, 0.214_041_14 * 40.0, 0.0]]).unwrap();
        let of =
            Materials { albedo: &albedo, roughness: &roughness, metallic: Some(&metallic), emission: Some(&emission) };
        let (document, images, _) = written(&of, Up::Z);
        assert_eq!(images["albedo"].as_raw(), &[128, 0, 255, 255, 0, 0]);
        assert_eq!(images["metallic_roughness"].as_raw(), &[0, 51, 255, 0, 255, 102]);
        assert_eq!(images["emission"].as_raw(), &[0, 0, 0, 255, 128, 0]);
        let material = document.materials().next().unwrap();
        assert_eq!(material.emissive_strength(), Some(40.0));
        assert!(material.double_sided() && is_one_sided(material.extras()));
        assert_eq!(material.emissive_factor(), [1.0; 3]);
        let pbr = material.pbr_metallic_roughness();
        assert_eq!((pbr.metallic_factor(), pbr.roughness_factor()), (1.0, 1.0));
        let uv_sets = document.meshes().next().unwrap().primitives().next().unwrap();
        assert!(uv_sets.get(&gltf::Semantic::TexCoords(1)).is_some(), "a set for the lightmap");
    }

    #[test]
    fn without_metal_and_light_the_file_says_so() {
        let (albedo, roughness) = (Rgb::filled(1, 1, [0.5; 3]), Gray::filled(1, 1, 0.5));
        for emission in [None, Some(&Rgb::filled(1, 1, [0.0; 3]))] {
            let of = Materials { albedo: &albedo, roughness: &roughness, metallic: None, emission };
            let (document, images, _) = written(&of, Up::Z);
            let material = document.materials().next().unwrap();
            // Written, since its absence would mean 1.
            let json = document.as_json().materials[0].pbr_metallic_roughness.metallic_factor;
            assert_eq!((json.0, material.pbr_metallic_roughness().metallic_factor()), (0.0, 0.0));
            assert!(material.emissive_texture().is_none() && material.emissive_strength().is_none());
            assert!(document.extensions_used().next().is_none());
            assert_eq!(images.len(), 2);
        }
    }

    #[test]
    fn z_up_stands_upright_and_y_up_is_left_alone() {
        let (albedo, roughness) = (Rgb::filled(1, 1, [0.5; 3]), Gray::filled(1, 1, 0.5));
        let of = Materials { albedo: &albedo, roughness: &roughness, metallic: None, emission: None };
        let (_, _, read) = written(&of, Up::Y);
        assert_eq!((&read.positions, &read.uvs, &read.triangles), (&mesh().positions, &mesh().uvs, &mesh().triangles));
        assert!(read.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-6), "{:?}", read.normals);
        let (_, _, read) = written(&of, Up::Z);
        for (read, world) in read.positions.iter().zip(mesh().positions) {
            assert!((*read - Vec3::new(world.x, world.z, -world.y)).length() < 1e-6, "{read} {world}");
        }
    }

    #[test]
    fn maps_that_share_an_image_must_share_their_size() {
        let (albedo, roughness) = (Rgb::filled(1, 1, [0.5; 3]), Gray::filled(1, 1, 0.5));
        let metallic = Gray::filled(2, 1, 0.0);
        let of = Materials { albedo: &albedo, roughness: &roughness, metallic: Some(&metallic), emission: None };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.glb");
        let error = write_glb(&path, &mesh(), &of, Up::Z).unwrap_err().to_string();
        assert!(error.contains("2×1") && error.contains("1×1"), "{error}");
        assert!(!path.exists());
    }
}
