//! glTF and GLB geometry: the default scene's nodes, transformed to world space. Materials and images are left alone
//! ([`crate::authored`] reads those).

use std::path::{Path, PathBuf};

use glam::{Mat4, Quat, Vec2, Vec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::buffer::{Data, Source};
use gltf::material::AlphaMode;
use gltf::mesh::Mode;
use gltf::scene::Transform;
use gltf::{Accessor, Buffer, Document, Gltf, Node, Primitive, Semantic};
use gltf_json::Root;
use gltf_json::extensions::ENABLED_EXTENSIONS;
use gltf_json::validation::{self, Checked, Validate};

use super::RawMesh;
use crate::error::{Error, Result};
use crate::text_file::BYTE_ORDER_MARK;

/// The shortest possible GLB header; the parser takes this much for granted.
const GLB_HEADER_BYTES: u32 = 12;

/// A glTF or GLB without its buffers.
pub(crate) fn open(path: &Path) -> Result<Gltf> {
    let bytes = std::fs::read(path).map_err(|e| Error::cannot_read(path, e))?;
    if let [b'g', b'l', b'T', b'F', _, _, _, _, a, b, c, d, ..] = bytes[..]
        && u32::from_le_bytes([a, b, c, d]) < GLB_HEADER_BYTES
    {
        return Err(Error::file(path, "says that it is shorter than a GLB's header; is it damaged?"));
    }
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK.as_bytes()).unwrap_or(&bytes);
    let Gltf { document, blob } =
        Gltf::from_slice_without_validation(bytes).map_err(|e| Error::cannot_read(path, e))?;
    let mut root = document.into_json();
    // The validation takes this much for granted.
    let position = Checked::Valid(Semantic::Positions);
    let primitives = root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let positions = primitives.filter_map(|primitive| primitive.attributes.get(&position));
    if let Some(index) = positions.map(|accessor| accessor.value()).find(|index| *index >= root.accessors.len()) {
        let count = root.accessors.len();
        return Err(Error::file(
            path,
            format!("POSITION is accessor {index}; expected one of the {count}: is it damaged?"),
        ));
    }
    check_required(path, &root.extensions_required)?;
    // The validation takes for granted as well that images are whole.
    let whole =
        |image: &gltf_json::Image| image.uri.is_some() || (image.buffer_view.is_some() && image.mime_type.is_some());
    if let Some(index) = root.images.iter().position(|image| !whole(image)) {
        return Err(Error::file(path, format!("image {index} has no uri, nor a bufferView with its mimeType")));
    }
    // Some exporters do not say that a file cannot be read without what it uses.
    root.extensions_required.retain(|name| ENABLED_EXTENSIONS.contains(&name.as_str()));
    let used: Vec<_> = root.extensions_used.iter().filter(|name| without(name) != WITHOUT).cloned().collect();
    let used = unread(&used);
    validate(&root).map_err(|e| match &used[..] {
        [] => Error::cannot_read(path, e),
        used => Error::file(path, format!("{e}; it uses what texir does not read: {}", used.join(", "))),
    })?;
    Ok(Gltf { document: Document::from_json_without_validation(root), blob })
}

/// Errors on what the reader cannot take. Accessors without values are sound by the specification: exporters write them
/// for morph targets that move nothing.
fn validate(root: &Root) -> std::result::Result<(), gltf::Error> {
    let mut found = Vec::new();
    root.validate(root, gltf_json::Path::new, &mut |place, what| found.push((place(), what)));
    let without_values = |place: &str| place.starts_with("accessors[") && place.ends_with("].bufferView");
    found.retain(|(place, what)| !(*what == validation::Error::Missing && without_values(place.as_str())));
    if found.is_empty() { Ok(()) } else { Err(gltf::Error::Validation(found)) }
}

/// An error where the file says that it cannot be read without what texir does not know.
fn check_required(path: &Path, required: &[String]) -> Result<()> {
    let unknown = unread(required);
    if unknown.is_empty() {
        return Ok(());
    }
    Err(Error::file(path, format!("extensionsRequired asks for what texir does not read: {}", unknown.join(", "))))
}

/// Those of some extensions that texir does not read, and how to export a scene without them. What materials have
/// besides (gloss, sheen) takes nothing from what is read of them.
fn unread(extensions: &[String]) -> Vec<String> {
    let is_read = |name: &str| {
        ENABLED_EXTENSIONS.contains(&name)
            || name.starts_with("KHR_materials_") && name != "KHR_materials_pbrSpecularGlossiness"
    };
    let unread = extensions.iter().filter(|name| !is_read(name));
    unread.map(|name| format!("{name} ({})", without(name))).collect()
}

