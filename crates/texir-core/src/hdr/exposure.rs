//! How much light a photo took in, from its EXIF fields.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use exif::{Exif, In, Reader, Tag, Value};

use crate::error::{Error, Result};

/// Seconds · ISO / (100 · f-number²), from ExposureTime, PhotographicSensitivity and FNumber. A missing field is an
/// error: a guess would show as wrong light.
pub fn read_exposure(path: impl AsRef<Path>) -> Result<f64> {
    let path = path.as_ref();
    let file = File::open(path).map_err(|e| Error::cannot_read(path, e))?;
    let exif = Reader::new().read_from_container(&mut BufReader::new(file)).map_err(|e| {
        let what = format!(
            "has no readable EXIF ({e}); expected ExposureTime, FNumber and PhotographicSensitivity (ISO): {}",
            hint()
        );
        Error::file(path, what)
    })?;
    let time = number(path, &exif, Tag::ExposureTime, "ExposureTime")?;
    let aperture = number(path, &exif, Tag::FNumber, "FNumber")?;
    let iso = number(path, &exif, Tag::PhotographicSensitivity, "PhotographicSensitivity")?;
    Ok(time * iso / (100.0 * aperture * aperture))
}

fn hint() -> &'static str {
    "copy the fields from the camera's files (exiftool -TagsFromFile), or give the exposure times with --times"
}

fn number(path: &Path, exif: &Exif, tag: Tag, name: &str) -> Result<f64> {
    let missing = || Error::file(path, format!("EXIF field {name} is missing; {}", hint()));
    let field = exif.get_field(tag, In::PRIMARY).ok_or_else(missing)?;
    let value = match &field.value {
        Value::Rational(values) => values.first().map(exif::Rational::to_f64),
        Value::SRational(values) => values.first().map(exif::SRational::to_f64),
        Value::Float(values) => values.first().copied().map(f64::from),
        Value::Double(values) => values.first().copied(),
        other => other.get_uint(0).map(f64::from),
    };
    value.filter(|v| *v > 0.0 && v.is_finite()).ok_or_else(|| {
        let found = field.display_value();
        Error::file(path, format!("EXIF field {name} is {found}; expected a positive number: {}", hint()))
    })
}
