//! Authored scenes from glTF and GLB: geometry with the lightmap's coordinates, Lambertian materials with their
//! emission (`KHR_materials_emissive_strength`, `KHR_texture_transform`), and `KHR_lights_punctual`.
//!
//! Base colour is the albedo, also of metals, whose reflection is treated as diffuse; on request so is the specular
//! reflection of dielectrics ([`BounceAlbedo`]). Light passes where alpha or transmission let it (`opacity.rs`). Vertex
//! colours, skins and morph targets are ignored, with a warning.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;

use glam::{Mat4, Vec2, Vec3};
use gltf::khr_lights_punctual::Kind;
use gltf::{Node, Semantic};
use rayon::prelude::*;

use super::Surfaces;
use super::materials::materials;
use super::shading::{BounceAlbedo, Shading, shading};
use super::texture::{Colour, Footprint, Images, encoded};
use crate::atlas::{self, BAND, bands};
use crate::backend::Backend;
use crate::bake::{BakedTexels, Buried, PADDING, Texels};
use crate::brdf::Masking;
use crate::environment::Environment;
use crate::error::{Error, Result};
use crate::glb::check_length;
use crate::mesh::{Mesh, cross};
use crate::mesh_io::gltf::{self as geometry, Contents};
use crate::progress::Progress;
use crate::punctual::PunctualLight;
use crate::raster::{Raster, Rgb};
use crate::scene::{Scene, TriangleOpacity};
use crate::specular_albedo::specular_albedo;
use crate::surface::{SurfacePoint, TexelHit};

/// Cells per texel and axis over which materials are looked up: a texel may show several triangles.
const LOOKUPS: usize = 2;

/// Normals against the front are told of where they are on more than this share of the surface.
const FEW: f64 = 1e-3;

/// Extensions that say what shines, and what becomes of light at surfaces, beyond what is read here. Those that only
/// add gloss do not matter to what is Lambertian.
const LIGHTING: [geometry::Ignored; 5] = [
    ("KHR_materials_pbrSpecularGlossiness", "its colours are left out: convert materials to metallic-roughness"),
    ("KHR_materials_unlit", "such surfaces take light, reflect it and cast shadows: leave out those that must not"),
    ("KHR_materials_diffuse_transmission", "no light passes"),
    ("EXT_lights_image_based", "it does not shine: give the image as --environment"),
    ("EXT_lights_ies", "lamps shine without their profiles"),
];

/// One primitive of the scene, placed in the world.
pub(crate) struct Part {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    /// TEXCOORD_0 and those that follow it in the file, zero at vertices that have none.
    pub uvs: Vec<Vec<Vec2>>,
    /// Which of them it has at every vertex.
    pub has_uvs: Vec<bool>,
    pub triangles: Vec<[u32; 3]>,
    /// Index of the material in the document; `None`: glTF's default.
    pub material: Option<usize>,
    /// The node's name, or its index.
    pub name: String,
    /// Of every triangle, what rays meet of it; none where they meet all of all.
    pub opacity: Vec<TriangleOpacity>,
}

impl Part {
    fn memory(&self) -> u64 {
        let Self { positions, normals, uvs, triangles, .. } = self;
        let uvs: usize = uvs.iter().map(|set| size_of_val(&set[..])).sum();
        (size_of_val(&positions[..]) + size_of_val(&normals[..]) + uvs + size_of_val(&triangles[..])) as u64
    }

    /// Bytes of what rays meet of its triangles.
    fn memory_of_opacity(&self) -> u64 {
        let of_triangle = |opacity: &TriangleOpacity| match opacity {
            TriangleOpacity::Micromap(micromap) => size_of_val(micromap.words()),
            TriangleOpacity::Opaque | TriangleOpacity::Transparent => 0,
        };
        (size_of_val(&self.opacity[..]) + self.opacity.iter().map(of_triangle).sum::<usize>()) as u64
    }

    /// Whether light passes as if it were not there.
    pub fn is_transparent(&self) -> bool {
        !self.opacity.is_empty() && self.opacity.iter().all(|opacity| *opacity == TriangleOpacity::Transparent)
    }
}

/// Triangles of a part as they are seen from the side that the lightmap does not hold.
pub(super) struct OtherSide {
    /// Index of the part, all of whose vertices come again.
    pub part: usize,
    /// Indices into [`Part::triangles`].
    pub triangles: Vec<u32>,
}