/// What is to be done about an extension that is not known.
const WITHOUT: &str = "export without it";

/// How to export a scene without an extension.
fn without(extension: &str) -> &'static str {
    match extension {
        "KHR_draco_mesh_compression" | "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "export without compression"
        }
        "KHR_mesh_quantization" => "export without quantization",
        "KHR_texture_basisu" | "EXT_texture_webp" | "EXT_texture_avif" | "MSFT_texture_dds" => {
            "export textures as PNG or JPEG"
        }
        "EXT_mesh_gpu_instancing" => "export every instance as a node",
        "KHR_materials_pbrSpecularGlossiness" => "convert materials to metallic-roughness",
        _ => WITHOUT,
    }
}

/// A glTF or GLB with its buffers.
pub(crate) struct Contents {
    pub document: Document,
    pub buffers: Vec<Data>,
}

/// Reads a file and the buffers that it refers to.
pub(crate) fn load(path: &Path) -> Result<Contents> {
    let Gltf { document, mut blob } = open(path)?;
    let buffers = document.buffers().map(|buffer| read_buffer(path, &buffer, &mut blob)).collect::<Result<_>>()?;
    Ok(Contents { document, buffers })
}

/// Where a scene's `uri`, decoded, leads.
pub(crate) fn beside(scene: &Path, uri: &str) -> PathBuf {
    scene.parent().unwrap_or(Path::new("")).join(uri)
}

/// Says what is wrong with what is there, but is no file: a device never ends.
pub(crate) fn check_is_file(path: &Path) -> std::result::Result<(), &'static str> {
    if path.exists() && !path.is_file() { Err("is a folder or a device; expected a file") } else { Ok(()) }
}

/// A buffer's bytes: of the GLB itself, of a data URI, or of a file beside the scene.
fn read_buffer(path: &Path, buffer: &Buffer, blob: &mut Option<Vec<u8>>) -> Result<Data> {
    let place = format!("buffers[{}]", buffer.index());
    let file = match buffer.source() {
        Source::Uri(uri) if !uri.starts_with("data:") => Some(
            // The reader takes for granted that it is text.
            urlencoding::decode(uri).map_err(|e| Error::file(path, format!("{place}: uri {uri:?} is no text: {e}")))?,
        ),
        _ => None,
    };
    if let Some(file) = &file {
        check_is_file(&beside(path, file))
            .map_err(|what| Error::file(path, format!("{place}: its file {file} {what}")))?;
    }
    let read = Data::from_source_and_blob(buffer.source(), path.parent(), blob);
    let data = read.map_err(|e| match &file {
        Some(file) => Error::file(
            path,
            format!(
                "{place}: its file {file} cannot be read: {e}; expected it where the uri says, beside the scene: copy it \
                 there, or export a .glb"
            ),
        ),
        None => Error::file(path, format!("{place} cannot be read: {e}")),
    })?;
    if data.len() < buffer.length() {
        let (found, expected) = (data.len(), buffer.length());
        let of = file.map(|file| format!(", {file},")).unwrap_or_default();
        return Err(Error::file(
            path,
            format!("{place}{of} has {found} bytes; expected {expected}: is it cut short, or of another export?"),
        ));
    }
    Ok(data)
}

/// Calls `visit(node, world_from_node)` for every node of the default scene, parents first.
pub(crate) fn for_each_node(
    path: &Path,
    document: &Document,
    mut visit: impl FnMut(&Node, Mat4) -> Result<()>,
) -> Result<()> {
    let scene = document
        .default_scene()
        .or_else(|| document.scenes().next())
        .ok_or_else(|| Error::file(path, "has no scene; expected one with nodes"))?;
    let mut visited = vec![false; document.nodes().len()];
    let mut stack: Vec<_> = scene.nodes().map(|n| (n, Mat4::IDENTITY)).collect();
    stack.reverse();
    while let Some((node, world_from_parent)) = stack.pop() {
        if std::mem::replace(&mut visited[node.index()], true) {
            return Err(Error::file(path, format!("{} is reached twice; expected a tree", label(&node))));
        }
        let world_from_node = world_from_parent * parent_from_node(path, &node)?;
        visit(&node, world_from_node)?;
        let children: Vec<_> = node.children().map(|c| (c, world_from_node)).collect();
        stack.extend(children.into_iter().rev());
    }
    Ok(())
}

/// A node as users are told of it: by its index, and its name if it has one.
pub(crate) fn label(node: &gltf::Node) -> String {
    let index = node.index();
    node.name().map_or_else(|| format!("node {index}"), |name| format!("node {index} ({name:?})"))
}

