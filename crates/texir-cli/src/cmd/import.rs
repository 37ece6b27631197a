//! `texir import`: a capture folder from what other programs write.

use std::path::PathBuf;

use clap::Args;
use glam::Vec3;
use serde::Serialize;
use texir_core::capture::import::{self, ImportOptions, Written};
use texir_core::capture::segment::Segmenter;
use texir_core::image_io::TransferCurve;

use crate::failure::Failure;
use crate::session::Session;

/// Arguments of `texir import`.
#[derive(Debug, Args)]
pub struct Import {
    /// Folder written by a capture app, COLMAP, nerfstudio, Blender, ...; `texir inspect` shows the format it detects
    source: PathBuf,
    /// The capture folder to write; new or empty
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Use this mesh instead of the folder's; in the frame of its cameras
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    #[command(flatten)]
    source_args: SourceArgs,
    /// Decode 8 and 16-bit images (last resort, lamps are clipped): srgb, linear or gamma=2.2
    #[arg(long, value_name = "CURVE")]
    curve: Option<TransferCurve>,
    /// Compute semantic ids with this segmentation model, replacing the source's (builds with `--features onnx`)
    #[arg(long, value_name = "MODEL.onnx", requires = "classes")]
    segment: Option<PathBuf>,
    /// The model's classes in output order: ade20k, coco, nyu40, or a JSON file
    #[arg(long, value_name = "FILE", requires = "segment")]
    classes: Option<String>,
    /// Link to images that need no change, instead of copying them
    #[arg(long)]
    link: bool,
}

/// What the user knows better than the files.
#[derive(Clone, Debug, Args)]
pub struct SourceArgs {
    /// Read the folder as this format instead of detecting it: nerfstudio, colmap, blender, panoramas, gltf,
    /// matterport3d or texir-authors
    #[arg(long, value_name = "NAME")]
    format: Option<String>,
    /// Up direction in the source: +z, -y, ... or X,Y,Z
    #[arg(long, value_name = "AXIS", value_parser = direction, allow_hyphen_values = true)]
    up: Option<Vec3>,
    /// Length of the source's unit
    #[arg(long, value_name = "METRES")]
    metres_per_unit: Option<f64>,
    /// Reduce the mesh to about so many triangles, and give it a new atlas
    #[arg(long, value_name = "TRIANGLES")]
    decimate: Option<usize>,
    /// Always make a new atlas; by default only if the mesh has none or it overlaps
    #[arg(long)]
    unwrap: bool,
}

impl SourceArgs {
    /// Whether anything is said about the source: it is not to be taken as it is.
    pub fn any_given(&self) -> bool {
        let Self { format, up, metres_per_unit, decimate, unwrap } = self;
        format.is_some() || up.is_some() || metres_per_unit.is_some() || decimate.is_some() || *unwrap
    }

    /// The same for the library.
    pub fn options(&self, mesh: Option<PathBuf>) -> ImportOptions {
        ImportOptions {
            format: self.format.clone(),
            mesh,
            up: self.up,
            metres_per_unit: self.metres_per_unit,
            decimate: self.decimate,
            unwrap: self.unwrap,
            ..ImportOptions::default()
        }
    }
}

/// `+z`, `z`, `-y`, or three numbers with commas between them.
fn direction(text: &str) -> Result<Vec3, String> {
    let (sign, axis) = match text.strip_prefix('-') {
        Some(axis) => (-1.0, axis),
        None => (1.0, text.strip_prefix('+').unwrap_or(text)),
    };
    match axis {
        "x" => return Ok(sign * Vec3::X),
        "y" => return Ok(sign * Vec3::Y),
        "z" => return Ok(sign * Vec3::Z),
        _ => {}
    }
    let numbers: Vec<f32> = text.split(',').map_while(|n| n.trim().parse().ok()).collect();
    match numbers[..] {
        [x, y, z] if text.split(',').count() == 3 => Ok(Vec3::new(x, y, z)),
        _ => Err("expected an axis such as +z or -y, or three numbers such as 0,-1,0".to_owned()),
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary {
    output: PathBuf,
    format: &'static str,
    assumed: Vec<String>,
    #[serde(flatten)]
    written: Written,
}

impl Import {
    /// Reads, converts and writes.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        import::check_vacant(&self.output)?;
        let models = self.segment.iter().zip(&self.classes);
        let segmenter = models.map(|(model, classes)| Segmenter::open(model, classes)).next().transpose()?;
        let options = ImportOptions {
            curve: self.curve,
            link: self.link,
            segmenter,
            ..self.source_args.options(self.mesh.clone())
        };
        let read = import::read(&self.source, &options, session.console)?;
        let written = import::write(&read, &self.output, &options, session.console)?;
        let summary = Summary { output: self.output.clone(), format: read.format, assumed: read.assumed, written };
        session.print(&summary, || {
            let mut out = format!("{}: {} views from {}", summary.output.display(), written.views, summary.format);
            if written.undistorted > 0 {
                out += &format!(", {} undistorted", written.undistorted);
            }
            if written.decoded > 0 {
                out += &format!(", {} decoded from 8 or 16 bits", written.decoded);
            }
            if written.segmented > 0 {
                out += ", segmented";
            }
            for line in &summary.assumed {
                out += &format!("\nassumed: {line}");
            }
            out + "\ncheck it with `texir inspect`"
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_axes_or_numbers() {
        assert_eq!(direction("+z"), Ok(Vec3::Z));
        assert_eq!(direction("-y"), Ok(Vec3::NEG_Y));
        assert_eq!(direction("0, -1,0.5"), Ok(Vec3::new(0.0, -1.0, 0.5)));
        for wrong in ["w", "", "1,2", "1,2,x", "1,2,3,4"] {
            assert!(direction(wrong).is_err(), "{wrong}");
        }
    }
}