/// Where a triangle of [`Model::mesh`] comes from.
#[derive(Clone, Copy)]
pub(super) struct Face {
    /// Index of the part.
    pub part: usize,
    /// Index into [`Part::triangles`].
    pub triangle: usize,
    /// The mesh's index of the part's first vertex.
    pub first_vertex: u32,
}

/// A scene as its file describes it, with the coordinates of its lightmap.
pub struct Model {
    /// All surfaces in world space, metres, +Y up, each from the side that the lightmap holds, then again those whose
    /// other side matters to its light ([`Model::find_sides`]). `uvs` are those of the map that is baked.
    pub mesh: Mesh,
    /// Columns and rows of the map that is baked: the lightmap ([`Model::lightmap_size`]), and below it, where there
    /// are any, the other sides of the surfaces in the same places.
    pub size: [usize; 2],
    /// Rows of the lightmap.
    pub(super) rows: usize,
    /// The TEXCOORD of the file that `mesh.uvs` are; `None` where the scene was unwrapped.
    pub(crate) lightmap_set: Option<usize>,
    /// Points, spots and distant lights.
    pub lights: Vec<PunctualLight>,
    /// The primitives, whose vertices and triangles `mesh` holds one after the other.
    pub(crate) parts: Vec<Part>,
    /// Those that follow them.
    pub(super) other_sides: Vec<OtherSide>,
    /// By document index, glTF's default material last.
    pub(super) shading: Vec<Shading>,
    pub(super) images: Images,
}

impl fmt::Debug for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { mesh, size, lights, parts, .. } = self;
        f.debug_struct("Model")
            .field("triangles", &mesh.triangles.len())
            .field("size", size)
            .field("lights", lights)
            .field("parts", &parts.len())
            .finish_non_exhaustive()
    }
}

/// Reads a scene whose lightmap is to have `size` columns.
///
/// Its coordinates are TEXCOORD_1 where that gives every surface a place of its own, otherwise TEXCOORD_0 where that
/// does; otherwise the scene is unwrapped, into a map of `size` columns and at most as many rows.
pub fn read_gltf(
    path: impl AsRef<Path>,
    size: usize,
    bounce_albedo: BounceAlbedo,
    progress: &dyn Progress,
) -> Result<Model> {
    let path = path.as_ref();
    let Contents { document, buffers } = geometry::load(path)?;
    geometry::left_out(path, &document).iter().for_each(|warning| progress.warn(warning));
    let extensions = [&geometry::PLACING[..], &LIGHTING].concat();
    geometry::ignored(path, &document, &extensions).iter().for_each(|warning| progress.warn(warning));
    let tinted = |primitive: &gltf::Primitive| primitive.get(&Semantic::Colors(0)).is_some();
    let tinted = document.meshes().flat_map(|mesh| mesh.primitives()).filter(tinted).count();
    if tinted > 0 {
        progress.warn(&format!(
            "{}: {tinted} primitives have vertex colours (COLOR_0), which do not tint them",
            path.display()
        ));
    }
    let (mut parts, mut lights) = (Vec::new(), Vec::new());
    geometry::for_each_node(path, &document, |node, world_from_node| {
        for primitive in node.mesh().iter().flat_map(|m| m.primitives()) {
            let place = format!("primitive {} of {}", primitive.index(), geometry::label(node));
            match geometry::surface(path, &place, &primitive, &buffers, world_from_node)? {
                Some(surface) => parts.push(Part::new(path, &place, node, primitive.material().index(), surface)?),
                None => progress.warn(&geometry::no_surface(path, &place, &primitive)),
            }
        }
        if let Some(light) = node.light() {
            let light = punctual(&light, world_from_node);
            lights.push(light.map_err(|e| Error::file(path, format!("the light of {}: {e}", geometry::label(node))))?);
        }
        Ok(())
    })?;
    parts.retain(|part| !part.triangles.is_empty());
    if parts.is_empty() {
        return Err(Error::file(path, "has no triangles with an area; expected a scene"));
    }
    let mut images = Images::default();
    let shading = shading(path, &document, &buffers, bounce_albedo, &mut images)?;
    // All come along into the baked scene: what cannot is to be known before the bake.
    materials(path, document.as_json().materials.clone(), false)?;
    let files: Vec<u64> = document
        .images()
        .map(|image| encoded(path, &image, &buffers).map(|file| file.len() as u64))
        .collect::<Result<_>>()?;
    let geometry: u64 = parts.iter().map(|part| part.memory() + size_of_val(&part.uvs[0][..]) as u64).sum();
    check_length(geometry + files.iter().sum::<u64>()).map_err(|what| Error::file(path, what))?;
    let mut model = Model {
        mesh: Mesh::default(),
        size: [size; 2],
        rows: size,
        lightmap_set: None,
        lights,
        parts,
        other_sides: Vec::new(),
        shading,
        images,
    };
    let mut told = model.without_coordinates();
    told.extend(model.lay_out(size, progress)?);
    told.extend(model.find_openings());
    told.extend(model.turned_away());
    told.extend(model.mesh.misplaced());
    told.iter().for_each(|what| progress.warn(&format!("{}: {what}", path.display())));
    Ok(model)
}

