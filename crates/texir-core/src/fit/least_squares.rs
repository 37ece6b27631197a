//! Sparse least squares: conjugate gradients on the normal equations, the three colour channels side by side.

use glam::Vec3A;
use rayon::prelude::*;

/// Items per task of a parallel loop.
pub const BLOCK: usize = 4096;

/// A symmetric positive definite system A x = b.
pub trait NormalEquations {
    /// A x.
    fn apply(&self, x: &[Vec3A]) -> Vec<Vec3A>;

    /// The diagonal of A.
    fn diagonal(&self) -> Vec<Vec3A>;
}

/// Improves `x` by steps of conjugate gradients, Jacobi-preconditioned.
pub fn conjugate_gradients(system: &impl NormalEquations, x: &mut [Vec3A], right: &[Vec3A], iterations: u32) {
    let inverse: Vec<Vec3A> = system.diagonal().into_par_iter().map(|d| 1.0 / d.max(Vec3A::splat(1e-12))).collect();
    let mut residual: Vec<Vec3A> = (system.apply(x), right).into_par_iter().map(|(a, r)| *r - a).collect();
    let mut preconditioned: Vec<Vec3A> = (&residual, &inverse).into_par_iter().map(|(r, m)| *r * *m).collect();
    let mut direction = preconditioned.clone();
    let mut rho = dot(&residual, &preconditioned);
    for _ in 0..iterations {
        let image = system.apply(&direction);
        let step = ratio(rho, dot(&direction, &image));
        (&mut *x, &direction).into_par_iter().for_each(|(x, d)| *x += step * *d);
        (&mut residual, &image).into_par_iter().for_each(|(r, a)| *r -= step * *a);
        (&mut preconditioned, &residual, &inverse).into_par_iter().for_each(|(z, r, m)| *z = *r * *m);
        let next = dot(&residual, &preconditioned);
        let turn = ratio(next, rho);
        rho = next;
        (&mut direction, &preconditioned).into_par_iter().for_each(|(d, z)| *d = *z + turn * *d);
    }
}

/// Per channel, summed block by block in a fixed order.
fn dot(a: &[Vec3A], b: &[Vec3A]) -> [f64; 3] {
    let partial: Vec<[f64; 3]> = a
        .par_chunks(BLOCK)
        .zip(b.par_chunks(BLOCK))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| *a * *b).sum::<Vec3A>().to_array().map(f64::from))
        .collect();
    partial.iter().fold([0.0; 3], |sum, p| std::array::from_fn(|c| sum[c] + p[c]))
}

/// a / b per channel; 0 where b is: nothing is left to do there.
fn ratio(a: [f64; 3], b: [f64; 3]) -> Vec3A {
    Vec3A::from_array(std::array::from_fn(|c| if b[c] > 0.0 { (a[c] / b[c]) as f32 } else { 0.0 }))
}
