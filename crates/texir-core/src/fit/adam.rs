//! Adam on the host (Kingma and Ba, "Adam: A Method for Stochastic Optimization", 2015, algorithm 1).

use rayon::prelude::*;

use super::settings::OptimiserSettings;

/// First and second moments of one parameter array.
pub struct Adam {
    settings: OptimiserSettings,
    moments: Vec<[f32; 2]>,
    steps: i32,
}

impl Adam {
    /// Fresh moments for `parameters` numbers.
    pub fn new(settings: &OptimiserSettings, parameters: usize) -> Self {
        Self { settings: settings.clone(), moments: vec![[0.0; 2]; parameters], steps: 0 }
    }

    /// Goes on after `steps` steps with the moments they left.
    pub fn resume(settings: &OptimiserSettings, moments: Vec<[f32; 2]>, steps: u32) -> Self {
        Self { settings: settings.clone(), moments, steps: steps as i32 }
    }

    /// First and second moment of each parameter, and the number of steps taken.
    pub fn state(&self) -> (&[[f32; 2]], u32) {
        (&self.moments, self.steps as u32)
    }

    /// One step of size `learning_rate` against `gradient`, then the clamp to `range`.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32], learning_rate: f32, range: [f32; 2]) {
        self.steps += 1;
        let OptimiserSettings { beta1, beta2, epsilon, .. } = self.settings;
        let (bias1, bias2) = (1.0 - beta1.powi(self.steps), 1.0 - beta2.powi(self.steps));
        let update = |((p, [m, v]), &g): ((&mut f32, &mut [f32; 2]), &f32)| {
            *m = beta1 * *m + (1.0 - beta1) * g;
            *v = beta2 * *v + (1.0 - beta2) * g * g;
            *p = (*p - learning_rate * (*m / bias1) / ((*v / bias2).sqrt() + epsilon)).clamp(range[0], range[1]);
        };
        const BLOCK: usize = 1 << 14;
        parameters
            .par_chunks_mut(BLOCK)
            .zip(self.moments.par_chunks_mut(BLOCK))
            .zip(gradient.par_chunks(BLOCK))
            .for_each(|((p, m), g)| p.iter_mut().zip(m).zip(g).for_each(update));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_size_of_the_learning_rate_whatever_the_gradient() {
        let mut adam = Adam::new(&OptimiserSettings::default(), 3);
        let mut p = [0.5, 0.5, 0.5];
        adam.step(&mut p, &[3.0, -1e-4, 0.0], 0.03, [0.0, 1.0]);
        assert!((p[0] - 0.47).abs() < 1e-5 && (p[1] - 0.53).abs() < 1e-5 && p[2] == 0.5, "{p:?}");
    }

    #[test]
    fn two_steps_follow_the_published_recurrence() {
        let mut adam = Adam::new(&OptimiserSettings::default(), 1);
        let mut p = [0.0f32];
        for g in [1.0, -2.0] {
            adam.step(&mut p, &[g], 0.1, [-1.0, 1.0]);
        }
        // m̂ = (0.09 − 0.2)/0.19, v̂ = (0.999·0.001 + 0.004)/0.001999
        let expected = -0.1 + 0.1 * (0.11 / 0.19) / (0.004_999f64 / 0.001_999).sqrt();
        assert!((f64::from(p[0]) - expected).abs() < 1e-6, "{} against {expected}", p[0]);
    }

    #[test]
    fn a_quadratic_is_minimised_within_its_range() {
        let mut adam = Adam::new(&OptimiserSettings::default(), 2);
        let mut p = [0.9f32, 0.9];
        for _ in 0..500 {
            let gradient = [2.0 * (p[0] - 0.3), 2.0 * (p[1] + 1.0)];
            adam.step(&mut p, &gradient, 0.03, [0.0, 1.0]);
        }
        assert!((p[0] - 0.3).abs() < 0.01 && p[1] == 0.0, "{p:?}");
    }
}
