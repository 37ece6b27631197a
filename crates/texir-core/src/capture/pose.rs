//! Camera poses as rows of numbers, checked to be rigid.

use glam::{DMat4, DVec4, Mat4};

use crate::camera::check_rigid;

/// A rigid `world_from_camera` of 4 rows (or 3) of 4 numbers; what is wrong with them otherwise, as the end of a
/// sentence.
pub(super) fn from_rows<R: AsRef<[f64]> + std::fmt::Debug>(rows: &[R]) -> Result<DMat4, String> {
    if !matches!(rows.len(), 3 | 4) || rows.iter().any(|row| row.as_ref().len() != 4) {
        let lengths: Vec<usize> = rows.iter().map(|row| row.as_ref().len()).collect();
        return Err(format!("has rows of {lengths:?} numbers; expected 4 rows (or 3) of 4"));
    }
    let row = |i: usize| rows.get(i).map_or(DVec4::W, |row| DVec4::from_slice(row.as_ref()));
    let matrix = DMat4::from_cols(row(0), row(1), row(2), row(3)).transpose();
    if !matrix.is_finite() {
        return Err(format!("has the rows {rows:?}; expected finite numbers"));
    }
    if row(3) != DVec4::W {
        return Err(format!("has {} as its last row; expected [0, 0, 0, 1]: is the matrix transposed?", row(3)));
    }
    check_rigid(&matrix)?;
    Ok(matrix)
}

/// The rows of a matrix, as [`from_rows`] takes them.
pub(super) fn to_rows(matrix: Mat4) -> Vec<Vec<f64>> {
    matrix.transpose().to_cols_array_2d().map(|row| row.map(f64::from).to_vec()).to_vec()
}
