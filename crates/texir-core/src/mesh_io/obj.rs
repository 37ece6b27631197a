//! Wavefront OBJ. Its v points up: flipped here, on the way in and on the way out.

mod lines;

use std::fs::File;
use std::io::{BufReader, Write};
use std::path::Path;

use glam::{Vec2, Vec3};
use tobj::{LoadError, LoadOptions};

use self::lines::Lines;
use super::RawMesh;
use crate::atomic_file::write_atomic;
use crate::error::{Error, Result};
use crate::mesh::Mesh;

/// All objects and material groups as one mesh; one vertex per distinct (position, uv, normal) triple of a group.
/// Neighbouring faces that have the same of these make a group.
pub(super) fn read(path: &Path) -> Result<RawMesh> {
    let mut lines = Lines::new(BufReader::new(File::open(path).map_err(|e| Error::cannot_read(path, e))?));
    // The parser's triangles are fans, also where polygons are concave.
    let options = LoadOptions { single_index: true, triangulate: false, ignore_points: true, ignore_lines: true };
    // Materials are what texir recovers: the library that the file names is not looked for.
    let read = tobj::load_obj_buf(&mut lines, &options, |_| Ok(Default::default()));
    let (models, _) = read.map_err(|e| {
        let what = lines.wrong_index().unwrap_or_else(|| format!("line {}: {}", lines.number(), explain(&e)));
        Error::file(path, format!("is no valid OBJ: {what}"))
    })?;
    let mut raw = RawMesh::default();
    for model in models {
        let (mut mesh, base) = (model.mesh, raw.positions.len() as u32);
        let vertices = mesh.positions.len() / 3;
        raw.positions.extend(mesh.positions.chunks_exact(3).map(Vec3::from_slice));
        if mesh.texcoords.len() == 2 * vertices {
            raw.uvs.extend(mesh.texcoords.chunks_exact(2).map(|uv| Some(Vec2::new(uv[0], 1.0 - uv[1]))));
        } else {
            // None at all, or corners of one face with and without them: the parser does not tell which.
            raw.uvs.extend(std::iter::repeat_n(None, vertices));
        }
        if mesh.normals.len() == 3 * vertices {
            raw.normals.extend(mesh.normals.chunks_exact(3).map(|n| Some(Vec3::from_slice(n))));
        } else {
            raw.normals.extend(std::iter::repeat_n(None, vertices));
        }
        mesh.indices.iter_mut().for_each(|i| *i += base);
        let mut rest = &mesh.indices[..];
        // There are none where all faces are triangles.
        let mut corners = mesh.face_arities.iter().map(|corners| *corners as usize);
        while !rest.is_empty() {
            let (face, others) = rest.split_at(corners.next().unwrap_or(3));
            raw.push_polygon(face);
            rest = others;
        }
    }
    Ok(raw)
}

fn explain(e: &LoadError) -> &'static str {
    match e {
        LoadError::PositionParseError => "a `v` line is not three numbers",
        LoadError::NormalParseError => "a `vn` line is not three numbers",
        LoadError::TexcoordParseError => "a `vt` line is not two numbers",
        LoadError::FaceParseError => "an `f` line is not a list of v, v/vt, v//vn or v/vt/vn",
        LoadError::ScalingByZeroError => "the w of a `v` line is 0",
        LoadError::FaceColorOutOfBounds => "some of the `v` lines up to here have a colour, and some have none",
        LoadError::ReadError => "a line cannot be read as text",
        _ => "a line cannot be understood",
    }
}

/// Writes positions, atlas coordinates and normals as OBJ, one `v`, `vt` and `vn` per vertex.
pub fn write(path: impl AsRef<Path>, mesh: &Mesh) -> Result<()> {
    write_atomic(path, |sink| -> std::io::Result<()> {
        for p in &mesh.positions {
            writeln!(sink, "v {} {} {}", p.x, p.y, p.z)?;
        }
        for uv in &mesh.uvs {
            writeln!(sink, "vt {} {}", uv.x, 1.0 - uv.y)?;
        }
        for n in &mesh.normals {
            writeln!(sink, "vn {} {} {}", n.x, n.y, n.z)?;
        }
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| i + 1);
            writeln!(sink, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}")?;
        }
        Ok(())
    })
}
