//! Drawing one of several in proportion to weights, by inverting their running sums.

use crate::rng::BELOW_ONE;

/// Inverts a CDF: the item at `u` in [0, 1), and how far `u` lies within its share, in [0, 1): what is
/// left of a number that chose an item is still uniform, so that well-spread points stay so within each item.
pub fn sample_cdf(items: usize, cdf: impl Fn(usize) -> f32, u: f32) -> (usize, f32) {
    let (mut low, mut high) = (0, items - 1);
    while low < high {
        let middle = (low + high) / 2;
        if cdf(middle) <= u {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    let before = if low > 0 { cdf(low - 1) } else { 0.0 };
    (low, ((u - before) / (cdf(low) - before)).clamp(0.0, BELOW_ONE))
}

/// Running sums of weights over their total; 1 from the last weight above 0 on, whatever was rounded.
pub(crate) fn cdf(weights: &[f32]) -> Vec<f32> {
    let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
    let last = weights.iter().rposition(|&w| w > 0.0).unwrap_or(0);
    let mut sum = 0.0;
    let up_to = |(i, &weight): (usize, &f32)| {
        sum += f64::from(weight);
        if i < last { (sum / total) as f32 } else { 1.0 }
    };
    weights.iter().enumerate().map(up_to).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverting_draws_in_proportion_and_leaves_a_uniform_rest() {
        let weights = [0.1, 2.0, 0.0, 0.7, 1.2, 0.0];
        let cdf = cdf(&weights);
        assert_eq!(cdf[4..], [1.0, 1.0]);
        const N: u32 = 100_000;
        let (mut count, mut rest) = ([0.0f32; 6], [0.0f32; 6]);
        for i in 0..N {
            let (item, r) = sample_cdf(6, |i| cdf[i], (i as f32 + 0.5) / N as f32);
            assert!((0.0..1.0).contains(&r));
            count[item] += 1.0;
            rest[item] += r;
        }
        for item in 0..6 {
            assert!((count[item] / N as f32 - weights[item] / 4.0).abs() < 1e-4, "{item}: {count:?}");
            assert!(weights[item] == 0.0 || (rest[item] / count[item] - 0.5).abs() < 1e-3, "{item}: {rest:?}");
        }
        assert_eq!(sample_cdf(6, |i| cdf[i], BELOW_ONE).0, 4);
    }
}
