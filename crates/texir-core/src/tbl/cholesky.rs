//! Small dense systems.

/// Solves A X = B for a symmetric positive definite A, n × n, row by row; A is overwritten, B becomes X. `None` if A is not
/// positive definite.
pub(super) fn solve<const N: usize>(a: &mut [f64], b: &mut [[f64; N]]) -> Option<()> {
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
    for c in 0..N {
        for i in 0..n {
            let sum = b[i][c] - (0..i).map(|k| a[i * n + k] * b[k][c]).sum::<f64>();
            b[i][c] = sum / a[i * n + i];
        }
        for i in (0..n).rev() {
            let sum = b[i][c] - (i + 1..n).map(|k| a[k * n + i] * b[k][c]).sum::<f64>();
            b[i][c] = sum / a[i * n + i];
        }
    }
    Some(())
}