impl Model {
    /// The mesh as light meets it. Errors where it passes everywhere, and as [`Scene::check`].
    pub fn scene(&self) -> Result<Scene> {
        if self.parts.iter().all(|part| part.opacity.is_empty()) {
            return Scene::new(self.mesh.clone());
        }
        let faces = self.faces();
        Scene::with_opacity(self.mesh.clone(), |triangle| {
            let face = faces[triangle as usize];
            let part = &self.parts[face.part];
            let opacity = part.opacity.get(face.triangle).cloned().unwrap_or(TriangleOpacity::Opaque);
            let is_turned = self.corners(triangle as usize, face) != part.triangles[face.triangle];
            if is_turned { opacity.turned_over() } else { opacity }
        })
    }

    /// Columns and rows of the lightmap.
    pub fn lightmap_size(&self) -> [usize; 2] {
        [self.size[0], self.rows]
    }

    /// Bytes of the images that its materials are looked up in, and of its geometry, which it has as a whole and in
    /// parts; of what rays meet of it as its [`Model::scene`] will have it, too.
    pub fn memory(&self) -> u64 {
        let Mesh { positions, normals, uvs, triangles } = &self.mesh;
        let whole = size_of_val(&positions[..])
            + size_of_val(&normals[..])
            + size_of_val(&uvs[..])
            + size_of_val(&triangles[..]);
        let others: usize = self.other_sides.iter().map(|other| size_of_val(&other.triangles[..])).sum();
        self.images.memory()
            + (whole + others) as u64
            + self.parts.iter().map(|part| part.memory() + 2 * part.memory_of_opacity()).sum::<u64>()
    }

    /// The lightmap, of what was solved at the texels of the map that was baked.
    pub fn lightmap(&self, solution: &BakedTexels, texels: &Texels<'_>, buried: Buried) -> Result<Rgb> {
        let [width, height] = self.lightmap_size();
        Raster::new(width, height, solution.map_rows(texels, buried, 0..height)?)
    }

    /// What the scene emits and reflects at the texels of the map that is baked: the mean over each.
    pub fn surfaces(
        &self,
        backend: &mut dyn Backend,
        texels: &Texels<'_>,
        environment: Option<Environment>,
    ) -> Result<Surfaces> {
        let [width, height] = texels.size();
        let columns = LOOKUPS * width;
        let cells = Vec2::new(columns as f32, (LOOKUPS * height) as f32);
        let faces = self.faces();
        let [mut albedo, mut emission] = [(); 2].map(|()| Rgb::filled(width, height, [0.0; 3]));
        let mut filled = vec![false; width * height];
        // A band takes all triangles in hand, and has this many lookups at a texel.
        let least = backend.scene().mesh().triangles.len() / (LOOKUPS * LOOKUPS);
        for rows in bands(width, height, BAND.max(least)) {
            let hits = backend.texels([columns, LOOKUPS * height], LOOKUPS * rows.start..LOOKUPS * rows.end)?;
            let texel = |point: &SurfacePoint| {
                let (x, y) = (point.index as usize % width, point.index as usize / width - rows.start);
                let points =
                    (0..LOOKUPS * LOOKUPS).map(|k| (LOOKUPS * y + k / LOOKUPS) * columns + LOOKUPS * x + k % LOOKUPS);
                let found: Vec<&TexelHit> = points.filter_map(|i| hits[i].as_ref()).collect();
                let sum = found.iter().fold([Vec3::ZERO; 2], |sum, hit| {
                    let at = self.over(hit, cells, faces[hit.triangle as usize]);
                    [sum[0] + at[0], sum[1] + at[1]]
                });
                sum.map(|sum| (sum / found.len().max(1) as f32).to_array())
            };
            let points = texels.points_in(rows.clone())?;
            let values: Vec<[[f32; 3]; 2]> = points.par_iter().map(texel).collect();
            for (point, value) in points.iter().zip(values) {
                let i = point.index as usize;
                [albedo.data[i], emission.data[i]] = value;
                filled[i] = true;
            }
        }
        atlas::pad(&mut albedo, &mut filled.clone(), PADDING);
        atlas::pad(&mut emission, &mut filled, PADDING);
        Ok(Surfaces { albedo, emission, lights: self.lights.clone(), environment })
    }

