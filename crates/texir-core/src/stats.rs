//! Single numbers that stand for many.

/// The median, as one of the values: of an even count, the upper of the two in the middle. `None` without values; they
/// change places.
pub(crate) fn median(values: &mut [f32]) -> Option<f32> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// 0 of nothing.
pub(crate) fn root_mean_square(values: &[f32]) -> f32 {
    (values.iter().map(|value| value.powi(2)).sum::<f32>() / values.len().max(1) as f32).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_one_of_the_values() {
        assert_eq!(median(&mut []), None);
        assert_eq!(median(&mut [7.0]), Some(7.0));
        assert_eq!(median(&mut [9.0, -1.0, 4.0]), Some(4.0));
        assert_eq!(median(&mut [9.0, 4.0, -1.0, 5.0]), Some(5.0));
        assert_eq!(median(&mut [f32::INFINITY, 2.0, f32::NEG_INFINITY]), Some(2.0));
    }
}
