//! Small dense systems, by Cholesky decomposition.

/// Solves A X = B for a symmetric positive definite A, n × n, row by row; A is overwritten, B becomes X. `None` if A is
/// not positive definite.
pub(crate) fn solve<const N: usize>(a: &mut [f64], b: &mut [[f64; N]]) -> Option<()> {
    let n = b.len();
    for i in 0..n {
        for j in 0..=i {
            let sum = a[i * n + j] - (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum::<f64>();
            if i != j {
                a[i * n + j] = sum / a[j * n + j];
            } else if sum > 0.0 {
                a[i * n + i] = sum.sqrt();
            } else {
                return None;
            }
        }
    }
    for i in 0..n {
        let known = |c: usize| (0..i).map(|k| a[i * n + k] * b[k][c]).sum::<f64>();
        b[i] = std::array::from_fn(|c| (b[i][c] - known(c)) / a[i * n + i]);
    }
    for i in (0..n).rev() {
        let known = |c: usize| (i + 1..n).map(|k| a[k * n + i] * b[k][c]).sum::<f64>();
        b[i] = std::array::from_fn(|c| (b[i][c] - known(c)) / a[i * n + i]);
    }
    Some(())
}
