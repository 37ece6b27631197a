//! The baked scene as a GLB: its surfaces in world space with the lightmap's coordinates in TEXCOORD_1, its materials
//! and images as they were. Lights, cameras and animations are left out: the light is in the map.
//!
//! Engines look for a lightmap in TEXCOORD_1. Where that set of the file is another, it and those after it move up by
//! one, and the materials' references with them.

use std::collections::BTreeSet;
use std::path::Path;

use glam::Vec2;
use gltf::image::Source;
use gltf_json::texture::{MagFilter, MinFilter, Sampler, WrappingMode};
use gltf_json::validation::Checked::Valid;
use gltf_json::{Index, Material, Mesh as GltfMesh, Node, Scene, Texture};
use serde_json::{Value, json};

use super::gltf::{Model, Part};
use super::layout::{PlacedPart, placed};
use super::materials::{for_fields, materials};
use super::texture::encoded;
use crate::error::{Error, Result};
use crate::glb::Builder;
use crate::image_io::encode_hdr;
use crate::mesh::Mesh;
use crate::mesh_io::gltf::{self as geometry, Contents};
use crate::raster::Rgb;

/// The TEXCOORD where engines look for a lightmap.
const LIGHTMAP_SET: usize = 1;

/// Writes the scene that `source` holds and `model` was read from.
///
/// `attached`: an irradiance map to be put inside, as every material's `MOZ_lightmap` (a Radiance HDR image, marked by
/// `MOZ_texture_rgbe`); primitives without a material get one that carries it.
pub fn write_lightmapped_glb(
    path: impl AsRef<Path>,
    source: impl AsRef<Path>,
    model: &Model,
    attached: Option<&Rgb>,
) -> Result<()> {
    let (path, source) = (path.as_ref(), source.as_ref());
    let Contents { document, buffers } = geometry::load(source)?;
    let mut builder = Builder::default();
    for image in document.images() {
        let file = encoded(source, &image, &buffers)?;
        let name = image.name().map(str::to_owned);
        let image = builder.image(name, mime_type(&file, declared_type(&image)), &file);
        builder.root.images.push(image);
    }
    let from = document.into_json();
    let root = &mut builder.root;
    (root.textures, root.samplers) = (from.textures, from.samplers);
    // Whose work it is.
    (root.asset.copyright, root.asset.extras) = (from.asset.copyright, from.asset.extras);
    let moved = model.lightmap_set != Some(LIGHTMAP_SET);
    root.materials = materials(source, from.materials, moved)?;
    let mut default = None;
    if let Some(irradiance) = attached {
        // What has no material has nothing to carry a lightmap: it takes glTF's default material in words.
        default =
            model.parts.iter().any(|part| part.material.is_none()).then(|| builder.root.push(Material::default()));
        attach(path, &mut builder, irradiance)?;
    }

    // Those of the lightmap, which has some of the rows that are baked.
    let rows = Vec2::new(1.0, model.size[1] as f32 / model.rows as f32);
    let mut nodes = Vec::new();
    for PlacedPart { part, vertices, .. } in placed(&model.parts) {
        let material = part.material.map(|index| Index::new(index as u32)).or(default);
        let lightmap = model.mesh.uvs[vertices].iter().map(|uv| uv * rows).collect();
        // Where the file's own set is the lightmap's, that comes once.
        let displaced = if moved { 1 } else { 2 };
        nodes.push(add(&mut builder, part, material, lightmap, part.uvs.get(displaced..).unwrap_or_default()));
    }
    let scene = Scene { nodes, name: Some("lightmapped".to_owned()), extensions: None, extras: None };
    builder.root.scene = Some(builder.root.push(scene));
    let written = serde_json::to_value(&builder.root);
    let used = extensions(written.map_err(|e| Error::file(path, format!("the scene cannot be written: {e}")))?);
    builder.root.extensions_required =
        from.extensions_required.into_iter().filter(|name| used.contains(name)).collect();
    builder.root.extensions_used = used.into_iter().collect();
    builder.write(path)
}

/// The extensions that a document holds.
fn extensions(mut json: Value) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for_fields(&mut json, &mut |name, value| {
        if let (Value::Object(of_it), "extensions") = (value, name) {
            found.extend(of_it.keys().cloned());
        }
    });
    found
}

/// Adds a part with its lightmap's coordinates, and the `further` sets that come after them.
fn add(
    builder: &mut Builder,
    part: &Part,
    material: Option<Index<Material>>,
    lightmap: Vec<Vec2>,
    further: &[Vec<Vec2>],
) -> Index<Node> {
    let mesh = Mesh {
        positions: part.positions.clone(),
        normals: part.normals.clone(),
        uvs: lightmap,
        triangles: part.triangles.clone(),
    };
    let mut primitive = builder.primitive(&mesh, &part.uvs[0], further);
    primitive.material = material;
    let mesh = builder.root.push(GltfMesh {
        name: Some(part.name.clone()),
        primitives: vec![primitive],
        weights: None,
        extensions: None,
        extras: None,
    });
    builder.root.push(Node { mesh: Some(mesh), name: Some(part.name.clone()), ..Node::default() })
}

/// Gives every material the irradiance as `MOZ_lightmap`.
fn attach(path: &Path, builder: &mut Builder, irradiance: &Rgb) -> Result<()> {
    let mut file = Vec::new();
    encode_hdr(irradiance, &mut file).map_err(|e| Error::file(path, format!("the lightmap cannot be encoded: {e}")))?;
    let image = builder.image(Some("lightmap".to_owned()), "image/vnd.radiance", &file);
    let image = builder.root.push(image);
    let sampler = builder.root.push(Sampler {
        mag_filter: Some(Valid(MagFilter::Linear)),
        min_filter: Some(Valid(MinFilter::Linear)),
        wrap_s: Valid(WrappingMode::ClampToEdge),
        wrap_t: Valid(WrappingMode::ClampToEdge),
        ..Sampler::default()
    });
    let mut extensions = gltf_json::extensions::texture::Texture::default();
    extensions.others.insert("MOZ_texture_rgbe".to_owned(), json!({ "source": image.value() }));
    let texture = builder.root.push(Texture {
        name: Some("lightmap".to_owned()),
        sampler: Some(sampler),
        source: image,
        extensions: Some(extensions),
        extras: None,
    });
    let lightmap = json!({ "index": texture.value(), "texCoord": LIGHTMAP_SET, "intensity": 1.0 });
    for material in &mut builder.root.materials {
        let extensions = material.extensions.get_or_insert_default();
        extensions.others.insert("MOZ_lightmap".to_owned(), lightmap.clone());
    }
    Ok(())
}

/// The type of an image by its first bytes, and of formats that glTF and its extensions do not know what the scene
/// says.
fn mime_type<'a>(file: &[u8], declared: Option<&'a str>) -> &'a str {
    match file {
        [0x89, b'P', b'N', b'G', ..] => "image/png",
        [0xff, 0xd8, 0xff, ..] => "image/jpeg",
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => "image/webp",
        [0xab, b'K', b'T', b'X', b' ', b'2', b'0', 0xbb, ..] => "image/ktx2",
        _ => declared.unwrap_or("application/octet-stream"),
    }
}

/// The type that the scene names: beside the image, or in its data URI.
fn declared_type<'a>(image: &gltf::Image<'a>) -> Option<&'a str> {
    match image.source() {
        Source::View { mime_type, .. } => Some(mime_type),
        Source::Uri { uri, mime_type } => mime_type.or_else(|| uri.strip_prefix("data:")?.split([';', ',']).next()),
    }
}