    /// What to tell the user of primitives that lack the coordinates of their material's textures, per set.
    fn without_coordinates(&self) -> Vec<String> {
        let mut lacking = BTreeMap::<usize, usize>::new();
        for part in &self.parts {
            let Shading { albedo, emission, metallic_roughness, .. } = &self.shading[self.shading_of(part)];
            let used = [albedo, emission].into_iter().chain(metallic_roughness);
            let sets: BTreeSet<usize> = used.filter_map(|c| Some(c.texture.as_ref()?.placement.set)).collect();
            let missing = sets.into_iter().filter(|set| part.has_uvs.get(*set) != Some(&true));
            missing.for_each(|set| *lacking.entry(set).or_default() += 1);
        }
        let sentence = |(set, count): (usize, usize)| {
            format!(
                "{count} primitives have no TEXCOORD_{set} at every vertex, where their materials' textures are to be looked up: \
                 they take the texture's corner; export them with that UV set"
            )
        };
        lacking.into_iter().map(sentence).collect()
    }

    /// What to tell the user of triangles whose normals all point away from their front.
    pub(super) fn turned_away(&self) -> Option<String> {
        let away = |triangle: u32| {
            let front = self.mesh.face_normal(triangle);
            self.mesh.corner_normals(triangle).iter().all(|normal| normal.dot(front) < 0.0)
        };
        let (mut count, mut area, mut whole) = (0, 0.0, 0.0);
        for triangle in 0..self.mesh.triangles.len() as u32 {
            let of_triangle = f64::from(self.mesh.area(triangle));
            whole += of_triangle;
            if away(triangle) {
                (count, area) = (count + 1, area + of_triangle);
            }
        }
        // Slivers between smooth neighbours may have them.
        (area > FEW * whole).then(|| {
            format!(
                "{count} triangles have normals that point away from where their corners run counter-clockwise: they take light on the \
                 side of their normals, and shine from the other; turn either around"
            )
        })
    }

    /// Names of the materials in the scene that reflect at least a `share` of the light in some channel, on average.
    pub(super) fn reflecting(&self, share: f32) -> Vec<String> {
        let met = self.parts.iter().filter(|part| !part.is_transparent());
        let used: BTreeSet<usize> = met.map(|part| self.shading_of(part)).collect();
        let used = used.into_iter().map(|shading| &self.shading[shading]);
        used.filter(|shading| shading.albedo.mean(&self.images).max_element() >= share)
            .map(|s| s.name.clone())
            .collect()
    }

    /// Whether a part's backs send light as well.
    pub(super) fn is_double_sided(&self, part: &Part) -> bool {
        self.shading[self.shading_of(part)].double_sided
    }

    /// The place of a part's material in `shading`.
    pub(super) fn shading_of(&self, part: &Part) -> usize {
        part.shading(self.shading.len())
    }

    /// Per triangle of the mesh: where it comes from.
    pub(super) fn faces(&self) -> Vec<Face> {
        let (mut all, mut first_vertex) = (Vec::with_capacity(self.mesh.triangles.len()), 0);
        let mut add = |part: usize, triangles: &mut dyn Iterator<Item = usize>| {
            all.extend(triangles.map(|triangle| Face { part, triangle, first_vertex }));
            first_vertex += self.parts[part].positions.len() as u32;
        };
        (0..self.parts.len()).for_each(|part| add(part, &mut (0..self.parts[part].triangles.len())));
        let others = self.other_sides.iter();
        others.for_each(|other| add(other.part, &mut other.triangles.iter().map(|&triangle| triangle as usize)));
        all
    }

    /// The vertices of a triangle of the mesh among those of its part.
    fn corners(&self, triangle: usize, face: Face) -> [u32; 3] {
        self.mesh.triangles[triangle].map(|vertex| vertex - face.first_vertex)
    }

    /// Albedo and emission, the mean over the cell around a hit, of a map of so many `cells`.
    fn over(&self, hit: &TexelHit, cells: Vec2, face: Face) -> [Vec3; 2] {
        let footprint = Footprint::new(hit, self.mesh.corner_uvs(hit.triangle).map(|uv| uv * cells));
        let of = |colour: &Colour| self.mean(colour, &footprint, hit.triangle, face);
        let part = &self.parts[face.part];
        let Shading { albedo, emission, metallic_roughness, .. } = &self.shading[self.shading_of(part)];
        let specular = metallic_roughness.as_ref().map_or(0.0, |metallic_roughness| {
            let Vec3 { y: roughness, z: metallic, .. } = of(metallic_roughness);
            specular_albedo(Masking::Smith, roughness) * (1.0 - metallic)
        });
        [(of(albedo) + specular).clamp(Vec3::ZERO, Vec3::ONE), of(emission)]
    }

