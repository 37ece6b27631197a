//! Camera poses as rows of numbers, checked to be rigid.

use glam::{DMat3, DMat4, DVec4, Mat4};

/// A rotation may differ from an orthonormal one by this much per entry of RᵀR: files with few digits, f32 arithmetic.
const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

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

/// An error unless the upper left of the matrix is a rotation.
pub(super) fn check_rigid(matrix: &DMat4) -> Result<(), String> {
    let rotation = DMat3::from_mat4(*matrix);
    let determinant = rotation.determinant();
    let lengths = [rotation.x_axis, rotation.y_axis, rotation.z_axis].map(|axis| axis.length());
    // Relative to the lengths of the axes, so that a tiny but proper scale is not mistaken for a singular matrix.
    let spanned = determinant / lengths.iter().product::<f64>();
    if spanned.is_nan() || spanned.abs() <= 1e-6 {
        return Err(format!(
            "is singular (determinant {determinant:.3e}); expected a rotation and a translation, camera to world"
        ));
    }
    if determinant < 0.0 {
        return Err(format!(
            "mirrors (determinant {determinant:.3}); expected a rotation of determinant +1: flip one axis, as when \
             converting from a left-handed frame"
        ));
    }
    let difference = rotation.transpose() * rotation - DMat3::IDENTITY;
    let largest = difference.to_cols_array().into_iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    if largest > ORTHONORMAL_TOLERANCE {
        return Err(format!(
            "is not rigid: its axes have the lengths {:.4}, {:.4}, {:.4} and RᵀR differs from 1 by {largest:.2e}; expected \
             an orthonormal rotation: take the scale and the shear out of it",
            lengths[0], lengths[1], lengths[2]
        ));
    }
    Ok(())
}
