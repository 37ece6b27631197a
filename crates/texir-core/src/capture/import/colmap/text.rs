//! `cameras.txt` and `images.txt`.

use std::path::Path;
use std::str::{FromStr, SplitWhitespace};

use super::{Image, Sensor, camera_model};
use crate::error::{Error, Result};
use crate::text_file::read_text;

/// Where in a file something is wrong.
struct Line<'a> {
    path: &'a Path,
    /// From 1.
    number: usize,
}

impl Line<'_> {
    fn error(&self, what: impl std::fmt::Display) -> Error {
        Error::file(self.path, format!("line {}: {what}", self.number))
    }

    fn next<T: FromStr>(&self, words: &mut SplitWhitespace, what: &str) -> Result<T> {
        let word = words.next().ok_or_else(|| self.error(format!("{what} is missing; is the file cut off?")))?;
        word.parse().map_err(|_| self.error(format!("{what} is {word:?}; expected a number")))
    }
}

/// The lines, with their numbers.
fn lines<'a>(path: &'a Path, text: &'a str) -> impl Iterator<Item = (Line<'a>, &'a str)> {
    (1..).zip(text.lines()).map(move |(number, line)| (Line { path, number }, line.trim()))
}

fn holds_data(line: &str) -> bool {
    !line.is_empty() && !line.starts_with('#')
}

/// `CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS`.
pub(super) fn cameras(path: &Path) -> Result<Vec<Sensor>> {
    let text = read_text(path)?;
    let camera = |(place, line): (Line, &str)| {
        let mut words = line.split_whitespace();
        let id = place.next(&mut words, "CAMERA_ID")?;
        let name = words.next().unwrap_or_default();
        let model = camera_model(|m| m.name == name, name).map_err(|e| place.error(e))?;
        let (width, height) = (place.next(&mut words, "WIDTH")?, place.next(&mut words, "HEIGHT")?);
        let parameters = words.map(str::parse).collect::<Result<Vec<f64>, _>>();
        let parameters = parameters.ok().filter(|p| p.len() == model.parameters).ok_or_else(|| {
            place.error(format!("{line:?} ends in other than the {} numbers of {name}", model.parameters))
        })?;
        Ok(Sensor { id, model, width, height, parameters })
    };
    lines(path, &text).filter(|(_, line)| holds_data(line)).map(camera).collect()
}

/// `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`, each followed by a line of points, which may be empty.
pub(super) fn images(path: &Path) -> Result<Vec<Image>> {
    let text = read_text(path)?;
    let mut lines = lines(path, &text);
    let mut images = Vec::new();
    while let Some((place, line)) = lines.next() {
        if !holds_data(line) {
            continue;
        }
        let mut words = line.split_whitespace();
        let _id: u32 = place.next(&mut words, "IMAGE_ID")?;
        let mut numbers = [0.0; 7];
        for (number, what) in numbers.iter_mut().zip(["QW", "QX", "QY", "QZ", "TX", "TY", "TZ"]) {
            *number = place.next(&mut words, what)?;
        }
        let [w, x, y, z, translation @ ..] = numbers;
        let camera_id = place.next(&mut words, "CAMERA_ID")?;
        // A name may have spaces in it.
        let name = words.collect::<Vec<_>>().join(" ");
        if name.is_empty() {
            return Err(place.error("NAME is missing; is the file cut off?"));
        }
        images.push(Image { camera_id, camera_from_world: [w, x, y, z], translation, name });
        // X, Y and POINT3D_ID of every point, or nothing. The last line may be cut off: no pose is lost by that.
        if let Some((place, points)) = lines.next()
            && let Some(word) = points.split_whitespace().find(|word| word.parse::<f64>().is_err())
        {
            return Err(place.error(format!(
                "{word:?} stands in a line of points (X, Y, POINT3D_ID); expected one after the line of each image, empty where there are none"
            )));
        }
    }
    Ok(images)
}
