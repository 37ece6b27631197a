//! Small glTF documents made in code.

use std::path::Path;

use glam::{Mat4, Vec2, Vec3};
use serde_json::{Value, json};

/// A document as it grows: one buffer inside a data URI, one node per surface.
#[derive(Debug, Default)]
pub struct Document {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    materials: Vec<Value>,
    meshes: Vec<Value>,
    nodes: Vec<Value>,
    lights: Vec<Value>,
    images: Vec<Value>,
}

impl Document {
    /// Adds a Lambertian material that emits `emission`, written as a factor and a strength.
    pub fn material(&mut self, albedo: [f32; 3], emission: [f32; 3]) -> usize {
        let strength = emission.into_iter().fold(0.0, f32::max);
        let factor = emission.map(|v| if strength > 0.0 { v / strength } else { 0.0 });
        let [r, g, b] = albedo;
        self.raw_material(json!({
            "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0 },
            "emissiveFactor": factor,
            "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": strength } },
        }))
    }

    /// Adds a material as it stands.
    pub fn raw_material(&mut self, material: Value) -> usize {
        self.materials.push(material);
        self.materials.len() - 1
    }

    /// Makes a material double-sided.
    pub fn show_both_sides(&mut self, material: usize) {
        self.materials[material]["doubleSided"] = true.into();
    }

    /// Adds an 8-bit image with a texture of the same index.
    pub fn image(&mut self, width: usize, height: usize, pixels: Vec<[u8; 3]>) -> usize {
        let raster = texir_core::raster::Raster { width, height, data: pixels };
        let mut png = Vec::new();
        texir_core::image_io::encode_png(&raster, &mut png).unwrap_or_else(|e| panic!("a PNG: {e}"));
        let view = self.view(&png);
        self.images.push(json!({ "bufferView": view, "mimeType": "image/png" }));
        self.images.len() - 1
    }

    /// Adds a quad without normals, its corners counter-clockwise from the front, under a transform; `uvs` by set.
    pub fn quad(&mut self, corners: [Vec3; 4], material: usize, world_from_node: Mat4, uvs: &[[Vec2; 4]]) {
        let positions: Vec<f32> = corners.iter().flat_map(|c| c.to_array()).collect();
        let mut attributes = json!({ "POSITION": self.accessor(&positions, 3) });
        for (set, uvs) in uvs.iter().enumerate() {
            let uvs: Vec<f32> = uvs.iter().flat_map(|uv| uv.to_array()).collect();
            attributes[format!("TEXCOORD_{set}")] = self.accessor(&uvs, 2).into();
        }
        let indices: Vec<u8> = [0u16, 1, 2, 0, 2, 3].iter().flat_map(|i| i.to_le_bytes()).collect();
        let view = self.view(&indices);
        self.accessors.push(json!({ "bufferView": view, "componentType": 5123, "count": 6, "type": "SCALAR" }));
        let indices = self.accessors.len() - 1;
        self.meshes.push(json!({
            "primitives": [{ "attributes": attributes, "indices": indices, "material": material }],
        }));
        self.nodes.push(json!({ "mesh": self.meshes.len() - 1, "matrix": world_from_node.to_cols_array() }));
    }

    /// Adds a light under a transform.
    pub fn light(&mut self, light: Value, world_from_node: Mat4) {
        self.lights.push(light);
        let reference = json!({ "KHR_lights_punctual": { "light": self.lights.len() - 1 } });
        self.nodes.push(json!({ "extensions": reference, "matrix": world_from_node.to_cols_array() }));
    }

    /// Writes a `.gltf` with its buffer beside it.
    pub fn write(&self, path: &Path) {
        let buffer = path.with_extension("bin");
        std::fs::write(&buffer, &self.bytes).unwrap_or_else(|e| panic!("{}: {e}", buffer.display()));
        let textures: Vec<Value> = (0..self.images.len()).map(|image| json!({ "source": image })).collect();
        let mut root = json!({
            "asset": { "version": "2.0" },
            "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_emissive_strength"],
            "extensions": { "KHR_lights_punctual": { "lights": self.lights } },
            "buffers": [{ "byteLength": self.bytes.len(), "uri": buffer.file_name().and_then(|n| n.to_str()) }],
            "bufferViews": self.views, "accessors": self.accessors, "materials": self.materials,
            "meshes": self.meshes, "nodes": self.nodes, "images": self.images, "textures": textures,
            "scenes": [{ "nodes": (0..self.nodes.len()).collect::<Vec<_>>() }], "scene": 0,
        });
        if let Some(root) = root.as_object_mut() {
            root.retain(|_, value| value.as_array().is_none_or(|list| !list.is_empty()));
        }
        std::fs::write(path, root.to_string()).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() }));
        self.bytes.extend(bytes);
        self.views.len() - 1
    }

    fn accessor(&mut self, values: &[f32], components: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.view(&bytes);
        let bound = |fold: fn(f32, f32) -> f32, start: f32| -> Vec<f32> {
            (0..components).map(|c| values.iter().skip(c).step_by(components).copied().fold(start, fold)).collect()
        };
        self.accessors.push(json!({
            "bufferView": view, "componentType": 5126, "count": values.len() / components,
            "type": format!("VEC{components}"),
            "min": bound(f32::min, f32::INFINITY), "max": bound(f32::max, f32::NEG_INFINITY),
        }));
        self.accessors.len() - 1
    }
}
