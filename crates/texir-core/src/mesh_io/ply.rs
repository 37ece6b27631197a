//! Stanford PLY, ASCII and binary. Texture coordinates per vertex or per face corner, v up as MeshLab and Blender
//! write.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use glam::{Vec2, Vec3};
use serde::Deserialize;
use serde_ply::PlyReader;

use super::RawMesh;
use crate::error::{Error, Result};

#[derive(Deserialize)]
struct Vertex {
    /// No file has it. Where the properties of a binary file are the first fields of a struct, serde-ply 0.2 reads
    /// these in order, and fails at the first that the file lacks; otherwise it goes by their names.
    #[serde(rename = "")]
    _by_name: Option<f32>,
    x: f32,
    y: f32,
    z: f32,
    nx: Option<f32>,
    ny: Option<f32>,
    nz: Option<f32>,
    #[serde(alias = "u", alias = "texture_u", alias = "texture_s")]
    s: Option<f32>,
    #[serde(alias = "v", alias = "texture_v", alias = "texture_t")]
    t: Option<f32>,
}

#[derive(Deserialize)]
struct Face {
    #[serde(alias = "vertex_index")]
    vertex_indices: Vec<u32>,
    /// u, v per corner.
    #[serde(default)]
    texcoord: Vec<f32>,
}

/// An element that texir has no use for; its properties are skipped.
#[derive(Deserialize)]
struct Other {}

pub(super) fn read(path: &Path) -> Result<RawMesh> {
    let file = File::open(path).map_err(|e| Error::cannot_read(path, e))?;
    // The parser wants white space after every ASCII number, also after the last of a file without a final newline.
    let mut reader =
        PlyReader::from_reader(BufReader::new(file).chain(&b"\n"[..])).map_err(|e| Error::cannot_read(path, e))?;
    let (mut vertices, mut faces) = (Vec::<Vertex>::new(), Vec::<Face>::new());
    while let Some(element) = reader.current_element() {
        let name = element.name.clone();
        // A file of any size could claim any number of them.
        if element.properties.is_empty() && element.count > 0 {
            return Err(Error::file(
                path,
                format!("element {name:?} has no properties; expected some, or no such element"),
            ));
        }
        let parsed = match name.as_str() {
            "vertex" => reader.next_element().map(|v| vertices = v),
            "face" => reader.next_element().map(|f| faces = f),
            _ => reader.next_element::<Vec<Other>>().map(drop),
        };
        parsed.map_err(|e| Error::file(path, format!("element {name:?} cannot be read: {e}")))?;
    }
    if faces.iter().any(|f| !f.texcoord.is_empty()) {
        with_corner_uvs(path, &vertices, &faces)
    } else {
        Ok(with_vertex_uvs(&vertices, &faces))
    }
}

fn flip(u: f32, v: f32) -> Vec2 {
    Vec2::new(u, 1.0 - v)
}

impl Vertex {
    fn position(&self) -> Vec3 {
        Vec3::new(self.x, self.y, self.z)
    }

    fn normal(&self) -> Option<Vec3> {
        Some(Vec3::new(self.nx?, self.ny?, self.nz?))
    }

    fn uv(&self) -> Option<Vec2> {
        Some(flip(self.s?, self.t?))
    }
}

fn with_vertex_uvs(vertices: &[Vertex], faces: &[Face]) -> RawMesh {
    let mut raw = RawMesh {
        positions: vertices.iter().map(Vertex::position).collect(),
        normals: vertices.iter().map(Vertex::normal).collect(),
        uvs: vertices.iter().map(Vertex::uv).collect(),
        ..RawMesh::default()
    };
    faces.iter().for_each(|face| raw.push_polygon(&face.vertex_indices));
    raw
}

/// Every corner of a face becomes a vertex: charts meet at vertices of different texture coordinates.
fn with_corner_uvs(path: &Path, vertices: &[Vertex], faces: &[Face]) -> Result<RawMesh> {
    let mut raw = RawMesh::default();
    for (f, face) in faces.iter().enumerate() {
        let corners = face.vertex_indices.len();
        if face.texcoord.len() != 2 * corners {
            return Err(Error::file(
                path,
                format!(
                    "face {f} has {} numbers in texcoord; expected {}: u, v per corner",
                    face.texcoord.len(),
                    2 * corners
                ),
            ));
        }
        let base = raw.positions.len() as u32;
        for (index, uv) in face.vertex_indices.iter().zip(face.texcoord.chunks_exact(2)) {
            let vertex = vertices.get(*index as usize).ok_or_else(|| {
                Error::file(path, format!("face {f} uses vertex {index}; expected indices below {}", vertices.len()))
            })?;
            raw.positions.push(vertex.position());
            raw.normals.push(vertex.normal());
            raw.uvs.push(Some(flip(uv[0], uv[1])));
        }
        let indices: Vec<u32> = (base..base + corners as u32).collect();
        raw.push_polygon(&indices);
    }
    Ok(raw)
}
