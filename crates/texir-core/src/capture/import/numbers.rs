//! Text files that are nothing but numbers, and matrices of them.

use std::path::Path;

use glam::DMat4;

use crate::capture::pose;
use crate::error::{Error, Result};

/// All white-space separated numbers of a text.
pub(super) fn parse(path: &Path, text: &str) -> Result<Vec<f64>> {
    let number = |word: &str| {
        word.parse().map_err(|_| Error::file(path, format!("has {word:?} in it; expected numbers and white space")))
    };
    text.split_whitespace().map(number).collect()
}

/// A rigid camera-to-world matrix of 16 numbers, row by row; `whose` tells which of the file's.
pub(super) fn pose(path: &Path, whose: &str, numbers: &[f64]) -> Result<DMat4> {
    let rows: Vec<&[f64]> = numbers.chunks(4).collect();
    pose::from_rows(&rows).map_err(|what| Error::file(path, format!("{whose} {what}")))
}
