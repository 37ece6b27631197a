//! A plain list of equirectangular panoramas with poses, `panoramas.csv` or `panoramas.json`: what is easily written by
//! hand or by a script. Metres, +Z up.

use std::path::{Path, PathBuf};

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4, Vec3};
use serde::Deserialize;

use super::{Importer, Source};
use crate::camera::{Camera, Projection};
use crate::capture::files;
use crate::capture::{Split, View};
use crate::error::{Error, Result};
use crate::image_io::read_size;
use crate::text_file::read_text;

/// See the module.
pub(super) struct Panoramas;

const LISTS: [&str; 2] = ["panoramas.csv", "panoramas.json"];
/// Where images are looked for.
const IMAGES: [&str; 3] = ["hdr", "", "images"];

/// What the header of a CSV names.
const COLUMNS: &str = "file,x,y,z and qw,qx,qy,qz or yaw,pitch,roll";

/// A line of the CSV, whose header names these columns; an object of the JSON array.
#[derive(Deserialize)]
struct Row {
    file: String,
    x: f64,
    y: f64,
    z: f64,
    /// Quaternion, camera to world, of a camera with OpenGL axes: the image's centre is at −Z, its top at +Y.
    qw: Option<f64>,
    qx: Option<f64>,
    qy: Option<f64>,
    qz: Option<f64>,
    /// Or angles in degrees. Heading of the image's centre, counter-clockwise from +X.
    yaw: Option<f64>,
    /// Of the image's centre, upwards.
    pitch: Option<f64>,
    /// Of the camera to its right.
    roll: Option<f64>,
    split: Option<Split>,
}

impl Importer for Panoramas {
    fn name(&self) -> &'static str {
        "panoramas"
    }

    fn signature(&self) -> &'static str {
        "panoramas.csv or panoramas.json"
    }

    fn detects(&self, folder: &Path) -> bool {
        list(folder).is_some()
    }

    fn read(&self, folder: &Path) -> Result<Source> {
        let path = list(folder).ok_or_else(|| Error::file(folder, format!("has no {}", self.signature())))?;
        let text = read_text(&path)?;
        let rows = if path.extension().is_some_and(|e| e == "json") {
            serde_json::from_str(&text).map_err(|e| Error::file(&path, format!("is no list of panoramas: {e}")))?
        } else {
            from_csv(&path, &text)?
        };
        let names = files::view_names(rows.iter().map(|row: &Row| row.file.as_str()));
        let view = |(index, (row, name)): (usize, (&Row, String))| {
            let wrong = |what: String| Error::file(&path, format!("panorama {} ({}): {what}", index + 1, row.file));
            let image = files::image(folder, &IMAGES, &row.file);
            let [width, height] = read_size(&image)?;
            if width != 2 * height {
                return Err(wrong(format!(
                    "the image is {width}×{height}; expected a full panorama, twice as wide as high"
                )));
            }
            let world_from_camera = row.pose().map_err(wrong)?.as_mat4();
            let camera = Camera { projection: Projection::Equirectangular, width, height, world_from_camera };
            Ok(View::new(name, camera, row.split.unwrap_or(Split::Train), image).into())
        };
        Ok(Source {
            shots: rows.iter().zip(names).enumerate().map(view).collect::<Result<_>>()?,
            mesh: files::mesh(folder),
            textures: Vec::new(),
            up: Some(Vec3::Z),
            metres_per_unit: Some(1.0),
            assumed: vec![
                "images are full panoramas; quaternions turn camera (−Z forward, +Y up) to world, yaw is counter-clockwise \
                 from +X"
                    .into(),
            ],
        })
    }
}

fn list(folder: &Path) -> Option<PathBuf> {
    LISTS.iter().map(|name| folder.join(name)).find(|path| path.is_file())
}

/// Fields are separated by commas or, as some tables are exported, by semicolons.
fn from_csv(path: &Path, text: &str) -> Result<Vec<Row>> {
    let is_read = |line: &&str| !line.starts_with('#') && !line.trim().is_empty();
    let header = text.lines().find(is_read).unwrap_or_default();
    let delimiter = if header.contains(';') { b';' } else { b',' };
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(delimiter)
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let wrong = |what: String| Error::file(path, format!("is no list of panoramas: {what} {COLUMNS}"));
    let has_header = |columns: &csv::StringRecord| columns.iter().any(|column| column == "file");
    if reader.headers().is_ok_and(|columns| !has_header(columns)) {
        let first = header.trim_end();
        return Err(wrong(format!("its first line is {first:?}; expected a header, a line that names the columns")));
    }
    reader.deserialize().collect::<Result<_, _>>().map_err(|e| wrong(format!("{e}; expected the columns")))
}

impl Row {
    fn pose(&self) -> Result<DMat4, String> {
        let position = DVec3::new(self.x, self.y, self.z);
        if !position.is_finite() {
            return Err(format!("x, y, z are {position}; expected finite numbers"));
        }
        let quaternion = [self.qx, self.qy, self.qz, self.qw];
        let angles = [self.yaw, self.pitch, self.roll];
        let rotation = match (quaternion, angles) {
            ([Some(x), Some(y), Some(z), Some(w)], [None, None, None]) => {
                let quaternion = DVec4::new(x, y, z, w);
                let unit = quaternion.try_normalize();
                DQuat::from_vec4(
                    unit.ok_or_else(|| format!("the quaternion (x, y, z, w) is {quaternion}; expected a rotation"))?,
                )
            }
            ([None, None, None, None], [Some(yaw), pitch, roll]) => {
                let [yaw, pitch, roll] =
                    [yaw, pitch.unwrap_or_default(), roll.unwrap_or_default()].map(f64::to_radians);
                if !(yaw + pitch + roll).is_finite() {
                    return Err("yaw, pitch and roll are not all finite; expected degrees".to_owned());
                }
                // A level camera that looks along +X: its right is −Y, its back −X.
                let level = DQuat::from_mat3(&DMat3::from_cols(DVec3::NEG_Y, DVec3::Z, DVec3::NEG_X));
                DQuat::from_rotation_z(yaw) * level * DQuat::from_rotation_x(pitch) * DQuat::from_rotation_z(-roll)
            }
            _ => return Err("expected either qw, qx, qy and qz, or yaw (and pitch and roll where not 0)".to_owned()),
        };
        Ok(DMat4::from_rotation_translation(rotation, position))
    }
}