/// The transform of a node. A rotation of another length than 1 would skew what it turns; it is taken for the unit one
/// that it is along.
fn parent_from_node(path: &Path, node: &gltf::Node) -> Result<Mat4> {
    match node.transform() {
        Transform::Matrix { matrix } => Ok(Mat4::from_cols_array_2d(&matrix)),
        Transform::Decomposed { translation, rotation, scale } => {
            let length = Quat::from_array(rotation).length();
            let turn = Quat::from_array(rotation) / length;
            if !turn.is_finite() {
                return Err(Error::file(
                    path,
                    format!("rotation of {} is {rotation:?}; expected a quaternion of length 1", label(node)),
                ));
            }
            Ok(Mat4::from_scale_rotation_translation(scale.into(), turn, translation.into()))
        }
    }
}

pub(super) fn read(path: &Path) -> Result<RawMesh> {
    let Contents { document, buffers } = load(path)?;
    let mut raw = RawMesh { warnings: left_out(path, &document), ..RawMesh::default() };
    let transparent = document.materials().filter(|material| material.alpha_mode() != AlphaMode::Opaque).count();
    if transparent > 0 {
        raw.warnings.push(format!(
            "{}: {transparent} materials are transparent in places (alphaMode): their surfaces count as opaque everywhere",
            path.display()
        ));
    }
    raw.warnings.extend(ignored(path, &document, &PLACING));
    for_each_node(path, &document, |node, world_from_node| {
        for primitive in node.mesh().iter().flat_map(|m| m.primitives()) {
            let place = format!("primitive {} of {}", primitive.index(), label(node));
            let Some(surface) = surface(path, &place, &primitive, &buffers, world_from_node)? else {
                raw.warnings.push(no_surface(path, &place, &primitive));
                continue;
            };
            let base = raw.positions.len() as u32;
            raw.positions.extend(surface.positions);
            raw.normals.extend(surface.normals);
            raw.uvs.extend(surface.uvs.into_iter().next().unwrap_or_default());
            raw.triangles.extend(surface.triangles.iter().map(|t| t.map(|i| base + i)));
        }
        Ok(())
    })?;
    Ok(raw)
}

/// What a primitive holds, in world space. Attributes are per vertex, indices in range.
pub(crate) struct PrimitiveGeometry {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Option<Vec3>>,
    /// TEXCOORD_0, also where the file has none, and those that follow it in the file.
    pub uvs: Vec<Vec<Option<Vec2>>>,
    pub triangles: Vec<[u32; 3]>,
}

/// What to tell the user of a primitive of points or lines.
pub(crate) fn no_surface(path: &Path, place: &str, primitive: &Primitive) -> String {
    format!("{}: {place} is {:?}, no surface, and is left out", path.display(), primitive.mode())
}

/// What the file says of its surfaces' shape that is not taken into account, in sentences for the user.
pub(crate) fn left_out(path: &Path, document: &Document) -> Vec<String> {
    let primitives = document.meshes().flat_map(|mesh| mesh.primitives());
    [
        (
            primitives.filter(|primitive| primitive.morph_targets().next().is_some()).count(),
            "primitives have morph targets: they keep the shape that they have without them",
        ),
        (
            document.nodes().filter(|node| node.skin().is_some()).count(),
            "nodes have a skin: their meshes keep the shape in which they were bound",
        ),
    ]
    .into_iter()
    .filter(|(count, _)| *count > 0)
    .map(|(count, what)| format!("{}: {count} {what}", path.display()))
    .collect()
}

/// An extension that is not taken into account, and what that means.
pub(crate) type Ignored = (&'static str, &'static str);

/// Extensions that say where surfaces are.
pub(crate) const PLACING: [Ignored; 2] = [
    ("EXT_mesh_gpu_instancing", "a mesh stands once where its node is: export every instance as a node"),
    ("KHR_node_visibility", "hidden nodes count as visible: leave them out of the file"),
];

/// What to tell the user where the file uses some of the `extensions`.
pub(crate) fn ignored(path: &Path, document: &Document, extensions: &[Ignored]) -> Option<String> {
    let used = extensions.iter().filter(|(name, _)| document.extensions_used().any(|used| used == *name));
    let used: Vec<_> = used.map(|(name, what)| format!("{name} ({what})")).collect();
    (!used.is_empty())
        .then(|| format!("{}: extensions are not taken into account: {}", path.display(), used.join(", ")))
}

