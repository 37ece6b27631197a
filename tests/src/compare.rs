//! Comparison with absolute and relative tolerance.

/// |got − expected| ≤ absolute + relative · |expected|, phrased so that NaN fails.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// In the unit of the values.
    pub absolute: f64,
    /// Share of the expected value.
    pub relative: f64,
}

impl Tolerance {
    /// The lanes that differ by more, described.
    pub fn failures(&self, got: &[f64], expected: &[f64]) -> Vec<String> {
        let within = |g: f64, e: f64| (g - e).abs() <= self.absolute + self.relative * e.abs();
        got.iter()
            .zip(expected)
            .enumerate()
            .filter(|(_, (g, e))| !within(**g, **e))
            .map(|(i, (g, e))| format!("lane {i}: {g} where {e} is expected, off by {:.3e}", g - e))
            .collect()
    }

    /// Fails with every lane that differs by more. No lanes, or a different number of them, fail as well.
    pub fn check(&self, what: &str, got: &[f64], expected: &[f64]) {
        assert!(!expected.is_empty(), "{what}: nothing was compared");
        assert_eq!(got.len(), expected.len(), "{what}: number of lanes");
        let failures = self.failures(got, expected);
        assert!(
            failures.is_empty(),
            "{what}: {} of {} lanes are further off than {self:?}:\n{}",
            failures.len(),
            got.len(),
            failures.join("\n")
        );
    }
}

/// All components of `f32` triples, as lanes.
pub fn lanes3<'a>(values: impl IntoIterator<Item = &'a [f32; 3]>) -> Vec<f64> {
    values.into_iter().flatten().map(|&v| f64::from(v)).collect()
}

/// `f32`s as lanes.
pub fn lanes<'a>(values: impl IntoIterator<Item = &'a f32>) -> Vec<f64> {
    values.into_iter().map(|&v| f64::from(v)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOLERANCE: Tolerance = Tolerance { absolute: 1e-3, relative: 0.01 };

    #[test]
    fn every_failing_lane_is_reported_and_nan_fails() {
        let failures = TOLERANCE.failures(&[1.0, 1.02, 0.0005, f64::NAN], &[1.0, 1.0, 0.0, 1.0]);
        assert_eq!(failures.len(), 2, "{failures:?}");
        assert!(failures[0].starts_with("lane 1") && failures[1].starts_with("lane 3"));
    }

    #[test]
    #[should_panic(expected = "nothing was compared")]
    fn comparing_nothing_fails() {
        TOLERANCE.check("empty", &[], &[]);
    }
}