    /// What a triangle of the mesh emits, on average.
    pub(super) fn emission(&self, triangle: u32, face: Face) -> Vec3 {
        let emission = &self.shading[self.shading_of(&self.parts[face.part])].emission;
        self.mean(emission, &Footprint::whole(), triangle, face)
    }

    /// The mean of a colour over a footprint on a triangle of the mesh.
    fn mean(&self, colour: &Colour, footprint: &Footprint, triangle: u32, face: Face) -> Vec3 {
        let (uvs, corners) = (&self.parts[face.part].uvs, self.corners(triangle as usize, face));
        colour.over(footprint, |set| uvs.get(set).map(|uvs| corners.map(|i| uvs[i as usize])), &self.images)
    }
}

impl Part {
    fn new(
        path: &Path,
        place: &str,
        node: &Node,
        material: Option<usize>,
        surface: geometry::PrimitiveGeometry,
    ) -> Result<Self> {
        let geometry::PrimitiveGeometry { positions, normals, uvs, mut triangles } = surface;
        let uvs_finite = uvs.iter().flatten().flatten().all(|uv| uv.is_finite());
        if !positions.iter().all(|p| p.is_finite()) || !uvs_finite {
            return Err(Error::file(path, format!("{place} has coordinates that are not finite numbers")));
        }
        triangles.retain(|t| cross(t.map(|i| positions[i as usize])).length_squared() > 0.0);
        let normals: Vec<Option<Vec3>> = normals.iter().map(|n| n.and_then(Vec3::try_normalize)).collect();
        let has_uvs = uvs.iter().map(|uvs| uvs.iter().all(Option::is_some)).collect();
        let uvs = uvs.into_iter().map(|uvs| uvs.into_iter().map(Option::unwrap_or_default).collect()).collect();
        let named = node.name().or_else(|| node.mesh().and_then(|mesh| mesh.name()));
        let name = named.map_or(format!("node {}", node.index()), str::to_owned);
        let part = Self { positions, normals: vec![], uvs, has_uvs, triangles, material, name, opacity: vec![] };
        Ok(part.with_normals(&normals))
    }

    /// The place of its material among so many, the last of which is glTF's default.
    fn shading(&self, count: usize) -> usize {
        self.material.unwrap_or(count - 1)
    }

    /// Where normals are missing, the specification asks for flat ones: every triangle takes vertices of its own.
    fn with_normals(mut self, normals: &[Option<Vec3>]) -> Self {
        if let Some(normals) = normals.iter().copied().collect() {
            return Self { normals, ..self };
        }
        let corners: Vec<u32> = self.triangles.as_flattened().to_vec();
        self.positions = corners.iter().map(|&i| self.positions[i as usize]).collect();
        self.uvs.iter_mut().for_each(|uvs| *uvs = corners.iter().map(|&i| uvs[i as usize]).collect());
        self.triangles = (0..self.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let flat = |k: usize| {
            let face = [0, 1, 2].map(|corner| self.positions[k / 3 * 3 + corner]);
            normals[corners[k] as usize].unwrap_or(cross(face).normalize_or_zero())
        };
        let normals = (0..corners.len()).map(flat).collect();
        Self { normals, ..self }
    }
}

/// A light in the frame of its node, shining along −Z.
fn punctual(light: &gltf::khr_lights_punctual::Light, world_from_node: Mat4) -> Result<PunctualLight> {
    let position = world_from_node.w_axis.truncate().to_array();
    let direction = world_from_node.transform_vector3(Vec3::NEG_Z).normalize_or(Vec3::NEG_Z).to_array();
    let intensity = light.color().map(|c| c * light.intensity());
    let range = light.range();
    let light = match light.kind() {
        Kind::Directional => PunctualLight::Distant { direction, irradiance: intensity },
        Kind::Point => PunctualLight::Point { position, intensity, range },
        Kind::Spot { inner_cone_angle, outer_cone_angle } => {
            PunctualLight::Spot { position, direction, intensity, range, inner_cone_angle, outer_cone_angle }
        }
    };
    light.check()?;
    Ok(light)
}