/// Reads a primitive of triangles, in a list, a strip or a fan; `None` for points and lines.
pub(crate) fn surface(
    path: &Path,
    place: &str,
    primitive: &Primitive,
    buffers: &[Data],
    world_from_node: Mat4,
) -> Result<Option<PrimitiveGeometry>> {
    if !matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
        return Ok(None);
    }
    check_accessors(path, place, primitive)?;
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(|data| data.0.as_slice()));
    let out_of_buffer = |what: &str| Error::file(path, format!("{place}: {what} reaches beyond its buffer"));

    let positions = reader.read_positions().ok_or_else(|| out_of_buffer("POSITION"))?;
    let positions: Vec<Vec3> = positions.map(|p| world_from_node.transform_point3(p.into())).collect();
    let count = positions.len();
    // As many as positions, absent where the file has none.
    fn padded<T: Clone>(values: Option<impl Iterator<Item = T>>, count: usize) -> Vec<Option<T>> {
        values.into_iter().flatten().map(Some).chain(std::iter::repeat(None)).take(count).collect()
    }
    let normal_from_node = world_from_node.inverse().transpose();
    let normals = reader.read_normals().map(|n| n.map(|n| normal_from_node.transform_vector3(Vec3::from(n))));
    let uvs = (0..uv_sets(primitive))
        .map(|set| padded(reader.read_tex_coords(set).map(|uvs| uvs.into_f32().map(Vec2::from)), count))
        .collect();

    let indices: Vec<u32> = match primitive.indices() {
        Some(_) => reader.read_indices().ok_or_else(|| out_of_buffer("indices"))?.into_u32().collect(),
        None => (0..count as u32).collect(),
    };
    if let Some(index) = indices.iter().find(|i| **i as usize >= count) {
        return Err(Error::file(path, format!("{place} uses vertex {index}; expected indices below {count}")));
    }
    // A mirroring transform turns the winding around.
    let order = if world_from_node.determinant() < 0.0 { [0, 2, 1] } else { [0, 1, 2] };
    let triangles = triangles(primitive.mode(), &indices).into_iter().map(|t| order.map(|corner| t[corner])).collect();
    Ok(Some(PrimitiveGeometry { positions, normals: padded(normals, count), uvs, triangles }))
}

/// The triangles of a list, a strip or a fan, as the specification orders their corners.
fn triangles(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => {
            // Every other one is wound the other way. Corners that are there twice lead from one strip to the next.
            let triangle = |(i, t): (usize, &[u32])| [t[0], t[1 + i % 2], t[2 - i % 2]];
            let joins = |t: &[u32; 3]| t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
            indices.windows(3).enumerate().map(triangle).filter(|t| !joins(t)).collect()
        }
        Mode::TriangleFan => {
            let hub = indices.first().copied().unwrap_or_default();
            indices.windows(2).skip(1).map(|t| [t[0], t[1], hub]).collect()
        }
        _ => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

/// How many sets of coordinates a primitive has: TEXCOORD_0, counted even where it is missing, and those that follow
/// it.
fn uv_sets(primitive: &Primitive) -> u32 {
    1 + (1..).take_while(|set| primitive.get(&Semantic::TexCoords(*set)).is_some()).count() as u32
}

/// The component types that the specification allows: the accessor reader relies on them.
fn check_accessors(path: &Path, place: &str, primitive: &Primitive) -> Result<()> {
    use DataType::{F32, U8, U16, U32};
    let check = |name: &str, accessor: Option<Accessor>, shape: Dimensions, types: &[DataType]| match accessor {
        // Zeros that stand nowhere in the file: a few bytes could ask for any number of them.
        Some(a) if a.view().is_none() => Err(Error::file(
            path,
            format!("{place}: {name} has no bufferView; expected one, also where an accessor is sparse, over zeros"),
        )),
        Some(a) if a.dimensions() != shape || !types.contains(&a.data_type()) || a.count() == 0 => Err(Error::file(
            path,
            format!(
                "{place}: {name} is {} × {:?} of {:?}; expected at least one {shape:?} of {types:?}",
                a.count(),
                a.dimensions(),
                a.data_type()
            ),
        )),
        _ => Ok(()),
    };
    if primitive.get(&Semantic::Positions).is_none() {
        return Err(Error::file(path, format!("{place} has no POSITION; expected one per vertex")));
    }
    check("POSITION", primitive.get(&Semantic::Positions), Dimensions::Vec3, &[F32])?;
    check("NORMAL", primitive.get(&Semantic::Normals), Dimensions::Vec3, &[F32])?;
    for set in 0..uv_sets(primitive) {
        let accessor = primitive.get(&Semantic::TexCoords(set));
        check(&format!("TEXCOORD_{set}"), accessor, Dimensions::Vec2, &[F32, U8, U16])?;
    }
    check("indices", primitive.indices(), Dimensions::Scalar, &[U8, U16, U32])
}
